"""Table 3 counts nodes; Table 4's layout; unknown tables."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mbocp_papers.so3 import FORMULATIONS
from mbocp_papers.so3.counts import nodes_table, step_function, step_nodes
from mbocp_papers.so3.data import formulation
from mbocp_papers.so3.request import Request
from mbocp_papers.so3.tables import TITLES, check_table, make_table
from mbocp_papers.so3.timings import IterationTime, _row

from mbocp.exceptions import InvalidValue
from mbocp.robot import load_robot


def test_table_3_has_the_paper_s_numbers() -> None:
    table = make_table(3, Request())
    text = table.markdown()
    for one in FORMULATIONS:
        assert f"| {one.label} | {' | '.join(map(str, one.nodes))} |" in text
    assert table.data["Q RK-MK"]["paper"] == [903, 49]


def test_nodes_grow_from_plain_to_group() -> None:
    robot = load_robot("unicycle_pendulum")
    for rotations in ("Q", "DCM"):
        found = [step_nodes(robot, formulation(f"{rotations} {lie}")) for lie in ("RK", "RK+BG", "RK-MK")]
        totals = [nodes.step + nodes.exponential for nodes in found]
        assert totals == sorted(totals)
        assert [nodes.exponential > 0 for nodes in found] == [False, False, True]
        for nodes in found:
            assert 0.8 * nodes.step < nodes.merged_step <= nodes.step


def test_nodes_are_of_the_paper_s_order() -> None:
    """The equations come from a URDF and not from a hand, within a factor of two."""
    for one, row in zip(FORMULATIONS, nodes_table().sections[0].blocks, strict=True):
        ratio = float(row[0][-2])
        assert 1.0 < ratio < 2.0, one.label


def test_the_step_counted_is_a_step() -> None:
    """Hanging at rest with no control nothing moves; a push moves the unicycle along x."""
    robot = load_robot("unicycle_pendulum")
    for one in FORMULATIONS:
        step = step_function(robot, one)
        turn = [1, 0, 0, 0] if one.rotations == "quaternion" else [1, 0, 0, 0, -1, 0, 0, 0, -1]
        rest = [0, 0, *turn, 0, 0, 0, 0, 0]
        still = np.vstack([o.full() for o in step([*rest, 0, 0], 0.03, [2, 1, 0])]).ravel()
        assert abs(still - rest).max() < 1e-14
        pushed = np.vstack([o.full() for o in step([*rest, 0, 2.0], 0.03, [2, 1, 0])]).ravel()
        assert math.isclose(pushed[-1], 0.06)
        assert math.isclose(pushed[0], 0.5 * 2.0 * 0.03**2)


def test_rows_of_table_4() -> None:
    converged = IterationTime(2.0, 2.5, 40, "converged")
    failed = IterationTime(math.nan, math.nan, 0, "diverged")
    row = _row(formulation("DCM RK-MK"), [converged, failed])
    assert row == ("DCM RK-MK", "148", "2.00", "2.50", "74.0", "40", "-", "-", "-", "0 (diverged)")
    assert failed.to_dict() == {"milliseconds": None, "mean": None, "iterations": 0, "status": "diverged"}


def test_unknown_tables_are_refused() -> None:
    assert list(TITLES) == [3, 4]
    with pytest.raises(InvalidValue, match="--table: got 1, expected one of 3, 4"):
        check_table(1)
