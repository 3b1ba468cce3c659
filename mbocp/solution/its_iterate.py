"""The solver's last iterate as parts of a result file, and back."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.exceptions import DimensionMismatch
from mbocp.programme.carried import Carried
from mbocp.programme.iterate import BoundMultipliers, Iterate
from mbocp.solution.records import Column
from mbocp.storage.content import FileContent

__all__ = ["MEANING", "arrays_of", "columns_of", "is_part", "iterate_in"]

MEANING = "iterate_meaning"  # among the texts of a result file
_PART = "iterate_"  # how names of its arrays begin
_STATES, _CONTROLS, _PATH, _GUARD, _ROOM = (
    f"{_PART}{name}" for name in ("lam_xs", "lam_us", "lam_path", "lam_guard", "room")
)


def is_part(name: str) -> bool:
    """Whether an array or text of a result file belongs to the iterate."""
    return name.startswith(_PART)


def arrays_of(carried: Carried | None) -> dict[str, Array]:
    """Arrays of a result file; without multipliers of limits where there are none."""
    if carried is None:
        return {}
    iterate, bounds = carried.iterate, carried.iterate.bounds
    found = {f"{_PART}{name}": getattr(iterate, name) for name in ("xs", "ys", "us", "ms")}
    if bounds is not None:
        found |= {_STATES: bounds.xs, _CONTROLS: bounds.us, _PATH: bounds.path, _GUARD: bounds.guard}
    return found | ({_ROOM: carried.room} if carried.room.size else {})


def columns_of(carried: Carried | None) -> dict[str, tuple[Column, ...]]:
    """Columns of these arrays."""
    columns = {
        name: tuple(Column(str(i), "") for i in range(array.shape[-1]))
        if array.ndim > 1
        else (Column("", ""),)
        for name, array in arrays_of(carried).items()
    }
    if carried is not None and _PATH in columns:
        columns[_PATH] = tuple(Column(name, "") for name in carried.names)
    return columns


def iterate_in(content: FileContent) -> Carried | None:
    """The iterate of a result file; None of one that holds none.

    Raises
    ------
    DimensionMismatch
        If its arrays do not fit together.
    """
    arrays, steps = content.arrays, len(content.arrays["t"]) - 1
    own = {name.removeprefix(_PART): array for name, array in arrays.items() if is_part(name)}
    if not own:
        return None
    x, u, y = (_width(own, name) for name in ("xs", "us", "ys"))
    shapes = {"xs": (steps + 1, x), "ys": (steps, y), "us": (steps, u), "ms": (steps, _width(own, "ms"))}
    limits = {
        "lam_xs": (steps + 1, x),
        "lam_us": (steps, u),
        "lam_path": (steps, _width(own, "lam_path")),
        "lam_guard": own.get("lam_guard", np.zeros(0)).shape,
    }
    has_limits = any(name in own for name in limits)
    for name, shape in {**shapes, **(limits if has_limits else {})}.items():
        got = own[name].shape if name in own else ()
        if got != shape:
            raise DimensionMismatch(f"{_PART}{name}", got, shape)
    bounds = BoundMultipliers(*(own[name] for name in limits)) if has_limits else None
    iterate = Iterate(**{name: own[name] for name in shapes}, eta=arrays["eta"], bounds=bounds)
    names = tuple(name for name, _ in content.columns.get(_PATH, ()))
    room = frozen_array(own.get("room", np.zeros(0)))
    return Carried(iterate, names, content.texts.get(MEANING, ""), room)


def _width(own: Mapping[str, Array], name: str) -> int:
    return int(own[name].shape[-1]) if name in own else 0
