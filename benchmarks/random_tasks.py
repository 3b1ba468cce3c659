"""Random tasks in classes, the same ones for the same seed: motions from rest to rest, mostly.

Robots, durations, steps, weights and limits vary. Limits leave room: speeds beyond the mean one, efforts
beyond what holds the robot still at both ends. Whether a task is feasible nobody knows before it is solved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.newton import EXAMPLES
from mbocp import Problem, Robot

__all__ = ["CLASSES", "Make", "random_problems", "rest_to_rest"]

Rng = np.random.Generator
Make = Callable[[Rng], Problem]

_FINGERS = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}


def random_problems(name: str, number: int, seed: int) -> Iterator[Problem]:
    """`number` problems of a class; the i-th does not depend on how many there are."""
    for i in range(number):
        yield CLASSES[name](np.random.default_rng([seed, sorted(CLASSES).index(name), i]))


def rest_to_rest(
    robot: Robot, duration: float, steps: int, start: Any, goal: Any, velocity: float, **tables: Any
) -> Problem:
    """From rest at `start` to rest at `goal`, by little effort and, as far as they weigh, low velocities."""
    return Problem.create(
        robot,
        duration,
        steps,
        start={"q": start},
        goal={"q": goal, "v": np.zeros(robot.nv)},
        cost={"effort": 1.0, "velocity": velocity},
        **{"integrator": {"scheme": "se1"}, **tables},
    )


@cache
def _robot(name: str, **options: Any) -> Robot:
    actuated = {"hector": ("root_joint",), "acrobot": ("joint2",)}.get(name)
    if name == "panda":
        return mbocp.load_robot("panda", lock=_FINGERS, damping=False)
    if actuated:
        return mbocp.load_robot(
            {"acrobot": "double_pendulum"}.get(name, name), actuated=list(actuated), damping=False
        )
    return mbocp.load_robot(name, damping=False)


def _pose(rng: Rng, robot: Robot, reach: float) -> Any:
    """Joints anywhere between their limits, at most `reach` from zero or from the middle between these."""
    model = robot.model
    tangent, q = rng.uniform(-reach, reach, model.nv), pin.neutral(model)
    for joint in list(model.joints)[1:]:
        if joint.nq != 1:
            continue
        lower, upper = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        if lower < upper:
            middle = 0.0 if lower < 0.0 < upper else 0.5 * (lower + upper)
            low, high = max(lower, middle - reach), min(upper, middle + reach)
            share = 0.5 * (tangent[joint.idx_v] / reach + 1.0)
            tangent[joint.idx_v] = low + share * (high - low) - q[joint.idx_q]
    return pin.integrate(model, q, tangent)


def _holding(robot: Robot, q: Any) -> Any:
    """Forces that hold the robot still, shape (nv,)."""
    return np.abs(pin.computeGeneralizedGravity(robot.model, robot.model.createData(), q))


def _random_limits(rng: Rng, robot: Robot, q0: Any, q1: Any, duration: float) -> dict[str, Any]:
    """Speeds beyond the mean one, efforts beyond what holds still, positions beyond both ends."""
    tangent = np.abs(pin.difference(robot.model, q0, q1))
    limits: dict[str, Any] = {}
    if rng.random() < 0.6:
        limits["velocity"] = rng.uniform(1.6, 4.0) * tangent / duration + 0.2
    if rng.random() < 0.4 and robot.nq == robot.nv:
        room = rng.uniform(0.1, 1.0, robot.nq)
        limits["position"] = np.column_stack([np.minimum(q0, q1) - room, np.maximum(q0, q1) + room])
    if rng.random() < 0.4 and robot.nu == robot.nv:
        held = np.maximum(_holding(robot, q0), _holding(robot, q1))
        swing = np.diag(pin.crba(robot.model, robot.model.createData(), q1)) * tangent / duration**2
        limits["effort"] = rng.uniform(2.0, 5.0) * (held + 6.0 * swing) + 0.1 * held.max()
    return limits


@dataclass(frozen=True)
class _RestToRest:
    """Between random poses of a robot with plain joints."""

    robot: str
    reach: float = 2.0
    durations: tuple[float, float] = (0.8, 3.0)
    velocities: tuple[float, ...] = (0.0, 1.0, 10.0, 100.0)
    limited: float = 0.0
    options: Mapping[str, Any] = field(default_factory=dict)
    hanging: float = 0.0  # share of tasks from hanging still to upright

    def __call__(self, rng: Rng) -> Problem:
        robot = _robot(self.robot)
        q0, q1 = _pose(rng, robot, self.reach), _pose(rng, robot, self.reach)
        if rng.random() < self.hanging:
            q0, q1 = np.zeros(robot.nq), np.array([np.pi, *np.zeros(robot.nq - 1)])
        duration, steps = float(rng.uniform(*self.durations)), int(rng.integers(30, 151))
        velocity = float(rng.choice(self.velocities))
        limits = _random_limits(rng, robot, q0, q1, duration) if rng.random() < self.limited else {}
        return rest_to_rest(robot, duration, steps, q0, q1, velocity, limits=limits or None, **self.options)


def _drone(rng: Rng) -> Problem:
    """A drone with force and moment in its body's axes, from rest to rest, most within limits."""
    robot = _robot("hector")
    q0 = pin.neutral(robot.model)
    turn = rng.uniform(-1.0, 1.0, 3)
    turn *= rng.uniform(0.0, 2.6) / np.linalg.norm(turn)
    goal = pin.integrate(robot.model, q0, np.concatenate([rng.uniform(-1.5, 1.5, 3), turn]))
    duration, steps = float(rng.uniform(0.8, 3.0)), int(rng.integers(30, 151))
    limits: dict[str, Any] = {}
    if rng.random() < 0.7:
        weight = 9.81 * pin.computeTotalMass(robot.model)
        inertia = np.abs(np.diag(robot.model.inertias[1].inertia))
        push = rng.uniform(1.2, 4.0) * weight + 8.0 * weight / 9.81 * np.abs(goal[:3]).max() / duration**2
        twist = rng.uniform(1.5, 6.0) * (6.0 * inertia * (np.linalg.norm(turn) + 0.2) / duration**2 + 0.02)
        limits["effort"] = np.concatenate([np.full(3, push), twist])
        if rng.random() < 0.5:
            speeds = np.abs(np.concatenate([goal[:3], turn])) / duration
            limits["velocity"] = (
                rng.uniform(2.0, 5.0) * np.repeat([speeds[:3].max(), speeds[3:].max()], 3) + 0.5
            )
    velocity = float(rng.choice([0.0, 1.0, 10.0, 100.0]))
    return rest_to_rest(robot, duration, steps, q0, goal, velocity, limits=limits or None)


def _legged(rng: Rng) -> Problem:
    """A robot with legs that falls freely and reaches a pose of its legs at rest against its trunk."""
    robot = _robot("solo8")
    q0 = np.array(robot.q0)
    q0[7:] += rng.uniform(-0.5, 0.5, robot.nq - 7)
    legs = [name for name in robot.model.names if name not in ("universe", "root_joint")]
    q1 = q0[7:] + rng.uniform(-1.5, 1.5, len(legs))
    return Problem.create(
        robot,
        float(rng.uniform(0.2, 0.8)),
        int(rng.integers(30, 81)),
        start={"q": q0},
        goal={
            "q": dict(zip(legs, q1.tolist(), strict=True)),
            "v": dict.fromkeys(legs, 0.0),
        },
        cost={"effort": 1.0, "velocity": float(rng.choice([0.01, 0.1, 1.0]))},
        scheme="se1",
    )


def _loop(rng: Rng) -> Problem:
    """A closed chain: its motors from the pose of the example to a place nearby."""
    name = str(
        rng.choice(["loops/four_bar", "loops/five_bar", "loops/slider_crank", "loops/parallelogram_arm"])
    )
    problem = mbocp.load_problem(EXAMPLES / f"{name}.toml")
    return problem.with_(
        duration=float(problem.duration * rng.uniform(0.5, 2.0)),
        num_steps=int(rng.integers(30, 121)),
        cost=_weighed(problem, rng),
    )


def _weighed(problem: Problem, rng: Rng) -> Any:
    cost = problem.cost
    return replace(
        cost, effort=np.asarray(cost.effort) * 10.0 ** rng.uniform(-2, 2), velocity=np.asarray(cost.velocity)
    )


def _natural(rng: Rng) -> Problem:
    """Two robots by their bodies' positions and directions."""
    name = str(rng.choice(["double_pendulum", "ur5"]))
    make = _RestToRest(
        name,
        1.5,
        velocities=(0.0, 1.0, 10.0) if name == "ur5" else (0.0,),
        options={"coordinates": "natural"},
    )
    return make(rng)


def _unicycle(rng: Rng) -> Problem:
    """Swing up while driving somewhere."""
    x, y = rng.uniform(-1.0, 1.0, 2)
    settings = {
        "horizon.duration": float(rng.uniform(2.5, 4.5)),
        "horizon.steps": int(rng.integers(60, 141)),
        "goal.q.base_x": float(x),
        "goal.q.base_y": float(y),
        "goal.q.yaw": float(rng.uniform(-np.pi, np.pi)),
    }
    return mbocp.load_problem(EXAMPLES / "so3/unicycle_pendulum.toml", settings)


def _path(rng: Rng) -> Problem:
    """A UR5 below a speed of its tool, within limits or not."""
    problem = _RestToRest("ur5", velocities=(10.0, 100.0))(rng)
    robot = problem.robot
    model, data = robot.model, robot.model.createData()
    q0, q1 = problem.q_start, np.asarray(problem.goal.q)
    ends = []
    for q in (q0, q1):
        pin.framesForwardKinematics(model, data, q)
        ends.append(data.oMf[model.getFrameId("tool0")].translation.copy())
    speed = np.abs(q1 - q0).max() / problem.duration * rng.uniform(1.2, 3.0)
    top = max(e[2] for e in ends) + rng.uniform(0.05, 0.5)
    bounds = [
        {"frame": "tool0", "kind": "position", "z": [-5.0, float(top)]},
        {"frame": "tool0", "kind": "speed", "max": float(speed)},
    ]
    return rest_to_rest(robot, problem.duration, problem.num_steps, q0, q1, 100.0, path=bounds)


def _paper(rng: Rng) -> Problem:
    """The paper's systems with other starts, steps and weights."""
    names = ("elastic_pendulum", "rigid_pendulum", "cart_pendulum_rigid", "cart_pendulum_elastic")
    name = str(rng.choice(names))
    settings: dict[str, Any] = {
        "horizon.steps": int(rng.integers(10, 121)),
        "cost.effort": float(10.0 ** rng.uniform(-2, 2)),
    }
    if name == "rigid_pendulum":
        settings["start.p"] = [0.0, float(rng.uniform(5, 15)), float(rng.uniform(-5, 5))]
    return mbocp.load_problem(EXAMPLES / "paper" / f"{name}.toml", settings)


def _scales(rng: Rng) -> Problem:
    """Far and near, heavy and light, slow and fast: elastic pendulum and double pendulum of all sizes."""
    weight = float(10.0 ** rng.uniform(-6, 6))
    if rng.random() < 0.5:
        far = float(10.0 ** rng.uniform(-3, 2.7))
        return mbocp.load_problem(
            EXAMPLES / "paper" / "elastic_pendulum.toml",
            {
                "cost.effort": weight,
                "goal.q": [0.0, 0.0, -5.0 - far],
                "horizon.steps": int(rng.integers(20, 101)),
            },
        )
    robot = _robot("double_pendulum")
    q0, q1 = rng.uniform(-1.0, 1.0, (2, 2))
    duration = float(10.0 ** rng.uniform(-2, 1))
    return Problem.create(
        robot,
        duration,
        int(rng.integers(20, 101)),
        start={"q": q0},
        goal={"q": q1, "v": np.zeros(2)},
        cost={"effort": weight},
        scheme="se1",
    )


CLASSES: dict[str, Make] = {
    "ur5": _RestToRest("ur5"),
    "ur5 limits": _RestToRest("ur5", limited=1.0),
    "panda": _RestToRest("panda"),
    "panda limits": _RestToRest("panda", limited=1.0),
    "kinova": _RestToRest("kinova", velocities=(1.0, 10.0, 100.0)),
    "kinova effort": _RestToRest("kinova", velocities=(0.0,), durations=(1.0, 3.0)),
    "double pendulum": _RestToRest("double_pendulum", 3.14, velocities=(0.0, 1.0, 10.0), limited=0.5),
    "acrobot": _RestToRest("acrobot", 3.14, velocities=(0.0, 1.0, 10.0), limited=0.3, hanging=0.3),
    "drone": _drone,
    "legged": _legged,
    "loops": _loop,
    "natural": _natural,
    "unicycle": _unicycle,
    "path": _path,
    "paper": _paper,
    "scales": _scales,
}
