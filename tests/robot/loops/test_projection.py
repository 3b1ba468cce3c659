"""Closing loops: redundant rows, assembly, and what cannot be closed."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbocp.exceptions import LoopNotClosed, RobotFileError, UnknownFrame, UnknownJoint, UnsupportedRobot
from mbocp.robot import Robot, describe, load_robot, singular_closure
from mbocp.robot.loops.projection import follow, gauss_newton
from mbocp.robot.loops.redundancy import singular_pose
from tests.robot import urdfs
from tests.robot.loops import builders as loops

POSED = loops.MOTOR + loops.OPEN_POSE
STRIKER = '[[constraint]]\ntype = "point"\nname = "{}"\nframes = ["coupler_end", "rocker_end"]\n'


def four_bar(folder: Path, closure: str = loops.HINGE, **options: object) -> Robot:
    return loops.load(folder, loops.four_bar(), POSED + closure, **options)


def names(robot: Robot) -> list[str]:
    return [robot.closure_labels[i].name for i in robot.redundant_rows]


# Redundant rows


@pytest.mark.parametrize(
    ("closure", "redundant"),
    [(loops.POINT, ["pin.y"]), (loops.HINGE, ["pin.y", "pin.tilt_1", "pin.tilt_2"])],
)
def test_a_planar_loop_keeps_two_rows(tmp_path: Path, closure: str, redundant: list[str]) -> None:
    robot = four_bar(tmp_path, closure)
    assert names(robot) == redundant
    assert (robot.nc, robot.nv - robot.nc, len(robot.constraint_labels)) == (2, 1, 2)
    for q in (robot.q0, robot.assemble(robot.q0 + np.array([0.4, 0.0, 0.0]), fixed=["crank"])):
        np.testing.assert_allclose(robot.closure_residual(q), 0.0, atol=1e-13)
        assert robot.constraint_jacobian(q).shape == (2, 3)
        assert np.linalg.matrix_rank(robot.closure_jacobian(q), tol=1e-9) == 2


@pytest.mark.parametrize("tilt", ["0 0 0.7", "1.5708 0 0", "0.3 0.4 0.5"])
def test_a_loop_may_lie_in_any_plane(tmp_path: Path, tilt: str) -> None:
    """Rows turn with frame b; six digits of an angle make no row independent."""
    robot = loops.load(tmp_path, loops.four_bar(tilt=tilt), POSED + loops.HINGE)
    assert robot.nc == 2
    np.testing.assert_allclose(robot.constraint_residual(robot.q0), 0.0, atol=1e-13)


def test_six_digits_of_a_joint_are_enough(tmp_path: Path) -> None:
    urdf = loops.four_bar().replace(
        f'xyz="{loops.GROUND} 0 0" rpy="0 0 0"', f'xyz="{loops.GROUND} 0.000001 0" rpy="0.000003 0 0.000002"'
    )
    robot = loops.load(tmp_path, urdf, POSED + loops.HINGE)
    assert robot.nc == 2
    np.testing.assert_allclose(robot.constraint_residual(robot.q0), 0.0, atol=1e-13)
    assert 1e-9 < np.abs(robot.closure_residual(robot.q0)).max() < 1e-4


def test_a_loop_that_turns_with_its_base_keeps_its_rank(tmp_path: Path) -> None:
    urdf = loops.four_bar().replace('name="mount" type="fixed"', 'name="mount" type="continuous"')
    urdf = urdf.replace('child link="frame"/><axis xyz="0 -1 0"/>', 'child link="frame"/><axis xyz="0 0 1"/>')
    robot = loops.load(tmp_path, urdf, POSED + loops.HINGE)
    assert robot.nc == 2
    for turn in np.linspace(0.0, 3.0, 7):
        v = np.zeros(robot.nv)
        v[robot.velocity_indices("mount")] = turn
        q = robot.integrate(robot.q0, v)
        np.testing.assert_allclose(robot.closure_residual(q), 0.0, atol=1e-13)
        singular = np.linalg.svd(robot.constraint_jacobian(q), compute_uv=False)
        np.testing.assert_allclose(singular, np.linalg.svd(robot.constraint_jacobian(robot.q0))[1], rtol=1e-9)


def test_redundant_rows_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, logger="mbocp"):
        robot = four_bar(tmp_path)
    assert "redundant rows left out: 'pin.y', 'pin.tilt_1', 'pin.tilt_2'" in caplog.text
    told = describe(robot)
    assert (told["mobility"], told["actuated"], told["passive"]) == (1, ["crank"], ["coupler", "rocker"])
    (pin,) = told["constraints"]
    assert pin["redundant_rows"] == names(robot)
    assert len(pin["rows"]) == 5


def test_the_fingerprint_knows_the_rows(tmp_path: Path) -> None:
    prints = {four_bar(tmp_path / str(i), c).fingerprint for i, c in enumerate((loops.POINT, loops.HINGE))}
    assert len(prints) == 2
    robot = four_bar(tmp_path)
    assert load_robot(tmp_path).fingerprint == robot.fingerprint


# What is refused


def test_a_duplicated_constraint(tmp_path: Path) -> None:
    with pytest.raises(
        UnsupportedRobot, match="constraint 'second' is a duplicate: 'first' implies it; take"
    ):
        four_bar(tmp_path, STRIKER.format("first") + STRIKER.format("second"))


def test_a_constraint_that_follows_from_several(tmp_path: Path) -> None:
    gear = '[[constraint]]\ntype = "coupling"\nname = "{}"\njoints = ["{}", "{}"]\n'
    gears = gear.format("ab", "j1", "j2") + gear.format("bc", "j2", "j3") + gear.format("ca", "j3", "j1")
    with pytest.raises(UnsupportedRobot, match=r"constraint 'ca' follows from the others \('ab', 'bc'\)"):
        loops.load(tmp_path, urdfs.chain("revolute", "revolute", "revolute", "revolute"), gears)


def test_a_constraint_on_nothing_that_moves(tmp_path: Path) -> None:
    idle = '[[constraint]]\ntype = "plane"\nname = "floor"\nframes = ["coupler_end", "world"]\n'
    idle += "normal = [0, 1, 0]\n"
    with pytest.raises(UnsupportedRobot, match="constraint 'floor' holds nothing that moves"):
        four_bar(tmp_path, loops.HINGE + idle)


def test_a_robot_whose_only_constraint_holds_nothing(tmp_path: Path) -> None:
    """Then there is no row at all to keep."""
    idle = '[[constraint]]\ntype = "plane"\nname = "floor"\nframes = ["coupler_end", "world"]\n'
    with pytest.raises(UnsupportedRobot, match="constraint 'floor' holds nothing that moves"):
        four_bar(tmp_path, idle + "normal = [0, 1, 0]\n")
    with pytest.raises(UnsupportedRobot, match="constraint 'pin' holds nothing that moves"):
        four_bar(tmp_path, loops.HINGE.replace('"rocker_end"', '"crank"').replace('"coupler_end"', '"world"'))


@pytest.mark.parametrize("beside", [5e-324, 1e-200, 1e-120])
def test_a_pose_as_good_as_singular_closes_like_a_singular_one(beside: float) -> None:
    """The gradient of a rod between frames at one place is no number any more when it is squared."""
    robot = load_robot("rigid_pendulum")
    np.testing.assert_array_equal(robot.assemble([beside, 0.0, 0.0]), robot.assemble(np.zeros(3)))


def test_a_weld_locks_a_planar_loop(tmp_path: Path) -> None:
    crank, coupler, rocker = four_bar(tmp_path).q0
    end = loops.tip("rocker_end", "rocker_link", loops.ROCKER)
    turned = loops.tip("rocker_end", "rocker_link", loops.ROCKER, f"0 {rocker - crank - coupler} 0")
    urdf = loops.four_bar().replace(end, turned)
    with pytest.raises(
        UnsupportedRobot, match=r"\('pin'\) leave nothing that moves: 3 independent.*\"hinge\""
    ):
        loops.load(tmp_path, urdf, POSED + loops.WELD)


def test_a_loop_that_cannot_close(tmp_path: Path) -> None:
    urdf = loops.four_bar().replace(f'xyz="{loops.GROUND} 0 0"', 'xyz="1.9 0 0"')
    with pytest.raises(
        LoopNotClosed, match=r"cannot be closed: the nearest configuration violates 'pin\.x' by"
    ):
        loops.load(tmp_path, urdf, loops.HINGE)


def test_unknown_frames_and_joints(tmp_path: Path) -> None:
    with pytest.raises(UnknownFrame, match="no frame 'coupler_tip'"):
        four_bar(tmp_path, loops.HINGE.replace("coupler_end", "coupler_tip"))
    gear = '[[constraint]]\ntype = "coupling"\njoints = ["crank", "{}"]\n'
    with pytest.raises(UnknownJoint, match="no joint 'rockr': did you mean 'rocker'"):
        four_bar(tmp_path, gear.format("rockr"))
    with pytest.raises(RobotFileError, match=r"constraint\[0\]: joints must be two different joints"):
        four_bar(tmp_path, gear.format("crank"))
    with pytest.raises(RobotFileError, match=r"constraint\[0\]\.joints: joint 'rocker' is locked"):
        four_bar(tmp_path, gear.format("rocker"), lock=["rocker"])
    with pytest.raises(RobotFileError, match=r"constraint\[0\]\.joints: joint 'j2' is floating and has 6"):
        loops.load(
            tmp_path,
            urdfs.chain("revolute", "floating"),
            '[[constraint]]\ntype = "coupling"\njoints = ["j1", "j2"]\n',
        )


WRONG = {
    r"constraint\[0\]\.axis: must not be zero": loops.HINGE.replace("[0, 1, 0]", "[0, 0, 0]"),
    r"constraint\[0\]\.length: unknown key; valid names: name, frames, position, .*, orientation_b, type$": (
        loops.POINT + "length = 1\n"
    ),
    r"constraint\[0\]: ratio must not be zero": (
        '[[constraint]]\ntype = "coupling"\njoints = ["crank", "rocker"]\nratio = 0\n'
    ),
    r"constraint\[0\]\.axes: unknown key; did you mean 'axis'": loops.HINGE.replace("axis", "axes"),
}


@pytest.mark.parametrize("message", WRONG)
def test_wrong_keys_are_refused(tmp_path: Path, message: str) -> None:
    with pytest.raises(RobotFileError, match=message):
        four_bar(tmp_path, WRONG[message])


# Assembly


def test_the_initial_pose_keeps_the_motors(tmp_path: Path) -> None:
    robot = four_bar(tmp_path)
    assert robot.q0[robot.configuration_indices("crank")] == 1.0
    np.testing.assert_allclose(robot.q0[robot.configuration_indices("coupler")], -0.551, atol=1e-3)


def test_assembly_takes_the_shortest_way(tmp_path: Path) -> None:
    """To first order the correction is normal to the constraints in the kinetic metric."""
    robot = four_bar(tmp_path)
    away = 1e-4 * np.random.default_rng(1).standard_normal(3)
    closed = robot.assemble(robot.q0 + away)
    np.testing.assert_allclose(robot.constraint_residual(closed), 0.0, atol=1e-14)
    along = robot.assemble_velocity(closed, [1.0, 0.0, 0.0])
    moved = robot.mass_matrix(closed) @ (closed - robot.q0 - away)
    assert abs(along @ moved) < 1e-3 * np.linalg.norm(along) * np.linalg.norm(moved)
    np.testing.assert_allclose(robot.assemble(closed), closed, atol=1e-14)


def test_assembly_of_velocities_is_a_projection(tmp_path: Path) -> None:
    robot = four_bar(tmp_path)
    v = np.array([0.3, -1.0, 2.0])
    along = robot.assemble_velocity(robot.q0, v)
    np.testing.assert_allclose(robot.closure_jacobian(robot.q0) @ along, 0.0, atol=1e-13)
    np.testing.assert_allclose(robot.assemble_velocity(robot.q0, along), along, atol=1e-13)
    assert abs(along @ robot.mass_matrix(robot.q0) @ (along - v)) < 1e-12
    held = robot.assemble_velocity(robot.q0, [1.0, 0.0, 0.0], fixed=["crank"])
    assert held[robot.velocity_indices("crank")] == 1.0
    np.testing.assert_allclose(robot.closure_jacobian(robot.q0) @ held, 0.0, atol=1e-13)


def test_fixed_joints_stay_or_it_is_said_why_not(tmp_path: Path) -> None:
    robot = four_bar(tmp_path)
    q = robot.assemble(robot.q0 + np.array([0.2, 0.0, 0.0]), fixed=["crank"])
    assert q[0] == robot.q0[0] + 0.2
    with pytest.raises(
        LoopNotClosed, match=r"with 'rocker' held.*violates 'pin\.x' by.*other positions of 'rocker'"
    ):
        robot.assemble([0.0, 0.0, 0.2], fixed=["rocker"])
    with pytest.raises(UnknownJoint, match="no joint 'rockr'"):
        robot.assemble(robot.q0, fixed=["rockr"])


def test_robots_without_constraints_need_no_assembly() -> None:
    robot = load_robot("ur5")
    q, v = robot.q0 + 0.3, np.ones(robot.nv)
    np.testing.assert_array_equal(robot.assemble(q), q)
    np.testing.assert_array_equal(robot.assemble_velocity(q, v), v)
    assert singular_closure(robot, np.array([q])) == ""


def test_a_full_turn_of_the_crank_leads_back(tmp_path: Path) -> None:
    robot = four_bar(tmp_path)
    crank = np.zeros(3, dtype=bool)
    crank[robot.velocity_indices("crank")] = True
    q = np.array(robot.q0)
    for _ in range(4):
        target = q.copy()
        target[robot.configuration_indices("crank")] += np.pi / 2
        q = follow(robot, q, target, crank)
        np.testing.assert_array_equal(q[crank], target[crank])
        np.testing.assert_allclose(robot.closure_residual(q), 0.0, atol=1e-13)
    turned = np.where(crank, 2 * np.pi, [0.0, -2 * np.pi, 0.0])  # the coupler turns back on the crank
    np.testing.assert_allclose(q, robot.q0 + turned, atol=1e-12)


def test_a_motion_through_a_singular_pose_is_told(tmp_path: Path) -> None:
    """A parallelogram that is stretched may go on as a parallelogram or as an antiparallelogram."""
    urdf = loops.four_bar().replace(f'xyz="{loops.GROUND} 0 0"', f'xyz="{loops.COUPLER} 0 0"')
    urdf = urdf.replace(f'xyz="{loops.ROCKER} 0 0"', f'xyz="{loops.CRANK} 0 0"')
    toml = POSED.replace("coupler = -0.5, rocker = 1.6", "coupler = -1.0, rocker = 1.0") + loops.HINGE
    robot = loops.load(tmp_path, urdf, toml)
    cranks = np.linspace(1.0, -1.0, 101)
    qs = np.column_stack([cranks, -cranks, cranks])
    assert np.abs([robot.closure_residual(q) for q in qs]).max() < 1e-14
    words = singular_closure(robot, qs)
    assert words.startswith("near a singular configuration at node 50: there the constraint 'pin.x' holds")
    assert singular_closure(robot, qs[:40]) == ""
    between = (qs[1:] + qs[:-1]) / 2  # linear in the crank, and closed, too
    words = singular_closure(robot, between)
    assert words.startswith("through a singular configuration between nodes 49 and 50: there")
    assert singular_closure(robot, np.full_like(qs, np.nan)) == ""
    assert singular_closure(robot, qs + 0.1) == ""  # not closed


def test_rows_left_out_must_stay_implied(tmp_path: Path) -> None:
    robot = four_bar(tmp_path)
    dropped = replace(robot, redundant_rows=(1, 2, 3, 4))  # pin.z is one too many
    told = "the constraint 'pin.z', left out because the others imply it, "
    assert singular_closure(dropped, np.tile(robot.q0, (5, 1))) == f"{told}is independent of them at node 0"
    assert singular_pose(dropped, robot.q0) == f"{told}is independent of them there"
    aside = robot.q0 + np.array([0.1, 0.2, 0.3])
    slid = gauss_newton(dropped, aside, np.ones(3, dtype=np.bool_), dropped.kept_rows)
    words = singular_closure(dropped, np.array([robot.q0, slid]))
    assert words.startswith(f"{told}is violated by")
    assert words.endswith(" m at node 1")
    assert singular_pose(robot, robot.q0) == ""
