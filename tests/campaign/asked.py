"""What tasks ask beside goal and limits, around a motion that fulfils it: points, spans, rates, durations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from tests.campaign.frames import inner, last_frame, moving, placements
from tests.campaign.guarded import beside
from tests.campaign.on_the_way import followed, shape_table, stopped, via_time
from tests.campaign.robots import Loaded
from tests.campaign.witness import Witness
from tests.checker.system import Array, System
from tests.checker.task import FramePose, PathBound, Point, Task

__all__ = ["ASKS", "asked", "asked_tables"]


def asked(kind: str, loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """The task with what `kind`, words of `ASKS` joined by "+", adds to it."""
    for word in filter(None, kind.split("+")):
        task = ASKS[word](loaded, task, witness, rng)
    return task


def _span(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """A height that is kept between two times, just below the motion."""
    frame = last_frame(loaded)
    first, last = sorted(rng.choice(np.arange(2, task.num_steps - 1), 2, replace=False).tolist())
    heights = np.array([place.translation[2] for place in placements(loaded.system, frame, witness)])
    below = heights[first : last + 1].min() - rng.uniform(0.0, 0.02) * max(float(np.ptp(heights)), 1e-3)
    bound = PathBound("position", frame, np.array([below]), np.array([np.inf]), (2,), first=first, last=last)
    return replace(task, path=(bound,))


def _gate(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """A coordinate that is given at one node: equal bounds."""
    frame, node = last_frame(loaded), inner(task, rng)
    places = placements(loaded.system, frame, witness)
    axis = int(rng.choice(np.flatnonzero(moving(places))))
    at = np.array([places[node].translation[axis]])
    return replace(task, path=(PathBound("position", frame, at, at, (axis,), first=node, last=node),))


def _plane(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """A coordinate that the motion keeps, at all nodes or from a node to another."""
    frame = last_frame(loaded)
    places = placements(loaded.system, frame, witness)
    axis = int(np.flatnonzero(~moving(places))[0])
    at = np.array([places[0].translation[axis]])
    first, last = (1, None) if rng.random() < 0.5 else (inner(task, rng), task.num_steps - 1)
    return replace(task, path=(PathBound("position", frame, at, at, (axis,), first=first, last=last),))


def _line(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """The straight line that the motion follows, exactly or as a tube."""
    frame = last_frame(loaded)
    places = placements(loaded.system, frame, witness)
    a, b = places[0].translation, places[-1].translation
    if rng.random() < 0.5:
        zero = np.zeros(2)
        bound = PathBound("line", frame, zero, zero, point=a, direction=_unit(b - a))
    else:
        width = np.array([0.02 * np.linalg.norm(b - a)])
        bound = PathBound("line", frame, -np.inf * width, width, point=a, direction=_unit(b - a))
    return replace(task, path=(bound,))


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def _kept(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """The axes that the motion keeps, exactly or within a cone."""
    frame = last_frame(loaded)
    axes = placements(loaded.system, frame, witness)[0].rotation
    zero, cone = np.zeros(3), np.array([rng.uniform(0.02, 0.1)])
    if rng.random() < 0.5:
        return replace(task, path=(PathBound("kept", frame, zero, zero, rotation=axes),))
    return replace(task, path=(PathBound("kept", frame, -np.inf * cone, cone, rotation=axes),))


def _cone(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """A largest angle of an axis to a direction, just above that of the motion."""
    frame, axis = last_frame(loaded), np.array([0.0, 0.0, 1.0])
    places = placements(loaded.system, frame, witness)
    direction = _unit(places[0].rotation @ axis + places[-1].rotation @ axis)
    largest = max(float(np.arccos(np.clip(direction @ place.rotation @ axis, -1.0, 1.0))) for place in places)
    most = np.array([min(largest * rng.uniform(1.02, 1.2), 3.0)])
    bound = PathBound("orientation", frame, -np.inf * most, most, direction=direction, axis=axis)
    return replace(task, path=(bound,))


def _spin(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """A largest angular speed of the last frame."""
    model, data, frame = loaded.system.model, loaded.system.data, last_frame(loaded)
    index, speeds = model.getFrameId(frame), []
    for q, v in zip(witness.qs, witness.vs, strict=True):
        pin.forwardKinematics(model, data, q, v)
        pin.updateFramePlacements(model, data)
        speeds.append(float(np.linalg.norm(pin.getFrameVelocity(model, data, index, pin.LOCAL).angular)))
    most = np.array([rng.uniform(1.02, 1.3) * max(speeds)])
    return replace(task, path=(PathBound("angular_speed", frame, -np.inf * most, most),))


def _via(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """Some joints, and now and then the speeds of others, at a node on the way."""
    nv, node = loaded.system.nv, inner(task, rng)
    q_active = rng.random(nv) < 0.6
    q_active[int(rng.integers(nv))] = True
    v_active = (rng.random(nv) < 0.5) & (rng.random() < 0.5)
    point = Point(node, witness.qs[node], q_active, witness.vs[node], v_active)
    return replace(task, points=(*task.points, point))


def _pose_at(
    loaded: Loaded, witness: Witness, node: int, rng: np.random.Generator, *, tolerance: bool
) -> FramePose:
    """Pose of the last frame there; with a tolerance beside it."""
    frame = last_frame(loaded)
    places = placements(loaded.system, frame, witness)
    place = places[node]
    position = np.where(moving(places), place.translation, np.nan)
    has_axes = loaded.system.nv >= 6 and rng.random() < 0.5
    rotation = place.rotation if has_axes else None
    if not tolerance:
        return FramePose(frame, position, rotation)
    box = 0.05 * max(float(np.ptp([p.translation for p in places], axis=0).max()), 1e-3)
    position = position + 0.9 * box * rng.uniform(-1.0, 1.0, 3)
    cone = 0.2 if has_axes else 0.0
    if has_axes:
        turn = rng.standard_normal(3)
        rotation = place.rotation @ pin.exp3(0.9 * cone * rng.random() * turn / np.linalg.norm(turn))
    return FramePose(frame, position, rotation, box, cone)


def _at_pose(loaded: Loaded, task: Task, node: int, pose: FramePose) -> Task:
    nobody, q = np.zeros(loaded.system.nv, dtype=bool), task.q_start
    return replace(task, points=(*task.points, Point(node, q, nobody, 0.0 * task.v_start, nobody, (pose,))))


def _via_pose(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    node = inner(task, rng)
    return _at_pose(loaded, task, node, _pose_at(loaded, witness, node, rng, tolerance=False))


def _via_box(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    node = inner(task, rng)
    return _at_pose(loaded, task, node, _pose_at(loaded, witness, node, rng, tolerance=True))


def _reach(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """A pose of the last frame in place of the goal of the joints; the speeds stay asked for."""
    pose = _pose_at(loaded, witness, task.num_steps, rng, tolerance=False)
    task = replace(task, q_active=np.zeros(loaded.system.nv, dtype=bool))
    return _at_pose(loaded, task, task.num_steps, pose)


def _around(values: Array, rng: np.random.Generator) -> Array:
    largest = np.abs(values).max(axis=0)
    largest = np.maximum(largest, 0.1 * largest.max()) * rng.uniform(1.02, 1.5, largest.size)
    return np.array([-largest, largest])


def _rates(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """One or two kinds of rates, just above those of the motion."""
    a = np.diff(witness.vs, axis=0) / task.dt
    found = {
        "acceleration": a,
        "jerk": np.vstack([2.0 * a[:1], np.diff(a, axis=0), -2.0 * a[-1:]]) / task.dt,  # from rest to rest
        "effort_rate": np.diff(witness.us, axis=0) / task.dt,
        "power": witness.us * (witness.vs[1:] @ loaded.system.selection),
    }
    chosen = rng.choice(list(found), int(rng.integers(1, 3)), replace=False)
    return replace(task, **{str(key): _around(found[str(key)], rng) for key in chosen})


def _free(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """A duration that is found; time costs about what the effort does."""
    efforts = 0.5 * float(np.mean(np.sum(task.effort * witness.us**2, axis=1)))
    weight = efforts * 10 ** rng.uniform(-1.0, 0.5)
    return replace(task, duration_range=(0.1 * task.duration, 3.0 * task.duration), time=float(weight))


def _crate(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """A box near the straight line."""
    return beside(loaded, task, witness, rng, ("box",))


def _clutter(loaded: Loaded, task: Task, witness: Witness, rng: np.random.Generator) -> Task:
    """A box and a sphere."""
    return beside(loaded, task, witness, rng, ("box", "sphere"))


ASKS: dict[str, Callable[[Loaded, Task, Witness, np.random.Generator], Task]] = {
    "span": _span,
    "gate": _gate,
    "plane": _plane,
    "line": _line,
    "kept": _kept,
    "cone": _cone,
    "spin": _spin,
    "via": _via,
    "via_pose": _via_pose,
    "via_box": _via_box,
    "reach": _reach,
    "rates": _rates,
    "free": _free,
    "times": stopped,
    "follow": followed,
    "crate": _crate,
    "clutter": _clutter,
}


# As mbocp reads it


def asked_tables(loaded: Loaded, task: Task) -> dict[str, Any]:
    """Keys of a problem for what was asked, to be put beside the others."""
    via, at_end = [], []
    for point in task.points:
        frames = [_frame_table(pose) for pose in point.frames]
        if point.node == task.num_steps:
            at_end += frames
            continue
        names = list(loaded.system.model.names)[1:]
        table: dict[str, Any] = {"share": point.node / task.num_steps, **via_time(task, point.node)}
        for key, values, active in (("q", point.q, point.q_active), ("v", point.v, point.v_active)):
            if active.any():
                table[key] = _by_joint(loaded.system, names, values, active, key)
        via.append({**table, **({"frame": frames} if frames else {})})
    found: dict[str, Any] = {"via": via} if via else {}
    if at_end:
        found["goal_frame"] = at_end
    if task.shapes:
        found["obstacle"] = [shape_table(shape) for shape in task.shapes]
    rates = {key: getattr(task, key) for key in ("acceleration", "jerk", "effort_rate", "power")}
    found["limits"] = {key: sides.T.tolist() for key, sides in rates.items() if sides is not None}
    if task.duration_range is not None:
        lower, upper = task.duration_range
        found["duration"] = {"min": lower, "max": upper, "guess": task.duration}
        found["time"] = task.time
    return found


def _by_joint(system: System, names: list[str], values: Array, active: Array, key: str) -> dict[str, float]:
    """Numbers by joint; tasks with points have joints of one number alone."""
    joints = list(system.model.joints)[1:]
    at = [(name, j.idx_q if key == "q" else j.idx_v, j.idx_v) for name, j in zip(names, joints, strict=True)]
    return {name: float(values[i]) for name, i, k in at if active[k]}


def _frame_table(pose: FramePose) -> dict[str, Any]:
    table: dict[str, Any] = {"name": pose.frame}
    if np.isfinite(pose.position).all():
        table["position"] = pose.position.tolist()
    else:
        table |= {"xyz"[i]: float(pose.position[i]) for i in np.flatnonzero(np.isfinite(pose.position))}
    if pose.rotation is not None:
        table["orientation"] = pin.Quaternion(pose.rotation).coeffs().tolist()
    if pose.box:
        table["position_tolerance"] = pose.box
    if pose.cone:
        table["orientation_tolerance"] = pose.cone
    return table
