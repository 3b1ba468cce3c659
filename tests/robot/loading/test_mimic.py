"""Mimic joints of a URDF: chains of them, and limits of those that follow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from mbocp.robot import NotModelledWarning, Robot, load_robot
from tests.robot import urdfs
from tests.robot.urdfs import joint, link, mimic

WIDE = '<limit lower="-3" upper="3" effort="3" velocity="10"/>'


def arm(folder: Path, follower: str, leader: str = WIDE, kind: str = "revolute") -> Robot:
    """A joint "a" and one, "b", that follows it."""
    text = urdfs.robot(
        link("base", None),
        link("la"),
        joint("a", kind, "base", "la", extra=leader),
        link("lb"),
        joint("b", kind, "la", "lb", extra=follower),
    )
    return load_robot(urdfs.write(folder, text))


def tied(multiplier: float, offset: float, limit: str) -> str:
    return limit + f'<mimic joint="a" multiplier="{multiplier}" offset="{offset}"/>'


def test_one_that_mimics_a_mimic_joint_follows_the_leader_of_both(tmp_path: Path) -> None:
    """c = 0.5 b + 0.2 and b = -2 a + 0.1: c = -a + 0.25."""

    def text(last: str) -> str:
        return urdfs.robot(
            link("base", None),
            link("la"),
            joint("a", "revolute", "base", "la"),
            link("lb"),
            joint("b", "prismatic", "la", "lb", axis="0 1 0", extra=mimic("a", -2.0, 0.1)),
            link("lc"),
            joint("c", "revolute", "lb", "lc", axis="1 0 0", extra=last),
        )

    chained = load_robot(urdfs.write(tmp_path / "chained", text(mimic("b", 0.5, 0.2))))
    direct = load_robot(urdfs.write(tmp_path / "direct", text(mimic("a", -1.0, 0.25))))
    assert chained.nv == 1
    q, v, a = np.random.default_rng(0).standard_normal((3, 1))
    data = [robot.model.createData() for robot in (chained, direct)]
    forces = [pin.rnea(r.model, d, q, v, a) for r, d in zip((chained, direct), data, strict=True)]
    np.testing.assert_allclose(forces[0], forces[1], rtol=1e-13)
    np.testing.assert_allclose(data[0].oMi[3].homogeneous, data[1].oMi[3].homogeneous, atol=1e-13)


def test_leaders_may_come_later_by_name(tmp_path: Path) -> None:
    """A left finger and its tip follow the right ones, whose names come later."""

    def text(*names: str) -> str:
        leader, tip, left, left_tip = names
        return urdfs.robot(
            link("base"),
            *(link(name) for name in ("palm", "l", "lt", "r", "rt")),
            joint("z", "revolute", "base", "palm"),
            joint(left, "revolute", "palm", "l", axis="1 0 0", extra=mimic(leader, -1.0, 0.1)),
            joint(left_tip, "revolute", "l", "lt", axis="0 1 0", extra=mimic(tip, 0.5, 0.0)),
            joint(leader, "revolute", "palm", "r", axis="1 0 0"),
            joint(tip, "revolute", "r", "rt", axis="0 1 0"),
        )

    late = load_robot(urdfs.write(tmp_path / "late", text("r", "r_tip", "l", "l_tip")), free_flyer=True)
    first = load_robot(urdfs.write(tmp_path / "first", text("a", "a_tip", "b", "b_tip")), free_flyer=True)
    assert late.joint_names == ("root_joint", "z", "r", "r_tip", "l", "l_tip")
    assert (late.nv, late.nu) == (first.nv, first.nu) == (9, 3)
    q = late.integrate(late.q0, np.linspace(-0.5, 0.5, 9))
    v, a = np.random.default_rng(0).standard_normal((2, 9))
    forces = [pin.rnea(each.model, each.model.createData(), q, v, a) for each in (late, first)]
    np.testing.assert_allclose(*forces, rtol=1e-13)
    for name in ("l", "lt", "rt"):
        ours, theirs = late.frame_placement(name, q), first.frame_placement(name, q)
        np.testing.assert_allclose(ours.homogeneous, theirs.homogeneous, atol=1e-13)


@pytest.mark.parametrize(
    ("multiplier", "offset", "expected"),
    [(2.0, 0.5, (-0.75, 0.25)), (-0.5, 0.0, (-2.0, 2.0)), (0.0, 0.4, (-3, 3))],
)
def test_limits_of_a_follower_narrow_those_of_its_leader(
    tmp_path: Path, multiplier: float, offset: float, expected: tuple[float, float]
) -> None:
    """-1 <= m q + o <= 1, and |m v| <= 4."""
    limit = '<limit lower="-1" upper="1" effort="3" velocity="4"/>'
    limits = arm(tmp_path, tied(multiplier, offset, limit)).limits
    assert (limits.position_lower[0], limits.position_upper[0]) == pytest.approx(expected)
    assert limits.velocity[0] == pytest.approx(min(10.0, 4.0 / abs(multiplier) if multiplier else 10.0))


def test_a_follower_without_limits_narrows_nothing(tmp_path: Path) -> None:
    limits = arm(tmp_path, tied(5.0, 1.0, '<limit effort="3" velocity="0"/>')).limits
    assert (limits.position_lower[0], limits.position_upper[0], limits.velocity[0]) == (-3.0, 3.0, 10.0)


def test_limits_that_leave_the_leader_nowhere_to_move_are_left_out_and_told(tmp_path: Path) -> None:
    one_way = '<limit lower="0" upper="1" effort="3" velocity="4"/>'
    with pytest.warns(
        NotModelledWarning, match=r"position limits of 'b' leave 'a', which it mimics, nowhere"
    ):
        limits = arm(tmp_path, tied(-1.0, 0.0, one_way), leader=one_way).limits
    assert (limits.position_lower[0], limits.position_upper[0]) == (0.0, 1.0)


def test_a_continuous_leader_gets_the_speed_alone(tmp_path: Path) -> None:
    follower = tied(3.0, 0.0, '<limit lower="-1" upper="1" effort="3" velocity="6"/>')
    limits = arm(tmp_path, follower, leader="", kind="continuous").limits
    assert limits.velocity[0] == 2.0
    assert not np.isfinite(limits.position_lower).any()


def test_locking_a_leader_takes_the_whole_chain(tmp_path: Path) -> None:
    text = urdfs.robot(
        link("base", None),
        link("la"),
        joint("a", "revolute", "base", "la"),
        link("lb"),
        joint("b", "revolute", "la", "lb", extra=mimic("a", 2.0)),
        link("lc"),
        joint("c", "revolute", "lb", "lc", extra=mimic("b", 2.0)),
        link("ld"),
        joint("d", "revolute", "lc", "ld"),
    )
    path = urdfs.write(tmp_path, text)
    assert load_robot(path, lock={"a": 0.2}).joint_names == ("d",)
