"""Published limits of robots: `limits.profile`, from the files of `mbocp/profiles`, or one's own.

A profile speaks of joints by name. Those of a robot may have a prefix, or several: `panda_`, `left/`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import Field, ValidationError

from mbocp._arrays import dataclass
from mbocp._files import is_file, path_of, read_toml
from mbocp._keys import Kind, Table
from mbocp._measured import KeyUnits, plain_number
from mbocp._quantities import Quantity
from mbocp._text import show
from mbocp.exceptions import ProblemError, Unreadable, suggest
from mbocp.problem.file.messages import schema_error
from mbocp.problem.limits import is_plain
from mbocp.robot import Robot
from mbocp.terms.kinds import AccelerationOverSpeed, MotorTorque
from mbocp.terms.over_speed import OverSpeed, read_falling_lines
from mbocp.terms.written import range_of, read_side

_FOLDER = Path(__file__).parents[2] / "profiles"
_OF_CONTROLS = ("effort", "effort_rate", "power")
_OF_FORCES = ("effort", "effort_rate")
_OF_ANGLES = ("position", "velocity", "acceleration", "jerk")
_OVER_SPEEDS: Mapping[str, type[OverSpeed]] = {
    "effort": MotorTorque,
    "acceleration": AccelerationOverSpeed,
}  # by key
_LEAST_SHARE = 0.5  # of its joints that a robot has; the others may be locked

_Numbers: TypeAlias = float | list[float]
_WRITTEN = "number, list with an entry for each joint, or table of `payload` and `values`"
_OVER_SPEED = f"{_WRITTEN}, `speed` and `values`, or all three"


def _numbers(value: Any, over: tuple[str, ...] = ("payload",)) -> _Numbers | dict[str, Any]:
    if not isinstance(value, Mapping):
        return _one(value)
    columns = tuple(key for key in over if key in value)
    if not columns or set(value) != {*columns, "values"}:
        expected = " or ".join(f"{key} and values" for key in over)
        expected += f", or {', '.join(over)} and values" if len(over) > 1 else ""
        raise ValueError(f"got keys {', '.join(map(show, value))}, expected {expected}")
    if not all(isinstance(part, list) for part in value.values()):
        raise ValueError(f"expected lists in {', '.join(columns)} and values")
    places = {column: [read_side(place, f" in {column}") for place in value[column]] for column in columns}
    return {**places, "values": _table(value["values"], places, "values")}


def _table(values: Any, places: Mapping[str, Sequence[Any]], where: str) -> list[Any]:
    """A number or list at each place of the last column, in a list for each place of those before."""
    (column, own), *further = places.items()
    if not isinstance(values, list) or len(values) != len(own) or not own or any(np.diff(own) <= 0.0):
        what = {"payload": "masses", "speed": "speeds"}[column]
        each = f"list over {further[0][0]}" if further else "number or list"
        raise ValueError(f"expected {what} that rise in {column}, and a {each} for each in {where}")
    entries = [(entry, f"{where}[{i}]") for i, entry in enumerate(values)]
    return [
        _table(entry, dict(further), at) if further else _one(entry, f" in {at}") for entry, at in entries
    ]


def _one(value: Any, where: str = "") -> _Numbers:
    if isinstance(value, list):
        return [read_side(entry, f"{where} at index {i}") for i, entry in enumerate(value)]
    return read_side(value, where)


def _pairs(value: Any) -> list[list[float]]:
    if not isinstance(value, list):
        raise ValueError(f"got {show(value)}, expected [lower, upper] for each joint")
    return [range_of(entry, f" at index {i}") for i, entry in enumerate(value)]


_PerJoint = Annotated[Any, Kind(_WRITTEN, _numbers, Any)]
_OverSpeed = Annotated[Any, Kind(_OVER_SPEED, partial(_numbers, over=("payload", "speed")), Any)]
_Plain = Annotated[Any, Kind("number, or list with an entry for each joint", _one, Any)]
_PARTS = (("payload", KeyUnits("kg")), ("speed", KeyUnits("m/s, rad/s")))
_RATE, _SECOND_RATE = KeyUnits("m/s, rad/s", _PARTS), KeyUnits("m/s^2, rad/s^2", _PARTS)


class _BrakingTable(Table):
    """Velocities that fall towards the limits of position, see `mbocp.terms.braking`."""

    deceleration: Annotated[_Plain, _SECOND_RATE]
    reserve: Annotated[_Plain, _RATE] = 0.0


class ProfileTable(Table):
    """The file of a profile."""

    source: list[str]
    joints: list[str]
    robots: list[str] = Field(default_factory=list)
    degrees: bool = False  # and not radians, for all that is an angle
    position: Annotated[Any, Kind("[lower, upper] for each joint", _pairs, Any), KeyUnits("m, rad")] = None
    velocity: Annotated[_PerJoint, _RATE] = None
    acceleration: Annotated[_OverSpeed, _SECOND_RATE] = None
    jerk: Annotated[_PerJoint, KeyUnits("m/s^3, rad/s^3", _PARTS)] = None
    effort: Annotated[_OverSpeed, KeyUnits("N, N m", _PARTS)] = None
    effort_rate: Annotated[_PerJoint, KeyUnits("N/s, N m/s", _PARTS)] = None
    power: Annotated[_PerJoint, KeyUnits("W", _PARTS)] = None
    braking: _BrakingTable | None = None


@dataclass(frozen=True)
class Profile:
    """Limits of a kind of robot.

    Attributes
    ----------
    name : str
    table : ProfileTable
        What its file says.
    """

    name: str
    table: ProfileTable

    def limits(self, robot: Robot) -> dict[str, dict[str, Any]]:
        """Return the tables of `[limits]` for a robot, by key.

        Positions of continuous joints are left out, and controls that are not those of a joint. Rates and
        efforts of elastic joints are those of their motors, efforts of joints with gears those before these.

        Raises
        ------
        ProblemError
            If it is not that robot's profile, or the robot carries what the profile does not speak of.
        """
        found: dict[str, dict[str, Any]] = {}
        names, controls = self._joints(robot), {label.name for label in robot.u_labels}
        for key in (*_OF_ANGLES, *_OF_CONTROLS):
            values = self._values(key, robot)
            if values is None:
                continue
            moved = {} if key == "position" else {joint.name: joint.motor for joint in robot.elastic}
            ratios = _ratios(robot) if key in _OF_FORCES else {}
            before = {
                name: (np.array(values[i]) / ratios.get(name, 1.0)).tolist() for name, i in names.items()
            }
            named = {moved.get(name, name): value for name, value in before.items()}
            entries = {name: value for name, value in named.items() if self._has(key, name, robot, controls)}
            finite = {name: value for name, value in entries.items() if np.isfinite(value).any()}
            found |= {key: finite} if finite else {}
        return found

    def paths(self, robot: Robot) -> list[dict[str, Any]]:
        """Return the tables of `[[path]]` for a robot."""
        over_speed = chain(*(self._over_speed(key, term, robot) for key, term in _OVER_SPEEDS.items()))
        return [{**row, "profile": self.name} for row in (*over_speed, *self._describe_braking(robot))]

    def _over_speed(self, key: str, term: type[OverSpeed], robot: Robot) -> list[dict[str, Any]]:
        """What falls with the speeds of joints and motors, beyond that at rest, which `[limits]` has.

        Raises
        ------
        InvalidValue
            If they do not fall ever faster.
        """
        written = getattr(self.table, key)
        if not (isinstance(written, Mapping) and "speed" in written):
            return []
        speeds = [self._number(speed, "rad/s", f"{key}.speed") for speed in written["speed"]]
        values = np.array(self._rows(key, robot))
        moved = {joint.name: joint.motor for joint in robot.elastic}
        ratios = _ratios(robot) if key in _OF_FORCES else {}
        controls, found = {label.name for label in robot.u_labels}, []
        for name, i in self._joints(robot).items():
            ratio = ratios.get(name, 1.0)
            curve = np.column_stack([np.array(speeds) * ratio, values[:, i] / ratio])
            where = f"limits.profile: {show(self.name)}: {key} of {self.table.joints[i]}"
            lines = read_falling_lines(curve, where, term.values)
            motor = moved.get(name, name)
            if len(lines) and self._has(key, motor, robot, controls):
                found.append(
                    {
                        "name": self._name(term.kind, name),
                        "kind": term.kind,
                        "frame": motor,
                        "curve": lines.tolist(),
                    }
                )
        return found

    def _describe_braking(self, robot: Robot) -> list[dict[str, Any]]:
        braking = self.table.braking
        if braking is None or self.table.position is None:
            return []
        positions = np.array(self._values("position", robot))
        numbers = {
            key: self._for_all(getattr(braking, key), f"braking.{key}", robot)
            for key in ("deceleration", "reserve")
        }
        return [
            {
                "name": self._name("braking", name),
                "kind": "braking",
                "frame": name,
                **{key: float(values[i]) for key, values in numbers.items()},
                **{
                    key: float(x)
                    for key, x in zip(("min", "max"), positions[i], strict=True)
                    if np.isfinite(x)
                },
            }
            for name, i in self._joints(robot).items()
            if np.isfinite(positions[i]).any()
        ]

    def _name(self, kind: str, joint: str) -> str:
        return f"{self.name}'s {kind} of {joint}"

    def _joints(self, robot: Robot) -> dict[str, int]:
        """Places in the profile of the robot's joints, by their names."""
        joints, slots = self.table.joints, ((n, robot.velocity_indices(n)) for n in robot.joint_names)
        names = [name for name, slot in slots if slot.stop - slot.start == 1]
        prefixes = {name.removesuffix(joint) for name in names for joint in joints if name.endswith(joint)}
        found: dict[str, int] = {}
        for prefix in sorted(prefixes):
            own = {prefix + joint: i for i, joint in enumerate(joints) if prefix + joint in names}
            found |= own if len(own) >= _LEAST_SHARE * len(joints) else {}
        if not found:
            raise ProblemError(
                f"limits.profile: {show(self.name)} is about the joints {', '.join(joints)}, which robot "
                f"{robot.name!r} does not have: it has {', '.join(names)}"
            )
        units = {name: robot.v_labels[robot.velocity_indices(name).start].unit for name in found}
        sliding = [name for name, unit in units.items() if unit != "rad/s"]
        if self.table.degrees and sliding:
            raise ProblemError(
                f"limits.profile: {show(self.name)} is in degrees, but {sliding[0]!r} slides; "
                "leave degrees out, and give radians and metres"
            )
        return found

    def _has(self, key: str, name: str, robot: Robot, controls: set[str]) -> bool:
        """Whether a robot has what a key limits, for one of the joints."""
        if key in _OF_CONTROLS:
            return name in controls
        return key != "position" or bool(is_plain(robot)[robot.configuration_indices(name)].all())

    def _values(self, key: str, robot: Robot) -> Any:
        """Values for each joint, in radians; None where there are none."""
        if getattr(self.table, key) is None:
            return None
        return self._rows(key, robot)[0]  # at rest; `paths` has what is left of it at a speed

    def _rows(self, key: str, robot: Robot) -> list[list[Any]]:
        """Values for each joint [SI], at each speed of a table of speeds."""
        written = getattr(self.table, key)
        if not isinstance(written, Mapping):
            return [self._for_all(written, key, robot)]
        tables = written["values"] if "payload" in written else [written["values"]]
        tables = tables if "speed" in written else [[row] for row in tables]
        tables = [[self._for_all(row, key, robot) for row in rows] for rows in tables]
        return self._at_payload(key, written["payload"], tables, robot) if "payload" in written else tables[0]

    def _at_payload(
        self, key: str, masses: list[float], tables: list[list[list[float]]], robot: Robot
    ) -> list[list[float]]:
        """Between the tables of two masses."""
        mass = sum(payload.mass for payload in robot.payloads)
        if not masses[0] <= mass <= masses[-1]:
            raise ProblemError(
                f"limits.profile: {show(self.name)} says {key} for payloads of {masses[0]:g} to "
                f"{masses[-1]:g} kg, and the robot carries {mass:g} kg"
            )
        return [
            [float(np.interp(mass, masses, column)) for column in zip(*rows, strict=True)]
            for rows in zip(*tables, strict=True)
        ]

    def _for_all(self, written: Any, key: str, robot: Robot) -> list[Any]:
        """An entry for each joint [SI]."""
        count = len(self.table.joints)
        values = written if isinstance(written, Sequence) else [written] * count
        if len(values) != count:
            raise ProblemError(
                f"limits.profile: {show(self.name)} has {len(values)} entries in {key} for {count} joints"
            )
        slots = {i: robot.velocity_indices(name) for name, i in self._joints(robot).items()}
        units = {i: robot.v_labels[slot.start].unit for i, slot in slots.items()}
        return [self._number(entry, units.get(i, "rad/s"), key) for i, entry in enumerate(values)]

    def _number(self, written: Any, unit: str, key: str) -> Any:
        """A number [SI], or several, of a joint whose speed has this unit."""
        if isinstance(written, list):
            return [self._number(entry, unit, key) for entry in written]
        if isinstance(written, Quantity):
            return plain_number(written, unit, f"limits.profile: {key} of {show(self.name)}")
        in_degrees = self.table.degrees and key not in _OF_CONTROLS
        return written * (math.pi / 180.0) if in_degrees else float(written)


def _ratios(robot: Robot) -> dict[str, float]:
    """Of the gears behind which profiles speak of torques, before which controls are, by joint."""
    return {motor.name: motor.gear_ratio for motor in robot.motors}


def profile_names() -> list[str]:
    """Return the names of the profiles that come with mbocp."""
    return sorted(file.stem for file in _FOLDER.glob("*.toml"))


def profile_of(written: Any, robot: Robot, folder: Path) -> Profile | None:
    """Return the profile that `limits.profile` names; `True` is that of the robot's name.

    Raises
    ------
    ProblemError
        If there is no such profile, or its file is wrong.
    """
    if not written:
        return None
    if written is True:
        for profile in map(_load_profile, profile_names()):
            if robot.name in profile.table.robots:
                return profile
        raise ProblemError(
            f"limits.profile: no profile is for a robot of the name {robot.name!r}; name one of "
            f"{', '.join(profile_names())}, or a file of your own"
        )
    if written in profile_names():
        return _load_profile(written)
    file = folder / path_of(written)
    if not is_file(file):
        raise ProblemError(
            f"limits.profile: no profile and no file {show(written)}: {suggest(written, profile_names(), 20)}"
        )
    return _read(file)


@lru_cache(maxsize=64)
def _load_profile(name: str) -> Profile:
    return _read(_FOLDER / f"{name}.toml")


def _read(file: Path) -> Profile:
    try:
        return Profile(file.stem, ProfileTable.model_validate(read_toml(file)))
    except Unreadable as error:
        raise ProblemError(f"limits.profile: {file} {error.reason}") from error
    except ValidationError as error:
        raise schema_error(str(file), ProfileTable, error) from error
