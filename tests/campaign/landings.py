"""Random tasks at whose end something is held since a node on the way: `python -m tests.campaign.landings`.

A frame moves freely, lands where it likes, and stays there while the robot comes to rest in a pose that is
asked for. Each is feasible: its goal is a configuration in which the frame is where it was at the landing,
and the robot has a motor for every direction. What comes out is judged by Pinocchio's numeric algorithms.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import mbocp
from mbocp.exceptions import MbocpError
from tests.campaign.frames import last_frame
from tests.campaign.robots import Loaded, load
from tests.checker.implicit import ImplicitStep
from tests.checker.system import Array

__all__ = ["KINDS", "Landing", "failures", "landing", "run_landing"]

# Robot, kind of the hold, and the directions of the world in which the frame stays (6: its axes, too).
KINDS: dict[str, tuple[str, str, tuple[int, ...]]] = {
    "pendulum_slides": ("double_pendulum", "plane", (2,)),
    "drone_lands": ("drone", "point", (0, 1, 2)),
    "drone_is_gripped": ("drone", "weld", (0, 1, 2, 3, 4, 5)),
    "ur5_slides": ("ur5", "plane", (2,)),
    "ur5_leans": ("ur5", "point", (0, 1, 2)),
}
# [m, rad]; m/s, at the end of the fastest; [m, rad]; of the sizes.
_SMALL = {"place": 1e-7, "rate": 1e-6, "goal": 1e-6, "force": 1e-6}


@dataclass(frozen=True, eq=False)
class Landing:
    """A task, as mbocp reads it, and what it is judged by."""

    loaded: Loaded
    tables: Mapping[str, Any]
    frame: str
    rows: tuple[int, ...]
    steps: tuple[int, int]
    q_goal: Array
    wanted: Array  # bool, shape (nv,): components of the goal's configuration


def landing(name: str, seed: int, folder: Path) -> Landing:
    """Task number `seed` of a kind."""
    robot, kind, rows = KINDS[name]
    loaded, rng = load(robot, folder), np.random.default_rng([sum(name.encode()), seed])
    system, frame = loaded.system, last_frame(loaded)
    start = system.step(np.asarray(loaded.robot.q0), rng.uniform(-0.3, 0.3, system.nv))
    there = system.step(start, rng.uniform(-0.6, 0.6, system.nv))
    goal = _along(loaded, frame, rows, there, rng.uniform(-0.4, 0.4, system.nv))
    steps = (int(rng.integers(8, 16)), int(rng.integers(6, 12)))
    times = rng.uniform(0.4, 1.0, 2)
    lengths: list[Any] = [float(length) for length in times]
    time: dict[str, float] = {}
    if rng.random() < 0.5:
        time = {"time": 1.0}
        lengths = [{"min": 0.5 * length, "max": 2.0 * length} for length in lengths]
    hold = {
        "name": "landed",
        "frame": frame,
        "kind": kind,
        **({"axis": [0, 0, 1]} if kind == "plane" else {}),
    }
    wanted = np.ones(system.nv, dtype=np.bool_)
    asks: Any = goal
    if system.is_vector and rng.random() < 0.5:  # some joints alone
        wanted = rng.random(system.nv) < 0.5
        wanted[0] = True
        asks = {n: float(goal[k]) for k, n in enumerate(loaded.robot.joint_names) if wanted[k]}
    phases = [
        {"name": "free", "steps": steps[0], "duration": lengths[0]},
        {"name": "landed", "steps": steps[1], "duration": lengths[1], "hold": [hold]},
    ]
    tables = {
        "robot": loaded.robot,
        "phase": phases,
        "start": {"q": start},
        "goal": {"q": asks, "v": 0},
        "cost": {"effort": 1.0, "velocity": float(10 ** rng.uniform(-2, 1))} | time,
        "scheme": str(rng.choice(["se1", "midpoint"])),
    }
    return Landing(loaded, tables, frame, rows, steps, goal, wanted)


def _along(loaded: Loaded, frame: str, rows: Sequence[int], q: Array, delta: Array) -> Array:
    """A configuration about so far away in which the frame is where it is now."""
    system, target = loaded.system, _place(loaded, frame, q)
    q = system.step(q, delta)
    for _ in range(50):
        away = _moved(target, _place(loaded, frame, q))[list(rows)]
        if np.abs(away).max() < 1e-13:
            break
        q = system.step(q, -np.linalg.pinv(_jacobian(loaded, frame, q)[list(rows)], 1e-8) @ away)
    return q


def _place(loaded: Loaded, frame: str, q: Array) -> pin.SE3:
    loaded.system.place(q)
    return pin.SE3(loaded.system.data.oMf[loaded.system.model.getFrameId(frame)])


def _moved(a: pin.SE3, b: pin.SE3) -> Array:
    """From a placement to another, in axes of the world, shape (6,)."""
    return np.concatenate([b.translation - a.translation, pin.log3(b.rotation @ a.rotation.T)])


def _jacobian(loaded: Loaded, frame: str, q: Array) -> Array:
    """Twist of the frame, in axes of the world."""
    system = loaded.system
    system.place(q)
    return np.asarray(
        pin.computeFrameJacobian(
            system.model, system.data, q, system.model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED
        )
    )


def failures(task: Landing, solution: mbocp.Solution) -> list[str]:
    """What a motion does not keep of the task, by how much."""
    at = task.steps[0] + 1  # the node after the impact
    worst = dict(_judged(task, solution, at))
    return [f"{what}: {size:.1e}" for what, size in worst.items() if size > _SMALL[what.split(" ")[0]]]


def _judged(task: Landing, s: mbocp.Solution, at: int) -> Iterator[tuple[str, float]]:
    system, rows, loaded = task.loaded.system, list(task.rows), task.loaded
    landed = _place(loaded, task.frame, s.qs[at])
    last = _jacobian(loaded, task.frame, s.qs[-1])[rows]
    G = _jacobian(loaded, task.frame, s.qs[at])[rows]
    yield "goal q", _largest(system.away(task.q_goal, s.qs[-1])[task.wanted])
    yield (
        "rate at the end, of what the hold leaves",
        _largest(s.vs[-1] - np.linalg.pinv(last, 1e-8) @ (last @ s.vs[-1])) / max(_largest(s.vs), 1.0),
    )
    yield (
        "place of the frame",
        max(_largest(_moved(landed, _place(loaded, task.frame, q))[rows]) for q in s.qs[at:]),
    )
    yield "place of the robot at the impact", _largest(system.away(s.qs[at - 1], s.qs[at]))
    yield "rate after the impact", _largest(G @ s.vs[at])
    leap = system.mass(s.qs[at]) @ (s.vs[at] - s.vs[at - 1])
    yield "force of the impact", _largest(_beside(G.T, leap)) / (1.0 + _largest(leap))
    for n in [*range(at - 1), *range(at, len(s.us))]:
        yield f"force in step {n}", _unbalanced(task, s, n, is_held=n >= at)


def _unbalanced(task: Landing, s: mbocp.Solution, n: int, *, is_held: bool) -> float:
    """What no force of the hold balances in a step, as a part of the forces there."""
    system, dt = task.loaded.system, float(s.t[n + 1] - s.t[n])
    step = ImplicitStep(system, str(task.tables["scheme"]), dt)
    x0, x1 = (np.concatenate([s.qs[k], s.vs[k]]) for k in (n, n + 1))
    q, v = step.at(x0, x1)
    force = pin.rnea(system.model, system.data, q, v, (s.vs[n + 1] - s.vs[n]) / dt).copy()
    size = 1.0 + _largest(force) + _largest(s.us[n])
    force -= system.applied(q, v, np.zeros(system.nu))
    force -= system.actuation(q) @ s.us[n]
    if is_held:
        force = _beside(_jacobian(task.loaded, task.frame, q)[list(task.rows)].T, force)
    return _largest(force) / size


def _beside(columns: Array, vector: Array) -> Array:
    """Part of a vector that columns do not span."""
    return np.asarray(vector - columns @ (np.linalg.pinv(columns, 1e-8) @ vector))


def _largest(values: Array) -> float:
    return float(np.abs(values).max(initial=0.0))


def run_landing(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """Row of one task."""
    task = landing(name, seed, folder)
    row: dict[str, Any] = {"class": name, "seed": seed}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # steps that are too coarse are told in the status
            solution = mbocp.solve(mbocp.Problem.create(**task.tables, solver={"time_limit": 20.0}))
    except MbocpError as error:
        return row | {"status": "refused", "advice": str(error)[:300], "failures": []}
    row |= {
        "status": str(solution.status),
        "iterations": solution.iterations,
        "advice": solution.advice[:300],
    }
    met = str(solution.status) in ("converged", "under_resolved")
    return row | {"failures": failures(task, solution) if met else []}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run tasks of each kind; 1 if one is said to be solved and is not."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaign.landings", description=__doc__)
    parser.add_argument("--count", type=int, default=10, help="tasks of each kind")
    parser.add_argument("--first", type=int, default=0, help="number of the first seed")
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=list(KINDS), metavar="KIND")
    options = parser.parse_args(arguments)
    is_wrong = False
    with tempfile.TemporaryDirectory() as folder:
        for name in options.kinds:
            for seed in range(options.first, options.first + options.count):
                row = run_landing(name, seed, Path(folder))
                is_wrong |= bool(row["failures"])
                print(json.dumps(row), flush=True)
    return int(is_wrong)


if __name__ == "__main__":
    sys.exit(main())
