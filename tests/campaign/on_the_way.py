"""Times that are found, and paths that frames follow, around a motion that fulfils them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from tests.campaign.frames import last_frame, placements
from tests.campaign.robots import Loaded
from tests.campaign.witness import Witness
from tests.checker.following import spline
from tests.checker.system import Array
from tests.checker.task import Followed, Point, Shape, Stop, Task

__all__ = ["followed", "shape_table", "stopped", "via_time"]

_POINTS = 6  # of a followed path
_SAMPLES = 2000
_STRAIGHT = 1e-9  # of the length: so far from a line is on it


def stopped(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """One or two configurations on the way, in part, at times that are found."""
    N, nv = task.num_steps, loaded.system.nv
    shares = ((0.3, 0.7),) if rng.random() < 0.5 else ((0.2, 0.45), (0.55, 0.8))
    stops, points = [], []
    for node in (round(N * rng.uniform(*sides)) for sides in shares):
        active = rng.random(nv) < 0.7
        active[int(rng.integers(nv))] = True
        nothing = np.zeros(nv, dtype=bool)
        points.append(Point(node, witness.qs[node], active, witness.vs[node], nothing))
        time = node * task.dt
        sides = (rng.uniform(0.3, 0.95), rng.uniform(1.05, 1.6)) if rng.random() < 0.5 else (0.0, np.inf)
        stops.append(Stop(node, sides[0] * time, sides[1] * time))
    return replace(task, points=(*task.points, *points), stops=tuple(stops))


def via_time(task: Task, node: int) -> dict[str, Any]:
    """The key of a time that is found."""
    for stop in task.stops:
        if stop.node == node:
            if not np.isfinite(stop.latest):
                return {"time": "free"}
            return {"time": {"min": stop.earliest, "max": stop.latest, "guess": node * task.dt}}
    return {}


def followed(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """The path of the last frame: exactly where it is a line, else within a tube that the motion keeps."""
    frame = last_frame(loaded)
    ps = np.array([place.translation for place in placements(loaded.system, frame, witness)])
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(ps, axis=0), axis=1)))
    inside = (np.arange(1, _POINTS - 1) + rng.uniform(-0.3, 0.3, _POINTS - 2)) / (_POINTS - 1)
    shares = np.concatenate([[0.0], inside, [1.0]])
    points = np.array([[np.interp(s * lengths[-1], lengths, column) for column in ps.T] for s in shares])
    path = Followed(frame, points)
    away = _farthest(spline(path), ps)
    if away > _STRAIGHT * lengths[-1]:
        path = replace(path, tolerance=1.5 * away + 1e-3 * lengths[-1])
    return replace(task, followed=(path,))


def _farthest(curve: CubicSpline, ps: Array) -> float:
    """Largest distance of points from a curve."""
    samples = curve(np.linspace(0.0, 1.0, _SAMPLES + 1))
    steps = np.diff(samples, axis=0)
    worst = 0.0
    for p in ps:
        away = p - samples[:-1]
        t = np.clip((away * steps).sum(axis=1) / np.maximum((steps**2).sum(axis=1), 1e-300), 0.0, 1.0)
        worst = max(worst, float(np.linalg.norm(away - t[:, None] * steps, axis=1).min()))
    return worst


def shape_table(shape: Shape) -> dict[str, Any]:
    """An obstacle as mbocp reads it."""
    sizes = {"radius": float(shape.sizes[0])} if shape.kind == "sphere" else {"size": shape.sizes.tolist()}
    quaternion = pin.Quaternion(np.array(shape.rotation)).coeffs()
    return {
        "name": shape.name,
        "shape": shape.kind,
        **sizes,
        "position": shape.position.tolist(),
        "orientation": quaternion.tolist(),
        "margin": shape.margin,
        "smoothing": shape.smoothing,
    }
