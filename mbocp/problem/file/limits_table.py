"""`[limits]`: its keys, from what is written to bounds, and back."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Annotated, Any

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp._keys import Key, Table, Takes
from mbocp._measured import plain_number
from mbocp.exceptions import DimensionMismatch, InvalidValue, ProblemError, locate, suggest
from mbocp.problem.file.named_values import coordinate_slots, find_named_places, tangent_slots
from mbocp.problem.file.profile import Profile
from mbocp.problem.file.value_kinds import Limits, ProfileName, Ranges, Sizes, is_list_of_limits
from mbocp.problem.limits import LIMITS, Bounds, is_plain
from mbocp.robot import Robot
from mbocp.robot.parts import Label
from mbocp.terms.rates import RATE_TERMS

_Sides = tuple[Array, Array]
_NUMBERS = Takes("number, list, table")  # robots have none of their own


class LimitsTable(Table):
    """Bounds along the motion; components that are left out have none."""

    profile: Annotated[
        ProfileName,
        Key("[what a maker publishes](profiles.md), by name or file; `true`: by the robot's name"),
    ] = None
    effort: Annotated[Limits, Key("[limits](#limits) of the controls; `true`: the robot's own", "N, N m")] = (
        None
    )
    effort_rms: Annotated[
        Sizes, Key("of the [root mean squares](#root-mean-squares) of the controls", "N, N m")
    ] = None
    velocity: Annotated[Limits, Key("of the velocities", "m/s, rad/s")] = None
    position: Annotated[Ranges, Key("of lengths and angles", "m, rad")] = None
    acceleration: Annotated[
        Limits, _NUMBERS, Key("of [accelerations](#accelerations-jerks-rates-and-powers)", "m/s^2, rad/s^2")
    ] = None
    jerk: Annotated[Limits, _NUMBERS, Key("of the jerks", "m/s^3, rad/s^3")] = None
    effort_rate: Annotated[Limits, _NUMBERS, Key("of the rates of the controls", "N/s, N m/s")] = None
    power: Annotated[Limits, _NUMBERS, Key("of the powers of the controls", "W")] = None


def read_limits(robot: Robot, limits_table: LimitsTable, profile: Profile | None = None) -> Bounds:
    """Make the bounds of a table `[limits]`, and of the profile that it names.

    Raises
    ------
    ProblemError, DimensionMismatch, InvalidValue, UnknownJoint
        If a value does not fit the robot.
    """
    own = {key: value for key, value in dict(limits_table).items() if key != "profile" and value is not None}
    return bounds_from(robot, **{**(profile.limits(robot) if profile is not None else {}), **own})


def bounds_from(robot: Robot, **written: Any) -> Bounds:
    """Make the bounds from the values of the keys of `[limits]`.

    Parameters
    ----------
    robot : Robot
    **written : bool, float, list or mapping, optional
        Of efforts and velocities True for the robot's own; a number for all, or one entry for each in a list
        or table by name, where an entry is a number, the largest absolute value, or a pair [lower, upper].
        Names are those of joints or controls, of parts, or patterns; what is named by itself counts before
        its part, and this before patterns. Of
        positions True for the robot's own, or pairs; of `effort_rms` positive numbers. Keys of
        `mbocp.terms.rates.RATE_TERMS` are like efforts and velocities, but robots have none of their own.

    Raises
    ------
    ProblemError, DimensionMismatch, InvalidValue, UnknownJoint
        If a value does not fit the robot.
    """
    sides: dict[str, Array] = {}
    for letter, key in LIMITS.items():
        word = key.removeprefix("limits.")
        if word in written or word not in RATE_TERMS:
            read = _position if letter == "q" else _of_velocities_or_controls
            with locate(key):
                sides[f"{letter}_lower"], sides[f"{letter}_upper"] = read(robot, letter, written.get(word))
    return Bounds(**{**sides, "rms_lower": np.full_like(sides["rms_upper"], -np.inf)})


def write_limits(limits: Bounds) -> dict[str, Any]:
    """The table `[limits]`, or that of a phase."""
    found = {}
    for letter, key in LIMITS.items():
        if limits.finite(letter).any():
            lower, upper = limits.sides(letter)
            found[key.removeprefix("limits.")] = upper if letter == "rms" else np.column_stack([lower, upper])
    return found


def _of_velocities_or_controls(robot: Robot, letter: str, written: Any) -> _Sides:
    key = LIMITS[letter]
    term = RATE_TERMS.get(key.removeprefix("limits."))
    if term is not None and written is True:
        raise ProblemError(f"{key}: got true, but URDFs have no such limits; give numbers")
    is_of_v = letter == "v" or (term is not None and term.over == "v")
    places = _Places.of_velocities(robot) if is_of_v else _Places.of_controls(robot, key)
    none = np.full(len(places.labels), np.inf)
    limits = robot.limits
    own = {"u": (limits.effort_lower, limits.effort), "v": (-limits.velocity, limits.velocity)}.get(
        letter, (-none, none)
    )
    lower, upper = _sides(robot, key, written, own, places)
    if letter == "v" and written is True:  # of motors with gears that are found: paths keep them
        free = np.isin(np.arange(robot.nv), [motor.dof for motor in robot.found_gears])
        lower, upper = np.where(free, -np.inf, lower), np.where(free, np.inf, upper)
    return lower, upper


def _position(robot: Robot, letter: str, written: Any) -> _Sides:
    key, plain = LIMITS[letter], is_plain(robot)
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
    places = _Places(slots, robot.q_labels, partial(_unknown_joint, robot, slots), plain)
    return _sides(robot, key, written, (lower, upper), places)


@dataclass(frozen=True, eq=False)
class _Places:
    """What a kind of limit has an entry for.

    Attributes
    ----------
    slots : mapping of str to slice
        Places by name.
    labels : sequence of Label
    refusal : callable
        Makes the error about a name that is none.
    usable : ndarray of bool, shape (places,), optional
        Which of them parts and patterns stand for; all by default.
    """

    slots: Mapping[str, slice]
    labels: Sequence[Label]
    refusal: Callable[[str], Exception]
    usable: BoolArray | None = None

    @classmethod
    def of_velocities(cls, robot: Robot) -> _Places:
        slots = tangent_slots(robot)
        return cls(slots, robot.v_labels, partial(_unknown_joint, robot, slots))

    @classmethod
    def of_controls(cls, robot: Robot, key: str) -> _Places:
        slots = {label.name: slice(i, i + 1) for i, label in enumerate(robot.u_labels)}
        return cls(slots, robot.u_labels, partial(_unknown_control, robot, key))

    def name_places(self, robot: Robot, written: Mapping[str, Any]) -> Iterator[tuple[str, list[int]]]:
        """Names of a table, and places that they stand for."""
        labels = self.labels
        if self.usable is not None:  # labels without a name stand for nothing
            pairs = zip(labels, self.usable, strict=True)
            labels = [label if usable else Label("", label.unit) for label, usable in pairs]
        return find_named_places(robot, written, self.slots, labels, self.refusal)


def _unknown_joint(robot: Robot, slots: Mapping[str, slice], name: str) -> Exception:
    return robot.unknown_joint(name, [*slots, *(part.name for part in robot.parts)])


def _unknown_control(robot: Robot, key: str, name: str) -> Exception:
    names = [label.name for label in robot.u_labels]
    names += [part.name for part in robot.parts if any(one.startswith(part.prefix) for one in names)]
    return ProblemError(f"{key}: robot {robot.name!r} has no control {name!r}: {suggest(name, names)}")


def _sides(robot: Robot, key: str, written: Any, own: _Sides, places: _Places) -> _Sides:
    """Lower and upper bounds from the values in a file."""
    size, labels = len(own[0]), places.labels
    if written is True:
        if not any(np.isfinite(side).any() for side in own):
            raise ProblemError(f"{key}: got true, but robot {robot.name!r} has no such limits; give numbers")
        return own
    lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
    if written is None or written is False:
        return lower, upper
    if isinstance(written, Mapping):
        for name, at in places.name_places(robot, written):
            own_labels = [labels[i] for i in at]
            lower[at], upper[at] = _of_name(written[name], f"{key}.{name}", own_labels, key)
    elif isinstance(written, Sequence):
        if len(written) != size:
            slots = places.slots.items()
            names = ", ".join(name for name, slot in slots if slot.stop - slot.start == 1)
            raise DimensionMismatch(key, len(written), size, f"entries: {names}")
        lower[:], upper[:] = _of_each(written, key, labels, key)
    else:
        lower[:], upper[:] = _pair(written, key, labels, key)
    return lower, upper


def _of_name(written: Any, name: str, labels: Sequence[Label], key: str) -> tuple[Any, Any]:
    """Of all that a name stands for: an entry, or a list with one for each."""
    if not is_list_of_limits(written):
        return _pair(written, name, labels, key)
    if len(written) != len(labels):
        raise DimensionMismatch(name, len(written), len(labels), ", ".join(label.name for label in labels))
    return _of_each(written, name, labels, key)


def _of_each(written: Sequence[Any], name: str, labels: Sequence[Label], key: str) -> tuple[Any, Any]:
    pairs = [_pair(entry, f"{name}[{i}]", labels[i : i + 1], key) for i, entry in enumerate(written)]
    lower, upper = zip(*pairs, strict=True)
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
