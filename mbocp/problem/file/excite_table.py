"""`[goal.excite]`: its keys, from what is written to numbers, and back."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from mbocp._arrays import frozen_array
from mbocp._keys import Key, Table, checks_of
from mbocp.exceptions import ProblemError
from mbocp.problem._checks import check_positive, choice, whole
from mbocp.problem.excite import FRICTIONS, Excite
from mbocp.problem.file.named_values import control_from
from mbocp.robot import Robot
from mbocp.terms.written import Control


class ExciteTable(Table):
    """Which torques are measured, how well, and how long one looks for the motion."""

    torque_noise: Annotated[Control, Key("standard deviations of measured torques", "N m, N")] = 0.05
    friction: Annotated[str, choice(FRICTIONS), Key("what is unknown beside masses and inertias")] = "both"
    knots: Annotated[int, whole(1), Key("free control points of each joint's spline")] = 15
    starts: Annotated[int, whole(1), Key("random splines that are improved")] = 5
    rounds: Annotated[int, whole(1), Key("how often at most")] = 60
    seed: Annotated[int, whole(0), Key("of the random splines", takes="whole number")] = 0


_CHECKS = checks_of(ExciteTable)


def read_excite(table: ExciteTable | None, robot: Robot, *, has_several_goals: bool) -> Excite | None:
    """Make what a motion is to tell of its table.

    Raises
    ------
    MbocpError
        If a value does not fit the robot, or cannot be right.
    """
    if table is None:
        return None
    if has_several_goals:
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
