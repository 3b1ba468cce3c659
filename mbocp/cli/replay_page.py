"""`mbocp replay` and `live`: results as a page, live, as pictures, or as a film; goals that are dragged."""

from __future__ import annotations

import contextlib
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from mbocp._dataclass import dataclass
from mbocp._files import RESULT_SUFFIXES
from mbocp._numbers import finite_number
from mbocp.cli import signals
from mbocp.cli.results import load_result, name_errors, tell
from mbocp.cli.solve import PAGES, check_output, problem_of
from mbocp.exceptions import InvalidValue


@dataclass(frozen=True)
class Look:
    """What is drawn besides the robot, and how it is seen."""

    trace: tuple[str, ...]
    ghosts: int
    ghost_at: tuple[float, ...]
    camera: str | None
    speed: float

    def arguments(self) -> dict[str, Any]:
        """As of `mbocp.view.of_solution.replay_solution`, but for the speed."""
        if self.ghosts and self.ghost_at:
            raise InvalidValue("--ghosts", self.ghosts, "--ghosts or --ghost-at, one of the two")
        expected = "AZIMUTH,ELEVATION in degrees"
        direction = None if self.camera is None else _pair("--camera", self.camera, ",", expected)
        return {
            "trace": list(self.trace) or None,
            "ghosts": list(self.ghost_at) or self.ghosts,
            "direction": direction,
        }


@dataclass(frozen=True)
class Recording:
    """Pictures and films to write."""

    frames: Path | None
    movie: Path | None
    fps: float
    size: str


def replay_results(
    results: Sequence[Path],
    output: Path | None,
    look: Look,
    recording: Recording,
    *,
    live: bool,
    quiet: bool,
) -> None:
    """Write a replay page, pictures or a film, or show the motion in a browser."""
    if not look.speed > 0.0:
        raise InvalidValue("--speed", look.speed, "a positive number; 1 is true speed")
    records = recording.frames is not None or recording.movie is not None
    path = output if output is not None or live or records else results[0].with_suffix(".html")
    if path is not None:
        check_output(path, "-o", PAGES)
    from mbocp.view.movie import MOVIES, Film
    from mbocp.view.of_solution import film_solution, replay_solution

    if recording.movie is not None:
        check_output(recording.movie, "--movie", MOVIES)
    width, height = _pair("--size", recording.size, "x", "WxH in pixels, such as 960x640")
    film = Film(recording.fps, look.speed, (int(width), int(height)))
    signals.leave_in_order()
    solution, robot = load_result(results[0])
    others = [load_result(other)[0] for other in results[1:]]
    options: dict[str, Any] = {"robot": robot, "others": others, **look.arguments()}
    with name_errors(results[0], "cannot be drawn"):
        if path is not None:
            replay_solution(solution, path, speed=look.speed, **options)
            tell(f"replay: {path}", quiet)
        if records:
            film_solution(solution, frames=recording.frames, movie=recording.movie, film=film, **options)
            for kind, written in (("frames", recording.frames), ("movie", recording.movie)):
                if written is not None:
                    tell(f"{kind}: {written}", quiet)
        if live:
            replay_solution(solution, speed=look.speed, **options)


def _pair(option: str, written: str, between: str, expected: str) -> tuple[float, float]:
    words = written.split(between)
    try:
        first, second = (finite_number(float(word)) for word in words)
    except ValueError:
        raise InvalidValue(option, written, expected) from None
    return first, second


def live_page(
    file: Path,
    settings: Sequence[str],
    output: Path | None,
    *,
    host: str,
    port: int,
    browser: bool,
    quiet: bool,
) -> None:
    """Serve the page until Ctrl-C; write the last motion that converged."""
    if output is not None:
        check_output(output, "-o", RESULT_SUFFIXES)
    import mbocp
    from mbocp.cli.progress_table import Progress
    from mbocp.interactive import Live
    from mbocp.view.live.live_scene import viser_module

    viser_module()  # before anything takes time
    signals.leave_in_order()
    with Progress(title=file.stem, quiet=quiet) as progress:
        problem = problem_of(file, settings)
        progress.say("compiling, then guessing (slow the first time)")
        solution = mbocp.solve(problem, callback=progress)
    with Live(problem, solution, host=host, port=port) as page:
        typer.echo(f"{problem.name}: open {page.url} in a browser (Ctrl-C ends it)")
        try:
            if browser:
                with contextlib.suppress(webbrowser.Error):
                    webbrowser.open(page.url, new=2)
            page.wait_until_closed()
        except KeyboardInterrupt:
            if not quiet:
                typer.echo("\nPage closed.")
        if output is not None:
            page.solution.save(output)
            if not quiet:
                typer.echo(f"result: {output}")
