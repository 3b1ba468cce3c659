"""The panel of forces: what is held and what is bounded, in newtons, without impulses."""

from __future__ import annotations

import numpy as np
import pytest

import mbocp
from mbocp import Solution
from mbocp.view.figures.forces import force_panels
from mbocp.view.figures.panels import multiplier_panels
from tests.holds.cases import pendulum
from tests.integrators.conftest import interpreted
from tests.problem.test_impulse_bounds import lands

__all__ = ["interpreted"]

pytestmark = pytest.mark.usefixtures("interpreted")


@pytest.fixture
def solved(interpreted: None) -> Solution:
    return mbocp.solve(lands(), check=True)


def test_the_panel_has_the_size_of_each_force(solved: Solution) -> None:
    (panel,) = force_panels(solved)
    assert panel.names == ("tip",)
    assert panel.step
    sizes = panel.values[:, 0]
    (contact,) = lands().contacts
    np.testing.assert_allclose(sizes[7:10], np.linalg.norm(contact.wrenches(solved.lams)[7:10, :3], axis=1))
    assert sizes[6] == sizes[5] == 0.0  # the impact has an impulse, and no force
    assert np.linalg.norm(solved.lams[6]) > 0.0
    assert sizes[10] == sizes[9]  # the parting


def test_it_is_among_the_multipliers_where_something_is_held(solved: Solution) -> None:
    assert "Forces of constraints" in [panel.title for panel in multiplier_panels(solved)]
    free = mbocp.solve(pendulum(holds=(), impacts=()))
    assert not force_panels(free)
