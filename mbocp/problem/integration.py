"""Discretisation of time: the options of each scheme, and the robots that it can integrate."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal, TypeAlias

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.integrators import CONTROLS, LIE_METHODS, SCHEMES, schemes_that
from mbocp.problem._checks import check_choice, check_integer, check_number
from mbocp.problem.cost import Cost
from mbocp.problem.limits import Bounds
from mbocp.robot import Robot
from mbocp.robot.joints import unit_groups

Lie: TypeAlias = Literal["plain", "baumgarte", "munthe_kaas"]


@dataclass(frozen=True, kw_only=True)
class Stabilisation:
    r"""Rates at which explicit schemes pull the state back to where it belongs [1/s].

    Attributes
    ----------
    gamma_quaternion : float
        :math:`\gamma_q` of eq. (46) of [Manara2017]_, for the norm of quaternions; with
        ``lie = "baumgarte"``.
    gamma_dcm : float
        :math:`\gamma_R` of eq. (47), for the orthonormality of rotation matrices; with
        ``lie = "baumgarte"``.
    gamma_constraint : float
        Baumgarte's rate for holonomic constraints. Zero: accelerations that agree with the constraints, and
        nothing that pulls back.
    """

    gamma_quaternion: float = 2.0
    gamma_dcm: float = 1.0
    gamma_constraint: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            key = f"integrator.{field.name}"
            value = check_number(key, getattr(self, field.name))
            if value < 0.0:
                raise InvalidValue(key, value, "a rate >= 0 [1/s]")
            object.__setattr__(self, field.name, value)


def check_integrator(
    robot: Robot, scheme: str, lie: str, substeps: int, stabilisation: Stabilisation, *, suits: str = ""
) -> None:
    """Refuse options that the scheme does not use, and robots that it cannot integrate.

    Parameters
    ----------
    suits : str
        What the scheme was chosen for; "" if the problem says it.
    """
    check_choice("integrator.scheme", scheme, SCHEMES)
    check_choice("integrator.lie", lie, LIE_METHODS)
    check_integer("integrator.substeps", substeps, minimum=1)
    check_unused("integrator.lie", lie, "munthe_kaas", scheme, suits=suits)
    check_unused("integrator.substeps", substeps, 1, scheme, suits=suits)
    for field in fields(Stabilisation):
        key, value = f"integrator.{field.name}", getattr(stabilisation, field.name)
        check_unused(key, value, field.default, scheme, suits=suits)
    if robot.drives and not SCHEMES[scheme].takes_drives:
        raise ProblemError(
            f'integrator.scheme: got "{scheme}", but controls of robot {robot.name!r} prescribe velocities '
            f"({', '.join(drive.name for drive in robot.drives)}), which only explicit schemes "
            f"({schemes_that(lambda data: data.takes_drives)}) can do"
        )
    if robot.nc and not SCHEMES[scheme].takes_loops:
        raise ProblemError(
            f'integrator.scheme: got "{scheme}", whose stages lie between nodes, but {robot.name!r} has '
            f"holonomic constraints ({robot.constraint_labels[0].name}, ...), which hold at the nodes; "
            f"take one of {schemes_that(lambda data: data.takes_loops)}"
        )
    if robot.rotations == "dcm" and not SCHEMES[scheme].takes_matrices and has_rotations(robot):
        raise ProblemError(
            f'robot.rotations: got "dcm", but scheme "{scheme}" keeps rotations as quaternions; choose an '
            f'explicit scheme ({schemes_that(lambda data: data.takes_matrices)}), or rotations = "quaternion"'
        )


def check_controls(controls: str, scheme: str) -> None:
    """Refuse controls that the scheme cannot take.

    Raises
    ------
    InvalidValue, ProblemError
    """
    check_choice("horizon.controls", controls, CONTROLS)
    if controls not in SCHEMES[scheme].controls:
        raise ProblemError(
            f'horizon.controls: got "{controls}", but scheme "{scheme}" takes one control for each step; '
            f"choose integrator.scheme among {schemes_that(lambda data: controls in data.controls)}, or "
            'controls = "constant"'
        )


def check_control_terms(controls: str, cost: Cost, limits: Bounds, along: tuple[Array, Array]) -> None:
    """Refuse rates of controls that leap, and limits that have no control in common where they change.

    Parameters
    ----------
    along : tuple of ndarray, shapes (N, nu) or (1, nu)
        Limits of the controls in the steps.

    Raises
    ------
    ProblemError
    """
    if controls == "stages" and (np.any(cost.control_rate) or limits.finite("du").any()):
        key = "cost.control_rate" if np.any(cost.control_rate) else "limits.effort_rate"
        raise ProblemError(
            f'{key}: with horizon.controls = "stages" controls leap from step to step, and have no '
            'rate; take controls = "linear", whose rate is that within each step'
        )
    lower, upper = along
    if controls == "linear" and (np.maximum(lower[1:], lower[:-1]) > np.minimum(upper[1:], upper[:-1])).any():
        raise ProblemError(
            "limits.effort: those of two phases one after the other have no control in common, and "
            'horizon.controls = "linear" are continuous; take controls = "stages"'
        )


def check_unused(key: str, value: object, default: object, scheme: str, *, suits: str = "") -> None:
    """Refuse a value that the scheme would pass over in silence; `suits` as in `check_integrator`."""
    if not SCHEMES[scheme].takes(key) and value != default:
        got = f'"{value}"' if isinstance(value, str) else str(value).lower()
        chosen = f' ("auto" chose it for {suits})' if suits else ""
        raise ProblemError(
            f'{key}: got {got}, which scheme "{scheme}" does not use{chosen}; leave it out, or choose an '
            f"explicit scheme ({schemes_that(lambda data: data.takes(key))})"
            f"{' as integrator.scheme' * bool(suits)}"
        )


def has_rotations(robot: Robot) -> bool:
    """Whether a joint of the robot turns in three dimensions: a free-flyer, a ball joint."""
    return any(group.stop - group.start == 4 for _, group in unit_groups(robot.model))
