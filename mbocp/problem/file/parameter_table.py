"""`[[parameter]]`: its keys, from what is written to parameters, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Annotated, Any

from mbocp._keys import Key, Table
from mbocp._measured import plain_number
from mbocp._text import find_repeated, show
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem.found_parameter import Parameter, ParameterCost
from mbocp.robot import Robot
from mbocp.robot.named_numbers import OF_ROBOT, number_of, take, with_numbers
from mbocp.terms.written import Finite


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
