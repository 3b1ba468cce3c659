"""The checker accepts what is right, and finds each thing that is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy import sparse

import mbocp
from tests.campaign.run import motion_of
from tests.campaign.tasks import Draw, draw
from tests.checker import Report, check_solution
from tests.checker.clearance import _clearance, true_distance
from tests.checker.conditions import Motion, joint_conditions, step_of
from tests.checker.differences import derivative
from tests.checker.following import _Along
from tests.checker.frames import bound_values, pose_values
from tests.checker.optimality import _Projection
from tests.checker.task import Ball, Shape


@pytest.fixture
def pendulum(tmp_path: Path) -> Draw:
    return draw("double_pendulum", 1, tmp_path)


def solved(task: Draw) -> Motion:
    return motion_of(mbocp.solve(mbocp.Problem.create(**task.tables), check=True))


def verdict(task: Draw, motion: Motion) -> Report:
    return check_solution(task.loaded.system, task.task, motion)


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("double_pendulum", 1),
        ("double_pendulum_se2", 0),
        ("double_pendulum_midpoint", 2),
        ("double_pendulum_natural", 0),
        ("double_pendulum_slow", 1),
        ("rigid_pendulum", 0),
        ("elastic_cart", 0),
        ("four_bar", 0),
        ("double_pendulum_span", 1),
        ("double_pendulum_gate", 1),
        ("elastic_pendulum_plane", 1),
        ("elastic_pendulum_line", 1),
        ("drone_level", 1),
        ("double_pendulum_via", 0),
        ("double_pendulum_via_box", 2),
        ("double_pendulum_pose", 0),
        ("double_pendulum_rates", 1),
        ("double_pendulum_free", 0),
        ("double_pendulum_fast", 1),
        ("double_pendulum_times", 0),
        ("double_pendulum_stages", 1),
        ("double_pendulum_follow", 0),
        ("elastic_pendulum_follow", 1),
        ("crate", 2),
    ],
)
def test_optima_pass(name: str, seed: int, tmp_path: Path) -> None:
    task = draw(name, seed, tmp_path)
    report = verdict(task, solved(task))
    assert report.failures == ()
    assert report.step < 1e-11
    assert report.cost < 1e-13
    assert report.stationarity < 1e-7


@pytest.mark.parametrize(
    "name",
    [
        "double_pendulum",
        "acrobot_midpoint",
        "rigid_pendulum",
        "four_bar",
        "quadrotor",
        "two_arms",
        "double_pendulum_span",
        "double_pendulum_gate",
        "elastic_pendulum_plane",
        "double_pendulum_via",
        "double_pendulum_via_box",
        "double_pendulum_pose",
        "double_pendulum_rates",
        "double_pendulum_free",
        "double_pendulum_times",
        "double_pendulum_stages",
        "double_pendulum_follow",
        "elastic_pendulum_follow",
        "clutter",
        "ur5_gate",
        "ur5_via",
        "ur5_pose",
    ],
)
def test_a_feasible_motion_fails_by_not_being_optimal_alone(name: str, tmp_path: Path) -> None:
    """The motions that tasks are built on satisfy everything else."""
    task = draw(name, 3, tmp_path)
    w = task.witness
    motion = Motion(w.qs, w.vs, w.us, duration=task.task.duration)
    motion = replace(motion, dts=np.full(task.task.num_steps, task.task.dt))
    motion = replace(motion, cost=joint_conditions(task.loaded.system, task.task, motion).cost)
    assert verdict(task, motion).failures == ("stationarity",)


def nudged(array: np.ndarray, row: int, by: float) -> np.ndarray:
    out = array.copy()
    out[row] += by * np.abs(array).max()
    return out


@pytest.mark.parametrize(
    ("field", "row", "by", "found"),
    [
        ("us", 7, 1e-6, "step"),
        ("vs", 7, 1e-6, "step"),
        ("qs", 7, 1e-6, "step"),
        ("qs", 0, 1e-9, "start"),
        ("vs", 0, 1e-9, "start"),
        ("qs", -1, 1e-6, "end"),
        ("vs", -1, 1e-6, "end"),
        ("us", 7, np.nan, "step"),
    ],
)
def test_a_number_that_is_wrong_is_found(field: str, row: int, by: float, found: str, pendulum: Draw) -> None:
    motion = solved(pendulum)
    broken = replace(motion, **{field: nudged(getattr(motion, field), row, by)})
    assert found in verdict(pendulum, broken).failures


def test_a_cost_that_is_wrong_is_found(pendulum: Draw) -> None:
    motion = solved(pendulum)
    assert verdict(pendulum, replace(motion, cost=motion.cost * (1 + 1e-8))).failures == ("cost",)


def test_a_loop_that_opens_is_found(tmp_path: Path) -> None:
    task = draw("four_bar", 0, tmp_path)
    motion = solved(task)
    assert "constraint" in verdict(task, replace(motion, qs=nudged(motion.qs, 9, 1e-6))).failures


def test_the_optimum_of_another_cost_is_found(pendulum: Draw) -> None:
    motion = solved(pendulum)
    heavier = replace(pendulum.task, velocity=1.1 * pendulum.task.velocity)
    report = check_solution(pendulum.loaded.system, heavier, motion)
    assert set(report.failures) == {"cost", "stationarity"}


@pytest.mark.parametrize(
    ("name", "key", "found"),
    [
        ("double_pendulum_span", "path", "limits"),
        ("double_pendulum_gate", "path", "end"),
        ("double_pendulum_via", "via", "end"),
        ("double_pendulum_via_box", "via", "limits"),
        ("double_pendulum_rates", "limits", "limits"),
        ("double_pendulum_follow", "path", "limits"),
        ("crate", "obstacle", "limits"),
    ],
)
def test_what_is_asked_and_not_met_is_found(name: str, key: str, found: str, tmp_path: Path) -> None:
    """The optimum of a task that leaves it out: it fails by this alone, if its optimum is another."""
    missed = []
    for seed in range(4):
        task = draw(name, seed, tmp_path)
        bare = {k: v for k, v in task.tables.items() if k != key}
        report = verdict(task, solved(replace(task, tables=bare)))
        missed.append(found in report.failures)
        assert set(report.failures) <= {found, "stationarity"}
    assert any(missed)


def test_a_goal_of_a_frame_that_is_missed_is_found(tmp_path: Path) -> None:
    task = draw("double_pendulum_pose", 1, tmp_path)
    motion = solved(task)
    assert verdict(task, motion).failures == ()
    (point,) = task.task.points
    (pose,) = point.frames
    moved = replace(point, frames=(replace(pose, position=pose.position + 1e-5),))
    report = check_solution(task.loaded.system, replace(task.task, points=(moved,)), motion)
    assert "end" in report.failures


def test_a_duration_that_is_not_the_best_is_found(tmp_path: Path) -> None:
    """Another weight of time, a duration out of its bounds, and one that is given where it is to be found."""
    task = draw("double_pendulum_free", 0, tmp_path)
    motion = solved(task)
    system, wanted = task.loaded.system, task.task
    assert verdict(task, motion).failures == ()
    dearer = check_solution(system, replace(wanted, time=1.1 * wanted.time), motion)
    assert set(dearer.failures) == {"cost", "stationarity"}
    shorter = replace(wanted, duration_range=(0.1 * motion.duration, 0.9 * motion.duration))
    assert "limits" in check_solution(system, shorter, motion).failures
    given = {**task.tables, "duration": 0.8 * motion.duration}
    given["cost"] = {key: value for key, value in task.tables["cost"].items() if key != "time"}
    other = solved(replace(task, tables=given))
    other = replace(other, cost=other.cost + wanted.time * other.duration)
    assert verdict(task, other).failures == ("stationarity",)


def test_times_that_are_not_the_best_are_found(tmp_path: Path) -> None:
    """The optimum for a time that is given; and one whose time is out of its bounds."""
    task = draw("double_pendulum_times", 0, tmp_path)
    free = solved(task)
    assert verdict(task, free).failures == ()
    (stop,) = task.task.stops
    time = float(free.dts[: stop.node].sum())
    late = replace(task.task, stops=(replace(stop, earliest=1.01 * time, latest=np.inf),))
    assert "limits" in check_solution(task.loaded.system, late, free).failures
    (via,) = task.tables["via"]
    given = {**task.tables, "via": [{**via, "time": {"min": 1.1 * time, "max": 1.1 * time}}]}
    assert verdict(task, solved(replace(task, tables=given))).failures == ("stationarity",)


def test_derivatives_of_clearances_and_paths(tmp_path: Path) -> None:
    """Away from the motion, too; and the rounded distance is near to coal's."""
    task = draw("clutter", 1, tmp_path)
    system, wanted = task.loaded.system, task.task
    rng = np.random.default_rng(2)
    for _ in range(5):
        q = system.step(task.witness.qs[9], 0.3 * rng.standard_normal(system.nv))
        for ball in wanted.balls[-3:]:
            for shape in wanted.shapes:

                def clearance(d: np.ndarray, ball: Ball = ball, shape: Shape = shape) -> np.ndarray:
                    system.place(system.step(q, d))  # noqa: B023  called before q is another
                    return np.array([_clearance(system, ball, shape)[0]])

                numeric = derivative(clearance, system.nv)[0]
                system.place(q)
                value, slope = _clearance(system, ball, shape)
                np.testing.assert_allclose(slope, numeric, atol=1e-6)  # curvature: 1/smoothing
                frame = system.data.oMf[system.model.getFrameId(ball.frame)]
                near = true_distance(frame.act(np.array(ball.center)), ball.radius, shape)
                if near > 0.0:
                    assert abs(value + shape.margin - near) < shape.smoothing
    followed = draw("double_pendulum_follow", 1, tmp_path)
    system, (path,) = followed.loaded.system, followed.task.followed
    qs = followed.witness.qs

    def progress(d: np.ndarray) -> np.ndarray:
        moved = qs.copy()
        moved[12] = system.step(qs[12], d)
        return np.array([_Along(system, path, moved).s[12]])

    numeric = derivative(progress, system.nv)[0]
    np.testing.assert_allclose(_Along(system, path, qs).slope(12), numeric, atol=1e-7)


def limited(task: Draw, largest: float) -> Draw:
    """The task with a limit on the first joint's torque."""
    sides = np.full((2, 2), np.inf) * [[-1], [1]]
    sides[1, 0] = largest
    tables = {**task.tables, "limits": {"effort": [[-np.inf, largest], [-np.inf, np.inf]]}, "path": []}
    bare = replace(task.task, u_limits=sides, v_limits=np.full((2, 2), np.inf) * [[-1], [1]])
    return replace(task, task=replace(bare, q_limits=bare.v_limits), tables=tables)


def test_limits_hold_and_push_the_right_way(pendulum: Draw) -> None:
    free = solved(limited(pendulum, 1e3))
    largest = 0.8 * float(free.us[:, 0].max())
    tight = limited(pendulum, largest)
    motion = solved(tight)
    report = verdict(tight, motion)
    assert report.failures == ()
    assert report.active > 0
    assert "limits" in verdict(tight, free).failures
    # without the limit nothing holds the motion back, whatever multipliers it claims
    wide = limited(pendulum, 1e3)
    assert set(verdict(wide, motion).failures) <= {"stationarity", "complementarity"}
    assert not verdict(wide, motion).holds
    silent = replace(motion, lam_us=np.zeros_like(motion.lam_us))
    assert verdict(wide, silent).failures == ("stationarity",)
    # held back from the other side: a multiplier of the wrong sign
    inside = motion.us[:, 0] >= largest - 1e-6
    wrong = np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
    wrong[0, 0] = largest - 1e-9
    shifted = replace(tight.task, u_limits=wrong)
    report = check_solution(tight.loaded.system, shifted, silent)
    assert inside.any()
    assert "stationarity" in report.failures


@pytest.mark.parametrize(
    ("name", "seed"),
    [("double_pendulum_midpoint", 0), ("double_pendulum_se2", 0), ("four_bar_midpoint", 0), ("drone", 0)],
)
def test_derivatives_of_a_step(name: str, seed: int, tmp_path: Path) -> None:
    """Pinocchio's derivatives, put together, are those of the residual."""
    task = draw(name, seed, tmp_path)
    system, w = task.loaded.system, task.witness
    system.choose_rows(task.task.q_start)
    step = step_of(system, task.task)
    x0, x1 = (np.concatenate([w.qs[n], w.vs[n]]) for n in (5, 6))
    lam = np.random.default_rng(1).standard_normal(system.nc)
    at = step.linearise(x0, x1, lam, w.us[5])
    numeric = (
        derivative(lambda d: step.rows(step.move(x0, d), x1, lam, w.us[5])[0], step.nx),
        derivative(lambda d: step.rows(x0, step.move(x1, d), lam, w.us[5])[0], step.nx),
        derivative(lambda d: step.rows(x0, x1, lam + d, w.us[5])[0], system.nc) if system.nc else at.lam,
        derivative(lambda d: step.rows(x0, x1, lam, w.us[5] + d)[0], system.nu),
    )
    for exact, other in zip(at[2:], numeric, strict=True):
        np.testing.assert_allclose(exact, other, atol=1e-9 * (1 + np.abs(other).max(initial=0.0)))


@pytest.mark.parametrize(
    "name", ["double_pendulum_gate", "elastic_pendulum_line", "drone_level", "ur5_cone", "drone_spin"]
)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_derivatives_of_bounds(name: str, seed: int, tmp_path: Path) -> None:
    """Pinocchio's Jacobians of a frame's values are those of differences, away from the motion, too."""
    task = draw(name, seed, tmp_path)
    system, nv = task.loaded.system, task.loaded.system.nv
    (bound,) = task.task.path
    rng = np.random.default_rng(seed)
    q = system.step(task.witness.qs[7], 0.2 * rng.standard_normal(nv))
    v = rng.standard_normal(nv)
    numeric = derivative(lambda d: bound_values(system, bound, system.step(q, d[:nv]), v + d[nv:])[0], 2 * nv)
    np.testing.assert_allclose(bound_values(system, bound, q, v)[1], numeric, atol=1e-8)


def test_derivatives_of_poses(tmp_path: Path) -> None:
    task = draw("ur5_pose", 0, tmp_path)
    system = task.loaded.system
    (point,) = task.task.points
    (pose,) = point.frames
    turned = replace(pose, rotation=pin.exp3(np.array([0.3, -0.2, 0.5])))
    q = system.step(task.witness.qs[7], 0.1 * np.ones(system.nv))
    numeric = derivative(lambda d: pose_values(system, turned, system.step(q, d))[0], system.nv)
    np.testing.assert_allclose(pose_values(system, turned, q)[1], numeric, atol=1e-8)


def test_multipliers_are_found_where_dynamics_amplify() -> None:
    """A singular value of 5e-7: one solve of the regularised least squares would leave a part of it."""
    K = sparse.csr_matrix(np.array([[1.0, 0.0, 0.0], [1.0, 5e-7, 0.0]]))
    g = K.T @ np.array([-1.0, 3.0])
    left, _ = _Projection(K)(g)
    assert np.abs(left).max() < 1e-12
    left, _ = _Projection(K)(np.array([0.0, 0.0, 1.0]))  # and none where there are none
    np.testing.assert_allclose(left, [0.0, 0.0, 1.0], atol=1e-15)
