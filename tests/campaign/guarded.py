"""A robot with collision geometry, and obstacles beside a motion of it that stays clear of them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin

import mbocp
from tests.campaign.robots import Loaded, arm_urdf
from tests.campaign.witness import Witness
from tests.checker.clearance import centers, missing
from tests.checker.system import Array, System, read_system
from tests.checker.task import Ball, Shape, Task

__all__ = ["beside", "guarded_arm"]

_BALLS = (5, 3, 2)  # on each link of the arm
_RADIUS = 0.07  # [m] of them
_THICKNESS = 0.03  # [m] radius of the cylinders that they cover
_ATTEMPTS, _SOUGHT = 200, 60
_RESERVE = 5e-3  # [m] that the motion keeps beyond the margin
_BETWEEN = 4  # poses of a step that are looked at


def guarded_arm(folder: Path) -> Loaded:
    """Yaw, pitch, pitch; links of half a metre, a quarter and a sixth, thin cylinders that spheres cover."""
    length, mass = 0.5, 3.0
    text, balls, tables = arm_urdf(length, mass), [], []
    for i, count in enumerate(_BALLS):
        size = length / (i + 1)
        shape = (
            f'<collision><origin xyz="0 0 {size / 2!r}"/><geometry><cylinder radius="{_THICKNESS}" '
            f'length="{0.9 * size!r}"/></geometry></collision>'
        )
        text = text.replace(f'<link name="link_{i}"><inertial>', f'<link name="link_{i}">{shape}<inertial>')
        for k, z in enumerate(np.linspace(0.1 * size, 0.9 * size, count)):
            balls.append(Ball(f"link_{i}[{k}]", f"link_{i}", np.array([0.0, 0.0, z]), _RADIUS))
            tables += ["[[collision_sphere]]", f'frame = "link_{i}"', f"center = [0.0, 0.0, {float(z)!r}]"]
            tables += [f"radius = {_RADIUS}"]
    home = folder / "guarded"
    home.mkdir(parents=True, exist_ok=True)
    urdf = home / "robot.urdf"
    urdf.write_text(text)
    toml = home / "robot.toml"
    toml.write_text("\n".join(['name = "guarded"', 'urdf = "robot.urdf"', *tables]) + "\n")
    return Loaded(mbocp.load_robot(toml), read_system(urdf), balls=tuple(balls))


def beside(
    loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator, kinds: tuple[str, ...]
) -> Task:
    """The task with shapes near the straight line from start to goal that the motion stays clear of."""
    shapes: list[Shape] = []
    at = centers(loaded.system, loaded.balls, _finely(loaded.system, witness.qs))
    for k, kind in enumerate(kinds):
        for attempt in range(_ATTEMPTS):
            found = _drawn(loaded, task, f"{kind} {k}", kind, rng, is_near=attempt < _SOUGHT)
            grown = replace(found, margin=found.margin + found.smoothing + _RESERVE)
            if missing(replace(task, balls=loaded.balls, shapes=(grown,)), at) == 0.0:
                shapes.append(found)
                break
        else:
            raise RuntimeError("no place for an obstacle")
    return replace(task, balls=loaded.balls, shapes=tuple(shapes))


def _drawn(
    loaded: Loaded, task: Task, name: str, kind: str, rng: np.random.Generator, *, is_near: bool
) -> Shape:
    """A shape about a link on the straight line; farther off where there is no room for one."""
    system, ball = loaded.system, loaded.balls[int(rng.integers(2, len(loaded.balls)))]
    q = pin.interpolate(system.model, task.q_start, task.q_goal, rng.uniform(0.2, 0.8))
    system.place(q)
    at = system.data.oMf[system.model.getFrameId(ball.frame)].act(np.array(ball.center))
    away = rng.standard_normal(3)
    far = rng.uniform(0.0, 0.2) if is_near else rng.uniform(0.1, 0.6)
    size = rng.uniform(0.04, 0.15)
    sizes = np.array([size]) if kind == "sphere" else 2.0 * size * rng.uniform(0.4, 1.2, 3)
    turn = pin.exp3(rng.uniform(-1.5, 1.5, 3))
    position = np.asarray(at + far * away / np.linalg.norm(away))
    return Shape(name, kind, sizes, position, turn, float(rng.choice([0.0, 0.01, 0.03])), 2e-3)


def _finely(system: System, qs: Array) -> Array:
    """The motion with poses between its nodes."""
    found = [qs[0]]
    for a, b in pairwise(qs):
        found += [pin.interpolate(system.model, a, b, (k + 1) / _BETWEEN) for k in range(_BETWEEN)]
    return np.array(found)
