"""The table of robots with closed loops, of two robots of one's own."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent.parent))  # not part of the package

from benchmarks.parallel_robots import folders_of_robots, robot_rows, robot_table
from tests.robot.loops.test_undriven import five_bar


@pytest.mark.filterwarnings("ignore::mbocp.robot.HeldJointsWarning")
def test_robots_are_moved_or_it_says_why_not(tmp_path: Path) -> None:
    five_bar(tmp_path / "five")
    (tmp_path / "notes").mkdir()
    broken = tmp_path / "torn"
    broken.mkdir()
    (broken / "robot.urdf").write_text((tmp_path / "five" / "robot.urdf").read_text())
    (broken / "robot.yaml").write_text("closed_loop: [['tip_A', 'nowhere']]\n")
    folders = folders_of_robots(tmp_path)
    assert [folder.name for folder in folders] == ["five", "torn"]
    table = robot_table(list(robot_rows(folders, reaches=(400.0, 0.2))))
    five, torn = (dict(zip(table.columns, row, strict=True)) for row in table.rows)
    assert (five["unknowns"], five["rows"], five["rank"], five["joints held"]) == ("5", "6", "3", "1")
    assert (five["reach [rad, m]"], five["status"]) == ("0.2", "converged")
    assert "over 300 rad at most" in five["why not, or why not farther"]
    assert torn["loaded"] == "no"
    assert "nowhere" in torn["why not, or why not farther"]
    assert str(tmp_path) not in torn["why not, or why not farther"]
