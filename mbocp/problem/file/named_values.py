"""Configurations and velocities as people write them: plain lists, or tables by joint name.

A joint that Pinocchio stores as cosine and sine (continuous, planar) may be given by its angle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from functools import partial
from itertools import islice
from typing import Any, TypeAlias, TypeVar

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp._measured import plain_numbers
from mbocp._text import warn_caller
from mbocp.exceptions import DimensionMismatch, ProblemError, locate, suggest
from mbocp.problem._checks import ProblemWarning
from mbocp.problem.goals.end_control import EndControl
from mbocp.robot import Robot
from mbocp.robot.joints import JointPlace
from mbocp.robot.parts import Label
from mbocp.terms.written import FREE

Written: TypeAlias = Sequence[float] | Mapping[str, float | Sequence[float]]

_T = TypeVar("_T")

_TURN = 6.28  # [rad] as people round a full one


def _labels_to_write(robot: Robot, place: JointPlace, count: int) -> Sequence[Label]:
    """Names and units of the numbers that a person writes."""
    labels = robot.q_labels[place.q]
    is_angle = place.has_angle and count == place.n_written
    return [*labels[:-2], Label(place.name, "rad")] if is_angle else labels


def _expand(place: JointPlace, numbers: Sequence[float], key: str) -> list[float]:
    """Return the `nq` numbers of a joint."""
    values = [float(number) for number in numbers]
    if len(values) == place.nq:
        return values
    if place.has_angle and len(values) == place.n_written:
        return [*values[:-1], math.cos(values[-1]), math.sin(values[-1])]
    hint = f"joint {place.name!r}"
    if place.has_angle:
        hint += f", or {place.n_written} with the angle [rad]"
    raise DimensionMismatch(key, len(values), place.nq, hint)


def configuration_from(robot: Robot, written: Written, base: Array, key: str) -> tuple[Array, BoolArray]:
    """Return a configuration and which tangent directions of it were written.

    Parameters
    ----------
    robot : Robot
    written : sequence or mapping
        All of `q`, either its `nq` numbers or with one angle for each continuous joint, or some joints by
        name.
    base : ndarray, shape (nq,)
        Where the joints are that a mapping does not name. Motors of elastic joints need no numbers: without
        them they are where the joints stay at rest.
    key : str
        Dotted key, for messages.
    """
    slots = robot.joint_places
    written = _without_motors(robot, slots, written)
    written = _by_part(robot, written, key, [slot.nq for slot in slots], [s.n_written for s in slots])
    q = np.array(base, dtype=np.float64)
    active = np.zeros(robot.nv, dtype=np.bool_)
    for slot, numbers in _by_joint(robot, slots, written, key):
        where = f"{key}.{slot.name}" if isinstance(written, Mapping) else key
        values = _plain_values(numbers, _labels_to_write(robot, slot, len(numbers)), key)
        q[slot.q] = _expand(slot, values, where)
        if not key.startswith("start"):
            _warn_of_turns(slot, numbers, base, where)
        active[slot.v] = True
    q = np.array(robot.balanced(q, active)) if robot.elastic else q
    return q, active


def _plain_values(numbers: Sequence[float], labels: Sequence[Label], key: str) -> list[float]:
    return plain_numbers(numbers, [(label.name, label.unit) for label in labels], key)


def _without_motors(robot: Robot, slots: Sequence[JointPlace], written: Written) -> Written:
    """A list without numbers for the motors of elastic joints as a table by joint."""
    motors = {joint.motor for joint in robot.elastic}
    rest = [slot for slot in slots if slot.name not in motors]
    if not motors or isinstance(written, Mapping) or len(written) != sum(slot.n_written for slot in rest):
        return written
    ends = np.cumsum([slot.n_written for slot in rest]).tolist()
    return {
        slot.name: list(written[end - slot.n_written : end]) for slot, end in zip(rest, ends, strict=True)
    }


def with_motors_at_rest(robot: Robot, active: BoolArray) -> BoolArray:
    """Return what is written of a rest, and the motors of elastic joints, where all else is written."""
    motors = [joint.at_v[1] for joint in robot.elastic]
    if not motors or not np.delete(active, motors).all():
        return active
    return np.ones_like(active)


def _warn_of_turns(slot: JointPlace, numbers: Sequence[float], base: Array, key: str) -> None:
    """Say of an angle a turn away from zero, or from where the joint begins, that turns do not count."""
    if not (slot.has_angle and len(numbers) == slot.n_written):
        return
    angle, begin = float(numbers[-1]), math.atan2(base[slot.q][-1], base[slot.q][-2])
    if max(abs(angle), abs(angle - begin)) >= _TURN:
        warn_caller(
            f"{key}: joint {slot.name!r} is stored as cosine and sine, which count no turns: {angle:g} rad "
            f"is {math.remainder(angle, 2 * math.pi):.4g} rad to it, the shorter way round; a revolute joint "
            "counts turns, via points lead through them",
            ProblemWarning,
        )


def tangent_from(robot: Robot, written: Written, key: str) -> tuple[Array, BoolArray]:
    """Return a velocity or momentum, zero where nothing was written, and which components were written."""
    value = np.zeros(robot.nv)
    active = np.zeros(robot.nv, dtype=np.bool_)
    labels = robot.p_labels if key.endswith(".p") else robot.v_labels
    if not isinstance(written, Mapping):
        if len(written) != robot.nv:
            raise DimensionMismatch(key, len(written), robot.nv, f"joints: {_names(robot.joint_places)}")
        value[:] = _plain_values(written, labels, key)
        active[:] = True
        return value, active
    slots = tangent_slots(robot)
    sizes = _tangent_sizes(robot)
    rest = {name: [0.0] * sizes[name] for name, entry in written.items() if entry == 0 and name in sizes}
    of_v = [slot.nv for slot in robot.joint_places]
    for name, entry in _by_part(robot, {**written, **rest}, key, of_v).items():
        where = _find(slots, name, robot)
        numbers = _as_list(entry)
        if len(numbers) != where.stop - where.start:
            raise DimensionMismatch(f"{key}.{name}", len(numbers), where.stop - where.start)
        value[where] = _plain_values(numbers, labels[where], key)
        active[where] = True
    return value, active


def rate_from(robot: Robot, written: Any, key: str) -> tuple[Array, BoolArray]:
    """Return a velocity, momentum or acceleration, of which 0 says that all is zero; and what was written."""
    if isinstance(written, float):
        return np.zeros(robot.nv), np.ones(robot.nv, dtype=np.bool_)
    with locate(key):
        return tangent_from(robot, written, key)


def weights_from(robot: Robot, written: float | Written, key: str) -> Array:
    """Return `nv` weights from one number for all, a list, or a table by joint name (the others are zero)."""
    if isinstance(written, (int, float)):
        return np.array(_plain_values([written] * robot.nv, robot.v_labels, key), dtype=np.float64)
    if not isinstance(written, Mapping):
        return tangent_from(robot, written, key)[0]
    slots = _tangent_sizes(robot)
    spread = {name: _spread(entry, _find(slots, name, robot)) for name, entry in written.items()}
    return tangent_from(robot, spread, key)[0]


def _tangent_sizes(robot: Robot) -> dict[str, int]:
    """How many components of v each name stands for: joints, components, parts."""
    sizes = {name: where.stop - where.start for name, where in tangent_slots(robot).items()}
    for part in robot.parts:
        sizes[part.name] = sum(slot.nv for slot in robot.joint_places if slot.name.startswith(part.prefix))
    return sizes


def find_named_places(
    robot: Robot,
    written: Mapping[str, Any],
    slots: Mapping[str, slice],
    labels: Sequence[Label],
    refusal: Callable[[str], Exception],
) -> Iterator[tuple[str, list[int]]]:
    """Names of a table, and the places that each stands for: those of patterns, of parts, then of one thing.

    Parameters
    ----------
    robot : Robot
    written : mapping
        Its names are those of `slots`, of parts of the robot, or patterns with `*` and `?`.
    slots : mapping of str to slice
        Places of each name.
    labels : sequence of Label
        Of all places. A part, or a pattern, stands for those whose names are its own.
    refusal : callable
        Makes the error about a name that stands for nothing.
    """
    prefixes = {part.name: part.prefix for part in robot.parts}
    found: list[list[tuple[str, list[int]]]] = [[], [], []]
    for name in written:
        if name in slots:
            places, rank = list(range(len(labels)))[slots[name]], 2
        elif name in prefixes:
            places, rank = [i for i, one in enumerate(labels) if one.name.startswith(prefixes[name])], 1
        else:
            places, rank = [i for i, one in enumerate(labels) if fnmatchcase(one.name, name)], 0
        if not places:
            raise refusal(name)
        found[rank].append((name, places))
    return iter([pair for pairs in found for pair in pairs])


def control_from(robot: Robot, written: float | Written, key: str) -> Array:
    """Return `nu` controls from one number for all, a list, or a table by actuator (the others are zero)."""
    names = [label.name for label in robot.u_labels]
    if isinstance(written, (int, float)):
        return np.array(_plain_values([written] * robot.nu, robot.u_labels, key), dtype=np.float64)
    if not isinstance(written, Mapping):
        if len(written) != robot.nu:
            raise DimensionMismatch(key, len(written), robot.nu, f"actuators: {', '.join(names)}")
        return np.array(_plain_values(written, robot.u_labels, key), dtype=np.float64)
    u, slots = np.zeros(robot.nu), {name: slice(i, i + 1) for i, name in enumerate(names)}
    for name, places in find_named_places(
        robot, written, slots, robot.u_labels, partial(_no_actuator, robot, key)
    ):
        numbers = _spread(written[name], len(places))
        if len(numbers) != len(places):
            raise DimensionMismatch(f"{key}.{name}", len(numbers), len(places))
        u[places] = _plain_values(numbers, [robot.u_labels[i] for i in places], key)
    return u


def _no_actuator(robot: Robot, key: str, name: str) -> Exception:
    names = [label.name for label in robot.u_labels]
    return ProblemError(f"{key}: robot {robot.name!r} has no actuator {name!r}: {suggest(name, names)}")


def end_control_from(robot: Robot, written: Any, key: str) -> EndControl:
    """Return what is said of controls before the start or after the end; of a table all of them."""
    if written is None or written == FREE:
        return EndControl("rest" if written is None else "free")
    if isinstance(written, Mapping):
        named = control_from(robot, dict.fromkeys(written, 1.0), key)
        missing = [label.name for label, has in zip(robot.u_labels, named, strict=True) if not has]
        if missing:
            raise ProblemError(f"{key}: says nothing of {', '.join(missing)}; give all controls, or a list")
    return EndControl("given", control_from(robot, written, key))


def end_control_table(said: EndControl) -> Any:
    """Return the key that reads back as the same; None: nothing has to be written."""
    return {"rest": None, "free": FREE, "given": said.value}[said.rule]


def _by_part(robot: Robot, written: Written, key: str, *sizes: Sequence[int]) -> Any:
    """Spread lists that stand for all joints of a part; each of `sizes` has the numbers of each joint."""
    if not isinstance(written, Mapping):
        return written
    spread: dict[str, float | Sequence[float]] = {}
    for name, entry in written.items():
        part = next((part for part in robot.parts if part.name == name), None)
        if part is None:
            spread[name] = entry
            continue
        inside = {
            slot.name: i for i, slot in enumerate(robot.joint_places) if slot.name.startswith(part.prefix)
        }
        options = [[counts[i] for i in inside.values()] for counts in sizes]
        numbers = _as_list(entry)
        counts = next((one for one in options if sum(one) == len(numbers)), None)
        if counts is None:
            expected = sum(options[0])
            raise DimensionMismatch(f"{key}.{name}", len(numbers), expected, f"joints: {', '.join(inside)}")
        rest = iter(numbers)
        spread |= {joint: list(islice(rest, count)) for joint, count in zip(inside, counts, strict=True)}
    return spread


def joint_values(robot: Robot, value: Array, active: BoolArray) -> dict[str, Any]:
    """Return the table by joint name that reads back as `value`, a configuration or tangent."""
    table: dict[str, Any] = {}
    for slot in robot.joint_places:
        if active[slot.v].all():
            table[slot.name] = value[slot.q if len(value) == robot.nq else slot.v].tolist()
    if len(value) == robot.nv:
        labels = [label.name for label in robot.v_labels]
        whole = [slot for slot in robot.joint_places if slot.name in table]
        covered = {i for slot in whole for i in range(slot.v.start, slot.v.stop)}
        table |= {labels[i]: float(value[i]) for i in np.flatnonzero(active) if i not in covered}
    return table


def tangent_slots(robot: Robot) -> dict[str, slice]:
    """Names of whole joints, and of single components such as ``root_joint.wx``, and their places in v."""
    components = {label.name: slice(i, i + 1) for i, label in enumerate(robot.v_labels)}
    return components | {slot.name: slot.v for slot in robot.joint_places}


def coordinate_slots(robot: Robot) -> dict[str, slice]:
    """Names of whole joints, and of single numbers such as ``root_joint.x``, and their places in q."""
    numbers = {label.name: slice(i, i + 1) for i, label in enumerate(robot.q_labels)}
    return numbers | {slot.name: slot.q for slot in robot.joint_places}


def _by_joint(
    robot: Robot, slots: Sequence[JointPlace], written: Written, key: str
) -> Iterator[tuple[JointPlace, Sequence[float]]]:
    if isinstance(written, Mapping):
        by_name = {slot.name: slot for slot in slots}
        for name, entry in written.items():
            yield _find(by_name, name, robot), _as_list(entry)
        return
    sizes = [slot.nq for slot in slots]
    if len(written) != sum(sizes):
        shorter = [slot.n_written for slot in slots]
        if len(written) != sum(shorter):
            hint = f"joints: {_names(slots)}"
            if len(written) < sum(shorter):
                hint += "; `lock` of the robot makes those rigid that are not to move"
            if shorter != sizes:
                hint = f"or ({sum(shorter)},) with one angle for each continuous joint; {hint}"
            raise DimensionMismatch(key, len(written), sum(sizes), hint)
        sizes = shorter
    start = 0
    for slot, size in zip(slots, sizes, strict=True):
        yield slot, written[start : start + size]
        start += size


def _find(slots: Mapping[str, _T], name: str, robot: Robot) -> _T:
    if name not in slots:
        raise robot.unknown_joint(name, slots)
    return slots[name]


def _as_list(entry: float | Sequence[float]) -> Sequence[float]:
    return [entry] if isinstance(entry, (int, float)) else entry


def _spread(entry: float | Sequence[float], size: int) -> Sequence[float]:
    return [entry] * size if isinstance(entry, (int, float)) else entry


def _names(slots: Sequence[JointPlace], limit: int = 12) -> str:
    named = [slot.name if slot.nq == 1 else f"{slot.name} ({slot.nq})" for slot in slots]
    return ", ".join(named[:limit]) + (f", ... ({len(named)} joints)" if len(named) > limit else "")
