"""Random problems within limits, their solutions, and what the robot does between the nodes."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pinocchio as pin

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import MbocpError

RATE = 10_000.0  # samples a second
TOLERANCE = 0.01  # part of a limit by which the true flow may leave it farther than is told
_ROBOTS = ("ur5", "panda", "double_pendulum", "hector")
_SCHEMES = ("se1", "midpoint", "gauss2", "gauss3", "lobatto3")
_CONTROLS = ("constant", "linear", "stages")
_OF_STAGES = ("gauss2", "gauss3", "lobatto3")  # schemes whose controls may vary within steps
_STEPS = (25, 50, 100, 200, 400)


def problem_of(seed: int) -> mbocp.Problem:
    """Number `seed`: from rest to rest, in a time in which limits of speed are felt."""
    rng = np.random.default_rng([20, seed])
    name = str(rng.choice(_ROBOTS))
    scheme = str(rng.choice(_SCHEMES))
    controls = str(rng.choice(_CONTROLS)) if scheme in _OF_STAGES else "constant"
    steps = int(rng.choice(_STEPS))
    if name == "hector":
        return _drone(rng, scheme, controls, steps)
    robot = mbocp.load_robot(name, damping=False)
    q0, way = robot.q0, rng.uniform(0.3, 1.2, robot.nv) * rng.choice([-1.0, 1.0], robot.nv)
    limit = float(rng.uniform(1.0, 3.0))
    duration = float(1.5 * np.abs(way).max() / limit * rng.uniform(0.8, 1.6))
    return mbocp.Problem.create(
        robot,
        duration,
        steps,
        start={"q": q0},
        goal={"q": robot.integrate(q0, way), "v": 0},
        cost={"velocity": float(rng.choice([0.0, 1.0]))},
        limits={"velocity": limit},
        integrator={"scheme": scheme},
        controls=controls,
    )


def _drone(rng: np.random.Generator, scheme: str, controls: str, steps: int) -> mbocp.Problem:
    robot = mbocp.load_robot("hector", actuated=["root_joint"])
    goal = robot.q0.copy()
    goal[:3] += rng.uniform(0.5, 2.0, 3)
    limit = float(rng.uniform(0.8, 2.0))
    duration = float(1.3 * (goal[:3] - robot.q0[:3]).max() / limit * rng.uniform(0.9, 1.5))
    sizes = np.array([limit, limit, limit, 3.0, 3.0, 3.0])
    bounds = {label.name: float(size) for label, size in zip(robot.v_labels, sizes, strict=True)}
    return mbocp.Problem.create(
        robot,
        duration,
        steps,
        start={"q": robot.q0},
        goal={"q": goal, "v": 0},
        cost={"velocity": 1.0},
        limits={"velocity": bounds},
        integrator={"scheme": scheme},
        controls=controls,
    )


def true_excess(problem: mbocp.Problem, solution: mbocp.Solution, rate: float = RATE) -> float:
    """Part of a limit of speed by which the flow of the robot leaves it at most, from each node by itself.

    By classical Runge-Kutta steps, so many a second, on Pinocchio's numeric algorithms.
    """
    robot, limits = problem.robot, problem.limits_along()["v"]
    model, data = robot.model, robot.model.createData()
    lower, upper = (np.broadcast_to(side, (solution.num_steps, robot.nv)) for side in limits)
    size = np.maximum(np.abs(lower), np.abs(upper))
    worst = 0.0
    for n in range(solution.num_steps):
        begin, end = solution.t[n], solution.t[n + 1]
        count = max(2, int(np.ceil((end - begin) * rate)))
        h = (end - begin) / count
        shares = (np.arange(2 * count + 1) / (2 * count))[:, None]
        controls = _controls_within(solution, n, shares)
        q, v = solution.qs[n], solution.vs[n]
        for k in range(count):
            q, v = _runge_kutta(robot, model, data, q, v, controls[2 * k : 2 * k + 3], h)
            over = np.maximum(lower[n] - v, v - upper[n]) / size[n]
            worst = max(worst, float(over[np.isfinite(over)].max(initial=0.0)))
    return worst


def _controls_within(solution: mbocp.Solution, n: int, shares: Array) -> Array:
    """Controls at shares of a step, shape (any, nu)."""
    if solution.has_constant_controls:
        return np.repeat(solution.us[n][None], len(shares), axis=0)
    nodes, values = solution.u_shares, solution.u_values[n]
    weights = np.ones((len(shares), len(nodes)))
    for i, a in enumerate(nodes):
        for b in np.delete(nodes, i):
            weights[:, i] *= ((shares - b) / (a - b))[:, 0]
    found: Array = weights @ values
    return found


def _runge_kutta(
    robot: mbocp.Robot, model: Any, data: Any, q: Array, v: Array, us: Array, h: float
) -> tuple[Array, Array]:
    def rate(q: Array, v: Array, u: Array) -> Array:
        force = robot.actuation_matrix(q) @ u + robot.force_elements(q, v)
        found: Array = pin.aba(model, data, q, v, force).copy()
        return found

    a1 = rate(q, v, us[0])
    v2 = v + h / 2 * a1
    a2 = rate(pin.integrate(model, q, h / 2 * v), v2, us[1])
    v3 = v + h / 2 * a2
    a3 = rate(pin.integrate(model, q, h / 2 * v2), v3, us[1])
    v4 = v + h * a3
    a4 = rate(pin.integrate(model, q, h * v3), v4, us[2])
    way = h / 6 * (v + 2 * v2 + 2 * v3 + v4)
    return pin.integrate(model, q, way), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def row_of(seed: int, rate: float = RATE) -> dict[str, Any]:
    """What problem number `seed` comes to: what is told of its limits, and what is so."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            problem = problem_of(seed)
            solution = mbocp.solve(problem)
        except MbocpError as error:
            return {"seed": seed, "status": "refused", "advice": str(error)[:200]}
    row = {
        "seed": seed,
        "robot": problem.robot.name,
        "scheme": problem.scheme,
        "controls": problem.controls,
        "steps": problem.num_steps,
        "status": str(solution.status),
        "told": solution.limit_excess,
    }
    if solution.is_stationary:
        row["true"] = true_excess(problem, solution, rate)
        row["is_beyond"] = row["true"] > row["told"] + TOLERANCE  # not where nothing is told
    return row
