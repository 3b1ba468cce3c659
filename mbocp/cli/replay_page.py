"""`mbocp replay` and `live`: results as a page, live, as pictures, or as a film; goals that are dragged."""

from __future__ import annotations

import contextlib
import webbrowser
from pathlib import Path
from typing import Annotated, Any

import typer

from mbocp._files import RESULT_SUFFIXES
from mbocp._quantities import finite_number
from mbocp.cli import signals
from mbocp.cli.app import Quiet, Settings, argument, option, output_file
from mbocp.cli.results import load_result, name_errors, tell
from mbocp.cli.solve import PAGES, check_output, problem_of
from mbocp.exceptions import InvalidValue


def replay(
    results: Annotated[
        list[Path],
        argument("RESULT", "What `mbocp solve -o` wrote; of several, the others move beside the first."),
    ],
    output: Annotated[Path | None, output_file("FILE.html", "Page to write. [default: RESULT.html]")] = None,
    live: Annotated[
        bool, typer.Option("--open", help="Show it in a browser now, and write only what -o asks for.")
    ] = False,
    trace: Annotated[
        list[str] | None, option("--trace", "FRAME", "Frame that leaves a trace. Repeatable.")
    ] = None,
    ghosts: Annotated[
        int, typer.Option(metavar="N", help="Draw the robot, faint, at N times from start to end.")
    ] = 0,
    ghost_at: Annotated[
        list[float] | None, option("--ghost-at", "TIME", "And at this time [s]. Repeatable.")
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="AZIMUTH,ELEVATION",
            help="From where to look [deg]. [default: where most can be seen]",
            show_default=False,
        ),
    ] = None,
    speed: Annotated[float, typer.Option(help="1 is true speed.")] = 1.0,
    frames: Annotated[
        Path | None, option("--frames", "DIR", "Write pictures (PNG) instead of a page; needs Chromium.")
    ] = None,
    movie: Annotated[
        Path | None,
        option(
            "--movie", "FILE.gif|mp4", "Write a film instead of a page; needs Chromium, and ffmpeg for MP4."
        ),
    ] = None,
    fps: Annotated[float, typer.Option(help="Pictures a second, of --frames and --movie.")] = 25.0,
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the pictures [pixel].")] = "960x640",
    quiet: Quiet = False,
) -> None:
    """Replay results: a page, live in the browser, pictures, or a film.

    The page is one file that works offline.
    """
    if not speed > 0.0:
        raise InvalidValue("--speed", speed, "a positive number; 1 is true speed")
    if ghosts and ghost_at:
        raise InvalidValue("--ghosts", ghosts, "--ghosts or --ghost-at, one of the two")
    records = frames is not None or movie is not None
    path = output if output is not None or live or records else results[0].with_suffix(".html")
    if path is not None:
        check_output(path, "-o", PAGES)
    from mbocp.view.movie import MOVIES, Film
    from mbocp.view.of_solution import film_solution, replay_solution

    if movie is not None:
        check_output(movie, "--movie", MOVIES)
    expected = "AZIMUTH,ELEVATION in degrees"
    direction = None if camera is None else _pair("--camera", camera, ",", expected)
    width, height = _pair("--size", size, "x", "WxH in pixels, such as 960x640")
    film = Film(fps, speed, (int(width), int(height)))
    signals.leave_in_order()
    solution, robot = load_result(results[0])
    others = [load_result(other)[0] for other in results[1:]]
    look: dict[str, Any] = {"robot": robot, "others": others, "direction": direction}
    look |= {"trace": trace or None, "ghosts": ghost_at or ghosts}
    with name_errors(results[0], "cannot be drawn"):
        if path is not None:
            replay_solution(solution, path, speed=speed, **look)
            tell(f"replay: {path}", quiet)
        if records:
            film_solution(solution, frames=frames, movie=movie, film=film, **look)
            for kind, written in (("frames", frames), ("movie", movie)):
                if written is not None:
                    tell(f"{kind}: {written}", quiet)
        if live:
            replay_solution(solution, speed=speed, **look)


def _pair(option: str, written: str, between: str, expected: str) -> tuple[float, float]:
    words = written.split(between)
    try:
        first, second = (finite_number(float(word)) for word in words)
    except ValueError:
        raise InvalidValue(option, written, expected) from None
    return first, second


def live(
    file: Annotated[Path, argument("FILE", "Problem file (TOML), or a result of a solve.")],
    settings: Settings = None,
    output: Annotated[Path | None, output_file("RESULT.h5", "Save the last motion that converged.")] = None,
    host: Annotated[str, typer.Option(help="Address to serve the page at.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="The first port to try.")] = 8080,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open a browser window.")] = True,
    quiet: Quiet = False,
) -> None:
    """Drag the goal on a page, and watch it being solved again.

    Needs mbocp[live].
    """
    if output is not None:
        check_output(output, "-o", RESULT_SUFFIXES)
    import mbocp
    from mbocp.cli.progress_table import ProgressCallback
    from mbocp.interactive import Live
    from mbocp.view.live.live_scene import viser_module

    viser_module()  # before anything takes time
    signals.leave_in_order()
    with ProgressCallback(title=file.stem, quiet=quiet) as progress:
        problem = problem_of(file, settings or ())
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
