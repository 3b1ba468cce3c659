"""The solver's last iterate as parts of a result file, and back."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.exceptions import DimensionMismatch
from mbocp.programme.iterate import BoundMultipliers, Iterate, IterateRecord
from mbocp.solution.details import Column
from mbocp.storage.content import FileContent

MEANING = "iterate_meaning"  # among the texts of a result file
_PART = "iterate_"  # how names of its arrays begin
_LETTERS = "vajmp"  # of limits that may hold within steps; files of before tell fewer
_STATES, _CONTROLS, _PATH, _GUARD, _WITHIN = (
    f"{_PART}{name}" for name in ("lam_xs", "lam_us", "lam_path", "lam_guard", "within")
)
_CHOSEN = ("room", "q_end", "q_start", "first")  # what a solve chose, where it did


def is_part(name: str) -> bool:
    """Whether an array or text of a result file belongs to the iterate."""
    return name.startswith(_PART)


def arrays_of(carried: IterateRecord | None, trajectories: Mapping[str, Array]) -> dict[str, Array]:
    """Arrays of a result file; without those that its trajectories are, to the last bit.

    Multipliers of limits are left out, too, where there are none.
    """
    if carried is None:
        return {}
    iterate, bounds = carried.iterate, carried.iterate.bounds
    found = {f"{_PART}{name}": getattr(iterate, name) for name in ("xs", "ys", "us", "ms")}
    if bounds is not None:
        found |= {_STATES: bounds.xs, _CONTROLS: bounds.us, _PATH: bounds.path, _GUARD: bounds.guard}
    found |= {f"{_PART}{name}": part for name in _CHOSEN if (part := getattr(carried, name)).size}
    held = [float(letter in carried.limits_within) for letter in _LETTERS]
    found |= {_WITHIN: np.array(held)} if any(held) else {}
    for name, array in _in_trajectories(trajectories).items():
        if name in found and np.array_equal(found[name], array):
            del found[name]
    return found


def _in_trajectories(arrays: Mapping[str, Array]) -> dict[str, Array]:
    """What a solver's numbers are where states are (q, v) and controls the robot's, constant in each step.

    Raises
    ------
    DimensionMismatch
        If the trajectories do not fit together.
    """
    qs, vs, us = arrays["qs"], arrays["vs"], arrays["us"]
    lam_qs, lam_vs = arrays.get("lam_qs", np.zeros_like(qs)), arrays.get("lam_vs", np.zeros_like(vs))
    for name, array in (("vs", vs), ("lam_qs", lam_qs), ("lam_vs", lam_vs)):
        if len(array) != len(qs):
            raise DimensionMismatch(name, array.shape, (len(qs), array.shape[1]))
    return {
        f"{_PART}xs": np.hstack([qs, vs]),
        f"{_PART}us": us,
        _STATES: np.hstack([lam_qs, lam_vs]),
        _CONTROLS: arrays.get("lam_us", np.zeros_like(us)),
    }


def columns_of(carried: IterateRecord | None, arrays: Mapping[str, Array]) -> dict[str, tuple[Column, ...]]:
    """Columns of these arrays among those of a result file."""
    columns = {
        name: tuple(Column(str(i), "") for i in range(array.shape[-1]))
        if array.ndim > 1
        else (Column("", ""),)
        for name, array in arrays.items()
        if is_part(name)
    }
    if carried is not None and _PATH in columns:
        columns[_PATH] = tuple(Column(name, "") for name in carried.names)
    return columns


def iterate_in(content: FileContent) -> IterateRecord | None:
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
    has_limits = "lam_path" in own
    own = {**{name.removeprefix(_PART): array for name, array in _in_trajectories(arrays).items()}, **own}
    x, u, y = (_width(own, name) for name in ("xs", "us", "ys"))
    shapes = {"xs": (steps + 1, x), "ys": (steps, y), "us": (steps, u), "ms": (steps, _width(own, "ms"))}
    limits = {
        "lam_xs": (steps + 1, x),
        "lam_us": (steps, u),
        "lam_path": (steps, _width(own, "lam_path")),
        "lam_guard": own.get("lam_guard", np.zeros(0)).shape,
    }
    for name, shape in {**shapes, **(limits if has_limits else {})}.items():
        got = own[name].shape if name in own else ()
        if got != shape:
            raise DimensionMismatch(f"{_PART}{name}", got, shape)
    bounds = BoundMultipliers(*(own[name] for name in limits)) if has_limits else None
    xs, ys, us, ms = (own[name] for name in shapes)
    iterate = Iterate(xs, ys, us, ms, arrays["eta"], bounds)
    names = tuple(name for name, _ in content.columns.get(_PATH, ()))
    chosen = {name: frozen_array(own[name]) for name in _CHOSEN if name in own}
    within = sorted(letter for letter, held in zip(_LETTERS, own.get("within", ()), strict=False) if held)
    return IterateRecord(
        iterate, names, content.texts.get(MEANING, ""), limits_within="".join(within), **chosen
    )


def _width(own: Mapping[str, Array], name: str) -> int:
    return int(own[name].shape[-1]) if name in own else 0
