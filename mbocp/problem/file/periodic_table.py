"""`start.free` and `goal.periodic` as people write them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp._measured import plain_number
from mbocp._quantities import is_number
from mbocp._text import show
from mbocp.exceptions import ProblemError, locate
from mbocp.problem.file.named_values import tangent_slots
from mbocp.problem.goals.free_start import FreeStart
from mbocp.problem.goals.periodic import Periodic
from mbocp.robot import Robot

_PARTS = ("q", "v")


def free_from(robot: Robot, written: Any) -> FreeStart | None:
    """Free entries of a start from what `start.free` says.

    Raises
    ------
    UnknownJoint, ProblemError
    """
    if written is None:
        return None
    if isinstance(written, Mapping):
        table = dict(written)
    else:
        table = dict.fromkeys(_PARTS if written is True else (written,), True)
    _refuse_others("start.free", table, _PARTS)
    found = [_which(robot, table.get(part), f"start.free.{part}") for part in _PARTS]
    lower, upper = (np.concatenate([side[k] for side in found]) for k in (1, 2))
    return FreeStart(q=found[0][0], v=found[1][0], lower=lower, upper=upper)


def free_table(robot: Robot, free: FreeStart | None) -> dict[str, Any] | None:
    """What reads back as the same."""
    if free is None:
        return None
    nv, names = robot.nv, [label.name for label in robot.v_labels]
    table: dict[str, Any] = {}
    for part, mask, first in (("q", free.q, 0), ("v", free.v, nv)):
        sides = [(float(free.lower[first + i]), float(free.upper[first + i])) for i in range(nv)]
        entries = {
            names[i]: list(sides[i]) if np.isfinite(sides[i]).any() else True for i in range(nv) if mask[i]
        }
        if entries:
            table[part] = entries
    return table


def _which(robot: Robot, written: Any, key: str) -> tuple[BoolArray, Array, Array]:
    """Which components are free, and their bounds, shapes (nv,)."""
    nv = robot.nv
    free, lower, upper = np.zeros(nv, dtype=np.bool_), np.full(nv, -np.inf), np.full(nv, np.inf)
    if written is None or written is False:
        return free, lower, upper
    if written is True:
        return np.ones(nv, dtype=np.bool_), lower, upper
    if isinstance(written, Mapping) and set(written) == {"except"}:
        free[:] = True
        for name in written["except"] if _are_names(written["except"]) else [""]:
            free[_slot(robot, name, f"{key}.except")] = False
        return free, lower, upper
    if isinstance(written, list):
        written = dict.fromkeys(written, True)
    if not isinstance(written, Mapping):
        raise ProblemError(
            f"{key}: got {show(written)}, expected true, a list of joints, a table with true or "
            "[lower, upper] for each, or with except, a list of joints"
        )
    for name, entry in written.items():
        slot = _slot(robot, name, key)
        free[slot] = True
        if entry is True:
            continue
        pair = entry if isinstance(entry, list) else []
        if len(pair) != 2 or not all(is_number(side) for side in pair) or not pair[0] < pair[1]:
            raise ProblemError(f"{key}.{name}: got {show(entry)}, expected true, or [lower, upper]")
        unit = robot.v_labels[slot.start].unit.removesuffix("" if key.endswith("v") else "/s")
        lower[slot], upper[slot] = (plain_number(side, unit, f"{key}.{name}") for side in pair)
    return free, lower, upper


def _slot(robot: Robot, name: str, key: str) -> slice:
    """Where a joint, or a component of one, is in a velocity."""
    slots = tangent_slots(robot)
    if name not in slots:
        with locate(key):
            raise robot.unknown_joint(str(name), slots)
    return slots[name]


def periodic_from(robot: Robot, written: Any) -> Periodic | None:
    """The symmetry of a periodic motion from what `goal.periodic` says.

    Raises
    ------
    ProblemError
    """
    if written is None:
        return None
    table = {} if written is True else dict(written)
    key = "goal.periodic"
    _refuse_others(key, table, tuple(_EXPECTED))
    for word, (is_right, expected) in _EXPECTED.items():
        if word in table and not is_right(table[word]):
            raise ProblemError(f"{key}.{word}: got {show(table[word])}, expected {expected}")
    found = Periodic(
        swap=tuple((a, b) for a, b in table.get("swap", ())),
        mirror=table.get("mirror", ()),
        combine={
            a: _plain(robot, "", sums, f"{key}.combine.{a}") for a, sums in table.get("combine", {}).items()
        },
        moved={a: _plain(robot, a, far, f"{key}.moved.{a}") for a, far in table.get("moved", {}).items()},
        apart=table.get("except", ()),
        impact=table.get("impact", ""),
    )
    with locate(key):
        found.check(robot)
    return found


def _plain(robot: Robot, joint: str, written: Any, key: str) -> Any:
    """Numbers of a joint or, by words, of a base; those without a joint have no unit."""
    if isinstance(written, Mapping):
        units = {word: joint and ("rad" if word == "yaw" else "m") for word in written}
        return {word: plain_number(x, units[word], f"{key}.{word}") for word, x in written.items()}
    if joint not in robot.joint_names:
        return written
    unit = robot.v_labels[robot.velocity_indices(joint).start].unit
    return plain_number(written, unit.removesuffix("/s"), key)


def periodic_table(periodic: Periodic) -> dict[str, Any] | bool:
    """What reads back as the same."""
    table = {
        "swap": [list(pair) for pair in periodic.swap],
        "mirror": list(periodic.mirror),
        "combine": {
            name: {part: float(factor) for part, factor in sums.items()}
            for name, sums in periodic.combine.items()
        },
        "moved": {
            name: dict(far) if isinstance(far, Mapping) else float(far)
            for name, far in periodic.moved.items()
        },
        "except": list(periodic.apart),
        "impact": periodic.impact,
    }
    return {word: value for word, value in table.items() if value} or True


def _refuse_others(key: str, table: Mapping[str, Any], words: tuple[str, ...]) -> None:
    for word in table:
        if word not in words:
            raise ProblemError(f"{key}: unknown key {word!r}; there are {', '.join(words)}")


def _are_names(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(name, str) for name in value)


def _are_pairs(value: Any) -> bool:
    return isinstance(value, list) and all(_are_names(pair) and len(pair) == 2 for pair in value)


def _are_tables(value: Any) -> bool:
    return isinstance(value, Mapping) and all(isinstance(table, Mapping) for table in value.values())


# Keys of `goal.periodic`: whether a value is right, and what is expected.
_EXPECTED: dict[str, tuple[Callable[[Any], bool], str]] = {
    "swap": (_are_pairs, 'pairs of joints such as [["left", "right"]]'),
    "mirror": (_are_names, "a list of joints"),
    "combine": (_are_tables, "a table for each joint such as { leg = { leg = 1, hip = 1 } }"),
    "moved": (lambda value: isinstance(value, Mapping), "a table such as { x = 0.5 }"),
    "except": (_are_names, "a list of joints"),
    "impact": (lambda value: isinstance(value, str), "the name of a frame"),
}
