"""Discretisation of time: options and robots of each scheme, and the scheme of a problem that names none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Literal, TypeAlias

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.integrators import CONTROLS, LIE_METHODS, SCHEMES, schemes_that
from mbocp.integrators.schemes import PROJECTED
from mbocp.problem._checks import check_choice, check_integer, check_number
from mbocp.problem.contact_bounds import ContactBounds, forces_of_costs
from mbocp.problem.contact_force import ContactForce
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.goals.goal import Goal
from mbocp.problem.limits import Bounds
from mbocp.problem.path import PathConstraint
from mbocp.problem.timeline.hold import Hold, Release
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.phase_values import is_weighed
from mbocp.problem.warn import has_equations_throughout
from mbocp.problem.weights import Cost
from mbocp.robot import Robot, kinematics
from mbocp.terms.own import OwnTerm

Lie: TypeAlias = Literal["plain", "baumgarte", "munthe_kaas"]
FREE_SCHEME = "se1"  # of contacts that are found
AUTO_SCHEME = "auto"
SMALL_LOOP = 6  # velocities, beyond which the stages of a closed loop take longer than they win
_STIFF = 20.0  # times in a step that a velocity falls to 1/e: midpoint leaves 0.8 of it, with the other sign
_LARGE = 50  # velocities, beyond which stages of "radau2" have too many operations
_LONG_CHAIN = 24  # velocities, with which the functions of two stages have 350,000 operations


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
    robot: Robot,
    scheme: str,
    scheme_reason: str,
    lie: str,
    substeps: int,
    stabilisation: Stabilisation,
    controls: str,
) -> None:
    """Refuse options that the scheme does not use, and robots that it cannot integrate.

    Parameters
    ----------
    scheme_reason : str
        What the scheme was chosen for; "" if the problem says it.
    """
    check_choice("integrator.scheme", scheme, SCHEMES)
    check_choice("integrator.lie", lie, LIE_METHODS)
    check_integer("integrator.substeps", substeps, minimum=1)
    check_unused("integrator.lie", lie, "munthe_kaas", scheme, suits=scheme_reason)
    check_unused("integrator.substeps", substeps, 1, scheme, suits=scheme_reason)
    for field in fields(Stabilisation):
        key, value = f"integrator.{field.name}", getattr(stabilisation, field.name)
        check_unused(key, value, field.default, scheme, suits=scheme_reason)
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
    if not SCHEMES[scheme].has_forces and _lacks_masses(robot):
        raise ProblemError(
            f'integrator.scheme: got "{scheme}", which divides by masses, but links of {robot.name!r} in '
            f"closed loops have none; take one of {schemes_that(lambda data: data.has_forces)}"
        )
    if robot.rotations == "dcm" and not SCHEMES[scheme].takes_matrices and has_rotations(robot):
        raise ProblemError(
            f'robot.rotations: got "dcm", but scheme "{scheme}" keeps rotations as quaternions; choose an '
            f'explicit scheme ({schemes_that(lambda data: data.takes_matrices)}), or rotations = "quaternion"'
        )
    _check_controls(controls, scheme)


def _lacks_masses(robot: Robot) -> bool:
    """Whether only closed loops say how some links move, which have no mass."""
    free = list(robot.undriven)
    return bool(robot.nc) and kinematics.is_singular(robot.mass_matrix(robot.q0)[np.ix_(free, free)])


def _check_controls(controls: str, scheme: str) -> None:
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
    """Refuse a value that the scheme would pass over in silence; `suits` as `scheme_reason` there."""
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
    return any(group.stop - group.start == 4 for _, group in robot.unit_groups)


def choose_scheme(
    said_scheme: str,
    robot: Robot,
    coordinates: str,
    controls: str,
    said_goal: Goal,
    said_path: Sequence[object],
    said_cost: Cost,
    said_terms: tuple[OwnTerm, ...],
    said_phase: tuple[Phase, ...],
    said_holds: tuple[Hold, ...],
    said_releases: tuple[Release, ...],
    said_steps_of_impacts: tuple[int, ...],
    free_feet: tuple[Hold, ...],
    num_steps: int,
    duration: float,
) -> tuple[str, bool, str]:
    """Return the scheme, whether it is chosen since none is said, and for what kind of problem.

    For one accuracy of the motion, in the time of a solver (docs/problem_files.md, "The scheme that suits"):

    - contacts that are found: `se1`, under which velocities leap within a step, and settle;
    - controls that prescribe velocities, and rotation matrices, are for explicit schemes alone;
    - frames with equations at all nodes alternate under schemes that move by mean velocities: `se1`;
    - natural coordinates are for the tau family alone, of which `midpoint` is of order two;
    - constraints that begin or end along the way, and bounds of forces of constraints, too. Across these,
      velocities alternate under `midpoint`, and `se1` errs by a fifth of the way: `projected_midpoint`;
    - closed loops of links without masses, by which others divide: `midpoint`;
    - small closed loops: `lobatto3`, whose steps may be twice as long; larger ones, and those whose forces
      have a cost, which asks for one of each in a step: `projected_midpoint`;
    - joints whose damping is stiff beside a step: `radau2`, or `se1` for large robots, under which velocities
      settle within it. Under others they ring, and Newton's matrix is singular to round-off;
    - floating bases and ball joints: `midpoint`. Their masses are the same in all poses, so that stages win
      little;
    - arms: `gauss2`, of order four; chains of very many joints: `midpoint`, for functions of two stages are
      three times as large as those of one, and take as much longer to compile.
    """
    check_choice("coordinates", coordinates, COORDINATES)
    if said_scheme != AUTO_SCHEME:
        return said_scheme, False, ""
    of_phases = any(phase.holds or phase.releases for phase in said_phase)
    has_switches = of_phases or bool(said_holds or said_releases or said_steps_of_impacts)
    ends = num_steps, duration / (num_steps - len(said_steps_of_impacts))
    turns = has_rotations(robot)
    stiff, times = stiffest_joint(robot, ends[1])
    stiff_scheme = "se1" if robot.nv > _LARGE and controls == "constant" else "radau2"
    has_forces = any(isinstance(one, ContactForce | ContactBounds) for one in said_path)
    has_weight = is_weighed("constraint_force", said_cost, said_phase)
    has_cost = has_weight or bool(forces_of_costs(said_terms, robot))
    suits = (  # the first that holds
        (bool(free_feet), FREE_SCHEME, "contacts that are found"),
        (bool(robot.drives), "rk4", "controls that prescribe velocities"),
        (robot.rotations == "dcm" and turns, "rk4", "rotation matrices"),
        (COORDINATES[coordinates].needs_constraints, "midpoint", f"{coordinates} coordinates"),
        (has_switches, PROJECTED, "constraints that begin or end along the way"),
        (has_forces, PROJECTED, "bounds of contact forces"),
        (not robot.nc and times > _STIFF, stiff_scheme, f"the damping of {stiff}, stiff beside a step"),
        (_lacks_masses(robot), "midpoint", "links without masses in closed loops"),
        (controls != "constant", "lobatto3" if robot.nc else "gauss2", "controls that vary within steps"),
        (_alternates(said_goal, said_path, ends), "se1", "equations on frames at all nodes"),
        (has_cost, PROJECTED, "costs of contact forces"),
        (robot.nc > 0 and robot.nv <= SMALL_LOOP, "lobatto3", "small closed loops"),
        (robot.nc > 0, PROJECTED, "closed loops of many joints"),
        (turns, "midpoint", "a floating base or ball joints"),
        (robot.nv > _LONG_CHAIN, "midpoint", "a chain of many joints"),
        (True, "gauss2", "an open chain of joints"),
    )
    return next((scheme, True, reason) for holds, scheme, reason in suits if holds)


def stiffest_joint(robot: Robot, dt: float) -> tuple[str, float]:
    """Return the joint that damping slows fastest, and how many times in a step it falls to 1/e."""
    name, rate = robot.fastest_damping
    return name, rate * dt


def _alternates(goal: Goal, path: Sequence[object], ends: tuple[int, float]) -> bool:
    """Whether equations at all nodes and a velocity at the end are too much for mean velocities."""
    frames = [one for one in path if isinstance(one, PathConstraint)]
    asks = goal.is_exact and bool(goal.rate_active.any())
    return asks and any(has_equations_throughout(one, *ends) for one in frames)
