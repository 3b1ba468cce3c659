"""What is done with an input: load it, look at all that is in it, and at times solve or show it."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from mbocp.cli import main as command_line
from mbocp.cli.solution_summary import solution_rows
from mbocp.problem import load_problem
from mbocp.problem.file.tables import problem_to_toml
from mbocp.robot import describe, load_robot
from mbocp.solution import Solution
from mbocp.solving import solve
from mbocp.storage.seal import SEAL_SIZE, is_sealed, seal
from mbocp.study import Study, StudyResult
from mbocp.study.run_task import make_problem
from mbocp.view import plots  # noqa: F401  the forked command lines need not load it
from mbocp.view.replay import write_replay

from .cases import Case

__all__ = ["TARGETS", "Broken", "Refused"]

_COMPILED = 5  # one problem in so many is compiled before it is solved
_STEPS = 6  # of a problem that is solved
_ITERATIONS = 8
_TIME_LIMIT = 3.0  # [s]
_MOST_JOINTS = 12  # velocities of a robot whose problem is solved: larger ones take long to compile
_POSES = 4  # of a replay page
_BAD_INPUT = 2
_EXITS = (0, 1, _BAD_INPUT, 130)
_TASKS = 3  # of a study that are looked at


class Broken(Exception):
    """A promise is broken without an exception: false numbers, or the command line's manners."""


class Refused(Exception):
    """The command line refused the input, with this on stderr."""


def _problem(case: Case, path: Path) -> None:
    problem = load_problem(path)
    if problem.num_steps < 10**5:
        problem_to_toml(problem)


def _solve(case: Case, path: Path) -> None:
    problem = load_problem(path)
    if problem.robot.nv > _MOST_JOINTS:
        return
    options = replace(problem.solver, max_iterations=_ITERATIONS, time_limit=_TIME_LIMIT)
    problem = load_problem(path, {"horizon.steps": _STEPS}).with_(solver=options)
    with nullcontext() if case.seed % _COMPILED == 0 else _without_compiler():
        solution = solve(problem)
    values = (solution.qs, solution.vs, solution.us, np.array([solution.cost, solution.residual]))
    if solution.converged and not all(np.isfinite(value).all() for value in values):
        raise Broken("converged, with numbers that are not finite")
    saved = solution.save(path.with_name("out.h5"))
    if not Solution.load(saved).equals(solution):
        raise Broken("the saved solution is another one")


@contextmanager
def _without_compiler() -> Iterator[None]:
    """Functions are interpreted: compiling them takes longer than all the rest."""
    kept = {name: os.environ.pop(name) for name in ("PATH", "CC") if name in os.environ}
    os.environ["PATH"] = ""  # where there is none at all, the system's own is searched
    try:
        yield
    finally:
        os.environ.update(kept)


def _robot(case: Case, path: Path) -> None:
    robot = load_robot(path)
    json.dumps(describe(robot))
    v = np.ones(robot.nv)
    robot.difference(robot.q0, robot.integrate(robot.q0, v))
    robot.mass_matrix(robot.q0)


def _mesh(case: Case, path: Path) -> None:
    robot = load_robot(path)
    qs = np.array([robot.integrate(robot.q0, np.full(robot.nv, 0.1 * k)) for k in range(_POSES)])
    page = write_replay(robot, np.linspace(0.0, 1.0, _POSES), qs, path.with_name("out.html"))
    if b"root:" in page.read_bytes():
        raise Broken("a file of the machine is in the page")


def _study(case: Case, path: Path) -> None:
    study = Study.load(path)
    repr(study), study.groups, study.digest
    for task in islice(study.tasks(), _TASKS):
        make_problem(study.job, task.overrides)


def _result(case: Case, path: Path) -> None:
    solution = Solution.load(path)
    solution_rows(solution, "a robot")
    solution.to_json()
    repr(solution)
    if solution.converged and not np.isfinite(solution.qs).all():
        raise Broken("converged, with a trajectory that is not finite")
    data = case.files[case.main]
    if data != case.originals[case.main] and is_sealed(data) and seal(data[SEAL_SIZE:]) != data:
        raise Broken("a file that was changed is loaded")
    solution.to_csv(path.with_name("out.csv"))


def _rows(case: Case, path: Path) -> None:
    result = StudyResult.load(path)
    repr(result), result.missing, result.is_complete
    result.summary()
    for name in result.columns:
        result.column(name)


def _command(case: Case, path: Path) -> None:
    """Run the command line in a process of its own, for its exit status and what it writes."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        process = os.fork()
        if process == 0:
            _command_line(case, out.fileno(), err.fileno())
        _, status = os.waitpid(process, 0)
        err.seek(0)
        said = err.read().decode(errors="replace")
    code = os.waitstatus_to_exitcode(status)
    if code not in _EXITS:
        raise Broken(f"exit status {code} of {case.arguments[0]}: {_last_lines(said)}")
    errors = sum(line.startswith("error: ") for line in said.splitlines())  # "syntax error: " is one of them
    if errors > 1 or "Traceback" in said:
        raise Broken(f"{case.arguments[0]} says more than one line: {_last_lines(said)}")
    if code == _BAD_INPUT:
        raise Refused(said)


def _last_lines(said: str) -> str:
    return " | ".join(line.strip() for line in said.splitlines()[-6:])[-600:]


def _command_line(case: Case, out: int, err: int) -> None:
    """Never returns."""
    code = 1000
    try:
        os.dup2(out, 1)
        os.dup2(err, 2)
        sys.argv = ["mbocp", *case.arguments]
        sys.stdout = os.fdopen(1, "w", closefd=False)
        sys.stderr = os.fdopen(2, "w", closefd=False)
        try:
            command_line()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code if code < 256 else 99)


TARGETS: dict[str, Callable[[Case, Path], None]] = {
    "problem": _problem,
    "solve": _solve,
    "robot_toml": _robot,
    "robot_yaml": _robot,
    "urdf": _robot,
    "mesh": _mesh,
    "study": _study,
    "result": _result,
    "rows": _rows,
    "command": _command,
}
