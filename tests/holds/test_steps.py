"""Steps in which constraints begin and end: derivatives, mechanics against Pinocchio, what impacts keep."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mbocp.formulation import formulate
from mbocp.formulation.base import Formulation
from mbocp.mechanics import JointMechanics
from mbocp.mechanics.held_frames import compute_held_jacobians
from mbocp.problem import Problem
from mbocp.problem.timeline.hold import Hold
from mbocp.programme.kernel import kernel_programme
from mbocp.robot.loops.constraints import HOLDS
from mbocp.terms.contact import ContactConditionTerm
from mbocp.terms.point import Point
from tests.formulation.stages import check_derivatives
from tests.holds.cases import CASES, arm, drone, pendulum

SCHEMES = ("se1", "midpoint", "projected_midpoint", "semi_implicit_euler")
SHORT = {"semi_implicit_euler": {"duration": 0.1}}  # its damping is explicit: long steps swing up


def stage_by_stage(problem: Problem, u: float = 0.1) -> tuple[Formulation, np.ndarray, np.ndarray]:
    """A simulation with constant controls: states and impulses."""
    formulation = formulate(problem)
    native = kernel_programme(formulation.programme)
    N = problem.num_steps
    us = np.full((N, problem.robot.nu), u)
    native.u = np.hstack([us, np.zeros((N, formulation.layout.num_more_controls))]).ravel()
    xs = np.tile(formulation.programme.x_start, (N + 1, 1))
    native.x = xs.ravel()
    sweep = native.simulate(1e-12, 50)
    assert sweep.ok, sweep.failed_stage
    ys, rows = native.y.reshape(N, -1), len(formulation.constraint_labels)
    impulses = formulation.pieces.signature.steps.impulses_of(ys.T, rows).T
    return formulation, native.x.reshape(xs.shape), impulses


def split(formulation: Formulation, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    at = formulation.layout
    return x[at.z], x[at.s]


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", CASES)
def test_derivatives_of_free_held_and_leaping_steps(name: str, scheme: str) -> None:
    problem = CASES[name](scheme, solver={"method": "ipopt"})  # flat, as where there are limits
    formulation = formulate(problem)
    for stage in (0, problem.impacts[0], problem.impacts[0] + 1):
        check_derivatives(formulation, stage, alone=[0, formulation.layout.ds.start])


@pytest.mark.parametrize("scheme", ["se1", "midpoint"])
@pytest.mark.parametrize("name", ["pendulum", "drone"])
def test_derivatives_of_leaps_of_bodies(name: str, scheme: str) -> None:
    """In natural coordinates."""
    start = {"v_start": np.zeros(6)} if name == "drone" else {}
    problem = CASES[name](scheme, coordinates="natural", **start)
    formulation = formulate(problem)
    for stage in (problem.impacts[0], problem.impacts[0] + 1):
        check_derivatives(formulation, stage, alone=[0, formulation.layout.ds.start])


def test_derivatives_of_conditions_where_frames_meet() -> None:
    """Places and rates of each kind of hold at the node where it is taken on, against differences."""
    robot, rng, step = arm().robot, np.random.default_rng(0), 1e-6
    for kind in HOLDS:
        keys: dict[str, Any] = {"pitch": 0.2} if kind == "screw" else {}
        held = Hold(name="it", frame="tool0", kind=kind, at="coincide", **keys).as_frame(robot)
        term = ContactConditionTerm(held, tuple(range(len(held.rows))), has_place=True, has_rate=True)
        q, v = ca.SX.sym("q", robot.nq), ca.SX.sym("v", robot.nv)
        h, x = term.expression(Point(JointMechanics(robot), q, v), {}), ca.vertcat(q, v)
        m = ca.SX.sym("m", h.numel())
        f = ca.Function("f", [x, m], [h, ca.jacobian(h, x), ca.hessian(ca.dot(m, h), x)[0]])
        at, weights, d = rng.normal(size=12), rng.normal(size=h.numel()), rng.normal(size=12)
        (_, slopes, bends), (ahead, back) = (
            [np.asarray(ca.DM(out)) for out in f(at, weights)],
            ([np.asarray(ca.DM(out)) for out in f(at + s * step * d, weights)] for s in (1, -1)),
        )
        assert np.allclose(slopes @ d, (ahead[0] - back[0]).ravel() / (2 * step), atol=1e-7)
        assert np.allclose(bends @ d, (ahead[1] - back[1]).T @ weights / (2 * step), atol=1e-6)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", CASES)
def test_impacts_are_those_of_pinocchio(name: str, scheme: str) -> None:
    problem = CASES[name](scheme, **SHORT.get(scheme, {}))
    formulation, xs, ys = stage_by_stage(problem)
    robot, table = problem.robot, problem.timeline.switches
    assert table is not None
    for step in problem.impacts:
        (q, v), (q_after, v_after) = split(formulation, xs[step]), split(formulation, xs[step + 1])
        J = np.vstack(
            [
                robot.constraint_jacobian(q)[table.own[step]],
                table.jacobians(q[None])[0][table.rows[step]],
            ]
        )
        M = robot.mass_matrix(q)
        data = robot.model.createData()
        pin.computeJointJacobians(robot.model, data, q)
        wanted = pin.impulseDynamics(robot.model, data, q, v, J, 0.0, 0.0)
        size = 1.0 + np.abs(v).max()
        assert np.allclose(q_after, q, rtol=0.0, atol=1e-15)
        assert np.abs(v_after - wanted).max() < 1e-10 * size
        # What holds for an inelastic impact, to round-off.
        acting = np.concatenate([table.own[step], table.rows[step]])
        assert np.abs(M @ (v_after - v) + J.T @ ys[step][acting]).max() < 1e-12 * size * np.abs(M).max()
        assert np.abs(J @ v_after).max() < 1e-12 * size
        assert np.abs(ys[step][~acting]).max(initial=0.0) < 1e-12
        lost = (v @ M @ v - v_after @ M @ v_after) / 2
        leap = v_after - v
        assert lost == pytest.approx(leap @ M @ leap / 2, abs=1e-12 * (1.0 + v @ M @ v))
        assert lost >= -1e-12


def test_an_impact_keeps_the_angular_momentum_about_the_contact() -> None:
    problem = drone()
    formulation, xs, _ = stage_by_stage(problem)
    robot = problem.robot
    (q, v), (_, v_after) = split(formulation, xs[2]), split(formulation, xs[3])
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    contact = data.oMf[robot.frame_id(problem.holds[0].frame)].translation.copy()
    found = []
    for rate in (v, v_after):
        pin.computeCentroidalMomentum(robot.model, data, q, rate)
        pin.centerOfMass(robot.model, data, q)
        found.append(data.hg.angular + np.cross(data.com[0] - contact, data.hg.linear))
    assert np.abs(found[0]).max() > 1e-3  # there is something to keep
    assert np.abs(found[1] - found[0]).max() < 1e-12


@pytest.mark.parametrize("make", [arm, drone, pendulum])
def test_held_steps_are_constrained_dynamics(make) -> None:
    """The force of a held step, as its length goes to zero, is that of Pinocchio's constrained dynamics."""
    robot = make().robot
    errors = []
    for duration in (2e-3, 1e-3):
        problem = make(duration=duration)
        formulation, xs, ys = stage_by_stage(problem)
        step = problem.impacts[0] + 1
        (_, v0), (q, v) = split(formulation, xs[step]), split(formulation, xs[step + 1])
        table = problem.timeline.switches
        assert table is not None
        acts = table.rows[step]
        J = table.jacobians(q[None])[0][acts]
        h = 1e-6
        forward, backward = (
            table.jacobians(pin.integrate(robot.model, q, sign * h * v)[None])[0][acts] for sign in (1, -1)
        )
        drift = (forward - backward) @ v / (2 * h)
        data = robot.model.createData()
        effort = robot.actuation_matrix(q) @ np.full(robot.nu, 0.1)
        M = robot.mass_matrix(q)
        bias = pin.rnea(robot.model, data, q, v, np.zeros(robot.nv))
        matrix = np.block([[M, J.T], [J, np.zeros((len(J), len(J)))]])
        found = np.linalg.solve(matrix, np.concatenate([effort - bias, -drift]))
        a, force = found[: robot.nv], found[robot.nv :]
        errors.append(
            [
                np.abs((v - v0) / problem.dt - a).max() / (1.0 + np.abs(a).max()),
                np.abs(ys[step][acts] / problem.dt - force).max() / (1.0 + np.abs(force).max()),
            ]
        )
    assert max(errors[1]) < 5e-2
    assert all(fine < 0.7 * coarse + 1e-6 for coarse, fine in zip(*errors, strict=True))


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("make", [arm, drone, pendulum])
def test_held_frames_stay_where_they_were(make, scheme: str) -> None:
    problem = make(scheme, **SHORT.get(scheme, {}))
    formulation, xs, _ = stage_by_stage(problem)
    table = problem.timeline.switches
    assert table is not None
    qs = xs[:, formulation.layout.z]
    for step in range(problem.num_steps):
        acts = table.rows[step]
        if acts.any():
            anchor = table.anchors[step][acts][0]
            moved = table.residuals(qs[step + 1][None], qs[anchor][None])[0][acts]
            assert np.abs(moved).max() < 1e-11


@pytest.mark.parametrize("scheme", SCHEMES)
def test_what_is_never_held_is_free_to_round_off(scheme: str) -> None:
    more = SHORT.get(scheme, {})
    free = pendulum(scheme, holds=(), impacts=(), num_steps=10, **more)
    assert free.timeline.switches is None
    never = replace(pendulum().holds[0], spans=())
    switched = pendulum(scheme, holds=(never,), impacts=(), num_steps=10, **more)
    (_, plain, _), (_, found, ys) = stage_by_stage(free), stage_by_stage(switched)
    assert np.abs(found - plain).max() < 1e-13
    assert not ys.any()


def test_jacobians_of_held_frames_are_pinocchios() -> None:
    problem = drone()
    robot, hold = problem.robot, problem.holds[1]
    q = pin.randomConfiguration(robot.model, -np.ones(7), np.ones(7))
    J = compute_held_jacobians(robot, (hold.as_frame(robot),), q[None])[0]
    data = robot.model.createData()
    frame = robot.frame_id(hold.frame)
    world = pin.computeFrameJacobian(robot.model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
    own = pin.computeFrameJacobian(robot.model, data, q, frame, pin.LOCAL)
    assert np.allclose(J, np.vstack([world[:3], own[3:]]), atol=1e-13)
