"""Words for the rows of a programme, for messages."""

from __future__ import annotations

from collections.abc import Callable

from mbocp.formulation.bounds import state_bounds
from mbocp.formulation.goal import EndRows
from mbocp.formulation.layout import StateLayout
from mbocp.integrators import EXPLICIT_SCHEMES
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import NaturalSpace
from mbocp.problem import Problem
from mbocp.robot import Label

__all__ = ["row_describer"]


def row_describer(
    problem: Problem, space: ConfigurationSpace | NaturalSpace, at: StateLayout, rows: EndRows
) -> Callable[[int, int], str]:
    """(stage, row) -> words, see `StagewiseProgramme.describe_row`."""
    robot, dt, duration = problem.robot, problem.dt, problem.duration
    is_explicit, of_end = problem.scheme in EXPLICIT_SCHEMES, rows.words(robot)
    speeds = robot.speed_labels if is_explicit else robot.v_labels
    balance = "rate" if is_explicit else "momentum balance"
    positions, constraints = robot.v_labels, robot.constraint_labels
    if isinstance(space, NaturalSpace):
        natural = space.mechanics
        positions = speeds = natural.coordinate_labels
        constraints = natural.constraint_labels
    limits = _limits(problem, space, at, speeds)
    nc = 0 if is_explicit else len(constraints)

    def describe(stage: int, row: int) -> str:
        if stage < 0:
            if row >= len(of_end):
                return f"guard of the end condition at t = {duration:g} s"
            return f"end condition {row + 1} ({of_end[row]}) at t = {duration:g} s"
        when = f"in the step to t = {(stage + 1) * dt:g} s"
        if row >= at.ndx + nc:
            return f"{limits[row - at.ndx - nc]} {when}"
        if row < at.nw:
            name = positions[row].name if at.nw == at.nv else f"coordinate {row + 1}"
            return f"kinematics of {name} {when}"
        if row < at.nw + at.ns:
            return f"{balance} of {speeds[row - at.nw].name} {when}"
        if row < at.ndx:
            return f"remembered control {robot.u_labels[row - at.nw - at.ns].name} {when}"
        return f"constraint {constraints[row - at.ndx].name} {when}"

    return describe


def _limits(
    problem: Problem, space: ConfigurationSpace | NaturalSpace, at: StateLayout, speeds: tuple[Label, ...]
) -> list[str]:
    """What the limits of a stage are, in their order."""
    bounds, robot = state_bounds(problem, space, at), problem.robot
    names = {at.s.start + i: f"velocity limit of {speeds[i].name}" for i in range(at.ns)}
    for part in space.parts if isinstance(space, ConfigurationSpace) else ():
        for i in range(min(part.at_q.stop - part.at_q.start, part.at_z.stop - part.at_z.start)):
            label = robot.q_labels[part.at_q.start + i]
            names[part.at_z.start + i] = f"position limit of {label.name}"
    path = [f"path constraint {label.name!r}" for constraint in problem.path for label in constraint.labels]
    of_controls = [f"limit of control {robot.u_labels[i].name}" for i in bounds.limited_u]
    return [*(names[i] for i in bounds.limited_x), *of_controls, *path]
