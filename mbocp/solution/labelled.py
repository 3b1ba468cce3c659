"""A solution as an `xarray.Dataset`: every number by time and by the name of its joint or motor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbocp.exceptions import InvalidValue
from mbocp.solution.data import SolutionData
from mbocp.solution.records import Column
from mbocp.storage.content import QUANTITIES

if TYPE_CHECKING:
    import xarray

_DIMENSIONS = {"node": "t", "step": "step"}  # of rows, by the first axis


def dataset_of(solution: SolutionData) -> xarray.Dataset:
    """Trajectories with dimensions ``t`` (nodes, [s]) and ``step`` (begin of each step, [s]).

    Variables are ``q``, ``v``, ``p``, ``mu`` at the nodes, ``u``, ``lam``, ``zeta`` and
    ``control_hamiltonian`` in the steps, and ``u_within`` at shares of the steps where
    controls vary within them. The second dimension of each is called after it, ``v_name`` for one, and has
    the names of joints and motors; their units are a coordinate beside it, ``v_unit``.

    Raises
    ------
    InvalidValue
        If xarray is not installed.
    """
    try:
        import xarray
    except ImportError as error:
        raise InvalidValue(
            "to_xarray", "no xarray", "it to be installed: pip install mbocp[xarray]"
        ) from error
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {
        "t": ("t", solution.t, {"units": "s"}),
        "step": ("step", solution.t[:-1], {"units": "s", "description": "begin of the step"}),
    }
    for key, entry in QUANTITIES.items():
        letter, rows = entry.columns, _DIMENSIONS.get(entry.axes[0], "")
        if not rows or entry.axes[1:] != (letter,) or not (columns := solution.columns(key)):
            continue
        values, names = getattr(solution, key), f"{letter}_name"
        if entry.may_lack and not values.size:
            continue
        variables[entry.heading or letter] = ((rows, names), values, _words(key))
        coordinates[names] = (names, _distinct(columns))
        coordinates[f"{letter}_unit"] = (names, [column.unit for column in columns])
    if not solution.has_constant_controls:
        variables["u_within"] = (("step", "share", "u_name"), solution.u_values, _words("u_values"))
        coordinates["share"] = ("share", solution.u_shares, {"description": "part of the step"})
    if np.isfinite(solution.control_hamiltonians).any():
        words = {**_words("control_hamiltonians"), "units": "cost/s"}
        variables["control_hamiltonian"] = ("step", solution.control_hamiltonians, words)
    facts = {
        "problem": solution.problem_name,
        "robot": solution.robot_name,
        "status": str(solution.status),
        "cost": solution.cost,
    }
    return xarray.Dataset(variables, coordinates, facts)


def _words(key: str) -> dict[str, str]:
    return {"symbol": QUANTITIES[key].symbol, "description": QUANTITIES[key].description}


def _distinct(columns: tuple[Column, ...]) -> list[str]:
    """Names by which a column can be selected; adjoints have those of q, then those of p."""
    names = [column.name for column in columns]
    half = len(names) // 2
    if len(set(names)) == len(names):
        return names
    return [f"{'q' if i < half else 'p'}:{name}" for i, name in enumerate(names)]
