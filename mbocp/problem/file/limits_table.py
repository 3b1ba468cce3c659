"""`[limits]`: its keys, from what is written to bounds, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np

from mbocp._arrays import Array
from mbocp._keys import Key, Table, Takes
from mbocp._measured import plain_number
from mbocp.exceptions import DimensionMismatch, InvalidValue, ProblemError, suggest
from mbocp.problem.file.kinds import Limits, ProfileName, Ranges, Sizes
from mbocp.problem.file.messages import locate
from mbocp.problem.file.named_values import coordinate_slots, tangent_slots
from mbocp.problem.file.profile import Profile
from mbocp.problem.limits import LIMITS, Bounds, is_plain
from mbocp.robot import Robot
from mbocp.robot.parts import Label
from mbocp.terms import RATE_TERMS, RateTerm

_Sides = tuple[Array, Array]
_NUMBERS = Takes("number, list, table")  # robots have none of their own


class LimitsTable(Table):
    """Bounds along the motion; components that are left out have none."""

    profile: Annotated[
        ProfileName,
        Key("[limits that a maker publishes](profiles.md), by name or file; `true`: by the robot's name"),
    ] = None
    effort: Annotated[Limits, Key("[limits](#limits) of the controls; `true`: the robot's own", "N, N m")] = (
        None
    )
    effort_rms: Annotated[
        Sizes,
        Key(
            "of the [root mean squares](#root-mean-squares) of the controls",
            "N, N m",
        ),
    ] = None
    velocity: Annotated[Limits, Key("of the velocities", "m/s, rad/s")] = None
    position: Annotated[Ranges, Key("of lengths and angles", "m, rad")] = None
    acceleration: Annotated[
        Limits,
        _NUMBERS,
        Key(
            "of the [accelerations](#accelerations-jerks-rates-and-powers), the means of the steps",
            "m/s^2, rad/s^2",
        ),
    ] = None
    jerk: Annotated[Limits, _NUMBERS, Key("of the jerks", "m/s^3, rad/s^3")] = None
    effort_rate: Annotated[Limits, _NUMBERS, Key("of the rates of the controls", "N/s, N m/s")] = None
    power: Annotated[
        Limits, _NUMBERS, Key("of the powers of the controls; a pair's lower side is the regeneration", "W")
    ] = None


def read_limits(robot: Robot, limits_table: LimitsTable, profile: Profile | None = None) -> Bounds:
    """Make the bounds of a table `[limits]`, and of the profile that it names.

    Raises
    ------
    ProblemError, DimensionMismatch, InvalidValue, UnknownJoint
        If a value does not fit the robot.
    """
    own = {key: value for key, value in dict(limits_table).items() if key != "profile" and value is not None}
    return bounds_from(robot, **{**(profile.limits(robot) if profile is not None else {}), **own})


def bounds_from(
    robot: Robot,
    effort: Any = None,
    velocity: Any = None,
    position: Any = None,
    effort_rms: Any = None,
    **rates: Any,
) -> Bounds:
    """Make the bounds from the values of the keys of `[limits]`.

    Parameters
    ----------
    robot : Robot
    effort, velocity : bool, float, list or mapping, optional
        True for the robot's own; a number for all, or one entry for each in a list or table by name, where an
        entry is a number, the largest absolute value, or a pair [lower, upper].
    position : bool, list or mapping, optional
        True for the robot's own, or pairs.
    effort_rms : float, list or mapping, optional
        Positive numbers, for all or for each.
    **rates : float, list or mapping, optional
        By keys of `mbocp.terms.RATE_TERMS`: like effort or velocity, but robots have none of their own.

    Raises
    ------
    ProblemError, DimensionMismatch, InvalidValue, UnknownJoint
        If a value does not fit the robot.
    """
    with locate(LIMITS["u"]):
        u_lower, u_upper = _effort(robot, effort)
    with locate(LIMITS["rms"]):
        rms_upper = _effort_rms(robot, effort_rms)
    with locate(LIMITS["v"]):
        v_lower, v_upper = _velocity(robot, velocity)
    with locate(LIMITS["q"]):
        q_lower, q_upper = _position(robot, position)
    sides: dict[str, Array] = {}
    for key, written in rates.items():
        term = RATE_TERMS[key]
        with locate(LIMITS[term.letter]):
            lower, upper = _rate(robot, term, written)
        sides |= {f"{term.letter}_lower": lower, f"{term.letter}_upper": upper}
    return Bounds(
        u_lower=u_lower,
        u_upper=u_upper,
        rms_lower=np.full_like(rms_upper, -np.inf),
        rms_upper=rms_upper,
        v_lower=v_lower,
        v_upper=v_upper,
        q_lower=q_lower,
        q_upper=q_upper,
        **sides,
    )


def write_limits(limits: Bounds) -> dict[str, Any]:
    """The table `[limits]`, or that of a phase."""
    found = {}
    for letter, key in LIMITS.items():
        if limits.finite(letter).any():
            lower, upper = getattr(limits, f"{letter}_lower"), getattr(limits, f"{letter}_upper")
            found[key.removeprefix("limits.")] = upper if letter == "rms" else np.column_stack([lower, upper])
    return found


def _rate(robot: Robot, term: type[RateTerm], written: Any) -> _Sides:
    key = LIMITS[term.letter]
    if written is True:
        raise ProblemError(f"{key}: got true, but URDFs have no such limits; give numbers")
    is_of_motion = term.over == "v"
    slots = tangent_slots(robot) if is_of_motion else _control_slots(robot, key, written)
    labels = robot.v_labels if is_of_motion else robot.u_labels
    none = np.full(len(labels), np.inf)
    return _sides(robot, key, written, (-none, none), slots, labels)


def _effort(robot: Robot, written: Any) -> _Sides:
    own = robot.limits.effort
    slots = _control_slots(robot, LIMITS["u"], written)
    return _sides(robot, LIMITS["u"], written, (-own, own), slots, robot.u_labels)


def _effort_rms(robot: Robot, written: Any) -> Array:
    """Upper bounds; what is written is positive."""
    key, none = LIMITS["rms"], np.full(robot.nu, np.inf)
    slots = _control_slots(robot, key, written)
    return _sides(robot, key, written, (-none, none), slots, robot.u_labels)[1]


def _control_slots(robot: Robot, key: str, written: Any) -> dict[str, slice]:
    """Places of the controls, by name; a table with another name is refused."""
    names = [label.name for label in robot.u_labels]
    slots = {name: slice(i, i + 1) for i, name in enumerate(names)}
    if isinstance(written, Mapping):
        for name in written:
            if name not in slots:
                raise ProblemError(
                    f"{key}: robot {robot.name!r} has no control {name!r}: {suggest(name, names)}"
                )
    return slots


def _velocity(robot: Robot, written: Any) -> _Sides:
    own = robot.limits.velocity
    return _sides(robot, LIMITS["v"], written, (-own, own), tangent_slots(robot), robot.v_labels)


def _position(robot: Robot, written: Any) -> _Sides:
    key, plain = LIMITS["q"], is_plain(robot)
    lower = np.where(plain, robot.limits.position_lower, -np.inf)
    upper = np.where(plain, robot.limits.position_upper, np.inf)
    slots = coordinate_slots(robot)
    if isinstance(written, Mapping):
        for name in written:
            if name in slots and not plain[slots[name]].all():
                usable = [n for n in slots if plain[slots[n]].all() and n.startswith(f"{name}.")]
                advice = f"; name {', '.join(usable)}" if usable else ""
                raise ProblemError(
                    f"{key}.{name}: a unit quaternion or a (cos, sin) pair has no limits, only lengths and "
                    f"the angles of revolute joints have{advice}"
                )
    return _sides(robot, key, written, (lower, upper), slots, robot.q_labels)


def _sides(
    robot: Robot, key: str, written: Any, own: _Sides, slots: Mapping[str, slice], labels: Sequence[Label]
) -> _Sides:
    """Lower and upper bounds from the values in a file."""
    size = len(own[0])
    if written is True:
        if not any(np.isfinite(side).any() for side in own):
            raise ProblemError(f"{key}: got true, but robot {robot.name!r} has no such limits; give numbers")
        return own
    lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
    if written is None or written is False:
        return lower, upper
    if isinstance(written, Mapping):
        for name, entry in written.items():
            if name not in slots:
                raise robot.unknown_joint(name, slots)
            lower[slots[name]], upper[slots[name]] = _pair(entry, f"{key}.{name}", labels[slots[name]], key)
    elif isinstance(written, Sequence):
        if len(written) != size:
            names = ", ".join(name for name, slot in slots.items() if slot.stop - slot.start == 1)
            raise DimensionMismatch(key, len(written), size, f"entries: {names}")
        for i, entry in enumerate(written):
            lower[i], upper[i] = _pair(entry, f"{key}[{i}]", labels[i : i + 1], key)
    else:
        lower[:], upper[:] = _pair(written, key, labels, key)
    return lower, upper


def _pair(
    entry: float | Sequence[float], name: str, labels: Sequence[Label], key: str
) -> tuple[float, float]:
    for label in labels:
        for side in entry if isinstance(entry, Sequence) else [entry]:
            plain_number(side, label.unit, f"{key}.{label.name}")
    if isinstance(entry, Sequence):
        low, high = map(float, entry)
        if not low < high:
            raise InvalidValue(name, [low, high], "[lower, upper] with lower < upper")
        return low, high
    if not entry > 0.0:
        raise InvalidValue(name, entry, "a positive number, the largest absolute value, or [lower, upper]")
    return -entry, float(entry)
