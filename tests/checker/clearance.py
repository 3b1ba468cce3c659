"""Clearances: distances of spheres on links from shapes, by formulas of one's own, and by coal.

mbocp keeps rounded distances, so the conditions are those of rounded ones; the gradients are complex steps.
What is true of the shapes themselves coal says.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import coal
import numpy as np
import pinocchio as pin

from tests.checker.further import Bound
from tests.checker.system import Array, System
from tests.checker.task import Ball, Shape, Task

if TYPE_CHECKING:
    from tests.checker.conditions import Layout, Motion

__all__ = ["centers", "clearance_bounds", "missing", "rounded", "true_distance"]

_TINY = 1e-30  # imaginary part of a complex step
_NEAR = 0.2  # [m] of rows that matter
_MOST_RAISED = 1.01  # of the margin by which a solution says that it keeps away farther; it is told rounded


def rounded(shape: Shape, p: Any) -> Any:
    """Distance of a point, in the axes of the shape, from its surface; complex, too.

    Edges are rounded; a sphere is a point that a radius rounds, see docs/obstacles.md.
    """
    e = shape.smoothing

    def length(x: Any) -> Any:
        return np.sqrt(x * x + e * e)

    def positive(w: Any) -> Any:
        return 0.5 * (w + length(w))

    is_box = shape.kind == "box"
    sides = [length(0.5 * size) for size in shape.sizes] if is_box else [0.0] * 3
    gaps = [length(p[i]) - sides[i] for i in range(3)]
    largest = gaps[0]
    for gap in gaps[1:]:
        largest = 0.5 * (largest + gap + length(largest - gap))
    found = np.sqrt(sum(positive(gap) ** 2 for gap in gaps)) - positive(-largest)
    return found if is_box else found - shape.sizes[0]


def _slope(shape: Shape, p: Array) -> Array:
    return np.array([rounded(shape, p + 1j * _TINY * axis).imag / _TINY for axis in np.eye(3)])


def _at(system: System, ball: Ball) -> Any:
    """Frame of a sphere, placed with its axes at the sphere's centre; frames are placed already."""
    frame = system.model.getFrameId(ball.frame)
    return frame, system.data.oMf[frame].act(np.array(ball.center))


def _clearance(system: System, ball: Ball, shape: Shape) -> tuple[float, Array]:
    """Clearance beyond the margin, and its derivative in q."""
    frame, center = _at(system, ball)
    inside = shape.rotation.T @ (center - shape.position)
    J = system.frame_jacobian(frame, pin.LOCAL_WORLD_ALIGNED)
    arm = center - system.data.oMf[frame].translation
    moved = J[:3] - pin.skew(arm) @ J[3:]
    value = float(rounded(shape, inside)) - ball.radius - shape.margin
    return value, (shape.rotation @ _slope(shape, inside)) @ moved


def centers(system: System, balls: Sequence[Ball], qs: Array) -> Array:
    """Centers of spheres at every node, shape (nodes, balls, 3)."""
    found = np.zeros((len(qs), len(balls), 3))
    for n, q in enumerate(qs if balls else ()):
        system.place(q)
        found[n] = [_at(system, ball)[1] for ball in balls]
    return found


def _all_clearances(system: System, task: Task, qs: Array) -> Array:
    """Of every node, sphere and shape."""
    at, radii = centers(system, task.balls, qs), np.array([ball.radius for ball in task.balls])
    inside = [np.moveaxis((at - shape.position) @ shape.rotation, -1, 0) for shape in task.shapes]
    found = [rounded(shape, p) - radii - shape.margin for shape, p in zip(task.shapes, inside, strict=True)]
    return np.stack(found, axis=-1)


def clearance_bounds(system: System, task: Task, motion: Motion, layout: Layout) -> Iterator[Bound]:
    """Rows at nodes 1..N; a margin that was raised is where the motion touches it."""
    if not task.shapes:
        return
    every = _all_clearances(system, task, motion.qs[1:])
    nearest = every.min(axis=(0, 1))
    raised = np.where((nearest > 0.0) & (nearest <= _MOST_RAISED * motion.raised), nearest, 0.0)
    for n, i, k in np.argwhere(every < _NEAR):
        system.place(motion.qs[n + 1])
        ball, shape = task.balls[i], task.shapes[k]
        value, slope = _clearance(system, ball, shape)
        if not np.abs(slope).max() > 0.0:
            continue  # stands still
        columns = layout.x(n + 1).start + np.arange(system.nv)
        claimed = max(-motion.claimed(f"distance of {ball.name} from {shape.name}", n + 1), 0.0)
        yield Bound(f"clearance[{n + 1}]", raised[k] - value, 1.0, columns, -slope, claimed)


def true_distance(center: Array, radius: float, shape: Shape) -> float:
    """Distance of a sphere from a shape, by coal [m]."""
    made = (
        coal.Sphere(float(shape.sizes[0])) if shape.kind == "sphere" else coal.Box(*map(float, shape.sizes))
    )
    there = coal.Transform3s(np.array(shape.rotation), np.array(shape.position))
    here = coal.Transform3s(np.eye(3), np.array(center))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return float(coal.distance(made, there, coal.Sphere(float(radius)), here, request, result))


def missing(task: Task, at: Array) -> float:
    """What is missing to a margin at worst [m], by the distances themselves, less what rounding may take.

    Coal is asked for those alone that may be worst by the sphere about the shape.
    """
    worst, radii = 0.0, np.array([ball.radius for ball in task.balls])
    for shape in task.shapes:
        around = shape.sizes[0] if shape.kind == "sphere" else np.linalg.norm(shape.sizes) / 2.0
        kept = shape.margin - shape.smoothing
        least = np.linalg.norm(at - shape.position, axis=-1) - radii - around - kept
        for n, i in zip(*np.unravel_index(np.argsort(least, axis=None), least.shape), strict=True):
            if least[n, i] >= -worst:
                break
            worst = max(worst, kept - true_distance(at[n, i], radii[i], shape))
    return worst
