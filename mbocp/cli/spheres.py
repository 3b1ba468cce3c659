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
from mbocp.robot import LinkSpheres


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
        typer.echo(json.dumps(plain_json([_facts(link) for link in found]), indent=2))
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
    if replay is not None:
        console.print(f"replay: {replay}")


def _facts(link: LinkSpheres) -> dict[str, object]:
    return {
        "link": link.link,
        "origin": link.origin,
        "centers": link.centers,
        "radii": link.radii,
        "sticks_out": link.sticks_out,
        "uncovered": link.uncovered,
        "gap": link.gap,
    }


def _length(value: float) -> str:
    return "" if math.isnan(value) else f"{1e3 * value:.3g} mm"
