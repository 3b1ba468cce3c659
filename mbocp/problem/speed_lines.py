"""Limits that fall with a speed, as rows that are linear in that speed and a control or an acceleration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.path import PathConstraint
from mbocp.robot import Robot
from mbocp.terms.kinds import PATH_TERMS, MotorTorque
from mbocp.terms.over_speed import OverSpeed, place_of

if TYPE_CHECKING:
    from mbocp.problem.problem import Problem


@dataclass(frozen=True, eq=False)
class SpeedLines:
    """Rows c u + k v, or a + k v, of a path constraint.

    Attributes
    ----------
    path : PathConstraint
    control : int or None
        Place of u among the controls; None: they are about the acceleration.
    dof : int
        Place of v among the velocities.
    gain : float
        c: torque of the motor for a control of 1.
    slopes : ndarray, shape (rows,)
        k.
    """

    path: PathConstraint
    control: int | None
    dof: int
    gain: float
    slopes: Array

    @classmethod
    def of(cls, path: PathConstraint, robot: Robot) -> SpeedLines | None:
        """Those of a constraint; None where torques of its joint are not those of one control alone."""
        dof, kind = place_of(path.frame, robot), kind_of(path)
        if not issubclass(kind, MotorTorque):
            return cls(path, None, dof, 1.0, kind.slopes(path))
        pushes = robot.actuation.selection[dof]
        (controls,) = np.nonzero(pushes)
        is_found = any(motor.dof == dof for motor in robot.found_gears)
        if len(controls) != 1 or robot.actuation.frame_actuators or is_found:
            return None
        gear = next((motor.gear_ratio for motor in robot.motors if motor.dof == dof), 1.0)
        return cls(path, int(controls[0]), dof, float(pushes[controls[0]]) / gear, kind.slopes(path) * gear)


def over_speed(problem: Problem) -> tuple[PathConstraint, ...]:
    """Path constraints whose limits fall with a speed."""
    return tuple(path for path in problem.frame_constraints if issubclass(PATH_TERMS[path.kind], OverSpeed))


def kind_of(path: PathConstraint) -> type[OverSpeed]:
    """The class of such a constraint."""
    kind = PATH_TERMS[path.kind]
    assert issubclass(kind, OverSpeed)
    return kind


def speed_lines(problem: Problem) -> tuple[SpeedLines, ...]:
    """Rows of these that can hold within steps, too."""
    if problem.robot.drives or not COORDINATES[problem.coordinates].has_joint_states:
        return ()
    found = (SpeedLines.of(path, problem.robot) for path in over_speed(problem))
    return tuple(lines for lines in found if lines is not None)


def find_steps_held(path: PathConstraint, problem: Problem) -> BoolArray:
    """At both ends of which steps a constraint holds, shape (N,)."""
    at_nodes = np.append(path.span.has_start, path.span.nodes(problem.num_steps, problem.dt))
    return at_nodes[:-1] & at_nodes[1:]
