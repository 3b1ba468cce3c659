"""`[robust]`: its keys, from what is written to standard deviations, and back."""

from __future__ import annotations

from statistics import NormalDist
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from mbocp._arrays import Array
from mbocp._keys import Key, Table
from mbocp._measured import plain_number
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem._checks import check_choice, check_non_negative, check_positive, choice, positive
from mbocp.problem.file.messages import locate
from mbocp.problem.file.named_values import control_from, weights_from
from mbocp.problem.uncertainty import FEEDBACKS, Robust
from mbocp.robot import Robot
from mbocp.robot.named_numbers import OF_ROBOT, named_numbers
from mbocp.terms.written import Control, Finite, VectorOrNumber

_SIGMAS = 2.0
_SOMETHING = "a number above 0 in start, disturbance or parameters"


class SpreadTable(Table):
    """Of the state at t = 0."""

    q: Annotated[Control, Key("moves along the tangent of q, by joint", "m, rad")] = 0.0
    v: Annotated[Control, Key("velocities, by joint", "m/s, rad/s")] = 0.0


class DisturbanceTable(Table):
    """Of white noise: its mean over a time t has a standard deviation of so much by sqrt(t)."""

    tau: Annotated[Control, Key("controls, by name", "N sqrt(s), N m sqrt(s)")] = 0.0


class RobustTable(Table):
    """What is uncertain, as standard deviations, and how far limits keep off."""

    start: Annotated[SpreadTable, Key("of the state at t = 0", default="known")] = (
        SpreadTable.model_construct()
    )
    disturbance: Annotated[DisturbanceTable, Key("of white noise along the motion", default="none")] = (
        DisturbanceTable.model_construct()
    )
    parameters: Annotated[
        dict[str, VectorOrNumber],
        Key(
            "of numbers of the robot, by the words of [sensitivities](sensitivities.md)",
            "those of the number",
            "none",
            takes="table of numbers or lists",
        ),
    ] = Field(default_factory=dict)
    sigmas: Annotated[
        Finite | None, positive(), Key("standard deviations that limits keep off", default="2")
    ] = None
    confidence: Annotated[
        Finite | None,
        Key(
            "instead of `sigmas`: probability that a limit holds at a node", takes="number between 0.5 and 1"
        ),
    ] = None
    feedback: Annotated[str, choice(FEEDBACKS), Key("what answers to deviations")] = FEEDBACKS[0]


def read_robust(robot: Robot, robust_table: RobustTable | None) -> Robust | None:
    """Make what is uncertain of a table `[robust]`.

    Raises
    ------
    MbocpError
        If a value does not fit the robot, or cannot be right.
    """
    table = robust_table
    if table is None:
        return None
    found = Robust(
        q=_sizes("robust.start.q", weights_from, robot, table.start.q),
        v=_sizes("robust.start.v", weights_from, robot, table.start.v),
        tau=_sizes("robust.disturbance.tau", control_from, robot, table.disturbance.tau),
        parameters={word: _of_parameter(robot, word, sizes) for word, sizes in table.parameters.items()},
        sigmas=_sigmas(table),
        feedback=check_choice("robust.feedback", table.feedback, FEEDBACKS),
    )
    if not any(sizes.any() for sizes in (found.q, found.v, found.tau, *found.parameters.values())):
        raise InvalidValue("robust", "nothing uncertain", _SOMETHING)
    return found


def write_robust(robust: Robust | None) -> dict[str, Any] | None:
    """The table that reads back as the same."""
    if robust is None:
        return None
    return {
        "start": {"q": robust.q, "v": robust.v},
        "disturbance": {"tau": robust.tau},
        "parameters": dict(robust.parameters),
        "sigmas": robust.sigmas,
        "feedback": robust.feedback,
    }


def _sizes(key: str, read: Any, robot: Robot, written: Any) -> Array:
    with locate(key):
        sizes: Array = read(robot, written, key)
    check_non_negative(key, sizes)
    return sizes


def _of_parameter(robot: Robot, word: str, written: Any) -> Array:
    key, name = f"robust.parameters.{word}", word.removeprefix(OF_ROBOT)
    numbers = named_numbers(robot).items()
    unit = next((one.unit for known, one in numbers if known == name or known.startswith(f"{name}.")), "")
    each = written if isinstance(written, list) else [written]
    sizes = np.array([plain_number(size, unit, key) for size in each], dtype=np.float64)
    check_non_negative(key, sizes)
    return sizes


def _sigmas(table: RobustTable) -> float:
    if table.confidence is None:
        return _SIGMAS if table.sigmas is None else check_positive("robust.sigmas", table.sigmas)
    if table.sigmas is not None:
        raise ProblemError("robust: sigmas and confidence say the same; give one of them")
    if not 0.5 < table.confidence < 1.0:
        raise InvalidValue("robust.confidence", table.confidence, "a number between 0.5 and 1")
    return NormalDist().inv_cdf(table.confidence)
