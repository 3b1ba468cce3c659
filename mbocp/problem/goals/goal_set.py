"""Several goals of which the best is taken: `[[goal.any]]`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

import numpy as np

from mbocp._warn import warn_caller
from mbocp.exceptions import MbocpError, ProblemError, UnreachableGoal
from mbocp.problem._checks import ProblemWarning
from mbocp.problem.goals.goal import Goal

P = TypeVar("P")


@contextmanager
def of_member(place: int) -> Iterator[None]:
    """Name the member in every error from the block that names the goal."""
    try:
        yield
    except MbocpError as error:
        error.args = (_name(place, str(error)),)
        raise


def check_goals(goals: Sequence[Goal]) -> None:
    """Refuse members that ask for nothing, and penalties that do not weigh the same of all."""
    for place, goal in enumerate(goals):
        if goal.enforce == "none":
            raise ProblemError(
                f"goal.any.{place}: asks for nothing, so that it would be the best; give q, v, p or frame"
            )
    if any(goal.is_penalised for goal in goals):
        first = goals[0]
        for place, goal in enumerate(goals):
            masks = ((goal.q_active, first.q_active), (goal.rate_active, first.rate_active))
            if goal.rate != first.rate or not all(np.array_equal(*pair) for pair in masks):
                raise ProblemError(
                    f"goal.any.{place}: gives other components of q, v or p than goal.any.0, and "
                    "cost.terminal weighs the same of all; give the same ones, or say enforce = "
                    '"exact"'
                )


def reachable_members(goals: Sequence[Goal], resolve: Callable[[Goal], P]) -> tuple[tuple[int, P], ...]:
    """Place and problem of each goal that is not out of reach; the others are left out with a warning.

    Parameters
    ----------
    goals : sequence of Goal
    resolve : callable
        Makes the problem of one of them.

    Raises
    ------
    UnreachableGoal
        If all are out of reach.
    """
    check_goals(goals)
    found: list[tuple[int, P]] = []
    refused: list[UnreachableGoal] = []
    told: dict[str, type[Warning]] = {}
    for place, goal in enumerate(goals):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                with of_member(place):
                    found.append((place, resolve(goal)))
            except UnreachableGoal as error:
                if not str(error).startswith("goal"):
                    raise  # a via point
                refused.append(error)
                told[f"{error}; this goal is left out"] = ProblemWarning
        told |= {_name(place, str(entry.message)): entry.category for entry in caught}
    if not found:
        raise UnreachableGoal(
            f"goal.any: all {len(goals)} goals are out of reach; {'; '.join(map(str, refused))}"
        ) from refused[0]
    for message, category in told.items():
        warn_caller(message, category)
    return tuple(found)


def _name(place: int, message: str) -> str:
    return message.replace("goal", f"goal.any.{place}", 1) if message.startswith("goal") else message
