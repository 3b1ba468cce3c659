"""The scheme of a problem that names none: what measurement says is best for its kind.

For one accuracy of the motion, in the time of a solver (`docs/problem_files.md`, "The scheme that suits"):

- controls that prescribe velocities, and rotation matrices, are for explicit schemes alone;
- frames with equations at all nodes alternate under schemes that move by mean velocities: `se1`;
- natural coordinates, constraints that begin or end along the way, and bounds of their forces are for the tau
  family alone, of which `midpoint` is of order two; of legs that step, velocities of feet that stand
  alternate under it, and a trot of solo12 takes 285 iterations in place of 25: `se1`;
- small closed loops: `lobatto3`, whose steps may be twice as long; larger ones: `midpoint`;
- floating bases and ball joints: `midpoint`. Their masses are the same in all poses, so that stages win
  little;
- arms: `gauss2`, of order four; chains of very many joints: `midpoint`, for functions of two stages are three
  times as large as those of one, and take as much longer to compile.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mbocp.problem.contact_bounds import ContactBounds
from mbocp.problem.contact_force import ContactForce
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.goals.goal import Goal
from mbocp.problem.integration import has_rotations
from mbocp.problem.path import PathConstraint
from mbocp.problem.warn import has_equations_throughout
from mbocp.robot import Robot

AUTO_SCHEME = "auto"
_SMALL_LOOP = 6  # velocities, beyond which the stages of a closed loop take longer than they win
_LONG_CHAIN = 24  # velocities, with which the functions of two stages have 350,000 operations


@dataclass(frozen=True)
class ChosenScheme:
    """What suits a problem.

    Attributes
    ----------
    scheme : str
    reason : str
        Why, as a phrase that follows "for".
    """

    scheme: str
    reason: str


def choose_scheme(
    robot: Robot,
    coordinates: str,
    controls: str,
    goal: Goal,
    path: Sequence[object],
    *,
    has_switches: bool,
    ends: tuple[int, float],
) -> ChosenScheme:
    """Choose the scheme that suits a problem, and say why.

    Parameters
    ----------
    robot, coordinates, controls, goal, path
        As in `mbocp.problem.Problem`.
    has_switches : bool
        Whether constraints begin or end along the way.
    ends : tuple of int and float
        Number of steps, and their length [s].
    """
    turns = has_rotations(robot)
    has_forces = any(isinstance(one, ContactForce | ContactBounds) for one in path)
    suits = (  # the first that holds
        (bool(robot.drives), "rk4", "controls that prescribe velocities"),
        (robot.rotations == "dcm" and turns, "rk4", "rotation matrices"),
        (COORDINATES[coordinates].needs_constraints, "midpoint", f"{coordinates} coordinates"),
        (has_switches and has_forces and turns, "se1", "contacts that begin or end along the way"),
        (has_switches, "midpoint", "constraints that begin or end along the way"),
        (has_forces, "midpoint", "bounds of contact forces"),
        (controls != "constant", "lobatto3" if robot.nc else "gauss2", "controls that vary within steps"),
        (_alternates(goal, path, ends), "se1", "equations on frames at all nodes"),
        (robot.nc > 0 and robot.nv <= _SMALL_LOOP, "lobatto3", "small closed loops"),
        (robot.nc > 0, "midpoint", "closed loops of many joints"),
        (turns, "midpoint", "a floating base or ball joints"),
        (robot.nv > _LONG_CHAIN, "midpoint", "a chain of many joints"),
        (True, "gauss2", "an open chain of joints"),
    )
    return next(ChosenScheme(scheme, reason) for holds, scheme, reason in suits if holds)


def _alternates(goal: Goal, path: Sequence[object], ends: tuple[int, float]) -> bool:
    """Whether equations at all nodes and a velocity at the end are too much for mean velocities."""
    frames = [one for one in path if isinstance(one, PathConstraint)]
    asks = goal.is_exact and bool(goal.rate_active.any())
    return asks and any(has_equations_throughout(one, *ends) for one in frames)
