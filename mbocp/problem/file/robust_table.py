"""The tables `[[parameter]]` and `[robust]`: what is found with the motion, and what is uncertain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from statistics import NormalDist
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from mbocp._arrays import Array
from mbocp._keys import Key, Table
from mbocp._measured import plain_number
from mbocp._text import find_repeated, show
from mbocp.exceptions import InvalidValue, ProblemError, locate
from mbocp.problem._checks import check_choice, check_non_negative, check_positive, choice, positive
from mbocp.problem.file.named_values import control_from, weights_from
from mbocp.problem.found_parameter import FEEDBACKS, Parameter, ParameterCost, Robust
from mbocp.robot import Robot
from mbocp.robot.named_numbers import OF_ROBOT, list_named_numbers, number_of, take, with_numbers
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
    numbers = list_named_numbers(robot).items()
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


class ParameterCostTable(Table):
    """What a parameter costs."""

    linear: Annotated[Finite, Key("weight on p")] = 0.0
    square: Annotated[Finite, Key("weight on (p - reference)^2")] = 0.0
    reference: Annotated[Finite, Key("of p", "those of the number")] = 0.0


class ParameterTable(Table):
    """A number of the robot that is found with the motion."""

    of: Annotated[str | list[str], Key("[which number](parameters.md); those of a list have one value")]
    min: Annotated[Finite, Key("least value", "those of the number")]
    max: Annotated[Finite, Key("greatest value", "those of the number")]
    start: Annotated[
        Finite | None, Key("where the search begins", "those of the number", "that of the robot")
    ] = None
    cost: Annotated[ParameterCostTable | None, Key("what it costs", "", "nothing")] = None


def parameters_from(parameter_table: Sequence[ParameterTable], robot_of_file: Robot) -> tuple[Parameter, ...]:
    """Make the parameters from their tables.

    Raises
    ------
    ProblemError, InvalidValue
        If the robot has no such number, it is named twice, or bounds cannot be.
    """
    found = tuple(_parameter(table, k, robot_of_file) for k, table in enumerate(parameter_table))
    if repeated := find_repeated(word for one in found for word in one.words):
        raise ProblemError(f"parameter: {OF_ROBOT}{repeated[0]} is named twice; one parameter says it")
    return found


def _parameter(table: ParameterTable, index: int, robot: Robot) -> Parameter:
    key = f"parameter.{index}"
    words = [table.of] if isinstance(table.of, str) else table.of
    if not words or not all(word.startswith(OF_ROBOT) for word in words):
        raise InvalidValue(f"{key}.of", show(table.of), 'a number of the robot, as "robot.payload.NAME.mass"')
    words = [word.removeprefix(OF_ROBOT) for word in words]
    with locate(f"{key}.of"):
        numbers = [take(robot, word) for word in words]
    unit, said = numbers[0].unit, table.model_fields_set & {"min", "max", "start"}
    plain = {name: plain_number(getattr(table, name), unit, f"{key}.{name}") for name in said}
    table = table.model_copy(update=plain)
    if not table.min < table.max:
        raise InvalidValue(f"{key}.max", table.max, f"a number above {key}.min, {table.min:g}")
    _check_bounds(key, table, robot, words)
    start = number_of(robot, words[0]) if table.start is None else table.start
    if not table.min <= start <= table.max:
        where = f"{key}.start" if table.start is not None else f"{key}.start, that of the robot"
        raise InvalidValue(where, f"{start:g}", f"{table.min:g} to {table.max:g}")
    cost = ParameterCost() if table.cost is None else ParameterCost(**dict(table.cost))
    reference = plain_number(cost.reference, unit, f"{key}.cost.reference")
    return Parameter(
        tuple(words), numbers[0].unit, table.min, table.max, start, replace(cost, reference=reference)
    )


def _check_bounds(key: str, table: ParameterTable, robot: Robot, words: Sequence[str]) -> None:
    """Refuse numbers of several units as one, and bounds at which there is no such robot."""
    numbers = {word: take(robot, word) for word in words}
    units = sorted({number.unit for number in numbers.values()})
    if len(units) > 1:
        raise InvalidValue(
            f"{key}.of", show(table.of), f"numbers of one unit; these are in {', '.join(units)}"
        )
    for word, number in numbers.items():
        if not number.moves:
            for bound in (table.min, table.max):
                with_numbers(robot, {word: bound})
        elif word.endswith(".length") and table.min <= 0.0:
            raise InvalidValue(f"{key}.min", f"{table.min:g}", "a length above 0 [m]")


def write_parameter(one: Parameter) -> dict[str, Any]:
    """Return the table that reads back as the same parameter."""
    return {
        "of": [OF_ROBOT + word for word in one.words],
        "min": one.lower,
        "max": one.upper,
        "start": one.start,
        "cost": asdict(one.cost),
    }
