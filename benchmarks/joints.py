"""Time and memory over the degrees of freedom, beside Crocoddyl: python -m benchmarks.joints.

From rest to a small move of all motors, 50 steps of semi-implicit Euler, least effort. Every row is a
process of its own, and its peer another: once with an empty cache and no compiler, then with what that has
left there. Processor times, the least of many. Crocoddyl has another step and another Hessian
(Gauss-Newton's), and functions that need not be built.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import mbocp
from benchmarks.lanes import KernelIterate
from benchmarks.machine import header, memory, one_core
from benchmarks.peers.environments import environment_of_crocoddyl
from benchmarks.tables import Table, show
from mbocp.formulation import formulate
from mbocp.programme.native_modules import number_of_lanes

__all__ = ["ROBOTS", "measured", "table"]

ROBOTS = ("ur5", "panda", "baxter", "solo12", "hyq", "talos", "human", "talos_full")
_ROOT = Path(__file__).parents[1]
_STEPS, _DURATION, _MOVE = 50, 0.5, 0.1  # [s], [rad, m]
_ROUNDS = 15


def problem_of(name: str) -> mbocp.Problem:
    """From rest to a small move of all motors; where a floating base goes meanwhile is free."""
    robot = mbocp.load_robot(name)
    q, move = robot.neutral(), np.zeros(robot.nv)
    move[robot.nv - robot.nu :] = _MOVE
    goal: Mapping[str, Any] = {"q": robot.integrate(q, move), "v": 0.0}
    return mbocp.Problem.create(
        robot, _DURATION, _STEPS, start={"q": q}, goal=goal, scheme="semi_implicit_euler", coordinates="joint"
    )


def measured(name: str) -> dict[str, float]:
    """In this process: what is built, then the parts of an iteration [s], memory [bytes]."""
    begun = time.process_time()
    problem = problem_of(name)
    loaded = time.process_time()
    formulate(problem)
    built = time.process_time()
    iterate = KernelIterate(problem, number_of_lanes())
    t = iterate.measure(_ROUNDS)
    return {
        "nv": problem.robot.nv,
        "load": loaded - begun,
        "build": built - loaded,
        "evaluate": t.evaluate,
        "factorise": t.factorise,
        "solve": t.solve,
        "trial": t.trial,
        "stage": iterate.native.num_bytes / problem.num_steps,
        "peak": memory("VmHWM"),
    }


def table(robots: Sequence[str]) -> Table:
    """One row a robot, one more where Crocoddyl can be had."""
    peer = environment_of_crocoddyl()
    rows = []
    for name in robots:
        with tempfile.TemporaryDirectory() as folder:
            cache = {"MBOCP_CACHE_DIR": folder, "MBOCP_FUNCTIONS": "tapes"}
            first = _run([sys.executable, "-m", "benchmarks.joints", "--one", name], cache)
            again = _run([sys.executable, "-m", "benchmarks.joints", "--one", name], cache)
        rows.append(_row(name, first, again))
        if peer.has("crocoddyl"):
            script = "benchmarks.peers.tools.crocoddyl_iteration"
            other = _run([str(peer.python), "-m", script, name, str(_STEPS)], {})
            rows.append(_row_of_peer(other))
    columns = ("robot", "joints", "built [s]", "from the cache [s]", "evaluate [us]", "factorise [us]")
    note = f"Of a stage: derivatives, factorisation, solve, iteration; {_STEPS} stages. {peer.reason}"
    more = ("solve [us]", "trial [us]", "iteration [us]", "stage [kB]", "process [MB]")
    return Table("Degrees of freedom", (*columns, *more), rows, note.strip())


def _run(command: Sequence[str], environment: Mapping[str, str]) -> dict[str, Any]:
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        command,
        cwd=_ROOT,
        env={**kept, **environment, "PYTHONPATH": str(_ROOT), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise SystemExit(done.stderr)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def _row(name: str, first: Mapping[str, float], again: Mapping[str, float]) -> tuple[str, ...]:
    parts = [again[part] for part in ("evaluate", "factorise", "solve", "trial")]
    built = (f"{one['build']:.2f}" for one in (first, again))
    stage, peak = f"{1e-3 * again['stage']:.0f}", f"{1e-6 * first['peak']:.0f}"
    return (name, f"{again['nv']:.0f}", *built, *_of_stage([*parts, sum(parts)]), stage, peak)


def _row_of_peer(found: Mapping[str, Any]) -> tuple[str, ...]:
    parts = [found[part] for part in ("derivatives", "direction", "trial")]
    derivatives, direction, trial, whole = _of_stage([*parts, sum(parts)])
    return (f"  Crocoddyl {found['version']}", "", "", "", derivatives, direction, "", trial, whole, "", "")


def _of_stage(times: Sequence[float]) -> list[str]:
    return [f"{1e6 * t / _STEPS:.2f}" for t in times]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.joints", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS), metavar="NAME")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    one_core()
    if options.one:
        print(json.dumps(measured(options.one)))
        return
    show(header(), markdown=options.markdown)
    show(table(options.robots), markdown=options.markdown)


if __name__ == "__main__":
    main()
