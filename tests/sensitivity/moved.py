"""Problems with a number moved, for differences of optima that are solved again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

import mbocp
from mbocp.problem.limits import LIMITS
from mbocp.robot.named_numbers import number_of, with_numbers

ROUND_OFF = 1e-14


def moved(problem, word, k, size):
    """The problem with number k of a parameter larger by a size."""
    kind, _, key = word.partition(".")
    if kind == "start":
        q, v = problem.q_start, problem.v_start
        if key == "q":
            return problem.with_(q_start=moved_configuration(problem, q, k, size))
        return problem.with_(v_start=v + size * allowed(problem, q)[k])
    if kind == "goal":
        return problem.with_(goal=moved_goal(problem, problem.goal, key, k, size))
    if kind == "cost":
        weights = np.array(problem.cost.weight(key), dtype=float)
        if weights.ndim == 0:
            return problem.with_(cost=problem.cost.with_weights({key: float(weights) + size}))
        weights[k] += size
        return problem.with_(cost=problem.cost.with_weights({key: weights}))
    if kind == "limits":
        name, _, side = word.rpartition(".")
        field = f"{next(letter for letter, known in LIMITS.items() if known == name)}_{side}"
        sides = np.array(getattr(problem.limits, field))
        sides[k] += size
        return problem.with_(limits=replace(problem.limits, **{field: sides}))
    if word == "horizon.duration":
        return problem.with_(duration=problem.duration + size)
    if key.startswith("payload"):
        return problem.with_(robot=moved_payload(problem.robot, key, k, size))
    return with_other_number(problem, key, size)


def allowed(problem, q):
    """Projection of velocities onto what loops allow."""
    basis = problem.free_at_end(q) if problem.robot.nc else np.eye(problem.robot.nv)
    return basis @ basis.T


def moved_configuration(problem, q, k, size):
    """A configuration moved along a direction that loops allow, with closed loops."""
    return closed(problem.robot, problem.robot.integrate(q, size * allowed(problem, q)[k]))


def closed(robot, q):
    """A configuration near another, whose loops are closed."""
    while robot.nc and np.abs(robot.constraint_residual(q)).max() > ROUND_OFF:
        q = robot.integrate(q, -np.linalg.pinv(robot.constraint_jacobian(q)) @ robot.constraint_residual(q))
    return q


def moved_goal(problem, goal, key, k, size):
    if key == "q":
        return replace(goal, q=moved_configuration(problem, goal.q, k, size))
    if key in "vp":
        return replace(goal, value=goal.value + size * allowed(problem, goal.q)[k])
    (frame,) = goal.frames
    target = frame.target
    if key.endswith("position"):
        target = replace(target, position=target.position + size * np.eye(3)[k])
    else:
        turned = target.rotation @ pin.exp3(size * np.eye(3)[k])
        target = replace(target, orientation=pin.Quaternion(turned).coeffs())
    return replace(goal, frames=(replace(frame, target=target),))


def with_other_number(problem, word, size):
    """With one more of a number of the robot, and start and goal near those of before."""
    robot = with_numbers(problem.robot, {word: number_of(problem.robot, word) + size})
    q_start, q_goal = (closed(robot, q) for q in (problem.q_start, problem.goal.q))
    return replace(problem, robot=robot, q_start=q_start, goal=replace(problem.goal, q=q_goal))


def moved_payload(robot, key, k, size):
    (payload,) = (dict(payload) for payload in robot.spec["payload"])
    key = key.rpartition(".")[2]
    values = np.atleast_1d(np.array(payload[key], dtype=float))
    values[k] += size
    payload[key] = float(values[0]) if key == "mass" else values.tolist()
    return mbocp.load_robot(robot.spec["name"], payload=[payload])
