"""`[start]`: its keys, from what is written to a state, and back."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from mbocp._arrays import Array
from mbocp._keys import Key, Table
from mbocp.exceptions import ProblemError
from mbocp.mechanisms.completion import assembled_velocity, close_loops
from mbocp.problem._checks import MAX_POSITION, check_size
from mbocp.problem.file.frame_table import FramePoseTable, frames_from
from mbocp.problem.file.messages import locate
from mbocp.problem.file.named_values import (
    configuration_from,
    end_control_from,
    end_control_table,
    rate_from,
)
from mbocp.problem.file.periodic_table import free_from, free_table
from mbocp.problem.file.value_kinds import SEVERAL, Free, Rate
from mbocp.problem.found_parameter import Parameter, start_of_loops
from mbocp.problem.goals.end_control import EndControl
from mbocp.problem.goals.frames import start_at
from mbocp.problem.goals.free_start import FreeStart
from mbocp.problem.problem_data import ProblemData
from mbocp.robot import Robot
from mbocp.terms.written import ControlOrFree, VectorOrNamed


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
    return q, assembled_velocity(robot, q, v, active, assemble=table.assemble)


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
