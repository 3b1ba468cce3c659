"""A solution for other tools: a CSV table, an `xarray.Dataset`, and what `mbocp solve --json` prints."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mbocp._arrays import Array, plain_json
from mbocp.exceptions import InvalidValue
from mbocp.solution.atomic import csv_of, replace_file
from mbocp.solution.details import Column
from mbocp.solution.solution_data import TOLD, SolutionData
from mbocp.storage.content import QUANTITIES

if TYPE_CHECKING:
    import xarray


def table(solution: SolutionData) -> tuple[list[str], Array]:
    """All trajectories side by side, one row a node.

    What belongs to the step from node n to n+1 (u, lam, zeta, H) stands in row n, and is NaN in the last row.
    Where controls vary within steps `u` is their mean, and `u@0.5` their value after that part of the step.

    Returns
    -------
    header : list of str
        `t [s]`, then `q:joint [rad]` and so on.
    rows : ndarray, shape (N + 1, columns)
    """
    header, columns = ["t [s]"], [solution.t[:, None]]
    for prefix, names, values in _blocks(solution):
        header += [prefix + column.header for column in names]
        missing = np.full((len(solution.t) - len(values), values.shape[1]), np.nan)
        columns.append(np.vstack([values, missing]))
    return header, np.hstack(columns)


def _blocks(solution: SolutionData) -> Iterator[tuple[str, tuple[Column, ...], Array]]:
    """Beginning of the names, columns and rows of each quantity, those of no limits left out."""
    for name, quantity in QUANTITIES.items():
        values, columns, prefix = getattr(solution, name), solution.columns(name), quantity.heading
        if prefix is None or (quantity.may_lack and not values.size):
            continue
        if quantity.axes[1:2] == ("share",):  # where controls vary within steps
            for k, share in enumerate(solution.u_shares):
                yield f"{prefix}@{share:.6g}:", columns, values[:, k]
        elif quantity.axes[1:] == ("mu",):
            num_v = solution.nv
            yield f"{prefix}_q:", columns[:num_v], values[:, :num_v]
            yield f"{prefix}_p:", columns[num_v:], values[:, num_v:]
        elif quantity.axes[0] == "later node":  # nothing is constrained at the start
            start = np.full((1, values.shape[1]), np.nan)
            yield f"{prefix}:", columns, np.vstack([start, values])
        elif len(quantity.axes) == 1:
            yield "", columns, values[:, None]
        elif not quantity.columns.startswith("dual ") or _has_limits(solution, quantity.axes[1]):
            yield f"{prefix}:", columns, values


def _has_limits(solution: SolutionData, letter: str) -> bool:
    return bool(np.isfinite(getattr(solution, f"limits_{letter}")).any())


def write_csv(solution: SolutionData, path: str | Path) -> Path:
    """Write `table(solution)` as CSV, atomically; NaN is an empty cell, numbers have all their digits."""
    header, rows = table(solution)
    cells = (["" if math.isnan(x) else repr(x) for x in row] for row in rows.tolist())
    return replace_file(path, csv_of(header, cells))


def solution_dict(solution: SolutionData) -> dict[str, Any]:
    """The object of `--json`: plain numbers and lists; NaN and infinity become None."""
    result = {
        "status": str(solution.status),
        "converged": solution.converged,
        **{name: getattr(solution, name) for name in TOLD if name != "status"},
        "accuracy": dataclasses.asdict(solution.accuracy) if solution.accuracy.is_known else None,
        "unknowns": solution.unknowns,
        "num_steps": solution.num_steps,
        "duration": solution.duration,
        "via_times": solution.via_times,
        "phase_times": solution.phase_times,
        "parameters": solution.parameters,
        "wall_time_s": solution.wall_time_s,
        "phases": [dataclasses.asdict(phase) for phase in solution.phases],
        "history": [
            {"residual": r.residual, "increment": r.increment, "cost": r.cost, "step_length": r.step_length}
            for r in solution.history
            if not r.is_guess
        ],
        "control_hamiltonian": solution.control_hamiltonian,
        "control_momentum_drift": solution.control_momentum_drift,
        "conserved": [dataclasses.asdict(quantity) for quantity in solution.conserved],
        "q_final": solution.q_final,
        "p_final": solution.p_final,
        "u_first": solution.u_first,
        "u_last": solution.u_last,
        "eta": solution.eta,
        "starts": [
            {"guess": s.guess, "status": str(s.status), "cost": s.cost, "iterations": s.iterations}
            | ({} if s.goal is None else {"goal": s.goal})
            for s in solution.starts
        ],
    }
    return plain_json(result)


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
