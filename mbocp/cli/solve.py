"""`mbocp solve`: check the outputs, load, solve under a progress table, write, sum up."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbocp._files import RESULT_SUFFIXES, is_file, is_folder
from mbocp._text import printable, show
from mbocp.cli import signals
from mbocp.cli.app import Json, Quiet, Settings, argument, option, output_file, switch
from mbocp.cli.error_report import INTERRUPTED
from mbocp.exceptions import ResultFileError

if TYPE_CHECKING:
    from mbocp.problem import Problem
    from mbocp.solution import Solution

PAGES = (".html", ".htm")
IMAGES = (".png", ".pdf", ".svg")
_MAX_NAME_BYTES = 255  # bytes, of a file: what Linux takes


@dataclass(frozen=True)
class Outputs:
    """Files to write, each optional; and whether the robot's meshes go into the result, see `save`."""

    result: Path | None = None
    replay: Path | None = None
    plot: Path | None = None
    meshes: bool | None = None

    def check(self, source: Path) -> None:
        """Refuse what could not be written, before any work is done."""
        seen = {source.resolve(): "what is solved"}
        for name, path, suffixes in self._entries():
            check_output(path, name, suffixes)
            taken = seen.setdefault(path.resolve(), name)
            if taken != name:
                raise ResultFileError(path, f"{name} would overwrite {taken}; give it another name")

    def _entries(self) -> Iterator[tuple[str, Path, Sequence[str]]]:
        if self.result is not None:
            yield "-o", self.result, RESULT_SUFFIXES
        if self.replay is not None:
            yield "--replay", self.replay, PAGES
        if self.plot is not None:
            yield "--plot", self.plot, IMAGES


def check_output(path: Path, option: str, suffixes: Sequence[str]) -> None:
    """Refuse a path that cannot become a file of one of the kinds in `suffixes`."""
    if is_folder(path):
        raise ResultFileError(path, f"{option} is a folder, expected the name of a file")
    if path.suffix.lower() not in suffixes:
        raise ResultFileError(
            path, f"{option} must end in {' or '.join(suffixes)}, got {path.suffix or 'nothing'}"
        )
    folder = path.parent
    if not is_folder(folder):
        raise ResultFileError(path, f"{option}: there is no folder {show(str(folder))}; make it first")
    if len(os.fsencode(path.name)) > _MAX_NAME_BYTES:
        raise ResultFileError(
            path, f"{option}: a name of more than {_MAX_NAME_BYTES} bytes; give a shorter one"
        )
    if not os.access(folder, os.W_OK) or (is_file(path) and not os.access(path, os.W_OK)):
        raise ResultFileError(path, f"{option}: no permission to write there")


def solve(
    file: Annotated[
        Path, argument("FILE", "Problem file (TOML), or a result whose problem is solved again.")
    ],
    settings: Settings = None,
    solver: Annotated[
        str | None,
        option(
            "--solver",
            "NAME",
            "auto, monolithic, fbsm_newton, fbsm_bb, fbsm_bb+monolithic, fbsm_bb+fbsm_newton, ipopt "
            "or fatrop; short for --set solver.method=NAME.",
        ),
    ] = None,
    output: Annotated[Path | None, output_file("RESULT.h5", "Save the solution.")] = None,
    replay: Annotated[Path | None, option("--replay", "FILE.html", "Write a replay page.")] = None,
    plot: Annotated[Path | None, option("--plot", "FILE.png", "Write plots.")] = None,
    meshes: Annotated[
        bool | None,
        switch("--meshes/--no-meshes", "Whether -o keeps the robot's meshes, too; by default up to 64 MB."),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    accuracy: Annotated[
        bool | None,
        switch(
            "--accuracy/--no-accuracy",
            "Compare the motion with what the robot would do; by default unless that takes long.",
        ),
    ] = None,
) -> None:
    """Solve a problem file.

    Exit status: 0 converged, 1 not converged, 2 bad input, 130 interrupted (with what there is by then).
    """
    outputs = Outputs(result=output, replay=replay, plot=plot, meshes=meshes)
    outputs.check(file)
    _import(outputs)
    import mbocp
    from mbocp.cli.progress_table import ProgressCallback

    signals.leave_in_order()
    chosen = [*(settings or ()), *([f'solver.method="{solver}"'] if solver is not None else [])]
    with ProgressCallback(title=file.stem, quiet=quiet or as_json) as progress:
        progress.say("loading the robot")
        problem = problem_of(file, chosen)
        progress.say("compiling, then guessing (slow the first time)")
        solution = mbocp.solve(problem, callback=progress, accuracy=accuracy)
    problem = problem.with_found(solution.parameters)
    written = _write(solution, problem, outputs)
    if as_json:
        typer.echo(solution.to_json(indent=2))
    elif not quiet:
        from mbocp.cli.solution_summary import print_summary

        print_summary(solution, problem, written)
    elif not solution.converged:
        typer.echo(f"{file.name}: {solution.status}: {printable(solution.advice)}", err=True)
    raise typer.Exit(_exit_status(solution))


def _import(outputs: Outputs) -> None:
    """Import what takes time, and is better not interrupted, before there is anything to lose."""
    import mbocp.cli.solution_summary
    import mbocp.solving

    if outputs.result is not None:
        import mbocp.solution.file_content
        import mbocp.solution.files
        import mbocp.solution.its_robot
    if outputs.replay is not None:
        import mbocp.view.replay
    if outputs.plot is not None:
        import mbocp.view.plots  # noqa: F401


def _exit_status(solution: Solution) -> int:
    from mbocp.solution import Status

    if solution.status is Status.INTERRUPTED:
        return signals.status_of_signal() or INTERRUPTED
    return 0 if solution.converged else 1


def problem_of(file: Path, settings: Sequence[str]) -> Problem:
    """The problem of a problem file, or of a result."""
    return problem_and_solution(file, settings)[0]


def problem_and_solution(file: Path, settings: Sequence[str]) -> tuple[Problem, Solution | None]:
    """The problem of a problem file, or of a result with its solution."""
    if file.suffix.lower() in RESULT_SUFFIXES:
        from mbocp.solution import Solution

        solution = Solution.load(file)
        return solution.load_problem(settings), solution
    from mbocp.problem import load_problem

    return load_problem(file, settings), None


def _write(solution: Solution, problem: Problem, outputs: Outputs) -> list[tuple[str, Path]]:
    """Write the files; the result first, so that it is there whatever happens to the pictures."""
    written = []
    if outputs.result is not None:
        written.append(("result", solution.save(outputs.result, meshes=outputs.meshes)))
    if outputs.replay is not None:
        from mbocp.view.of_solution import replay_solution

        page = replay_solution(solution, outputs.replay, robot=problem.robot)
        assert page is not None
        written.append(("replay", page))
    if outputs.plot is not None:
        from mbocp.view.plots import plot_solution

        written.append(("plot", plot_solution(solution, outputs.plot, robot=problem.robot)))
    return written
