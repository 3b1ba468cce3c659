"""The scheme of a problem that names none: what measurement says is best for its kind.

For one accuracy of the motion, in the time of a solver (`docs/problem_files.md`, "The scheme that suits"):

- controls that prescribe velocities, and rotation matrices, are for explicit schemes alone;
- frames with equations at all nodes alternate under schemes that move by mean velocities: `se1`;
- natural coordinates, constraints that begin or end along the way, and bounds of their forces are for the tau
  family alone, of which `midpoint` is of order two;
- small closed loops: `lobatto3`, whose steps may be twice as long; larger ones: `midpoint`;
- floating bases and ball joints: `midpoint`. Their masses are the same in all poses, so that stages win
  little;
- arms: `gauss2`, of order four; chains of very many joints: `midpoint`, for functions of two stages are three
  times as large as those of one, and take as much longer to compile.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from mbocp.problem.contact_bounds import ContactBounds
from mbocp.problem.contact_force import ContactForce
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.goals.goal import Goal
from mbocp.problem.integration import Scheme, has_rotations
from mbocp.problem.path import PathConstraint
from mbocp.problem.timeline.named_phase import NamedPhase
from mbocp.problem.warn import has_equations_throughout
from mbocp.robot import Robot

__all__ = ["AUTO_SCHEME", "ChosenScheme", "Undecided", "chosen_scheme"]

AUTO_SCHEME = "auto"
_SMALL_LOOP = 6  # velocities, beyond which the stages of a closed loop take longer than they win
_LONG_CHAIN = 24  # velocities, with which the functions of two stages have 350,000 operations


@dataclass(frozen=True)
class ChosenScheme:
    """What suits a problem.

    Attributes
    ----------
    scheme : Scheme
    reason : str
        Why, as a phrase that follows "for".
    """

    scheme: Scheme
    reason: str


class Undecided(Protocol):
    """What of a problem decides, see `mbocp.problem.Problem`."""

    # fmt: off
    @property
    def robot(self) -> Robot: ...  # noqa: D102
    @property
    def coordinates(self) -> str: ...  # noqa: D102
    @property
    def controls(self) -> str: ...  # noqa: D102
    @property
    def goal(self) -> Goal: ...  # noqa: D102
    @property
    def path(self) -> Sequence[object]: ...  # noqa: D102
    @property
    def phase(self) -> Sequence[NamedPhase]: ...  # noqa: D102
    @property
    def holds(self) -> Sequence[object]: ...  # noqa: D102
    @property
    def releases(self) -> Sequence[object]: ...  # noqa: D102
    @property
    def impacts(self) -> Sequence[int]: ...  # noqa: D102
    @property
    def num_steps(self) -> int: ...  # noqa: D102
    @property
    def dt(self) -> float: ...  # noqa: D102
    # fmt: on


def chosen_scheme(problem: Undecided) -> ChosenScheme:
    """Scheme that suits a problem, and why."""
    robot = problem.robot
    if robot.drives:
        return ChosenScheme("rk4", "controls that prescribe velocities")
    if robot.rotations == "dcm" and has_rotations(robot):
        return ChosenScheme("rk4", "rotation matrices")
    if COORDINATES[problem.coordinates].needs_constraints:
        return ChosenScheme("midpoint", f"{problem.coordinates} coordinates")
    if _has_switches(problem):
        return ChosenScheme("midpoint", "constraints that begin or end along the way")
    if _has_forces(problem):
        return ChosenScheme("midpoint", "bounds of contact forces")
    if problem.controls != "constant":
        return ChosenScheme("lobatto3" if robot.nc else "gauss2", "controls that vary within steps")
    if _alternates(problem):
        return ChosenScheme("se1", "equations on frames at all nodes")
    if robot.nc and robot.nv <= _SMALL_LOOP:
        return ChosenScheme("lobatto3", "small closed loops")
    if robot.nc:
        return ChosenScheme("midpoint", "closed loops of many joints")
    if has_rotations(robot):
        return ChosenScheme("midpoint", "a floating base or ball joints")
    if robot.nv > _LONG_CHAIN:
        return ChosenScheme("midpoint", "a chain of many joints")
    return ChosenScheme("gauss2", "an open chain of joints")


def _has_forces(problem: Undecided) -> bool:
    return any(isinstance(one, ContactForce | ContactBounds) for one in problem.path)


def _has_switches(problem: Undecided) -> bool:
    of_phases = any(phase.holds or phase.releases for phase in problem.phase)
    return of_phases or bool(problem.holds or problem.releases or problem.impacts)


def _alternates(problem: Undecided) -> bool:
    """Whether equations at all nodes and a velocity at the end are too much for mean velocities."""
    goal, ends = problem.goal, (problem.num_steps, problem.dt)
    frames = [one for one in problem.path if isinstance(one, PathConstraint)]
    asks = goal.is_exact and bool(goal.rate_active.any())
    return asks and any(has_equations_throughout(one, *ends) for one in frames)
