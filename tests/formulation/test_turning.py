"""Which changes of a state are angles."""

from __future__ import annotations

import numpy as np
import pytest

from mbocp.formulation.layout import StateLayout
from mbocp.formulation.schemes.joint_states import find_turning_factors
from mbocp.lie import ConfigurationSpace
from mbocp.robot.kinematics import turns
from tests.mechanics.models import chain


@pytest.mark.parametrize(
    ("kinds", "angles"),
    [("RY", [1]), ("PX", [0]), ("RY PX", [1, 0]), ("PX RUBZ", [0, 1]), ("FreeFlyer", [0] * 6)],
)
def test_angles_of_joints_count(kinds: str, angles: list[int]) -> None:
    model, _ = chain(kinds)
    layout = StateLayout(nz=model.nq, nv=model.nv, ns=model.nv, is_flat=False)
    factors = find_turning_factors(turns(model), ConfigurationSpace(model, "quaternion"), layout)
    np.testing.assert_allclose(factors, [*angles, *[0] * model.nv], atol=1e-15)
