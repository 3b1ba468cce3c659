"""`[goal]` and `[goal.excite]`: their keys, from what is written to goals, and back."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from mbocp._arrays import Array, BoolArray, frozen_array
from mbocp._keys import Key, Table, checks_of
from mbocp.exceptions import ProblemError, locate
from mbocp.integrators import SCHEMES
from mbocp.mechanisms.completion import assemble_velocity, close_loops
from mbocp.problem._checks import MAX_POSITION, check_positive, check_size, choice, whole
from mbocp.problem.excite import FRICTIONS, Excite
from mbocp.problem.file.frame_table import FrameGoalTable, frames_from, write_frame
from mbocp.problem.file.named_values import (
    configuration_from,
    control_from,
    end_control_from,
    end_control_table,
    joint_values,
    rate_from,
    with_motors_at_rest,
)
from mbocp.problem.file.periodic_table import periodic_from, periodic_table
from mbocp.problem.file.value_kinds import SEVERAL, PeriodicWords, Rate, RateOrFree
from mbocp.problem.goals.ends import without_driven_velocities
from mbocp.problem.goals.goal import ENFORCE, RATES, REDUNDANT, Goal, of_member
from mbocp.problem.problem_data import ProblemData
from mbocp.robot import Robot
from mbocp.terms.written import Control, ControlOrFree, VectorOrNamed


class ExciteTable(Table):
    """Which torques are measured, how well, and how long one looks for the motion."""

    torque_noise: Annotated[Control, Key("standard deviations of measured torques", "N m, N")] = 0.05
    friction: Annotated[str, choice(FRICTIONS), Key("what is unknown beside masses and inertias")] = "both"
    knots: Annotated[int, whole(1), Key("free control points of each joint's spline")] = 15
    starts: Annotated[int, whole(1), Key("random splines that are improved")] = 5
    rounds: Annotated[int, whole(1), Key("how often at most")] = 60
    seed: Annotated[int, whole(0), Key("of the random splines", takes="whole number")] = 0


_CHECKS = checks_of(ExciteTable)


def read_excite(goal_table: GoalTable, robot: Robot) -> Excite | None:
    """Make what a motion is to tell of its table.

    Raises
    ------
    MbocpError
        If a value does not fit the robot, or cannot be right.
    """
    table = goal_table.excite
    if table is None:
        return None
    if goal_table.any:
        raise ProblemError("goal.excite: an exciting motion has one goal; choose one of goal.any")
    key = "goal.excite.torque_noise"
    noise = control_from(robot, table.torque_noise, key)
    for size in noise:
        check_positive(key, float(size), "N m, N")
    checked = {name: check(f"goal.excite.{name}", getattr(table, name)) for name, check in _CHECKS.items()}
    return Excite(torque_noise=frozen_array(noise), **checked)


def write_excite(excite: Excite | None) -> dict[str, Any]:
    """The key of the goal that reads back as the same."""
    return {} if excite is None else {"excite": asdict(excite)}


class GoalMemberTable(Table):
    """State at t = T, one of several."""

    q: Annotated[VectorOrNamed, Key("configuration at the end", "m, rad", "nothing")] = None
    v: Annotated[
        Rate,
        Key(
            "velocity or momentum at the end",
            "m/s, rad/s; kg m/s, N m s",
            "nothing",
            "vector, or 0 for rest, also of a joint or part",
            ("p",),
        ),
    ] = None
    p: Rate = None
    a: Annotated[
        RateOrFree,
        Key(
            "acceleration at the end",
            "m/s^2, rad/s^2",
            "0 of joints that stop and have limited jerk, else nothing",
        ),
    ] = None
    u: Annotated[
        ControlOrFree,
        Key(
            "controls after it, for limits of their rates",
            "N, N m",
            "what holds the robot at rest, else free",
        ),
    ] = None
    frame: Annotated[
        list[FrameGoalTable],
        SEVERAL,
        Key("[pose of a frame](#goals-of-frames), or parts of it", "", "nothing"),
    ] = Field(default_factory=list)
    assemble: Annotated[bool, Key("the same for the goal")] = False
    periodic: Annotated[
        PeriodicWords, Key("the end is the start, [moved by a symmetry](#periodic-motion)", "m, rad", "no")
    ] = None
    enforce: Annotated[
        str | None,
        choice(ENFORCE),
        Key(
            '`"none"`: the goal is only what tracking tracks',
            "",
            '`"exact"` if the goal says anything, else `"none"`',
        ),
    ] = None
    guard: Annotated[
        bool, Key("[explicit schemes](#explicit-schemes): keep the end less than a right angle from the goal")
    ] = True
    redundant: Annotated[
        str,
        choice(REDUNDANT),
        Key("[explicit schemes](#explicit-schemes): end conditions that hold by themselves"),
    ] = "drop"


class GoalTable(GoalMemberTable):
    """State at t = T; beside several that are given, what is common to them."""

    any: Annotated[
        list[GoalMemberTable],
        Key("[several goals](#several-goals), of which the best is taken", "", "one goal"),
    ] = Field(default_factory=list)
    excite: Annotated[
        ExciteTable | None,
        Key("instead of the cost: a [motion that tells most](identification.md#exciting-motions)", "", "no"),
    ] = None


def read_goals(goal_table: GoalTable, robot: Robot, said_q_start: Array) -> tuple[Goal, tuple[Goal, ...]]:
    """The goal, and all of them where there are several."""
    goals = _goals(goal_table, robot, said_q_start)
    return (goals[0] if goals else _goal(goal_table, robot, said_q_start)), goals


def _goals(table: GoalTable, robot: Robot, q_start: Array) -> tuple[Goal, ...]:
    """Several goals, each with what is common to all where it says nothing itself."""
    common = {key: getattr(table, key) for key in table.model_fields_set - {"any", "excite"}}
    goals = []
    for place, member in enumerate(table.any):
        given = member.model_fields_set
        own = given | (set(RATES) if given & set(RATES) else set())
        inherited = {key: value for key, value in common.items() if key not in own}
        with of_member(place):
            goals.append(_goal(member.model_copy(update=inherited), robot, q_start))
    return tuple(goals)


def _goal(table: GoalMemberTable, robot: Robot, q_start: Array) -> Goal:
    q, q_active = _configuration(table, robot, q_start)
    rate, value, rate_active = _rate(table, robot, q)
    if rate_active.all() and not value.any():
        q_active = with_motors_at_rest(robot, q_active)
    is_free = table.a == "free"
    a, a_active = _nothing(robot) if table.a is None or is_free else rate_from(robot, table.a, "goal.a")
    says = a_active.any() or table.frame or table.periodic or not (table.q is table.v is table.p is None)
    enforce: Any = table.enforce  # checked by the class, as is redundant
    if enforce is None:
        enforce = "exact" if says else "none"
    goal = Goal(
        q=q,
        a=a,
        a_active=a_active,
        a_rule="free" if is_free else "given",
        u=end_control_from(robot, table.u, "goal.u"),
        q_active=q_active,
        rate=rate,
        value=value,
        rate_active=rate_active,
        frames=frames_from(table.frame),
        periodic=periodic_from(robot, table.periodic),
        enforce=enforce,
        guard=table.guard,
        redundant=table.redundant,  # type: ignore[arg-type]
    )
    return without_driven_velocities(robot, goal)


def _nothing(robot: Robot) -> tuple[Array, BoolArray]:
    return np.zeros(robot.nv), np.zeros(robot.nv, dtype=np.bool_)


def _configuration(table: GoalMemberTable, robot: Robot, q_start: Array) -> tuple[Array, BoolArray]:
    if table.q is None:
        return np.array(q_start), np.zeros(robot.nv, dtype=np.bool_)
    with locate("goal.q"):
        q, active = configuration_from(robot, table.q, q_start, "goal.q")
        q = np.array(robot.normalise(q, name="goal.q"))
        check_size("goal.q", q, robot.q_labels, MAX_POSITION)
        if table.assemble:
            q = close_loops(robot, q, active, assemble=True, base=q_start, key="goal.q")
    return q, active


def _rate(table: GoalMemberTable, robot: Robot, q: Array) -> tuple[Literal["v", "p"], Array, BoolArray]:
    """Velocity or momentum, and which components of it are written."""
    if table.p is None and table.v is not None:
        v, active = rate_from(robot, table.v, "goal.v")
        if table.assemble and active.all():
            v = assemble_velocity(robot, q, v, active, assemble=True)
        return "v", v, active
    if table.v is not None:
        raise ProblemError("goal: give v or p, not both")
    return "p", *(_nothing(robot) if table.p is None else rate_from(robot, table.p, "goal.p"))


def write_goal(problem: ProblemData) -> dict[str, Any]:
    """Return the table that reads back as the same."""
    if problem.goals:
        return {"any": [_goal_table(goal, problem.robot, problem.scheme) for goal in problem.goals]}
    return _goal_table(problem.goal, problem.robot, problem.scheme) | write_excite(problem.excite)


def _goal_table(goal: Goal, robot: Robot, scheme: str) -> dict[str, Any]:
    table: dict[str, Any] = {"enforce": goal.enforce}
    options = {"guard": goal.guard, "redundant": goal.redundant}
    table |= {key: value for key, value in options.items() if SCHEMES[scheme].takes(f"goal.{key}")}
    for key, value, active in (("q", goal.q, goal.q_active), (goal.rate, goal.value, goal.rate_active)):
        if active.any():
            table[key] = _write(robot, value, active)
    if goal.a_rule == "free":
        table["a"] = "free"
    elif goal.a_active.any() and goal.a_rule == "given":
        table["a"] = _write(robot, goal.a, goal.a_active)
    if (u := end_control_table(goal.u)) is not None:
        table["u"] = u
    if goal.periodic is not None:
        table["periodic"] = periodic_table(goal.periodic)
    if goal.frames:
        table["frame"] = [write_frame(frame) for frame in goal.frames]
    return table


def _write(robot: Robot, value: Array, active: BoolArray) -> Any:
    return value if active.all() else joint_values(robot, value, active)
