"""The tables `[start]` and `[[via]]`: states where a motion begins, and on its way."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from mbocp._arrays import Array
from mbocp._keys import Key, Table
from mbocp.exceptions import ProblemError, locate
from mbocp.mechanisms.completion import assemble_velocity, close_loops
from mbocp.problem._checks import MAX_POSITION, check_size
from mbocp.problem.file.frame_table import FrameGoalTable, FramePoseTable, frames_from, write_frame
from mbocp.problem.file.named_values import (
    configuration_from,
    end_control_from,
    end_control_table,
    joint_values,
    rate_from,
    tangent_from,
)
from mbocp.problem.file.periodic_table import free_from, free_table
from mbocp.problem.file.value_kinds import SEVERAL, Free, Rate, ViaTime
from mbocp.problem.found_parameter import Parameter, start_of_loops
from mbocp.problem.goals.end_control import EndControl
from mbocp.problem.goals.frames import start_at
from mbocp.problem.goals.free_start import FreeStart
from mbocp.problem.goals.goal import Goal
from mbocp.problem.problem_data import ProblemData
from mbocp.problem.timeline.times import time_from, write_time
from mbocp.problem.timeline.via import ViaPoint
from mbocp.robot import Robot
from mbocp.terms.written import ControlOrFree, Finite, VectorOrNamed


class StartTable(Table):
    """State at t = 0."""

    q: Annotated[VectorOrNamed, Key("configuration at t = 0", "m, rad", "initial pose")] = None
    v: Annotated[
        Rate, Key("velocity or momentum at t = 0", "m/s, rad/s; kg m/s, N m s", "rest", beside=("p",))
    ] = None
    p: Rate = None
    a: Annotated[
        Rate,
        Key(
            "acceleration, for [limits of jerk](#accelerations-jerks-rates-and-powers)", "m/s^2, rad/s^2", "0"
        ),
    ] = None
    u: Annotated[
        ControlOrFree,
        Key(
            "controls before it, for [limits of their rates](#accelerations-jerks-rates-and-powers)",
            "N, N m",
            "what holds the robot at rest, else free",
        ),
    ] = None
    frame: Annotated[
        list[FramePoseTable],
        SEVERAL,
        Key("[pose of a frame](#start-at-a-pose), or parts of it", "", "nothing"),
    ] = Field(default_factory=list)
    assemble: Annotated[
        bool, Key("move what violates [constraints](#constraints) to the nearest that does not")
    ] = False
    free: Annotated[
        Free, Key("[what of the start is found](#free-start)", "m, rad, m/s, rad/s", "all is given")
    ] = None


def read_start(
    start_table: StartTable, robot: Robot, parameter: tuple[Parameter, ...]
) -> tuple[Array, Array, Array, EndControl, FreeStart | None]:
    """Return what is said of q, v, a, of the controls before, and of what is free."""
    q, v = _start_state(start_table, robot)
    has_a = start_table.a is not None
    a = rate_from(robot, start_table.a, "start.a")[0] if has_a else np.zeros(0)
    u = end_control_from(robot, start_table.u, "start.u")
    return q, v, a, u, free_from(robot, start_table.free) or start_of_loops(robot, parameter)


def _start_state(table: StartTable, robot: Robot) -> tuple[Array, Array]:
    q = _start_configuration(table, robot)
    if table.v is not None and table.p is not None:
        raise ProblemError("start: give v or p, not both")
    if table.p is not None:
        p, _ = rate_from(robot, table.p, "start.p")
        v = np.array(robot.velocity_from_momentum(q, p))
        return q, np.array(robot.assemble_velocity(q, v)) if table.assemble else v
    if table.v is None:
        return q, np.zeros(robot.nv)
    v, active = rate_from(robot, table.v, "start.v")
    return q, assemble_velocity(robot, q, v, active, assemble=table.assemble)


def _start_configuration(table: StartTable, robot: Robot) -> Array:
    q, written = np.array(robot.q0), np.zeros(robot.nv, dtype=np.bool_)
    if table.q is not None:
        with locate("start.q"):
            q, written = configuration_from(robot, table.q, robot.q0, "start.q")
            q = np.array(robot.normalise(q, name="start.q"))
            check_size("start.q", q, robot.q_labels, MAX_POSITION)
            if not table.frame:
                q = close_loops(robot, q, written, assemble=table.assemble, base=robot.q0, key="start.q")
    if table.frame:
        targets = [goal.target for goal in frames_from(table.frame, key="start.frame")]
        q = start_at(robot, targets, q, written)
    return np.array(robot.balanced(q, written)) if robot.elastic else q


def write_start(problem: ProblemData) -> dict[str, Any]:
    """Return the table that reads back as the same."""
    return {
        "q": problem.q_start,
        "v": problem.v_start,
        "a": problem.a_start if problem.a_start.any() else None,
        "u": end_control_table(problem.u_start),
        "free": free_table(problem.robot, problem.start_free),
    }


class ViaTable(Table):
    """What holds at one node between start and end."""

    name: Annotated[str | None, Key("its name", "", "its number")] = None
    time: Annotated[ViaTime, Key("when it holds, or [is passed](#free-times)", "s", "`via.share`")] = None
    share: Annotated[
        Finite | None,
        Key("in place of a time; of a free one of the steps", "part of the horizon", "`via.time`"),
    ] = None
    q: Annotated[
        VectorOrNamed,
        Key(
            "configuration and velocity there",
            "m, rad; m/s, rad/s",
            "free",
            "like `goal.q` and `goal.v`",
            ("v",),
        ),
    ] = None
    v: Rate = None
    frame: Annotated[
        list[FrameGoalTable], SEVERAL, Key("poses of frames there: keys of `goal.frame`", "", "nothing")
    ] = Field(default_factory=list)


def via_from(robot: Robot, tables: Iterable[tuple[str, ViaTable]], q_start: Array) -> tuple[ViaPoint, ...]:
    """Make the via points from keys and tables.

    Raises
    ------
    ProblemError, UnknownFrame, InvalidValue
        If a frame or joint is unknown, or a value cannot be right.
    """
    return tuple(_point(robot, table, i, key, q_start) for i, (key, table) in enumerate(tables))


def _point(robot: Robot, table: ViaTable, index: int, key: str, q_start: Array) -> ViaPoint:
    q, q_active = np.array(q_start), np.zeros(robot.nv, dtype=np.bool_)
    value, rate_active = np.zeros(robot.nv), np.zeros(robot.nv, dtype=np.bool_)
    if table.q is not None:
        with locate(f"{key}.q"):
            q, q_active = configuration_from(robot, table.q, q_start, f"{key}.q")
            q = robot.normalise(q, name=f"{key}.q")
    if isinstance(table.v, float):  # 0 for all
        rate_active = np.ones(robot.nv, dtype=np.bool_)
    elif table.v is not None:
        with locate(f"{key}.v"):
            value, rate_active = tangent_from(robot, table.v, f"{key}.v")
    with locate(key):
        if table.q is None and table.v is None and not table.frame:
            raise ProblemError("nothing holds there; give q, v or frame")
        goal = Goal(
            q=q,
            q_active=q_active,
            rate="v",
            value=value,
            rate_active=rate_active,
            frames=frames_from(table.frame, key=f"{key}.frame"),
        )
        return ViaPoint(
            name=table.name or str(index + 1), goal=goal, time=time_from(table.time, key), share=table.share
        )


def write_via(robot: Robot, point: ViaPoint) -> dict[str, Any]:
    """Return the table that reads back as the same via point."""
    goal = point.goal
    states = (("q", goal.q, goal.q_active), ("v", goal.value, goal.rate_active))
    return {
        "name": point.name,
        "time": write_time(point.time),
        "share": point.share,
        **{k: x if a.all() else joint_values(robot, x, a) for k, x, a in states if a.any()},
        **({"frame": [write_frame(frame) for frame in goal.frames]} if goal.frames else {}),
    }
