"""`mbocp robots` and `spheres`: what robots there are, what one has, and spheres that stand for its links."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from mbocp.cli import signals
from mbocp.cli.app import Dynamics, FreeFlyer, Json, Locks, PackageDirs, Robot, option
from mbocp.cli.console import count, output, plain_table
from mbocp.cli.robot_options import ROOT, RobotOptions
from mbocp.cli.solve import PAGES, check_output
from mbocp.exceptions import UnsupportedRobot

if TYPE_CHECKING:
    from mbocp.robot import RobotEntry

_FACTS = ("link", "origin", "centers", "radii", "sticks_out", "uncovered", "gap")


def robots(
    name: Annotated[str | None, typer.Argument(help="Robot to describe, by name or path.")] = None,
    package_dir: PackageDirs = None,
    free_flyer: FreeFlyer = None,
    dynamics: Dynamics = None,
    lock: Locks = None,
    as_json: Json = False,
) -> None:
    """List the robots there are, or say what one has."""
    from mbocp.robot import describe, list_robots

    if name is None:
        entries = list_robots()
        facts: Any = [asdict(entry) for entry in entries]
    else:
        options = RobotOptions(package_dir, free_flyer, dynamics, lock)
        facts = describe(options.load_as_it_can_move(name)[1])
    if as_json:
        typer.echo(json.dumps(facts, indent=2))
    elif name is None:
        _print_list(entries)
    else:
        _print_robot(facts)


def _print_list(entries: Sequence[RobotEntry]) -> None:
    console = output()
    for source, group in groupby(entries, key=lambda entry: entry.source):
        table = plain_table(show_header=False)
        for entry in group:
            table.add_row(entry.name, entry.description)
        console.print(f"from {source}:", style="bold")
        console.print(table)
    console.print("`mbocp robots NAME` says what a robot has; the path of its file is good for a name.")


def _print_robot(facts: Mapping[str, Any]) -> None:
    from mbocp.cli.solution_summary import print_rows

    print_rows(facts["name"], _facts(facts))
    console = output()
    for title, table in (
        ("joints", _joints(facts)),
        ("controls", _actuators(facts)),
        ("constraints and forces", _elements(facts)),
    ):
        if table.row_count:
            console.print(f"\n{title}", style="bold")
            console.print(table)


def _facts(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What a robot is and has, those rows that say something."""
    from mbocp.cli.solution_summary import inertia_words, payload_words

    rows = [row for constraint in facts["constraints"] for row in constraint["rows"]]
    redundant = [row for constraint in facts["constraints"] for row in constraint["redundant_rows"]]
    of_them = f" (of {len(rows)} rows)" if redundant else ""
    sizes = [f"nq = {facts['nq']}, nv = {facts['nv']}", count(facts["nu"], "control")]
    sizes += [f"{count(facts['nc'], 'constraint')}{of_them}"] if rows else []
    drives = {}
    if rows or facts["passive"]:
        names = {kind: ", ".join(facts[kind]) or "none" for kind in ("actuated", "passive")}
        drives = {"mobility": _mobility(facts), **names}
    words = {
        "what": facts["description"],
        facts["format"] or "file": facts["source"] or "none",
        "size": ", ".join(sizes),
        **drives,
        "redundant": f"{', '.join(redundant)}: left out, the other rows imply them" if redundant else "",
        "mass": f"{facts['mass']:.4g} kg",
        "inertias": inertia_words(facts["inertias"]),
        "carries": payload_words(facts["payloads"]),
        "gravity": f"{_numbers(facts['gravity'])} m/s^2",
        "q0": _numbers(facts["q0"]),
        "trace": ", ".join(facts["trace_frames"]) or "none",
        "frames": ", ".join(facts["frames"]),
    }
    always = ("frames", "size")
    return [(name, text) for name, text in words.items() if text or name in always]


def _mobility(facts: Mapping[str, Any]) -> str:
    free, controls = facts["mobility"], facts["nu"]
    if controls == 0:
        how = f"; nothing drives {'them' if free > 1 else 'it'}: {_what_drives(facts)}"
    elif controls < free:
        how = f", with {count(controls, 'control')}: underactuated"
    elif controls > free:
        how = f", with {count(controls, 'control')}: more than needed"
    else:
        how = ", each with a control" if free > 1 else ", with a control"
    return f"{count(free, 'degree')} of freedom{how}"


def _what_drives(facts: Mapping[str, Any]) -> str:
    """What to write for a robot without controls."""
    if any(joint["name"] == ROOT for joint in facts["joints"]):
        return f'robot.actuated = ["{ROOT}"] pushes the base, rotors are [[actuator]] of a robot.toml'
    return "name joints that have motors in robot.actuated"


def _joints(facts: Mapping[str, Any]) -> Table:
    losses = [key for key in ("damping", "friction") if any(joint[key] for joint in facts["joints"])]
    table = plain_table("name", "type", "driven", "from", "to", "speed", "unit", *losses)
    for joint in facts["joints"]:
        has_limits = joint["nq"] == 1
        table.add_row(
            joint["name"],
            joint["type"],
            "prescribed" if joint["driven"] else "yes" if joint["actuated"] else "no",
            *(_limit(joint[side][0]) if has_limits else "" for side in ("lower", "upper")),
            _limit(joint["velocity"][0]) if joint["nv"] == 1 else "",
            ", ".join(filter(None, dict.fromkeys(joint["units"]))) or ("rad" if joint["nv"] else ""),
            *(f"{joint[key]:.4g}" if joint[key] else "" for key in losses),
        )
    return table


def _actuators(facts: Mapping[str, Any]) -> Table:
    table = plain_table("name", "limit", "unit")
    for actuator in facts["actuators"]:
        sides = [actuator[side] for side in ("least", "limit") if side in actuator]
        table.add_row(actuator["name"], " to ".join(map(_limit, sides)), actuator["unit"])
    return table


def _elements(facts: Mapping[str, Any]) -> Table:
    table = plain_table("name", "type", "between", "numbers")
    for element in [*facts["constraints"], *facts["forces"], *facts["elastic"]]:
        keys = ("length", "ratio", "offset", "stiffness", "damping", "motor_inertia", "coefficient")
        numbers = [f"{key} {element[key]:g}" for key in keys if key in element]
        if len(element.get("rows", ())) > 1:
            kept = len(element["rows"]) - len(element["redundant_rows"])
            numbers.append(f"{kept} of {len(element['rows'])} rows")
        ends = element.get("frames") or element["joints"]
        table.add_row(element["name"], element["type"], " - ".join(ends), ", ".join(numbers))
    return table


def _limit(value: float | None) -> str:
    return "none" if value is None else f"{value:.4g}"


def _numbers(values: list[float]) -> str:
    return "[" + ", ".join(f"{value:.4g}" for value in values) + "]"


def spheres(
    name: Robot,
    replay: Annotated[
        Path | None, option("--replay", "FILE.html", "Write a page with the spheres over the robot.")
    ] = None,
    package_dir: PackageDirs = None,
    free_flyer: FreeFlyer = None,
    dynamics: Dynamics = None,
    lock: Locks = None,
    as_json: Json = False,
) -> None:
    """Show the spheres that stand for links where a robot may collide."""
    if replay is not None:
        check_output(replay, "--replay", PAGES)
    signals.leave_in_order()
    _, robot = RobotOptions(package_dir, free_flyer, dynamics, lock).load_as_it_can_move(name)
    found = robot.collision_spheres
    if not found:
        raise UnsupportedRobot(
            f"robot {robot.name!r}: has no collision geometry: its file has none, and its "
            "robot.toml no [[collision_sphere]]"
        )
    if replay is not None:
        from mbocp.view.replay import write_replay

        title = f"Spheres of {robot.name}"
        write_replay(robot, [0.0], [robot.q0], replay, trace=(), spheres=found, title=title)
    if as_json:
        from mbocp._arrays import plain_json

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
