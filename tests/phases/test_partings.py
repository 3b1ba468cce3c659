"""Where a hold ends: what is let go has the velocity that the hold allows, and momenta are kept."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp import Problem, Solution
from mbocp._arrays import Array
from mbocp.formulation import formulate
from mbocp.mechanics.held_frames import compute_held_jacobians
from mbocp.robot import Robot, load_parts
from tests.holds.cases import drone

EXAMPLES = Path(__file__).parents[2] / "examples"
SCHEMES = ("se1", "midpoint", "projected_midpoint")
COORDINATES = ("joint", "natural")


def cell() -> Robot:
    """A double pendulum, driven in both joints, and a ball."""
    tip = {"name": "tip", "frame": "link2", "mass": 0.1, "com": [0.0, 0.0, 0.2]}
    arm = {"name": "arm", "robot": "double_pendulum", "position": [0.0, 0.0, 0.0], "payload": [tip]}
    return load_parts([arm, {"name": "ball", "mass": 0.3, "sphere": 0.04}])


def thrown(scheme: str = "midpoint", *, kind: str = "point", finer: int = 1, **more: Any) -> Problem:
    """The tip of a pendulum holds a ball, swings it, and lets it go."""
    robot = cell()
    q = np.array(robot.q0)
    q[:2] = 0.3, 0.4
    tip = robot.frame_placement("arm/tip", q)
    held = [*tip.translation.tolist(), *pin.Quaternion(tip.rotation).coeffs().tolist()]
    grip = {"name": "grip", "frame": "ball/body", "to": "arm/tip", "kind": kind}
    words: dict[str, Any] = {
        "start": {"q": {"arm": [0.3, 0.4], "ball": held}},
        "goal": {"q": {"arm": [-0.4, -0.6]}, "v": {"arm": [0.0, 0.0]}},
        "scheme": scheme,
    }
    phases = [
        {"name": "swing", "steps": 6 * finer, "duration": 0.3, "hold": [grip]},
        {"name": "flight", "steps": 4 * finer, "duration": 0.2},
    ]
    return Problem.create(robot, phase=phases, **{"integrator": {"scheme": "se1"}, **words, **more})


def velocity_of(robot: Robot, frame: str, q: Array, v: Array, at: Array) -> Array:
    """Velocity of the point of a frame's body that is at a place of the world [m/s], by Pinocchio."""
    data, found = robot.model.createData(), robot.frame_id(frame)
    pin.forwardKinematics(robot.model, data, q, v)
    pin.updateFramePlacements(robot.model, data)
    twist = pin.getFrameVelocity(robot.model, data, found, pin.LOCAL_WORLD_ALIGNED)
    velocity: Array = twist.linear + np.cross(twist.angular, at - data.oMf[found].translation)
    return velocity


def slip_of(problem: Problem, s: Solution, node: int) -> float:
    """By how much the velocities of ball and tip differ [m/s]."""
    q, v = s.qs[node], s.vs[node]
    at = problem.robot.frame_placement("ball/body", q).translation
    ball, tip = (velocity_of(problem.robot, frame, q, v, at) for frame in ("ball/body", "arm/tip"))
    return float(np.linalg.norm(ball - tip))


@pytest.mark.parametrize(
    ("scheme", "coordinates"), [*itertools.product(("se1", "midpoint"), COORDINATES), (SCHEMES[-1], "joint")]
)
def test_a_ball_leaves_with_the_velocity_of_the_hand(scheme: str, coordinates: str) -> None:
    problem = thrown(scheme, coordinates=coordinates)
    s = mbocp.solve(problem, check=True)
    assert problem.impacts == (6,)
    assert (s.t[6], s.num_steps) == (s.t[7], 11)
    assert np.abs(s.qs[6] - s.qs[7]).max() < 1e-12
    assert slip_of(problem, s, 7) < 1e-9
    # What the steps leave, and the parting takes out, but for steps that have done it themselves.
    assert slip_of(problem, s, 6) < 1e-9 if scheme == "projected_midpoint" else slip_of(problem, s, 6) > 1e-4
    assert np.abs(s.lams[7:, -3:]).max() < 1e-12


def test_what_a_parting_takes_is_what_the_steps_err_by() -> None:
    """Its leap goes to zero with the length of the steps, and the cost converges."""
    leaps, costs = [], []
    for finer in (1, 2, 4):
        s = mbocp.solve(thrown(finer=finer), check=True)
        leaps.append(np.abs(np.diff(s.vs[6 * finer : 6 * finer + 2], axis=0)).max())
        costs.append(s.cost)
    assert leaps[2] < leaps[0] / 4
    assert abs(costs[2] - costs[1]) < abs(costs[1] - costs[0]) / 4


@pytest.mark.parametrize("kind", ["weld", "hinge"])
def test_all_that_is_held_takes_part(kind: str) -> None:
    problem = thrown(kind=kind)
    s = mbocp.solve(problem, check=True)
    assert slip_of(problem, s, 7) < 1e-9
    table = problem.timeline.switches
    assert table is not None
    J = compute_held_jacobians(problem.robot, table.held, s.qs[[7]])[0]
    assert np.abs(J @ s.vs[7])[table.rows[6]].max() < 1e-9
    # The impulse pushes along what is held, and nothing else changes velocities.
    M, leap = problem.robot.mass_matrix(s.qs[7]), s.vs[7] - s.vs[6]
    impulse = np.linalg.lstsq(J.T, M @ leap, rcond=None)[0]
    assert np.abs(J.T @ impulse - M @ leap).max() < 1e-9
    assert leap @ M @ leap > 0.0


@pytest.mark.parametrize("scheme", SCHEMES)
def test_optima_are_those_of_ipopt(scheme: str) -> None:
    problem = thrown(scheme)
    own = mbocp.solve(problem.with_(solver={"method": "monolithic"}), check=True)
    other = mbocp.solve(problem.with_(solver={"method": "ipopt"}), warm_start=own, check=True)
    assert own.cost == pytest.approx(other.cost, rel=1e-7)
    assert np.abs(own.qs - other.qs).max() < 1e-5


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.filterwarnings("ignore:points are held wherever")
def test_momenta_are_kept(scheme: str) -> None:
    """A free body on a spherical joint, then welded, then free: partings and an impact on its way."""
    asked = drone(scheme, holds=(), impacts=())
    ball, weld = ({"name": x.name, "frame": x.frame, "kind": x.kind} for x in drone().holds)
    phases = [
        {"name": "fly", "steps": 2, "duration": 0.15},
        {"name": "turn", "steps": 3, "duration": 0.2, "hold": [ball]},
        {"name": "rest", "steps": 2, "duration": 0.1, "hold": [weld]},
        {"name": "leave", "steps": 3, "duration": 0.15},
    ]
    problem = asked.with_(phase=phases)
    assert problem.impacts == (2, 6, 7, 10)
    s = mbocp.solve(problem, check=True)
    assert len(s.conserved) == 4
    assert all(found.relative_drift < 1e-12 for found in s.conserved)


def test_a_loop_that_opens_parts_too() -> None:
    phases: Any = [
        {"name": "closed", "steps": 3, "duration": 0.1},
        {"name": "open", "steps": 3, "duration": 0.1, "release": ["pin"]},
    ]
    ends: Any = {"start": {"q": {"crank": 0.4}}, "goal": {"q": {"crank": 0.8}}}
    problem = Problem.create("four_bar", phase=phases, scheme="midpoint", **ends)
    assert problem.impacts == (3,)
    assert problem.releases[0].spans == ((4, 7),)
    s = mbocp.solve(problem, check=True)
    J = problem.robot.constraint_jacobian(s.qs[4])
    assert np.abs(J @ s.vs[4]).max() < 1e-9
    assert np.abs(J @ s.vs[7]).max() > 1e-3


def test_a_part_of_a_phase_counts_steps_that_take_time() -> None:
    via = [{"name": "half", "time": {"phase": "swing", "share": 0.5}, "q": {"arm": [0.2, 0.2]}}]
    end = [{"name": "gone", "time": "swing", "q": {"arm": [0.0, 0.1]}}]
    assert thrown(finer=2, via=via).timeline.waypoints[0].node == 6
    assert thrown(finer=2, via=end).timeline.waypoints[0].node == 13


def test_other_numbers_compile_nothing_anew() -> None:
    one, other = thrown(), thrown(finer=2, goal={"q": {"arm": [0.1, 0.2]}, "v": {"arm": [0.0, 0.0]}})
    found = [formulate(problem).programme.functions for problem in (one, other)]
    assert found[0].tapes.held == found[1].tapes.held
    assert found[0].library == found[1].library


@pytest.mark.parametrize("scheme", SCHEMES)
def test_bounds_that_a_parting_repeats_are_left_out(scheme: str) -> None:
    """It leaves configurations, and velocities that are projected before: two bounds on one number."""
    settings = [f'integrator.scheme="{scheme}"', "limits.position=true"]
    formulation = formulate(mbocp.load_problem(EXAMPLES / "arms/throw_into_bucket.toml", settings))
    bounds, at = formulation.programme.bounds, formulation.layout
    (step,) = np.flatnonzero(formulation.problem.timeline.is_impact)
    is_bound = np.isfinite(bounds.x_upper)
    assert is_bound[step - 1, at.z].any()
    assert not is_bound[step, at.z].any()
    assert is_bound[step - 1, at.s].any()
    assert is_bound[step, at.s].any() == (scheme != "projected_midpoint")
    assert is_bound[step + 1].sum() == is_bound[step - 1].sum()
