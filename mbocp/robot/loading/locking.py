"""Locking joints: they become rigid, their links merge into the parent's body.

The link behind a locked joint is part of the body before it, with an inertia and placements of frames and
further joints that depend on the joint's value. Only entries that do so can be parameters of functions; the
others are the same for every value, to the last bit, so that models differ in the former alone.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from mbocp._arrays import Array
from mbocp._measured import plain_numbers
from mbocp.exceptions import DimensionMismatch, InvalidValue, UnsupportedRobot
from mbocp.robot import joints
from mbocp.robot.large import check_working_memory
from mbocp.symbolic.model_numbers import ModelNumber, all_numbers, values_of, with_values

Lock = Mapping[str, float | Sequence[float]] | Sequence[str]
_MIN_NORM = 1e-8
_SAMPLES = 3  # values of the joints; what depends on them differs between two of them but for an accident
_ROUND_OFF = 1e-13  # of the largest entry of an inertia's moments, or a placement


def lock_joints(
    model: pin.Model,
    visuals: pin.GeometryModel,
    q0: Array,
    lock: Lock,
    robot: str,
    named: Collection[str] = (),
) -> tuple[pin.Model, pin.GeometryModel, Array, tuple[ModelNumber, ...]]:
    """Return model, visuals and pose without the locked joints, and numbers that values of some decide.

    Parameters
    ----------
    lock : mapping or sequence of str
        Joint name to value [rad, m] (or list of numbers), or names of joints to lock at `q0`.
        Joints that mimic a locked joint are locked with it.
    named : collection of str
        Those of them whose values are to make no difference but in numbers of the model.
    """
    values = by_joint(lock)
    if not values:
        return model, visuals, q0, ()
    gone = _find_joints(model, values, robot)
    given = {name: value for name, value in values.items() if value is not None}
    q_ref = pose_by_joint(model, q0, given, robot)
    check_working_memory(model)
    reduced, (shown,) = pin.buildReducedModel(model, [visuals], gone, q_ref)
    if reduced.nv == 0:
        raise UnsupportedRobot(f"robot {robot!r}: all joints are locked, nothing is left to move")
    names = list(model.names)
    places = [joints.configuration_slice(model, names.index(name)) for name in joints.joint_names(reduced)]
    kept = np.concatenate([q_ref[place] for place in places])
    varied = [joint for joint in gone if model.names[joint] in named]
    if not varied:
        return reduced, shown, kept, ()
    reduced, numbers = reduce_by_locks(model, gone, varied, reduced, q_ref)
    return reduced, shown, kept, numbers


def by_joint(lock: Any) -> dict[str, Any]:
    """Locked joints and their positions; None: at the initial pose."""
    return dict(lock) if isinstance(lock, Mapping) else dict.fromkeys(lock)


def _find_joints(model: pin.Model, names: Iterable[str], robot: str) -> list[int]:
    """Joints of these names, and those that follow them."""
    ids = {joints.joint_id(model, name, robot) for name in names}
    for joint in ids:
        refuse_follower(model, joint, robot)
    return sorted(ids | {follower for leader, follower in _followers(model) if leader in ids})


def joint_configuration(model: pin.Model, joint: int, value: float | ArrayLike, robot: str) -> Array:
    """Configuration of one joint from a number or list.

    A continuous joint takes its angle [rad] or (cos, sin), a planar joint (x, y, angle) or (x, y, cos, sin);
    quaternions are xyzw and are normalised.
    """
    kind, name = joints.joint_kind(model, joint), model.names[joint]
    where = f"robot {robot!r}: joint {name!r}"
    value = _plain(value, kind, where)
    array = np.atleast_1d(np.array(value, dtype=float))
    if not np.isfinite(array).all():
        raise InvalidValue(where, array.tolist(), "finite numbers")
    if kind.word in ("continuous", "planar") and array.size == len(kind.q) - 1:
        array = np.concatenate([array[:-1], [np.cos(array[-1]), np.sin(array[-1])]])
    if array.shape != (len(kind.q),):
        takes = ", ".join(suffix or unit for suffix, unit in kind.q)
        hint = f"a {kind.word} joint takes {takes}"
        raise DimensionMismatch(where, array.shape, (len(kind.q),), hint)
    for a, b in kind.unit_groups:
        norm = float(np.linalg.norm(array[a:b]))
        if norm < _MIN_NORM:
            raise InvalidValue(where, f"{array[a:b].tolist()} of norm {norm:.3g}", "a unit vector")
        array[a:b] /= norm
    return array


def pose_by_joint(
    model: pin.Model, q: Array, values: Mapping[str, float | Sequence[float]], robot: str
) -> Array:
    """Copy of `q` with the joints in `values` set."""
    out = np.array(q)
    for name, value in values.items():
        joint = joints.joint_id(model, name, robot)
        refuse_follower(model, joint, robot)
        out[joints.configuration_slice(model, joint)] = joint_configuration(model, joint, value, robot)
    return out


def _followers(model: pin.Model) -> list[tuple[int, int]]:
    """Pairs of joint indices (leader, mimic joint that follows it)."""
    return list(zip(model.mimicked_joints, model.mimicking_joints, strict=True))


def refuse_follower(model: pin.Model, joint: int, robot: str) -> None:
    """Refuse a mimic joint where a joint with a position and control of its own is needed."""
    for leader, follower in _followers(model):
        if follower == joint:
            raise UnsupportedRobot(
                f"robot {robot!r}: joint {model.names[joint]!r} mimics {model.names[leader]!r} and has no "
                f"position or control of its own: name {model.names[leader]!r}, or load with mimic = false"
            )


def _plain(value: float | ArrayLike, kind: joints.JointKind, where: str) -> Any:
    """Numbers whose units, where they have some, are those of the joint."""
    values: Any = [value] if isinstance(value, float) else value
    if not isinstance(values, list | tuple):
        return value
    units = list(kind.q)
    if kind.word in ("continuous", "planar") and len(values) == len(units) - 1:
        units[-2:] = [("angle", "rad")]
    return plain_numbers(values, units, where)


def reduce_by_locks(
    model: pin.Model, locked: Sequence[int], named: Sequence[int], reduced: pin.Model, q: Array
) -> tuple[pin.Model, tuple[ModelNumber, ...]]:
    """Model without the locked joints, and which of its numbers the values of some of them decide.

    Parameters
    ----------
    model : pinocchio.Model
        Before locking.
    locked : sequence of int
        All joints that are locked.
    named : sequence of int
        Those whose values are to make no difference but in these numbers.
    reduced : pinocchio.Model
        After locking.
    q : ndarray, shape (nq,)
        Configuration at which they are locked.

    Returns
    -------
    model : pinocchio.Model
        `reduced`, with all else but these numbers from other values of the joints, which is the same but for
        round-off.
    numbers : tuple of ModelNumber
    """
    others = [pin.buildReducedModel(model, list(locked), at) for at in _elsewhere(model, named, q)]
    numbers = all_numbers(reduced)
    samples = np.array([values_of(other, numbers) for other in others])
    spread, sizes = np.ptp(samples, axis=0), np.abs(samples).max(axis=0)
    varying, start = list[ModelNumber](), 0
    for _, group in groupby(numbers, key=_kind):
        members = list(group)
        here = slice(start, start + len(members))
        largest = sizes[here].max()
        varying += [n for n, s in zip(members, spread[here], strict=True) if s > _ROUND_OFF * largest]
        start = here.stop
    found = tuple(varying)
    return with_values(others[0], found, values_of(reduced, found)), found


def _kind(number: ModelNumber) -> tuple[str, int, int]:
    """Entries whose sizes compare: mass, centre of mass or moments, rotation or translation of one owner."""
    is_inertia = number.of == "inertia"
    part = (number.entry > 0) + (number.entry > 3) if is_inertia else int(number.entry > 8)
    return number.of, number.owner, part


def _elsewhere(model: pin.Model, named: Sequence[int], q: Array) -> list[NDArray[np.float64]]:
    """Configurations with other values of the joints, the same ones each time."""
    rng, found = np.random.default_rng(0), []
    for _ in range(_SAMPLES):
        moved = pin.integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, model.nv))
        at = np.array(q)
        for joint in named:
            where = joints.configuration_slice(model, joint)
            at[where] = moved[where]
        found.append(at)
    return found
