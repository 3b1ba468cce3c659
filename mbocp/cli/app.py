"""What commands there are, and what several of them take; a command is imported when it is asked for."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command
from typer.models import CommandInfo

from mbocp.cli.command_examples import examples
from mbocp.cli.error_report import report_errors, report_errors_of

# Commands in the order of the help: the module of `mbocp.cli` that has a function of that name, and what the
# list of commands says, which is the first line of the function's docstring.
COMMANDS = {
    "new": ("new", "Write a problem file for a robot, with comments."),
    "solve": ("solve", "Solve a problem file."),
    "menu": ("menu_table", "List different motions that solve a problem, the cheapest first."),
    "check": ("check", "Say what a problem file asks for, and what is odd about it."),
    "explain": ("explain", "Say why a problem cannot be solved."),
    "bound": ("explain", "Bound cost and duration of all motions from below."),
    "excite": ("identify", "Find the motion that tells most about masses and friction."),
    "replay": ("replay_page", "Replay results: a page, live in the browser, pictures, or a film."),
    "live": ("replay_page", "Drag the goal on a page, and watch it being solved again."),
    "plot": ("results", "Plot a result: states, controls, multipliers, convergence, path."),
    "report": ("results", "Write all about a result, or about several, as one page."),
    "info": ("results", "Say what a result is and how good it is."),
    "export": ("results", "Write a motion for controllers, viewers and other tools."),
    "robots": ("robots", "List the robots there are, or say what one has."),
    "spheres": ("robots", "Show the spheres that stand for links where a robot may collide."),
    "study": ("study_table", "Solve many problems: a grid, a random sample, or a list."),
    "identify": ("identify", "Find masses, inertias and friction from a recorded motion."),
    "keys": ("new", "Say what keys of problem files take and mean."),
    "schema": ("new", "Write the JSON schema of problem files."),
    "doctor": ("doctor", "Say what works on this machine, and how to mend what does not."),
}


class _Commands(TyperGroup):
    """Commands that are lines of a list until one is asked for, whose module is imported then."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        name, command, rest = super().resolve_command(ctx, args)
        if name in COMMANDS:
            with report_errors(quiet="--quiet" in rest or "-q" in rest, as_json="--json" in rest):
                command = load_command(name)
        return name, command, rest


def load_command(name: str) -> Any:
    """One of mbocp's own commands, as typer reads its function."""
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    function = getattr(import_module(f"mbocp.cli.{COMMANDS[name][0]}"), name)
    alone.command(name, epilog=examples(name))(report_errors_of(function))
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
    wanted.registered_commands = [*app.registered_commands, *_find_added_commands()]
    return wanted


def _find_added_commands() -> Iterator[CommandInfo]:
    from importlib.metadata import entry_points  # slow to import

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
Robot = Annotated[str, argument("ROBOT", "Robot, by name or path of its file.")]
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
