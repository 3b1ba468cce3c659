"""`mbocp spheres`: the spheres that stand for a robot's links where it may collide."""

from __future__ import annotations

import json
import math
from pathlib import Path

import typer

from mbocp._arrays import plain_json
from mbocp.cli.console import output, plain_table
from mbocp.cli.robot_options import RobotOptions
from mbocp.cli.solve import PAGES, check_output
from mbocp.exceptions import UnsupportedRobot

_FACTS = ("link", "origin", "centers", "radii", "sticks_out", "uncovered", "gap")


def print_spheres(name: str, replay: Path | None, options: RobotOptions, *, as_json: bool) -> None:
    """Print a row for each link, and draw the spheres if a page is asked for.

    Raises
    ------
    UnsupportedRobot
        If the robot has neither collision geometry nor given spheres.
    """
    if replay is not None:
        check_output(replay, "--replay", PAGES)
    robot = options.load(name)
    found = robot.collision_spheres
    if not found:
        raise UnsupportedRobot(
            f"robot {robot.name!r}: has no collision geometry: its URDF has no <collision>, and its "
            "robot.toml no [[collision_sphere]]"
        )
    if replay is not None:
        from mbocp.view.replay import write_replay

        title = f"Spheres of {robot.name}"
        write_replay(robot, [0.0], [robot.q0], replay, trace=(), spheres=found, title=title)
    if as_json:
        facts = [{name: getattr(link, name) for name in _FACTS} for link in found]
        typer.echo(json.dumps(plain_json(facts), indent=2))
        return
    columns = ("link", "spheres", "from", "largest radius", "sticks out", "not covered", "by")
    table = plain_table(*columns)
    for link in found:
        table.add_row(
            link.link,
            str(len(link.radii)),
            link.origin,
            _length(float(link.radii.max())),
            _length(link.sticks_out),
            "" if math.isnan(link.uncovered) else f"{100.0 * link.uncovered:.2g} %",
            _length(link.gap),
        )
    console = output()
    console.print(f"{robot.name}: {sum(len(link.radii) for link in found)} spheres", style="bold underline")
    console.print(table)
    for link in found:
        if link.words:
            console.print(link.words)
    if replay is not None:
        console.print(f"replay: {replay}")


def _length(value: float) -> str:
    return "" if math.isnan(value) else f"{1e3 * value:.3g} mm"
