"""Solve and verify tasks, one row of a file each, on several processes; interrupted runs go on."""

from __future__ import annotations

import json
import re
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import TimeoutError as Late
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pebble import ProcessExpired, ProcessPool

import mbocp
from mbocp.exceptions import CompilationTimeout, MbocpError
from tests.campaign.classes import CLASSES
from tests.campaign.tasks import Draw, draw
from tests.checker import check_solution
from tests.checker.conditions import Motion

__all__ = ["plan", "read_rows", "run", "run_task"]

_RAISED = re.compile(r"margins at nodes were raised by (\S+) mm in all")
SOLVER_LIMIT = 20.0  # s, of a solve
TASK_LIMIT = 900.0  # s, with the compilation of a new shape and the check


def plan(count: int, names: Sequence[str] = (), first: int = 0) -> list[tuple[str, int]]:
    """`count` tasks, spread over the classes by their shares, so that any first part covers all classes.

    Their seeds count from `first`.
    """
    chosen = [CLASSES[name] for name in names or CLASSES]
    total = sum(c.share for c in chosen)
    tasks = []
    for c in chosen:
        wanted = max(1, round(count * c.share / total))
        tasks += [((i + 0.5) / wanted, c.name, first + i) for i in range(wanted)]
    return [(name, seed) for _, name, seed in sorted(tasks)]


def run_task(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """Row of one task."""
    row: dict[str, Any] = {"class": name, "seed": seed, "family": CLASSES[name].family}
    clock = time.perf_counter()
    task = draw(name, seed, folder)
    row |= {"feasible": task.is_feasible, "draw_s": round(time.perf_counter() - clock, 3)}
    row |= {"steps": task.task.num_steps, "duration": task.task.duration, "bounded": task.task.is_bounded}
    try:
        row |= _solved(task)
    except MbocpError as error:
        row |= {"status": "refused", "advice": str(error)[:300]}
    except Exception:  # a crash is a row of the campaign, too, and what it looks for: the others go on
        row |= {"status": "crash", "advice": traceback.format_exc()[-1500:]}
    return row


def _solved(task: Draw) -> dict[str, Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # goals beyond the limits of a joint that nobody enforces
        problem = mbocp.Problem.create(**task.tables, solver={"time_limit": SOLVER_LIMIT})
        try:
            solution = mbocp.solve(problem)
        except CompilationTimeout:  # a new shape: one iteration without a limit compiles what it takes
            mbocp.solve(problem.with_(solver=replace(problem.solver, time_limit=None, max_iterations=1)))
            solution = mbocp.solve(problem)
    taken = sum(phase.wall_time_s for phase in solution.phases if phase.name != "compile")
    row: dict[str, Any] = {
        "status": str(solution.status),
        "iterations": solution.iterations,
        "seconds": round(taken, 4),
        "residual": solution.residual,
        "cost": solution.cost,
        "solver": solution.solver,
        "advice": solution.advice[:300],
    }
    if str(solution.status) in ("converged", "under_resolved"):
        clock = time.perf_counter()
        report = check_solution(task.loaded.system, task.task, motion_of(solution))
        row |= {"report": report.to_dict(), "failures": list(report.failures)}
        row["check_s"] = round(time.perf_counter() - clock, 3)
    return row


def motion_of(solution: mbocp.Solution) -> Motion:
    """Numbers of a solution that are judged."""
    s = solution
    arrays = (s.qs, s.vs, s.us, s.cost, s.lam_us, s.lam_vs, s.lam_qs, s.lam_path)
    numbers = (*(np.array(a) for a in arrays[:3]), float(s.cost), *(np.array(a) for a in arrays[4:]))
    raised = _RAISED.search(s.advice)
    return Motion(
        *numbers,
        path_names=tuple(s.path_names),
        duration=float(s.duration),
        dts=np.diff(np.array(s.t)),
        raised=1e-3 * float(raised.group(1)) if raised else 0.0,
    )


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Rows of a file; a torn last line is left out."""
    rows = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def run(
    tasks: Sequence[tuple[str, int]], out: Path, folder: Path, workers: int = 1
) -> Iterator[dict[str, Any]]:
    """Rows of the tasks that `out` does not have yet, as they come."""
    done = {(row["class"], row["seed"]) for row in read_rows(out)}
    left = [task for task in tasks if task not in done]
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.open("a") as file, ProcessPool(max_workers=workers, max_tasks=200) as pool:
        futures = [
            (name, seed, pool.schedule(run_task, args=(name, seed, folder), timeout=TASK_LIMIT))
            for name, seed in left
        ]
        for name, seed, future in futures:
            try:
                row = future.result()
            except (Late, ProcessExpired) as error:
                row = {"class": name, "seed": seed, "family": CLASSES[name].family, "feasible": True}
                row |= {"status": "crash", "advice": f"{type(error).__name__}: {error}"}
            file.write(json.dumps(row) + "\n")
            file.flush()
            yield row
