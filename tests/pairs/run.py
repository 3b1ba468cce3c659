"""Make, compile, solve, save and solve again problems with several features, one row of a file each."""

from __future__ import annotations

import json
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import TimeoutError as Late
from pathlib import Path
from typing import Any

import numpy as np
from pebble import ProcessExpired, ProcessPool

import mbocp
from mbocp.exceptions import MbocpError, SolverError
from mbocp.formulation import formulate
from mbocp.receding.refusals import check_can_recede, check_functions
from tests.campaign.run import read_rows
from tests.pairs.cover import Pair, cover, pairs_within
from tests.pairs.features import FEATURES, ROBOTS, pairs, tables_of

__all__ = ["FAILED", "refusal", "run", "run_set"]

Row = dict[str, Any]
FAILED = ("crash", "late error")
SET_LIMIT = 300.0  # [s] of a set, with compiling
_MOST = 7  # features of a set


def refusal(robot: str, names: Sequence[str], folder: Path) -> Row:
    """Whether a problem is refused when it is made: nothing is compiled."""
    row: Row = {"robot": robot, "features": list(names), "kind": "made"}
    try:
        _made(robot, names, folder)
    except MbocpError as error:
        return row | {"status": "refused", "says": str(error)[:400]}
    except Exception:  # a crash is a row, and what is looked for
        return row | {"status": "crash", "says": traceback.format_exc()[-1500:]}
    return row | {"status": "made"}


def run_set(robot: str, names: Sequence[str], folder: Path) -> Row:
    """Row of a problem that is made, solved, saved, loaded, and solved again."""
    row: Row = {"robot": robot, "features": list(names), "kind": "solved"}
    clock = time.perf_counter()
    try:
        problem = _made(robot, names, folder)
    except MbocpError as error:
        return row | {"status": "refused", "says": str(error)[:400]}
    except Exception:
        return row | {"status": "crash", "says": traceback.format_exc()[-1500:]}
    try:
        formulate(problem)
    except MbocpError as error:
        return row | {"status": "refused", "says": str(error)[:400]}
    except Exception:
        return row | {"status": "crash", "says": traceback.format_exc()[-1500:]}
    try:
        row |= _solved(problem, folder, recedes="receding" in names)
    except MbocpError as error:  # what is refused is refused before the solve
        row |= {"status": "late error", "says": f"{type(error).__name__}: {str(error)[:1200]}"}
    except Exception:
        row |= {"status": "crash", "says": traceback.format_exc()[-1500:]}
    return row | {"seconds": round(time.perf_counter() - clock, 2)}


def _made(robot: str, names: Sequence[str], folder: Path) -> mbocp.Problem:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # numbers without effect, and goals that the limits leave little
        problem = mbocp.Problem.create(**tables_of(ROBOTS[robot](folder), names))
        if "receding" in names:
            check_can_recede(problem)
            check_functions(formulate(problem))
    return problem


def _solved(problem: mbocp.Problem, folder: Path, *, recedes: bool) -> Row:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = mbocp.solve(problem)
        file = solution.save(folder / f"{id(problem)}.h5")
        loaded = mbocp.Solution.load(file)
        file.unlink()
        np.testing.assert_array_equal(loaded.qs, solution.qs)
        again = mbocp.solve(loaded.load_problem())
        receding = _receded(problem, solution) if recedes else ""
    if not np.all(np.isfinite(solution.qs)):
        raise ArithmeticError("a configuration is not finite")
    if (again.status, again.num_steps) != (solution.status, solution.num_steps):
        raise ArithmeticError(f"solved again: {again.status}, and {solution.status} before")
    row: Row = {"status": str(solution.status), "iterations": solution.iterations, "receding": receding}
    return row | {"says": solution.advice[:200]}


def _receded(problem: mbocp.Problem, solution: mbocp.Solution) -> str:
    """How a step of a receding horizon ends, or why it does not begin: its first motion has to converge."""
    try:
        horizon = mbocp.RecedingHorizon(problem, warm_start=solution)
    except SolverError as error:
        return f"no first motion: {str(error)[:200]}"
    return str(horizon.step(problem.q_start, problem.v_start).status)


def run(robot: str, out: Path, folder: Path, workers: int = 1, names: Sequence[str] = ()) -> Iterator[Row]:
    """Rows that `out` does not have yet, as they come: each pair made, all solved in sets, what fails apart.

    Which pairs are refused depends on keys, so that the small robot says it for all.
    """
    wanted = pairs(names or list(FEATURES))
    made = yield from _rows(refusal, "small", wanted, "made", out, folder, workers)
    refused = [pair for pair in wanted if made[pair]["status"] != "made"]
    sets = cover([pair for pair in wanted if pair not in set(refused)], refused, _MOST)
    solved = yield from _rows(run_set, robot, sets, "solved", out, folder, workers)
    unknown = [names for names in sets if solved[names]["status"] in (*FAILED, "refused")]
    fine = {pair for names in sets if names not in unknown for pair in pairs_within(names)}
    left = {pair for names in unknown for pair in pairs_within(names) if len(names) > 2} - fine
    yield from _rows(run_set, robot, sorted(left), "solved", out, folder, workers)


def _rows(
    function: Any,
    robot: str,
    sets: Sequence[tuple[str, ...]],
    kind: str,
    out: Path,
    folder: Path,
    workers: int,
) -> Any:
    """Yield new rows; return those of all sets."""
    rows: dict[tuple[str, ...] | Pair, Row] = {
        tuple(row["features"]): row for row in read_rows(out) if (row["robot"], row["kind"]) == (robot, kind)
    }
    left = [names for names in sets if names not in rows]
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.open("a") as file, ProcessPool(max_workers=workers, max_tasks=100) as pool:
        futures = [
            (names, pool.schedule(function, args=(robot, names, folder), timeout=SET_LIMIT)) for names in left
        ]
        for names, future in futures:
            try:
                row = future.result()
            except (Late, ProcessExpired) as error:
                row = {"robot": robot, "features": list(names), "kind": kind, "status": "crash"}
                row["says"] = f"{type(error).__name__}: {error}"
            rows[names] = row
            file.write(json.dumps(row) + "\n")
            file.flush()
            yield row
    return rows
