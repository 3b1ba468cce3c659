"""Examples at the end of each command's help."""

from __future__ import annotations

EXAMPLES: dict[str, tuple[str, ...]] = {
    "new": ("mbocp new ur5", "mbocp new my_robot.urdf --package-dir ~/ros/src -o reach.toml"),
    "solve": (
        "mbocp solve reach.toml -o reach.h5 --replay reach.html",
        "mbocp solve reach.toml --set horizon.duration=1.5 --set limits.velocity=true",
        "mbocp solve reach.h5 --set horizon.steps=200 -o finer.h5",
    ),
    "menu": ("mbocp menu reach.toml", "mbocp menu reach.toml --tries 50 -o reach_menu --replay menu.html"),
    "check": ("mbocp check reach.toml -o reach.html", "mbocp check reach.toml --json"),
    "explain": ("mbocp explain reach.toml", "mbocp explain failed.h5 --no-search"),
    "bound": ("mbocp bound reach.toml", "mbocp bound reach.h5 --json"),
    "excite": ("mbocp excite reach.toml", "mbocp excite reach.toml -o exciting.h5 --torque-noise 0.1"),
    "replay": (
        "mbocp replay reach.h5",
        "mbocp replay reach.h5 --open --trace tool0 --speed 0.5",
        "mbocp replay reach.h5 finer.h5 --ghosts 5 -o both.html",
        "mbocp replay reach.h5 --movie reach.gif --camera 60,20",
    ),
    "live": ("mbocp live reach.toml", "mbocp live reach.h5 -o kept.h5"),
    "plot": ("mbocp plot reach.h5", "mbocp plot reach.h5 -o reach.pdf --style my.mplstyle"),
    "report": ("mbocp report reach.h5 -o reach.html", "mbocp report reach.h5 finer.h5 -o both.html"),
    "info": ("mbocp info reach.h5", "mbocp info reach.h5 --json"),
    "export": (
        "mbocp export reach.h5 -o reach.csv --rate 125",
        "mbocp export reach.h5 -o reach.script",
        "mbocp export reach.h5 -o reach.mcap",
    ),
    "robots": ("mbocp robots", "mbocp robots ur5", "mbocp robots my_robot.urdf --free-flyer"),
    "spheres": ("mbocp spheres ur5 --replay ur5.html",),
    "study": (
        "mbocp study steps.toml -o steps.jsonl --workers 2",
        "mbocp study --summary steps.jsonl --plot steps.png",
    ),
    "identify": (
        "mbocp identify my_robot.urdf log.csv --out identified.urdf --plot residuals.png",
        "mbocp identify identified.urdf loaded.csv --payload tool0",
    ),
    "keys": ("mbocp keys horizon", "mbocp keys jerk"),
    "schema": ("mbocp schema -o mbocp.schema.json",),
    "doctor": ("mbocp doctor",),
}


def examples(command: str) -> str:
    """The end of the help of one of mbocp's own commands: a line for each example."""
    return epilog(EXAMPLES[command])


def epilog(examples: tuple[str, ...]) -> str:
    """The end of a command's help: a line for each example."""
    lines = "\n".join(f"  {line}" for line in examples)
    return f"\b\nExamples:\n{lines}"  # \b: click leaves the lines as they are
