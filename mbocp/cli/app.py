"""What commands there are and what they take; the work is imported when it is asked for."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command
from typer.models import CommandInfo

from mbocp.cli import signals
from mbocp.cli.command_examples import examples
from mbocp.cli.error_report import reporting
from mbocp.cli.robot_options import RobotOptions

# Commands in the order of the help: the module of `mbocp.cli` that has a function of that name, and what the
# list of commands says, which is the first line of the function's docstring.
COMMANDS = {
    "new": ("new", "Write a problem file for a robot, with comments."),
    "solve": ("app", "Solve a problem file."),
    "menu": ("app", "List different motions that solve a problem, the cheapest first."),
    "check": ("check", "Say what a problem file asks for, and what is odd about it."),
    "explain": ("explain", "Say why a problem cannot be solved."),
    "bound": ("explain", "Bound cost and duration of all motions from below."),
    "excite": ("app", "Find the motion that tells most about masses and friction."),
    "replay": ("app", "Replay results: a page, live in the browser, pictures, or a film."),
    "live": ("app", "Drag the goal on a page, and watch it being solved again."),
    "plot": ("app", "Plot a result: states, controls, multipliers, convergence, path."),
    "report": ("app", "Write all about a result, or about several, as one page."),
    "info": ("app", "Say what a result is and how good it is."),
    "export": ("app", "Write a motion for controllers, viewers and other tools."),
    "robots": ("robots", "List the robots there are, or say what one has."),
    "spheres": ("robots", "Show the spheres that stand for links where a robot may collide."),
    "study": ("app", "Solve many problems: a grid, a random sample, or a list."),
    "identify": ("app", "Find masses, inertias and friction from a recorded motion."),
    "keys": ("keys", "Say what keys of problem files take and mean."),
    "schema": ("keys", "Write the JSON schema of problem files."),
    "doctor": ("doctor", "Say what works on this machine, and how to mend what does not."),
}


class _Commands(TyperGroup):
    """Commands that are lines of a list until one is asked for, whose module is imported then."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        name, command, rest = super().resolve_command(ctx, args)
        return name, reporting(load_command)(name) if name in COMMANDS else command, rest


def load_command(name: str) -> Any:
    """One of mbocp's own commands, as typer reads its function."""
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    function = getattr(import_module(f"mbocp.cli.{COMMANDS[name][0]}"), name)
    alone.command(name, epilog=examples(name))(reporting(function))
    return get_command(alone)


app = typer.Typer(
    name="mbocp",
    help="Optimal control of multibody systems: from a URDF to a solved, replayed motion.",
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _name, (_, _summary) in COMMANDS.items():
    app.command(_name, help=_summary)(lambda: None)


def app_for(words: Sequence[str]) -> typer.Typer:
    """Command line for some words: unless the first names a command of mbocp, with those of other packages.

    They are apps of typer under the entry point "mbocp.commands", and finding them takes time.
    """
    if COMMANDS.keys() & words[:1]:
        return app
    wanted = copy.copy(app)
    wanted.registered_commands = [*app.registered_commands, *_added_commands()]
    return wanted


def _added_commands() -> Iterator[CommandInfo]:
    for point in entry_points(group="mbocp.commands"):
        try:
            yield from point.load().registered_commands
        except ImportError as error:
            name = point.dist.name if point.dist else point.value
            typer.echo(f"warning: the commands of {name} cannot be loaded: {error}", err=True)


def argument(metavar: str, words: str) -> Any:
    """A word that a command takes."""
    return typer.Argument(metavar=metavar, help=words, show_default=False)


def option(name: str, metavar: str, words: str) -> Any:
    """An option with a value."""
    return typer.Option(name, metavar=metavar, help=words)


def output_file(metavar: str, words: str) -> Any:
    """The file that a command writes."""
    return typer.Option("--output", "-o", metavar=metavar, help=words)


def switch(names: str, words: str) -> Any:
    """An option of two names, whose help says what holds without it."""
    return typer.Option(names, help=words, show_default=False)


ProblemFile = Annotated[Path, argument("FILE", "Problem file (TOML).")]
ResultFile = Annotated[Path, argument("RESULT", "What `mbocp solve -o` wrote.")]
ProblemOrResult = Annotated[Path, argument("FILE|RESULT", "Problem file, or a result of a solve.")]
Robot = Annotated[str, argument("ROBOT", "Robot, by name or path of its URDF.")]
PackageDirs = Annotated[
    list[Path] | None, option("--package-dir", "DIR", "Folder with ROS packages (meshes). Repeatable.")
]
FreeFlyer = Annotated[bool | None, switch("--free-flyer/--fixed", "Whether the root link floats.")]
Dynamics = Annotated[
    bool | None,
    switch(
        "--dynamics/--no-dynamics",
        "Whether forces move it; without, controls are accelerations, and links need no inertias.",
    ),
]
Locks = Annotated[
    list[str] | None, option("--lock", "JOINT[=VALUE]", "Make a joint rigid [rad, m]. Repeatable.")
]
Settings = Annotated[
    list[str] | None, option("--set", "KEY=VALUE", "Change a key of the file; a TOML value. Repeatable.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]


def _show_version(wanted: bool) -> None:
    if wanted:
        from mbocp import __version__

        typer.echo(f"mbocp {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    _version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


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
    from mbocp.cli.solve import Outputs, run

    outputs = Outputs(result=output, replay=replay, plot=plot, meshes=meshes)
    status = run(file, settings or [], solver, outputs, as_json=as_json, quiet=quiet, accuracy=accuracy)
    raise typer.Exit(status)


def menu(
    file: Annotated[Path, argument("FILE", "Problem file (TOML), or a result of a solve.")],
    settings: Settings = None,
    tries: Annotated[int, typer.Option(min=1, metavar="N", help="Ways to try, to each goal.")] = 24,
    output: Annotated[Path | None, output_file("FOLDER", "Save a result for each in this folder.")] = None,
    replay: Annotated[
        Path | None, option("--replay", "FILE.html", "Write a page with the first five at once.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """List different motions that solve a problem, the cheapest first.

    Exit status: 0 converged, 1 none converged, 2 bad input, 130 interrupted before there is any.
    """
    from mbocp.cli.menu_table import print_menu

    raise typer.Exit(print_menu(file, settings or [], tries, output, replay, as_json=as_json, quiet=quiet))


def excite(
    file: ProblemFile,
    settings: Settings = None,
    output: Annotated[Path | None, output_file("FILE.h5", "Save the motion as a result.")] = None,
    torque_noise: Annotated[
        float | None, option("--torque-noise", "VALUE", "Standard deviation of measured torques [N m, N].")
    ] = None,
    starts: Annotated[int | None, option("--starts", "N", "Random motions that are improved.")] = None,
    as_json: Json = False,
) -> None:
    """Find the motion that tells most about masses and friction.

    From start to goal within all limits, by [goal.excite] and the options. Exit status: 0 converged, 1 not, 2
    bad input.
    """
    from mbocp.cli.identify import print_exciting

    options = {"torque_noise": torque_noise, "starts": starts}
    raise typer.Exit(print_exciting(file, settings or [], output, options, as_json=as_json))


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
    from mbocp.cli.replay_page import Look, Recording, replay_results

    look = Look(tuple(trace or ()), ghosts, tuple(ghost_at or ()), camera, speed)
    replay_results(results, output, look, Recording(frames, movie, fps, size), live=live, quiet=quiet)


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
    from mbocp.cli.replay_page import live_page

    live_page(file, settings or [], output, host=host, port=port, browser=browser, quiet=quiet)


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
    from mbocp.cli.results import plot_result

    plot_result(result, output, style, quiet=quiet)


def report(
    results: Annotated[list[Path], argument("RESULT", "What `mbocp solve -o` wrote; several side by side.")],
    output: Annotated[Path | None, output_file("PAGE.html", "Page to write. [default: RESULT.html]")] = None,
    quiet: Quiet = False,
) -> None:
    """Write all about a result, or about several, as one page.

    It works offline: replay, plots tied to its time, active limits, convergence, the problem, versions; of
    several results what differs.
    """
    from mbocp.cli.results import report_results

    report_results(results, output, quiet=quiet)


def info(result: ResultFile, as_json: Json = False) -> None:
    """Say what a result is and how good it is."""
    from mbocp.cli.results import print_info

    print_info(result, as_json=as_json)


def export(
    result: ResultFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="File to write.", show_default=False)
    ],
    kind: Annotated[
        str | None,
        option(
            "--format", "NAME", "csv, ros2, urscript, npz, parquet, mcap or rerun. [default: by the suffix]"
        ),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Samples a second. [default: the nodes]")
    ] = None,
    interpolation: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="cubic or quintic, between the nodes. [default: cubic; for ros2 quintic]",
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
    quiet: Quiet = False,
) -> None:
    """Write a motion for controllers, viewers and other tools."""
    from mbocp.cli.results import export_result

    if not export_result(result, output, kind, rate, interpolation, fit=fit, check=check, quiet=quiet):
        raise typer.Exit(1)


def study(
    file: Annotated[Path | None, argument("STUDY", "Study file (TOML).")] = None,
    output: Annotated[Path | None, output_file("FILE.jsonl", "Where the rows go.")] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Processes. [default: one a processor]")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help='Run on Dask: tcp://HOST:PORT, or "local" for a cluster here.'),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with FILE.jsonl, if it is there.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Begin FILE.jsonl anew.")] = False,
    summary: Annotated[
        Path | None, option("--summary", "FILE.jsonl", "Run nothing, sum up what is there.")
    ] = None,
    by: Annotated[
        list[str] | None, option("--by", "NAME", "Sum up by this varied key or axis. Repeatable.")
    ] = None,
    plot: Annotated[Path | None, option("--plot", "FILE.png", "Draw the summary as bars.")] = None,
    csv: Annotated[Path | None, option("--csv", "FILE.csv", "Write all rows.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Solve many problems: a grid, a random sample, or a list.

    Exit status: 0 all tasks converged, 1 some did not (each has a row), 2 bad input, 130 interrupted
    (--resume goes on).
    """
    from mbocp.cli.study_table import How, Shown, run, summarise
    from mbocp.exceptions import StudyError

    shown = Shown(by=tuple(by) if by else None, plot=plot, csv=csv, as_json=as_json, quiet=quiet)
    if summary is not None and file is None:
        summarise(summary, shown)
    elif file is not None and summary is None:
        run(file, output, How(workers, scheduler, resume, overwrite), shown)
    else:
        raise StudyError("give a study file to run or --summary FILE.jsonl to sum up, one of the two")


def identify(
    name: Robot,
    log: Annotated[
        Path, argument("LOG", "What was recorded: CSV, Parquet, MCAP; see docs/identification.md.")
    ],
    held_out: Annotated[
        Path | None, option("--held-out", "LOG", "Test the result on it. [default: the last fifth of LOG]")
    ] = None,
    payload: Annotated[
        str | None,
        option("--payload", "NAME", "Find this payload, or the body at this frame, and nothing else."),
    ] = None,
    friction: Annotated[
        str, option("--friction", "NAME", "What is unknown of it: both, viscous, coulomb or none.")
    ] = "both",
    friction_speed: Annotated[
        float | None,
        option("--friction-speed", "SPEED", "Over which Coulomb friction is smoothed [rad/s, m/s]."),
    ] = None,
    rotors: Annotated[bool, typer.Option("--rotors", help="Find rotor inertias, too.")] = False,
    offsets: Annotated[bool, typer.Option("--offsets", help="Find offsets of joint positions, too.")] = False,
    torque_constant: Annotated[
        list[str] | None,
        option("--torque-constant", "JOINT=VALUE", "Torque by motor current [N m/A, N/A]. Repeatable."),
    ] = None,
    out: Annotated[Path | None, option("--out", "NEW.urdf", "Write the URDF with the numbers found.")] = None,
    plot: Annotated[Path | None, option("--plot", "FILE.png", "Draw what is left of the torques.")] = None,
    package_dir: PackageDirs = None,
    lock: Locks = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find masses, inertias and friction from a recorded motion."""
    from mbocp.cli.identify import Asked, identify_robot

    asked = Asked(held_out, payload, friction, rotors, offsets, friction_speed, tuple(torque_constant or ()))
    signals.leave_in_order()
    options = RobotOptions(package_dir, None, None, lock)
    identify_robot(name, log, options, asked, out, plot, as_json=as_json, quiet=quiet)
