"""Via points as people write them: `[[via]]`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from mbocp._arrays import Array
from mbocp._keys import Key, Table
from mbocp.exceptions import ProblemError
from mbocp.problem.file.frame_table import FrameGoalTable, frames_from, write_frame
from mbocp.problem.file.messages import locate
from mbocp.problem.file.named_values import configuration_from, joint_values, tangent_from
from mbocp.problem.file.value_kinds import SEVERAL, Rate, ViaTime
from mbocp.problem.goals.goal import Goal
from mbocp.problem.timeline.times import time_from, write_time
from mbocp.problem.timeline.via import ViaPoint
from mbocp.robot import Robot
from mbocp.terms.written import Finite, VectorOrNamed


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


def via_from(robot: Robot, tables: Sequence[ViaTable], q_start: Array) -> tuple[ViaPoint, ...]:
    """Make the via points from the tables of `[[via]]`.

    Raises
    ------
    ProblemError, UnknownFrame, InvalidValue
        If a frame or joint is unknown, or a value cannot be right.
    """
    return tuple(_point(robot, table, i, q_start) for i, table in enumerate(tables))


def _point(robot: Robot, table: ViaTable, index: int, q_start: Array) -> ViaPoint:
    key = f"via.{index}"
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
