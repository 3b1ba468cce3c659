"""Via points: states, or poses of frames, that the motion goes through on its way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbocp._numbers import is_number
from mbocp._text import shown
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem.goals.goal import Goal
from mbocp.problem.timeline.via_time import FreeTime, InPhase


@dataclass(frozen=True, kw_only=True, eq=False)
class ViaPoint:
    """What holds at one node between the start and the end.

    Attributes
    ----------
    name : str
        What it is called in messages, results and plots.
    goal : Goal
        What is asked of joints and frames there, by the words of a goal: exact, and velocities, no momenta.
        Entries of `q` that are not active hold a configuration that is there.
    time : float, FreeTime or InPhase, optional
        When it holds [s]; or that the solver finds it, and between which bounds; or in which phase.
    share : float, optional
        In place of a time that is given: part of the horizon that is over by then, between 0 and 1. Beside
        one that is free: part of the steps that lead there.
    """

    name: str
    goal: Goal
    time: float | FreeTime | InPhase | None = None
    share: float | None = None

    def __post_init__(self) -> None:
        key = f"via {self.name!r}"
        goal = self.goal
        if goal.enforce != "exact" or goal.rate != "v":
            raise ProblemError(f"{key}: takes q, v and frame; no momentum, and no weight instead of it")
        if goal.a_active.any():
            raise ProblemError(f"{key}: a is for the goal; a via point takes q, v and frame")
        for frame in goal.frames:
            if frame.weight != 1.0:
                raise ProblemError(
                    f"{key}: weight of {frame.name!r}: is for goal.frame; a via point is no cost"
                )
        given = None if isinstance(self.time, (FreeTime, InPhase)) else self.time
        if isinstance(self.time, (FreeTime, InPhase)):
            self.time.check(key)
        if isinstance(self.time, InPhase) and self.share is not None:
            raise ProblemError(
                f"{key}: share is one of the horizon; give time = {{ phase = {self.time.name!r}, "
                "share = number }"
            )
        if given is not None and self.share is not None:
            raise ProblemError(f"{key}: give time or share, not both; a share is beside a time that is free")
        for name, value, largest in (("time", given, np.inf), ("share", self.share, 1.0)):
            if value is not None and not (is_number(value) and 0.0 < value < largest):
                what = (
                    "a time after the start [s]" if name == "time" else "a part of the horizon, 0 < share < 1"
                )
                raise InvalidValue(f"{key}: {name}", shown(value), what)

    @property
    def is_free(self) -> bool:
        """Whether its time is found with the motion."""
        return isinstance(self.time, FreeTime)
