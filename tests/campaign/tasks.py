"""Random tasks, each reproducible from its class and seed, and feasible by a motion that is at hand."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from tests.campaign.asked import asked, asked_tables
from tests.campaign.classes import CLASSES, TaskClass
from tests.campaign.robots import Loaded, load
from tests.campaign.witness import Witness, along_bend, along_geodesic, along_loops, closed, rollout
from tests.checker.conditions import step_of
from tests.checker.explicit import ExplicitStep
from tests.checker.system import Array, System
from tests.checker.task import Followed, PathBound, Task

__all__ = ["Draw", "draw"]

_ATTEMPTS = 40
_INFEASIBLE = 0.05  # part of the tasks of a class with velocity limits


@dataclass(frozen=True, eq=False)
class Draw:
    """A task as the checker reads it, as mbocp reads it, and what is known about it.

    Attributes
    ----------
    is_feasible : bool
        By a motion that satisfies all that is asked; or not, because a joint would have to move faster on
        average than it may.
    """

    task: Task
    tables: Mapping[str, Any]
    loaded: Loaded
    is_feasible: bool
    witness: Witness


def draw(name: str, seed: int, folder: Path) -> Draw:
    """Task number `seed` of a class."""
    kind = CLASSES[name]
    rng = np.random.default_rng([zlib.crc32(name.encode()), seed])
    loaded = load(kind.robot, folder)
    for _ in range(_ATTEMPTS):
        task = _bare(kind, loaded, rng)
        witness, task = _moved(kind, loaded, task, rng)
        if witness is not None:
            break
    else:
        raise RuntimeError(f"{name} {seed}: no motion found")
    task, is_feasible = _limited(kind, loaded.system, task, witness, rng)
    task = asked(kind.asks, loaded, task, witness, rng)
    return Draw(task, _tables(kind, loaded, task), loaded, is_feasible, witness)


def _bare(kind: TaskClass, loaded: Loaded, rng: np.random.Generator) -> Task:
    """Time, steps and weights; the motion is still to come."""
    system, nv, nu = loaded.system, loaded.system.nv, loaded.system.nu
    zero, q0 = np.zeros(nv), np.asarray(loaded.robot.q0)
    unit = 1.0
    if kind.family == "scale" and rng.random() < 0.5:  # a weight that suits the torques, or none chosen
        unit = float(np.abs(pin.computeGeneralizedGravity(system.model, system.data, q0 + 0.7)).max()) ** -2
    effort = unit * 10 ** rng.uniform(-1, 1)
    velocity = np.zeros(nv)
    if kind.cost in ("velocity", "penalty"):
        velocity = np.full(nv, unit * _typical(system, q0) ** 2 * 10 ** rng.uniform(-3, -1))
    rate = np.full(nu, effort * 10 ** rng.uniform(-3, -2)) if kind.cost == "rate" else np.zeros(nu)
    return Task(
        scheme=kind.scheme,
        coordinates=kind.coordinates,
        duration=float(rng.uniform(*kind.duration)),
        num_steps=int(rng.choice(kind.steps)),
        q_start=q0,
        v_start=zero,
        q_goal=q0,
        v_goal=zero,
        q_active=np.ones(nv, dtype=bool),
        v_active=np.full(nv, not system.drives),
        effort=np.full(nu, effort),
        velocity=velocity,
        control_rate=rate,
        tracking=np.full(nv, rng.uniform(0.1, 10.0)) if kind.cost == "tracking" else zero,
        q_target=q0,
        terminal=np.full(2 * nv, rng.uniform(1e2, 1e4)) if kind.cost == "penalty" else np.zeros(2 * nv),
        potential=float(rng.uniform(-0.1, 0.1)) if kind.cost == "rate" else 0.0,
        u_limits=_unbounded(nu),
        v_limits=_unbounded(nv),
        q_limits=_unbounded(system.nq),
    )


def _typical(system: System, q: Array) -> float:
    """Size of the forces that gravity takes [N, N m]."""
    bent = system.step(q, np.full(system.nv, 0.7))
    return max(float(np.abs(pin.computeGeneralizedGravity(system.model, system.data, bent)).max()), 1e-12)


def _unbounded(size: int) -> Array:
    return np.array([np.full(size, -np.inf), np.full(size, np.inf)])


def _with(task: Task, **changes: Any) -> Task:
    from dataclasses import replace

    return replace(task, **changes)


# Motions


def _moved(
    kind: TaskClass, loaded: Loaded, task: Task, rng: np.random.Generator
) -> tuple[Witness | None, Task]:
    system = loaded.system
    system.choose_rows(task.q_start)
    start = _start(kind, loaded, rng)
    if start is None:
        return None, task
    task = _with(task, q_start=start)
    system.choose_rows(start)
    step = step_of(system, task)
    if kind.motion == "geodesic":
        away = rng.uniform(-kind.spread, kind.spread, system.nv)
        if "kept" in kind.asks:  # a free body that does not turn
            away[3:] = 0.0
        if "plane" in kind.asks:  # of the sliders one stands still
            away[int(rng.integers(system.nv))] = 0.0
        found = along_geodesic(step, start, system.step(start, away), task.num_steps)
    elif kind.motion == "bend":
        away, aside = rng.uniform(-kind.spread, kind.spread, (2, system.nv))
        found = along_bend(step, start, away, aside, task.num_steps)
    elif kind.motion == "loops":
        change = rng.uniform(-kind.spread, kind.spread, len(loaded.dofs))
        found = along_loops(step, start, list(loaded.dofs), change, task.num_steps)
    else:
        found = _random_rollout(kind, system, step, task, rng)
    if found is None:
        return None, task
    q, v = _nearest(system, found.qs[-1]), found.vs[-1]
    if system.num_rows:  # the goal is along the loops; what a scheme leaves across them is its own
        _, values, right = np.linalg.svd(system.closure(q)[1])
        basis = right[int(np.sum(values > 1e-9 * values[0])) :].T
        v = basis @ (basis.T @ v)
    if system.drives:
        v = np.zeros(system.nv)
    if kind.motion != "rollout":
        v = np.zeros(system.nv)
    return found, _with(task, q_goal=q, v_goal=v, q_target=q)


def _nearest(system: System, q: Array) -> Array:
    """Point of the loops of which q lies straight across: P' (q - q_d) = 0."""
    if not system.num_rows or np.abs(system.closure(q)[0]).max() < 1e-9:
        return q
    near = q
    for _ in range(50):
        rows, J = system.closure(near)
        pinv = np.linalg.pinv(J, rcond=1e-9)
        along = system.away(near, q)
        near = system.step(near, along - pinv @ (J @ along) - pinv @ rows)
    return near


def _start(kind: TaskClass, loaded: Loaded, rng: np.random.Generator) -> Array | None:
    system, q0 = loaded.system, np.asarray(loaded.robot.q0)
    if kind.motion == "loops":
        dofs, delta, q = list(loaded.dofs), np.zeros(system.nv), q0
        delta[dofs] = rng.uniform(-kind.spread, kind.spread, len(dofs)) / 2
        for part in np.linspace(0.1, 1.0, 10):
            found = closed(system, q, dofs, system.step(q0, part * delta))
            if found is None:
                return None
            q = found
        return q
    if system.num_rows:
        return q0
    if kind.motion == "rollout" and kind.family not in ("arm", "pendulum"):
        lowest = min((q0, system.step(q0, np.eye(system.nv)[0] * np.pi)), key=system.potential)
        return system.step(lowest if kind.robot == "acrobot" else q0, rng.uniform(-0.3, 0.3, system.nv))
    if kind.family == "drone":
        return q0
    return system.step(q0, rng.uniform(-kind.spread, kind.spread, system.nv))


def _random_rollout(
    kind: TaskClass, system: System, step: Any, task: Task, rng: np.random.Generator
) -> Witness | None:
    N, nu = task.num_steps, system.nu
    if nu == system.nv and not system.num_rows and not system.drives:
        return _followed(kind, system, step, task, rng)
    s = (np.arange(N) + 0.5) / N
    waves = rng.uniform(-1.0, 1.0, (3, nu))
    shape = sum(np.outer(np.sin((k + 1) * np.pi * s), waves[k]) for k in range(3))
    held = _held(system, task.q_start)
    size = max(float(np.abs(held).max()), 0.3 * _typical(system, task.q_start)) if not system.drives else 3.0
    for factor in (0.7, 0.2, 0.05, 0.01):
        us = held + factor * rng.uniform(0.3, 1.0) * size * np.asarray(shape)
        found = rollout(step, task.q_start, task.v_start, us)
        if found is not None and _turned(system, found) < 6.0:
            return found
    return None


def _held(system: System, q: Array) -> Array:
    """Controls that hold the pose as well as they can."""
    gravity = np.array(pin.computeGeneralizedGravity(system.model, system.data, q))
    gravity -= system.applied(q, np.zeros(system.nv), np.zeros(system.nu))
    matrix = np.hstack([system.actuation(q), -system.Phi_q(q).T])
    found, *_ = np.linalg.lstsq(matrix, gravity, rcond=None)
    return np.asarray(found[: system.nu])


def _turned(system: System, motion: Witness) -> float:
    away = [system.away(motion.qs[0], q) for q in motion.qs] if system.is_vector else [np.zeros(1)]
    return float(np.abs(away).max())


def _followed(
    kind: TaskClass, system: System, step: Any, task: Task, rng: np.random.Generator
) -> Witness | None:
    """Explicit simulation of a tracker: computed torques, held during each step."""
    N, dt = task.num_steps, task.dt
    delta = rng.uniform(-kind.spread, kind.spread, system.nv)
    speeds = np.sin(np.pi * np.arange(N + 1) / N) ** 2
    speeds /= speeds.sum() * dt
    ahead = np.concatenate([[0.0], np.cumsum(speeds[1:] + speeds[:-1]) * dt / 2])
    x, us, xs = np.concatenate([task.q_start, task.v_start]), [], []
    xs.append(x)
    for n in range(N):
        q, v = step.split(x)
        wanted = (speeds[n + 1] - speeds[n]) / dt * delta
        away = system.away(q, system.step(task.q_start, ahead[n] * delta))
        wanted = wanted + 0.2 / dt * (speeds[n] * delta - v) + 0.01 / dt**2 * away
        force = pin.rnea(system.model, system.data, q, v, wanted) + system.damping * v
        us.append(np.linalg.solve(system.actuation(q), force))
        x = step.after(x, us[-1]) if isinstance(step, ExplicitStep) else None
        if x is None or not np.isfinite(x).all() or np.abs(x[system.nq :]).max() * dt > 0.5:
            return None
        xs.append(x)
    states = np.array(xs)
    return Witness(states[:, : system.nq], states[:, system.nq :], np.array(us))


# Limits


def _limited(
    kind: TaskClass, system: System, task: Task, witness: Witness, rng: np.random.Generator
) -> tuple[Task, bool]:
    """Limits around the motion, tight or wide; or a speed that is too low."""
    changes: dict[str, Any] = {}
    is_feasible = True
    if kind.limits and rng.random() < 0.6:
        if rng.random() < 0.6:
            changes["u_limits"] = _around(witness.us, rng)
        plain = kind.coordinates == "joint" and not system.drives and not system.num_rows
        if plain and rng.random() < 0.5:
            changes["v_limits"] = _around(witness.vs, rng)
            moved = np.abs(system.away(task.q_start, task.q_goal))
            if kind.motion == "geodesic" and kind.cost != "penalty" and rng.random() < 2 * _INFEASIBLE:
                i = int(np.argmax(moved))
                # another configuration or another duration may do where the task leaves them open
                is_given = not {"reach", "free"} & set(kind.asks.split("+"))
                if system.is_vector and is_given:
                    slow = 0.8 * moved[i] / task.duration
                    changes["v_limits"][:, i] = -slow, slow
                    is_feasible = False
        if plain and system.is_vector and rng.random() < 0.3:
            margin = rng.uniform(0.02, 0.3, system.nq)
            margin = margin * max(1.0, float(np.ptp(witness.qs, axis=0).max()))
            changes["q_limits"] = np.array([witness.qs.min(axis=0) - margin, witness.qs.max(axis=0) + margin])
    if kind.path:
        changes["path"] = (_path(kind, system, witness, rng),)
    return _with(task, **changes), is_feasible


def _around(values: Array, rng: np.random.Generator) -> Array:
    largest = np.abs(values).max(axis=0)
    largest = np.maximum(largest, 0.05 * largest.max()) * rng.uniform(1.02, 2.0, largest.size)
    return np.array([-largest, largest])


def _path(kind: TaskClass, system: System, witness: Witness, rng: np.random.Generator) -> PathBound:
    """Around the motion of the last link."""
    model, data = system.model, system.data
    frame = "tool0" if kind.robot == "ur5" else model.frames[model.nframes - 1].name
    positions, speeds = [], []
    for q, v in zip(witness.qs, witness.vs, strict=True):
        pin.forwardKinematics(model, data, q, v)
        pin.updateFramePlacements(model, data)
        i = model.getFrameId(frame)
        positions.append(data.oMf[i].translation.copy())
        speeds.append(np.linalg.norm(pin.getFrameVelocity(model, data, i, pin.LOCAL_WORLD_ALIGNED).linear))
    places, inf = np.array(positions), np.array([np.inf])
    if kind.path == "position":
        below = places[:, 2].min() - rng.uniform(0.01, 0.1)
        return PathBound("position", frame, np.array([below]), inf, axes=(2,))
    if kind.path == "speed":
        return PathBound("speed", frame, -inf, np.array([rng.uniform(1.02, 1.5) * max(speeds)]))
    point = places[0] + np.array([0.0, 0.5, 0.3])
    away = np.linalg.norm(places - point, axis=1)
    return PathBound(
        "distance", frame, np.array([0.98 * away.min()]), np.array([1.05 * away.max()]), point=point
    )


# As mbocp reads it


def _tables(kind: TaskClass, loaded: Loaded, task: Task) -> dict[str, Any]:
    goal: dict[str, Any] = {"q": task.q_goal}
    if task.v_active.any():
        goal["v"] = task.v_goal
    cost: dict[str, Any] = {"effort": float(task.effort[0])}
    if task.velocity.any():
        cost["velocity"] = float(task.velocity[0])
    if task.control_rate.any():
        cost["control_rate"] = float(task.control_rate[0])
    if task.potential:
        cost["potential"] = task.potential
    if task.tracking.any():
        weights = {"q": [1.0] * loaded.system.nv, "p": [0.0] * loaded.system.nv}
        cost |= {
            "tracking": float(task.tracking[0]),
            "tracking_weights": weights,
            "target": {"q": task.q_target},
        }
    if task.terminal.any():
        goal["enforce"] = "penalty"
        cost["terminal"] = float(task.terminal[0])
    limits: dict[str, Any] = {}
    for key, sides in (("effort", task.u_limits), ("velocity", task.v_limits), ("position", task.q_limits)):
        if np.isfinite(sides).any():
            limits[key] = [[float(a), float(b)] for a, b in sides.T]
    further = asked_tables(loaded, task)
    limits |= further["limits"]
    if "goal_frame" in further:
        goal = {key: value for key, value in goal.items() if key != "q"} | {"frame": further["goal_frame"]}
    goal |= {"a": 0.0 if task.ends_at_rest else "free", "u": "free"}
    if "time" in further:
        cost["time"] = further["time"]
    return {
        "robot": loaded.robot,
        "duration": further.get("duration", task.duration),
        "steps": task.num_steps,
        "start": {"q": task.q_start, "u": "free"},  # as those of the motion that limits are taken from
        "goal": goal,
        "cost": cost,
        "limits": limits,
        "path": [*(_path_table(p, task) for p in task.path), *map(_followed_table, task.followed)],
        "via": further.get("via", []),
        "obstacle": further.get("obstacle", []),
        "scheme": task.scheme,
        "coordinates": task.coordinates,
    }


def _path_table(bound: PathBound, task: Task) -> dict[str, Any]:
    table: dict[str, Any] = {"kind": bound.kind, "frame": bound.frame}
    if bound.first > 1:
        table["from"] = bound.first * task.dt
    if bound.last is not None:
        table["until"] = bound.last * task.dt
    if bound.kind == "position":
        table |= {"xyz"[a]: [lo, hi] for a, lo, hi in zip(bound.axes, bound.lower, bound.upper, strict=True)}
    elif bound.kind in ("speed", "angular_speed"):
        table["max"] = float(bound.upper[0])
    elif bound.kind == "line":
        table |= {"a": bound.point, "b": bound.point + bound.direction}
    elif bound.kind == "kept":
        rotation = bound.rotation
        assert rotation is not None
        table |= {"kind": "orientation_kept", "rpy": pin.rpy.matrixToRpy(rotation).tolist()}
    elif bound.kind == "orientation":
        table |= {"axis": bound.axis, "direction": bound.direction, "max": float(bound.upper[0])}
    else:
        table |= {"point": bound.point, "min": float(bound.lower[0]), "max": float(bound.upper[0])}
    if bound.kind in ("line", "kept") and bound.lower.size == 1:
        table["tolerance"] = float(bound.upper[0])
    return table


def _followed_table(path: Followed) -> dict[str, Any]:
    table: dict[str, Any] = {"kind": "follow", "frame": path.frame, "points": path.points.tolist()}
    return {**table, **({"tolerance": path.tolerance} if path.tolerance else {})}
