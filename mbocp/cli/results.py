"""What is done with a saved result: plot, report, info, export."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbocp._files import is_folder
from mbocp._text import show
from mbocp.cli import signals
from mbocp.cli.app import Json, Quiet, ResultFile, argument, option, output_file
from mbocp.cli.console import count
from mbocp.cli.solve import IMAGES, PAGES, check_output
from mbocp.exceptions import InvalidValue, LimitsExceeded, ReplayError, ResultFileError, RobotError

if TYPE_CHECKING:
    from rich.text import Text

    from mbocp.robot import Robot
    from mbocp.solution import Solution
    from mbocp.solution.sampled import JointSamples
    from mbocp.solution.sent import Sent


def plot(
    result: ResultFile,
    output: Annotated[
        Path | None, output_file("FILE.png", "Image to write: .png, .pdf or .svg. [default: RESULT.png]")
    ] = None,
    style: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="A style of matplotlib (grayscale, seaborn-v0_8-paper, my.mplstyle): fonts, sizes, grids.",
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Plot a result: states, controls, multipliers, convergence, path."""
    path = output if output is not None else result.with_suffix(".png")
    check_output(path, "-o", IMAGES)
    from mbocp.view.figures.style import house_style
    from mbocp.view.plots import plot_solution

    signals.leave_in_order()
    with house_style(style):  # a style that is not there is refused before the robot is loaded
        pass
    solution, robot = load_result(result)
    with name_errors(result, "cannot be drawn"):
        plot_solution(solution, path, robot=robot, style=style)
    tell(f"plot: {path}", quiet)


def report(
    results: Annotated[list[Path], argument("RESULT", "What `mbocp solve -o` wrote; several side by side.")],
    output: Annotated[Path | None, output_file("PAGE.html", "Page to write. [default: RESULT.html]")] = None,
    quiet: Quiet = False,
) -> None:
    """Write all about a result, or about several, as one page.

    It works offline: replay, plots tied to its time, active limits, convergence, the problem, versions; of
    several results what differs.
    """
    path = output if output is not None else results[0].with_suffix(".html")
    check_output(path, "-o", PAGES)
    from mbocp.view.report import compare_results, write_report

    signals.leave_in_order()
    loaded = [load_result(result) for result in results]
    with name_errors(results[0], "cannot be drawn"):
        if len(loaded) == 1:
            solution, robot = loaded[0]
            rows = [*_rows(solution), ("at least", _bound_words(solution))]
            write_report(solution, path, robot=robot, facts=[(k, str(v)) for k, v in rows])
        else:
            names = [result.stem for result in results]
            if len(set(names)) < len(names):
                names = [f"{result} ({place})" for place, result in enumerate(results, 1)]
            compare_results(dict(zip(names, (solution for solution, _ in loaded), strict=True)), path)
    tell(f"report: {path}", quiet)


def info(result: ResultFile, as_json: Json = False) -> None:
    """Say what a result is and how good it is."""
    from mbocp.solution import Solution

    solution = Solution.load(result)
    if as_json:
        typer.echo(solution.to_json(indent=2))
        return
    from mbocp.cli.solution_summary import print_rows

    versions = ", ".join(f"{name} {version}" for name, version in solution.versions.items())
    rows = [*_rows(solution), ("holds", _files_of(solution)), ("made with", versions or "not recorded")]
    print_rows(solution.problem_name or result.stem, rows)


def _rows(solution: Solution) -> list[tuple[str, str | Text]]:
    """What a result says of itself."""
    from mbocp.cli.solution_summary import robot_words, solution_rows

    ties = solution.facts.ties
    nc = solution.nc if ties is None else ties
    return solution_rows(solution, robot_words(solution.robot_name, solution.nv, solution.nu, nc))


def _bound_words(solution: Solution) -> str:
    """A lower bound of the cost."""
    from mbocp.bounds.of_problem import bound
    from mbocp.exceptions import MbocpError

    try:
        return bound(solution).words
    except MbocpError as error:
        return f"not known: {error}"


def _files_of(solution: Solution) -> str:
    """What a result has of its robot."""
    files = solution.robot_files
    if files is None:
        return "no robot: it can be shown and solved again where its robot is"
    left_out = len(files.left_out)
    words = f"its robot: {count(len(files.files) - left_out, 'file')}, {_size(files.size)}"
    return f"{words}; {count(left_out, 'mesh', 'meshes')} left out" if left_out else words


def _size(size: int) -> str:
    return f"{size / 1e6:.2g} MB" if size >= 1e5 else f"{size / 1e3:.2g} kB"


def load_result(result: Path) -> tuple[Solution, Robot]:
    """A result and its robot."""
    from mbocp.solution import Solution

    solution = Solution.load(result)
    if not solution.robot_spec:
        raise ResultFileError(result, "does not say which robot it is about, which this needs")
    with name_errors(result, "its robot cannot be loaded"):
        return solution, solution.load_robot()


@contextmanager
def name_errors(result: Path, what: str) -> Iterator[None]:
    """Name the file where its robot is gone, or its numbers diverged or are too large to be drawn."""
    try:
        yield
    except (InvalidValue, RobotError, ReplayError) as error:
        raise ResultFileError(result, f"{what}: {error}") from error


def tell(line: str, quiet: bool) -> None:
    """Print a line, unless it has to be quiet."""
    if not quiet:
        typer.echo(line)


def export(
    result: ResultFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="File to write.", show_default=False)
    ],
    kind: Annotated[
        str | None,
        option(
            "--format",
            "NAME",
            "csv, ros2, multidof, urscript, npz, parquet, mcap or rerun. [default: by the suffix]",
        ),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Samples a second. [default: the nodes]")
    ] = None,
    interpolation: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="cubic or quintic, between the nodes. [default: cubic; for ros2 quintic]"
        ),
    ] = None,
    fit: Annotated[
        bool,
        typer.Option(
            "--fit/--no-fit",
            help="Fit a motion from rest to rest into its limits as it is sent: smoother, slower by little.",
        ),
    ] = True,
    check: Annotated[
        bool,
        typer.Option(
            "--check/--no-check",
            help="Write nothing, and exit with 1, when a limit is exceeded as it is sent.",
        ),
    ] = True,
    part: Annotated[
        str | None,
        option("--part", "NAME", "Joints of one of several robots, by its own names. [default: all]"),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write a motion for controllers, viewers and other tools."""
    from mbocp.solution import Solution
    from mbocp.solution.export_formats import (
        format_of,
        prepare_within,
        what_helps,
        write_recording,
        write_samples,
    )
    from mbocp.solution.recordings import RECORDINGS
    from mbocp.solution.sampled import sample

    name = format_of(output, kind)
    if is_folder(output) or not is_folder(output.parent):
        raise ResultFileError(
            output, f"-o: there is no folder {show(str(output.parent))}, or it is one itself"
        )
    solution = Solution.load(result)
    if name in RECORDINGS:
        with _exit_on_excess():
            write_recording(solution, output, name, rate, interpolation, part, check=check)
        if not quiet:
            typer.echo(f"{name}: {output}; {solution.duration:.6g} s, the motion as it was solved")
        return
    sent, excesses = prepare_within(
        name, solution, rate, interpolation, fit=fit, load_robot=solution.load_robot
    )
    motion = sample(sent, solution.load_robot, part)
    if motion.left_out:
        what = ", ".join(motion.left_out)
        helps = "--format multidof writes them, and a base on the floor with joints x, y and yaw is sent"
        warnings.warn(f"left out, no joints of one velocity: {what}; {helps}", stacklevel=1)
    of_joints: dict[str, list[str]] = {}  # in the order of their worst
    for excess in excesses:
        of_joints.setdefault(excess.name, []).append(excess.words)
    for joint, words in of_joints.items():
        warnings.warn(f"{joint} leaves its limits: {'; '.join(words)}", stacklevel=1)
    if not solution.converged:
        warnings.warn(f"the solve ended with {solution.status}: this is no solution", stacklevel=1)
    if of_joints and check:
        helps = what_helps(sent, excesses, result, lacks_rate=fit and rate is None)
        typer.echo(f"{output}: not written: {helps}; --no-check writes it all the same", err=True)
        raise typer.Exit(1)
    write_samples(motion, solution, output, name)
    if not quiet:
        fitted = f" ({sent.words})" if sent.words else ""
        typer.echo(
            f"{name}: {output}; {motion.interpolation}s over {motion.t[-1]:.6g} s{fitted}, accelerations at "
            f"its ends up to {_largest_acceleration(motion, 0)} and {_largest_acceleration(motion, -1)}"
            f"{_points(sent, rate)}"
        )


@contextmanager
def _exit_on_excess() -> Iterator[None]:
    """Exit with 1 where limits are left, and a file is not written."""
    try:
        yield
    except LimitsExceeded as error:
        typer.echo(str(error).replace("check=False", "--no-check"), err=True)
        raise typer.Exit(1) from error


def _points(sent: Sent, rate: float | None) -> str:
    """How many points the rate gives, and how many it does not."""
    others = 0 if rate is None else sent.count_beside(rate)
    if not others:
        return ""
    return f"; {len(sent.times) - others} points at {rate:g} Hz, {others} where polynomials meet"


def _largest_acceleration(motion: JointSamples, sample: int) -> str:
    """The largest of each unit."""
    sizes = abs(motion.accelerations[sample])
    units = dict.fromkeys(motion.units)
    largest = (max(a for a, of in zip(sizes, motion.units, strict=True) if of == unit) for unit in units)
    return ", ".join(f"{round(float(a), 6):.3g} {unit}/s^2" for a, unit in zip(largest, units, strict=True))
