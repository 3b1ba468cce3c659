"""`mbocp check`: what a problem file asks for, without solving it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from mbocp.cli.app import Json, ProblemFile, Quiet, Settings, output_file
from mbocp.cli.clearance_words import clearance_lines
from mbocp.cli.error_report import tell
from mbocp.cli.solve import PAGES, check_output
from mbocp.exceptions import MbocpError

if TYPE_CHECKING:
    from mbocp._arrays import Array, BoolArray
    from mbocp.problem import Problem
    from mbocp.robot import Robot

_MAX_ENTRIES = 12
_Rows = list[tuple[str, str | Text]]


def check(
    file: ProblemFile,
    settings: Settings = None,
    output: Annotated[Path | None, output_file("PAGE.html", "Write a page: start, goal, obstacles.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Say what a problem file asks for, and what is odd about it.

    Its robot is looked at, too; nothing is solved.
    """
    if output is not None:
        check_output(output, "-o", PAGES)
    from mbocp.cli.solution_summary import print_rows
    from mbocp.problem import load_problem

    if as_json:
        raise typer.Exit(_print_findings(file, settings or (), output))
    problem = load_problem(file, settings or ())
    rows = _rows(problem)
    if output is not None:
        from mbocp.view.preview import write_preview

        rows.append(("page", str(write_preview(problem, output))))
    if not quiet:
        print_rows(problem.name, rows)


def _print_findings(file: Path, settings: Sequence[str], page: Path | None) -> int:
    from mbocp.cli.findings import Findings
    from mbocp.problem import load_problem
    from mbocp.problem.reasons.causes import causes_of
    from mbocp.robot.robot_facts import find_oddities

    found, status = Findings(file, settings), 0
    try:
        with found.record_warnings():
            problem = load_problem(file, settings)
    except MbocpError as error:
        found.add_error(error)
        status = tell(error)
    else:
        found.add_causes(causes_of(problem))
        found.add_oddities(find_oddities(problem.robot, problem.q_start))
        if page is not None:
            from mbocp.view.preview import write_preview

            write_preview(problem, page)
    typer.echo(json.dumps(found.to_dict(status), indent=2))
    return status


def _rows(problem: Problem) -> _Rows:
    from mbocp.cli.solution_summary import cause_rows, count_impacts, inertia_words, robot_words
    from mbocp.problem.reasons.causes import causes_of
    from mbocp.robot.robot_facts import describe, find_oddities

    robot = problem.robot
    rows: _Rows = [
        ("robot", robot_words(robot.name, robot.nv, robot.nu, robot.nc)),
        ("horizon", _horizon(problem, count_impacts(len(problem.timeline.impacts)))),
        ("start", _configuration(robot, problem.q_start)),
        *_goal(problem),
        *_limits(problem),
        *_others(problem),
        ("cost", _cost(problem)),
        ("solver", f"{problem.solver.method}, {problem.num_end_conditions} end conditions"),
    ]
    rows += cause_rows(causes_of(problem))
    if words := inertia_words(describe(robot)["inertias"]):
        rows.append(("inertias", words))
    odd = find_oddities(robot, problem.q_start)
    return [*rows, *(("file", Text(words, style="yellow")) for words in odd)]


def _horizon(problem: Problem, impacts: str) -> str:
    T = f"{problem.duration:g} s"
    if problem.duration_range is not None:
        T = f"between {problem.duration_range[0]:g} and {problem.duration_range[1]:g} s"
    how = {"linear": ", controls linear", "stages": ", controls at its stages"}.get(problem.controls, "")
    why = f", chosen for {problem.scheme_reason}" if problem.chooses_scheme else ""
    steps = f"{problem.timeline.num_timed_steps} steps{impacts}"
    return f"{T} in {steps} by scheme {problem.scheme}{why}{how}"


def _configuration(robot: Robot, q: Array, shown: BoolArray | None = None) -> str:
    """Joints by name, all or those shown, as many as fit."""
    words = []
    for name in robot.joint_names:
        q_place, v_place = robot.configuration_indices(name), robot.velocity_indices(name)
        if v_place.stop == v_place.start or (shown is not None and not shown[v_place].all()):
            continue
        numbers = [round(x, 9) + 0.0 for x in q[q_place].tolist()]  # what is left of a search is round-off
        if len(numbers) == 2:
            numbers = [math.atan2(numbers[1], numbers[0])]
        value = f"{numbers[0]:.4g}" if len(numbers) == 1 else f"[{', '.join(f'{x:.4g}' for x in numbers)}]"
        words.append(f"{name} {value}")
    more = f" and {len(words) - _MAX_ENTRIES} more" if len(words) > _MAX_ENTRIES else ""
    return ", ".join(words[:_MAX_ENTRIES]) + more


def _goal(problem: Problem) -> Iterator[tuple[str, str | Text]]:
    """Where and how the motion is to end."""
    for k, (_, member) in enumerate(problem.members):
        goal, robot = member.goal, member.robot
        parts = []
        if goal.q_active.any():
            parts.append(
                _configuration(robot, goal.q, goal.q_active) or f"{int(goal.q_active.sum())} directions"
            )
        parts += [f"frame {frame.name}" for frame in goal.frames]
        if goal.periodic is not None:
            parts.append("the start, moved by a symmetry")
        if goal.rate_active.any():
            count = int(goal.rate_active.sum())
            rest = "at rest" if not goal.value[goal.rate_active].any() else f"{goal.rate} given"
            parts.append(rest if count == robot.nv else f"{rest} in {count} of {robot.nv} directions")
        if words := words_of_rest(member):
            parts.append(words)
        yield ("goal" if k == 0 else "or goal", f"{'; '.join(parts) or 'free'} ({goal.enforce})")
        if goal.frames:
            yield ("found at", _configuration(robot, goal.q))


def _limits(problem: Problem) -> _Rows:
    from mbocp.problem.limits import LIMITS

    words = []
    for letter, key in LIMITS.items():
        count = int(problem.widest_limits.finite(letter).sum())
        if count:
            words.append(f"{key.removeprefix('limits.')} of {count}")
    return [("limits", ", ".join(words) or "none; effort, velocity, position = true enforce the robot's own")]


def _others(problem: Problem) -> _Rows:
    words = {
        "via points": ", ".join(point.name for point in problem.timeline.waypoints) if problem.via else "",
        "paths": ", ".join(f"{c.name} ({c.kind})" for c in problem.frame_constraints),
        "obstacles": ", ".join(f"{o.name} ({o.shape})" for o in problem.obstacle),
        "kept apart": "\n".join(clearance_lines(problem.clearance)),
        "phases": ", ".join(phase.name for phase in problem.phase),
        "to find": "\n".join(
            f"{one.name} between {one.lower:g} and {one.upper:g} {one.unit}" for one in problem.parameter
        ),
    }
    return [(name, said) for name, said in words.items() if said]


def _cost(problem: Problem) -> str:
    import numpy as np

    cost = problem.cost
    words = ["effort" if np.any(cost.effort) else ""]
    others = ("velocity", "tracking", "terminal", "time", "energy")
    words += [key for key in others if np.any(cost.weight(key))]
    return ", ".join(word for word in words if word) or "none"


def words_of_rest(problem: Problem) -> str:
    """What a goal of rest says of accelerations where jerks are limited; "" where there is nothing to say."""
    from mbocp.problem.goals.end_conditions import stops_at_end

    robot, goal = problem.robot, problem.goal
    if goal.a_rule == "rest":
        return "a = 0 since jerk is limited"
    stops = stops_at_end(robot, goal, problem.limits_of_ends[1], problem.free_at_end(goal.q))
    if goal.a_active.any() or not stops.any():
        return ""
    if goal.a_rule == "free":
        return "acceleration free"
    if robot.drives:
        return "acceleration free, since controls prescribe velocities"
    return f"acceleration free: {robot.nu} control{'s' * (robot.nu != 1)} cannot set it"
