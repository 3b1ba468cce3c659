"""Side by side on the problems of `problems/`: `python -m benchmarks.peers`."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.machine import header, one_core
from benchmarks.peers.environments import Environment, environment_of_crocoddyl, own_environment
from benchmarks.peers.judge import Verdict, judge
from benchmarks.peers.task import Task, load_task
from benchmarks.tables import Table, show

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

_HERE = Path(__file__).parent
_ROOT = _HERE.parent.parent
_ORDER = ("U", "U-lim", "F", "F-lim", "F-500", "Z", "D")
_KNOWN = {"U": 456.10444, "U-lim": 460.39759, "F": 295.80841, "F-lim": 296.94346}
_SAME_COST = 1e-6  # relative
_END = 1e-2  # of states at the end: what a penalty leaves is less, another motion's is more
_HARD_END = 1e-5
_EXCESS = 1e-4  # of torques beyond their limits [N m]
_HIGHER = 5e-3  # relative: a cost this much above mbocp's is another minimum's, and so is one below


@dataclass(frozen=True)
class Tool:
    """A solver: its name in the table, module and method, and the package that it needs."""

    label: str
    module: str
    package: str
    is_own: bool = True


_TOOLS = (
    Tool("mbocp", "own:auto", "mbocp"),
    Tool("Crocoddyl FDDP", "crocoddyl_ddp:fddp", "crocoddyl", is_own=False),
    Tool("Crocoddyl BoxFDDP", "crocoddyl_ddp:box", "crocoddyl", is_own=False),
    Tool("Crocoddyl Intro, inverse dynamics", "crocoddyl_ddp:intro", "crocoddyl", is_own=False),
    Tool("mim_solvers CSQP, hard end", "mim_csqp:hard", "mim-solvers", is_own=False),
    Tool("mim_solvers CSQP, penalty", "mim_csqp:soft", "mim-solvers", is_own=False),
    Tool("CasADi + IPOPT (MUMPS), compiled", "casadi_nlp:ipopt", "casadi"),
    Tool("CasADi + fatrop, compiled", "casadi_nlp:fatrop", "casadi"),
)


@dataclass(frozen=True)
class Found:
    """What a solver came to on a problem, or why it did not."""

    tool: Tool
    verdict: Verdict | None = None
    iterations: int = 0
    milliseconds: float = np.nan
    reason: str = ""
    remark: str = ""


def main(arguments: Sequence[str] | None = None) -> None:
    """Solve and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--problems", nargs="+", choices=_ORDER, default=_ORDER)
    parser.add_argument("--repeats", type=int, default=9, help="solves of which the median is taken")
    parser.add_argument("--timeout", type=float, default=300.0, help="of a solver on a problem [s]")
    options = parser.parse_args(arguments)
    one_core()
    own, other = own_environment(), environment_of_crocoddyl()
    show(header(), markdown=options.markdown)
    show(_versions(own, other), markdown=options.markdown)
    with tempfile.TemporaryDirectory() as folder:
        for name in options.problems:
            path = _written(name, Path(folder))
            task = load_task(path)
            found = [
                _solved(tool, own if tool.is_own else other, task, path, options.repeats, options.timeout)
                for tool in _TOOLS
            ]
            show(_table(task, found), markdown=options.markdown)


def _written(name: str, folder: Path) -> Path:
    """Tables of a problem file as JSON; rotors in place of the name of a robot that has them."""
    tables = tomllib.loads((_HERE / "problems" / f"{name}.toml").read_text())
    robot = _HERE / "problems" / tables["robot"]["name"] / "robot.toml"
    if robot.exists():
        described = tomllib.loads(robot.read_text())
        tables["robot"] = {"rotors_of": described["part"][0]["robot"], "rotors": described["actuator"]}
    path = folder / f"{name}.json"
    path.write_text(json.dumps(tables))
    return path


def _solved(
    tool: Tool, environment: Environment, task: Task, path: Path, repeats: int, timeout: float
) -> Found:
    """One solver in its own process, on one core."""
    if not environment.has(tool.package):
        return Found(tool, reason=environment.reason or f"{tool.package} is not installed")
    out = path.with_name(f"{task.name}-{tool.module.replace(':', '-')}.npz")
    command = [str(environment.python), "-m", "benchmarks.peers.tools.one", tool.module, str(path), str(out)]
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    try:
        done = subprocess.run(
            [*command, str(repeats)],
            cwd=_ROOT,
            env={**os.environ, **threads, "OMP_WAIT_POLICY": "passive", "PYTHONPATH": str(_ROOT)},
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Found(tool, reason=f"no end within {timeout:.0f} s")
    if out.with_suffix(".json").exists():
        return Found(tool, reason=json.loads(out.with_suffix(".json").read_text())["reason"])
    if done.returncode:
        said = done.stderr.strip().splitlines()
        return Found(tool, reason=said[-1] if said else f"ended with {done.returncode}")
    with np.load(out) as kept:
        verdict = judge(task, kept["qs"], kept["vs"], kept["us"])
        seconds = float(median(kept["seconds"].tolist()))
        iterations, remark = int(kept["iterations"]), str(kept["remark"])
        return Found(tool, verdict, iterations, 1e3 * seconds, remark=remark)


def _versions(own: Environment, other: Environment) -> Table:
    rows = [("mbocp, CasADi", ", ".join(f"{n} {own.versions.get(n)}" for n in ("pin", "casadi")))]
    names = ("crocoddyl", "mim-solvers", "pin", "libpinocchio")
    rows.append(
        ("Crocoddyl, mim_solvers", other.reason or ", ".join(f"{n} {other.versions.get(n)}" for n in names))
    )
    return Table("Environments", ("", "versions"), rows)


def _table(task: Task, found: Sequence[Found]) -> Table:
    base = found[0]
    rows = [_row(task, one, base) for one in found]
    known, cost = _KNOWN.get(task.name), base.verdict.cost if base.verdict else np.nan
    note = f"N = {task.num_steps}, T = {task.duration:g} s, w = {task.weight:g}. "
    if known is not None:
        is_there = abs(cost - known) <= max(_SAME_COST * known, 5e-6)
        note += f"Optimum known: {known:.5f}, mbocp " + ("is there. " if is_there else "IS NOT THERE. ")
    note += (
        "Cost, defect of steps and error of the end by Pinocchio's ABA from the trajectory alone; excess of "
        "torques beyond limits. Median times of solves, on compiled functions, setting up not counted."
    )
    columns = (
        "solver",
        "cost",
        "iterations",
        "wall [ms]",
        "times mbocp's",
        "defect",
        "end",
        "excess",
        "remark",
    )
    return Table(task.name, columns, rows, note)


def _row(task: Task, one: Found, base: Found) -> tuple[str, ...]:
    verdict = one.verdict
    if verdict is None:
        return (one.tool.label, *[""] * 7, one.reason)
    numbers: list[Any] = [f"{verdict.cost:.5f}", str(one.iterations), f"{one.milliseconds:.3g}"]
    wrong = _wrong(verdict, base.verdict)
    ratio = one.milliseconds / base.milliseconds
    numbers.append("" if wrong.startswith("not") else f"{ratio:.1f}")
    errors = (f"{e:.0e}" for e in (verdict.defect, verdict.end, verdict.excess))
    return (one.tool.label, *numbers, *errors, ", ".join(filter(None, (wrong, one.remark))))


def _wrong(verdict: Verdict, base: Verdict | None) -> str:
    """What keeps a trajectory from being a solution, or from being the same one."""
    if verdict.excess > _EXCESS or verdict.end > _END or verdict.defect > _END:
        return "not solved"
    if base is not None and abs(verdict.cost - base.cost) > _HIGHER * base.cost:
        return "another minimum"
    return "penalty at the end" if verdict.end > _HARD_END else ""


if __name__ == "__main__":
    main()
