"""Crocoddyl's published examples by the same equations: python -m benchmarks.crocoddyl_examples.

The same robots, costs, semi-implicit steps and guesses; `peers/tools/crocoddyl_examples.py` has theirs.
Crocoddyl's own functions judge both motions. Processor times of solves, the median of repeats, one thread.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import casadi as ca
import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.peers.environments import environment_of_crocoddyl
from benchmarks.peers.tools.runs import timed
from benchmarks.tables import Table, show
from mbocp.formulation import Formulation, Motion, formulate
from mbocp.guesses import make_guess
from mbocp.programme import Iterate
from mbocp.solvers import SolverSettings, Start, run_strategy
from mbocp.terms import running_cost, terminal_cost

__all__ = ["PROBLEMS", "arm", "quadrotor", "solved", "table"]

_ROOT = Path(__file__).parents[1]
_SCHEME = {"scheme": "semi_implicit_euler", "coordinates": "joint"}


def arm() -> mbocp.Problem:
    """A Kinova reaches for a pose: `arm_manipulation_fwddyn.py`, and by inverse dynamics `..._invdyn.py`."""
    robot = mbocp.load_robot("kinova")
    q, nv = robot.model.referenceConfigurations["arm_up"], robot.nv

    def pose(at):
        return ca.sumsqr(at.pose_error("j2s6s200_end_effector", [0.6, 0.2, 0.5])) / 2

    at_start = {
        "tracking": 0.1,
        "tracking_weights": [1] * nv + [0] * nv,
        "target": {"q": q, "p": np.zeros(nv)},
    }
    return mbocp.Problem.create(
        robot,
        1.0,
        100,
        start={"q": q},
        cost={"effort": 0.1, "velocity": 0.1, **at_start},
        terms=[running_cost(pose), terminal_cost(pose, weight=1e3, name="pose at the end")],
        **_SCHEME,
    )


def quadrotor() -> mbocp.Problem:
    """Hector flies to a pose: `quadrotor_fwddyn.py`, and by inverse dynamics `quadrotor_invdyn.py`."""
    robot = mbocp.load_robot(_ROOT / "benchmarks/peers/robots/hector")
    nv = robot.nv

    def pose(at):
        return ca.sumsqr(at.pose_error("hector/base_link", [1.0, 0.0, 1.0])) / 2

    weights = [1e-7] * 3 + [1e-3] * 3 + [0] * nv
    upright = {
        "tracking": 1.0,
        "tracking_weights": weights,
        "target": {"q": robot.neutral(), "p": np.zeros(nv)},
    }
    return mbocp.Problem.create(
        robot,
        0.99,
        33,
        start={"q": robot.neutral()},
        cost={"effort": 1e-6, "velocity": 1e-3, **upright},
        terms=[running_cost(pose, weight=1e-2), terminal_cost(pose, weight=3.0, name="pose at the end")],
        **_SCHEME,
    )


PROBLEMS: Mapping[str, Callable[[], mbocp.Problem]] = {
    "arm_manipulation_fwddyn": arm,
    "arm_manipulation_invdyn": arm,
    "quadrotor_fwddyn": quadrotor,
    "quadrotor_invdyn": quadrotor,
}


def guessed(formulation: Formulation, kind: str) -> Iterate:
    """The first iterate: "hold", or "zero", Crocoddyl's default: the neutral configuration, no controls."""
    if kind == "hold":
        return make_guess(kind, formulation)[0]
    problem, N = formulation.problem, formulation.problem.num_steps
    robot = problem.robot
    still = Motion(
        np.tile(robot.neutral(), (N + 1, 1)),
        np.zeros((N + 1, robot.nv)),
        np.zeros((N, robot.nu)),
        problem.timeline.lengths(),
    )
    return formulation.iterate_of(still, np.zeros((N, 0)))


def solved(problem: mbocp.Problem, kind: str, repeats: int) -> tuple[Motion, int, list[float], str]:
    """Motion, iterations, processor times [s], and how the solver ended."""
    formulation = formulate(problem)
    guess = guessed(formulation, kind)
    settings = SolverSettings.of(problem.solver, formulation.programme, has_inequalities=problem.is_bounded)
    start = Start(formulation.programme, guess)
    outcome, seconds = timed(lambda: run_strategy(settings, start), repeats, time.process_time)
    result = outcome.result
    iterations = sum(not record.is_guess for record in result.history)
    return formulation.motion_of(result.iterate), iterations, seconds, str(result.status)


def compared(name: str, kind: str, repeats: int, python: Path) -> dict[str, Any]:
    """What both came to, from one guess."""
    motion, iterations, seconds, status = solved(PROBLEMS[name](), kind, repeats)
    with tempfile.TemporaryDirectory() as folder:
        ours = Path(folder) / "ours.npz"
        np.savez(ours, qs=motion.qs, vs=motion.vs, us=motion.us)
        script = "benchmarks.peers.tools.crocoddyl_examples"
        done = subprocess.run(
            [str(python), "-m", script, name, kind, str(repeats), str(ours)],
            cwd=_ROOT,
            env={**os.environ, "PYTHONPATH": str(_ROOT), "OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode:
        raise SystemExit(done.stderr)
    theirs = json.loads(done.stdout.splitlines()[-1])
    return {"status": status, "own iterations": iterations, "own seconds": seconds, **theirs}


def table(names: Sequence[str], repeats: int) -> Table:
    """Two rows an example: from Crocoddyl's default guess, and from holding the start."""
    peer, rows, versions = environment_of_crocoddyl(), [], set()
    if not peer.has("crocoddyl"):
        raise SystemExit(f"Crocoddyl: {peer.reason}")
    for name in names:
        for kind in ("zero", "hold"):
            found = compared(name, kind, repeats, peer.python)
            versions.add(found["version"])
            rows.append(_row(name, kind, found))
    note = (
        f"Crocoddyl {', '.join(sorted(versions))}. Guess zero: its default, the neutral configuration and no "
        "controls; hold: at the start, gravity compensated. From mbocp's: the cost at which Crocoddyl's solver "
        "ends that begins at mbocp's motion. Difference: of the costs, by the lower. Gradient: the largest "
        "derivative of the cost in a control, by the largest of the effort. Defect: of mbocp's steps."
    )
    columns = ("example", "guess", *(f"{who}: {what}" for who in ("mbocp", "Crocoddyl") for what in _WHAT))
    return Table("Crocoddyl's examples", (*columns, "from mbocp's", "difference", "defect"), rows, note)


_WHAT = ("cost", "iterations", "time [ms]", "gradient")


def _row(name: str, kind: str, found: Mapping[str, Any]) -> tuple[str, ...]:
    ours, theirs = found["ours"], found["theirs"]
    less = min(ours["cost"], theirs["cost"])
    said = "" if found["status"] == "converged" else f" ({found['status']})"
    return (
        name,
        kind,
        f"{ours['cost']:.7g}{said}",
        str(found["own iterations"]),
        f"{1e3 * median(found['own seconds']):.3g}",
        f"{ours['gradient']:.0e}",
        f"{theirs['cost']:.7g}",
        str(found["iterations"]),
        f"{1e3 * median(found['seconds']):.3g}",
        f"{theirs['gradient']:.0e}",
        f"{found['from ours']['cost']:.7g}",
        f"{(theirs['cost'] - ours['cost']) / less:+.0e}",
        f"{ours['defect']:.0e}",
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.crocoddyl_examples", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--examples", nargs="+", choices=PROBLEMS, default=list(PROBLEMS))
    parser.add_argument("--repeats", type=int, default=9, help="solves of which the median is taken")
    options = parser.parse_args(arguments)
    one_core()
    show(header(), markdown=options.markdown)
    show(table(options.examples, options.repeats), markdown=options.markdown)


if __name__ == "__main__":
    main()
