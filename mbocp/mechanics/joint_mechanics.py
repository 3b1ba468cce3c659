"""Joint coordinates: the robot tree's own, on the joints' Lie group, with holonomic constraints on top.

Configurations q live on the group of the joints, velocities v and all derivatives in its tangent space. The
equations are the paper's (1)-(3) with p = M(q) v; the inverse-dynamics form needs no inverse of M.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from typing import TypeVar

import casadi as ca
import numpy as np

from mbocp.lie import ConfigurationSpace
from mbocp.mechanics.forces import force_element_energy, force_element_force, resistance_torque
from mbocp.robot import Robot
from mbocp.symbolic import ModelNumber, model_functions
from mbocp.symbolic.matrices import call_with_matrices
from mbocp.symbolic.model_numbers import numbers_of_model

M = TypeVar("M", bound="JointMechanics")


def symbols_of(robot: Robot) -> ca.SX:
    """Symbols for the numbers of a robot that vary, shape (len(robot.varying),)."""
    return ca.SX.sym("numbers", len(robot.varying))


class JointMechanics:
    """Symbolic equations of motion of `robot` in joint coordinates.

    Every method takes and returns `casadi.SX`; vectors are columns.

    Parameters
    ----------
    robot : Robot
    rotations : {"quaternion", "dcm"}
        Coordinates of attitudes in q; with "quaternion" q is Pinocchio's configuration.
    numbers : casadi.SX, optional
        Values of `robot.varying`, as a rule symbols, see `symbols_of`. By default those of the robot are
        constants of the equations.

    Attributes
    ----------
    numbers : casadi.SX, shape (len(robot.varying),)
    symbols : casadi.SX
        Symbols that the numbers are made of; of shape (0, 1) where they are constants. Functions of
        expressions of this class need them among their inputs.
    found, fixed : casadi.SX
        Those of the symbols that links of a chain are differentiated in, which are found with the motion,
        and the others.
    nq, nv, ns, nu, nc : int
        Sizes of configuration, velocity, speeds, control and holonomic constraints.
    space : ConfigurationSpace
        The maps between configurations.
    is_vector_space : bool
        Whether a configuration is a plain vector, so that tangent and coordinate derivatives agree.
    """

    def __init__(self, robot: Robot, rotations: str = "quaternion", *, numbers: ca.SX | None = None) -> None:
        self.robot = robot
        self.space = ConfigurationSpace(robot.model, rotations)
        self.nq, self.nv, self.nu, self.nc = self.space.nz, robot.nv, robot.nu, robot.nc
        self.ns = self.nv
        self.is_vector_space = robot.is_vector_space
        of_model = numbers_of_model(robot.varying)
        self._at = [robot.varying.index(number) for number in of_model]
        given = () if numbers is None else of_model
        self._motors = robot.opened_motors if numbers is not None else ()
        self.functions = model_functions(robot.model_without_rotors if self._motors else robot.model, given)
        self._take(numbers)
        self._dcm = [part for part in self.space.parts if part.at_matrix >= 0]

    def with_numbers(self: M, numbers: ca.SX, found: ca.SX | None = None) -> M:
        """Return the same equations with other expressions for the numbers.

        Parameters
        ----------
        numbers : casadi.SX, shape (len(robot.varying),)
        found : casadi.SX, optional
            Symbols among those of `numbers` in which links are differentiated, see `found`.
        """
        other = copy(self)
        other._take(numbers, found)
        return other

    def _take(self, numbers: ca.SX | None, found: ca.SX | None = None) -> None:
        self.numbers = ca.SX(ca.DM(self.robot.varying_values)) if numbers is None else numbers
        self.found = ca.SX.zeros(0, 1) if found is None else found
        is_plain = numbers is not None and numbers.is_valid_input()
        symbols = ca.symvar(self.numbers)
        every = self.numbers if is_plain and symbols else ca.vertcat(ca.SX.zeros(0, 1), *symbols)
        own = {element.element_hash() for element in ca.vertsplit(self.found)}
        fixed = [symbol for symbol in symbols if symbol.element_hash() not in own]
        self.fixed = ca.vertcat(ca.SX.zeros(0, 1), *fixed) if own else every
        self.symbols = ca.vertcat(self.fixed, self.found) if own else every
        # The last argument of all functions.
        self._given = (self.numbers[self._at],) if self.functions.given else ()

    def velocity(self, q: ca.SX, s: ca.SX, u: ca.SX) -> ca.SX:
        """Velocity of a state's speeds: the speeds themselves, shape (nv,) [m/s, rad/s]."""
        return s

    def integrate(self, q: ca.SX, dv: ca.SX) -> ca.SX:
        """Configuration q moved along the tangent vector `dv`, shape (nq,)."""
        return self.space.integrate(q, dv)

    def difference(self, q0: ca.SX, q1: ca.SX) -> ca.SX:
        """Tangent vector at `q0` that leads to `q1`, shape (nv,)."""
        return self.space.difference(q0, q1)

    def end_difference(self, goal: ca.SX, q: ca.SX) -> ca.SX:
        """What an end condition holds at zero: the tangent vector from the goal, shape (nv,)."""
        return self.difference(goal, q)

    @property
    def joint_space(self) -> ConfigurationSpace:
        """What costs compare configurations of the joints in: the space of q itself."""
        return self.space

    def joint_coordinates(self, q: ca.SX) -> ca.SX:
        """Configuration of the joints: q itself."""
        return q

    def joint_velocity(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Velocities of the joints, v itself, shape (nv,) [rad/s, m/s]."""
        return v

    def joint_momentum(self, q: ca.SX, p: ca.SX) -> ca.SX:
        """Canonical momenta of the joints, p itself, shape (nv,)."""
        return p

    def joint_difference(self, goal: ca.SX, q: ca.SX, parts: Sequence[int] | None = None) -> ca.SX:
        """Tangent vector of the joints from `goal` to q, shape (nv,).

        Parameters
        ----------
        goal, q : casadi.SX
        parts : sequence of int, optional
            Which parts of the space are compared; the others get zeros.
        """
        return self.difference(goal, q) if parts is None else self.space.partial_difference(goal, q, parts)

    def tangent_map(self, q: ca.SX) -> ca.SX:
        """Derivative of q's coordinates along the tangent space, shape (nq, nv)."""
        if self.is_vector_space:
            return ca.SX.eye(self.nv)
        dv = ca.SX.sym("dv", self.nv)
        jacobian = ca.jacobian(self.integrate(q, dv), dv)
        return ca.Function("tangent_map", [q, dv], [jacobian])(q, ca.SX.zeros(self.nv))

    def derivative(self, function: Callable[[ca.SX], ca.SX], q: ca.SX) -> ca.SX:
        """Derivative of `function` along the tangent space of q, which may be any expression."""
        at = ca.SX.sym("q", self.nq)
        jacobian = ca.jacobian(function(at), at) @ self.tangent_map(at)
        return ca.Function("derivative", [at, self.symbols], [jacobian])(q, self.symbols)

    def momentum(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Canonical momentum p = M(q) v, shape (nv,) [kg m/s, N m s]."""
        return self.mass_matrix(q) @ v

    def mass_matrix(self, q: ca.SX) -> ca.SX:
        """Joint-space mass matrix M(q), shape (nv, nv)."""
        return self._call(self.functions.crba, q)[0] + ca.diag(self._rotors)

    def forward_dynamics(self, q: ca.SX, v: ca.SX, force: ca.SX) -> ca.SX:
        """Acceleration under a generalised force, without constraints, shape (nv,) [m/s^2, rad/s^2]."""
        if self._motors:
            rest = self.inverse_dynamics(q, v, ca.SX.zeros(self.nv))
            return ca.ldl_solve(force - rest, *ca.ldl(self.mass_matrix(q)))
        return self._call(self.functions.aba, q, v, force)[0]

    def inverse_mass_matrix(self, q: ca.SX) -> ca.SX:
        """M(q)^-1, shape (nv, nv)."""
        if self._motors:
            return ca.ldl_solve(ca.SX.eye(self.nv), *ca.ldl(self.mass_matrix(q)))
        return self._call(self.functions.minverse, q)[0]

    @property
    def _rotors(self) -> ca.SX:
        """What motors that have parameters add to the diagonal of M, shape (nv,)."""
        found = ca.SX(self.nv, 1)
        for motor in self._motors:
            J = self._of_model([ModelNumber("motor", self.robot.motors.index(motor), 1)])
            found[motor.dof] = self.gear_ratio(motor.dof) ** 2 * J
        return found

    def gear_ratio(self, dof: int) -> ca.SX:
        """Turns of the motor for one of a joint with this velocity; 1 without a gear."""
        motors = [k for k, motor in enumerate(self.robot.motors) if motor.dof == dof]
        return self._of_model([ModelNumber("motor", motors[0], 0)]) if motors else ca.SX(1)

    def kinetic_energy(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Kinetic energy, armature included [J]."""
        return self._call(self.functions.kinetic_energy, q, v)[0] + ca.dot(self._rotors, v**2) / 2

    def gravity(self, q: ca.SX) -> ca.SX:
        """Derivative of the potential of gravity along the tangent space, shape (nv,) [N, N m]."""
        return self._call(self.functions.gravity, q)[0]

    def inverse_dynamics(self, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
        """Generalised force M(q) a + C(q, v) v + gravity, shape (nv,) [N, N m]."""
        return self._call(self.functions.rnea, q, v, a)[0] + self._rotors * a

    def force(self, q: ca.SX, v: ca.SX, u: ca.SX) -> ca.SX:
        """Applied generalised force B(q) u plus that of force elements and losses, shape (nv,) [N, N m]."""
        actuation = self.robot.actuation
        selection = ca.sparsify(ca.SX(ca.DM(np.asarray(actuation.selection))))
        for geared in self._motors:
            selection[geared.dof, geared.column] = self.gear_ratio(geared.dof)
        num_joint = selection.shape[1]
        total = selection @ u[:num_joint] if num_joint else ca.SX.zeros(self.nv)
        for k, actuator in enumerate(actuation.frame_actuators):
            jacobian = self._call(self.functions.frame_jacobian(actuator.frame_id, "local"), q)[0]
            total += jacobian.T @ ca.DM(np.asarray(actuator.direction)) * u[num_joint + k]
        for index in range(len(self.robot.forces)):
            total += force_element_force(index, self, q, v)
        for index, resistance in enumerate(self.robot.resistances):
            numbers = self._of_model([ModelNumber("resistance", index, entry) for entry in range(2)])
            total[resistance.dof] += resistance_torque(resistance, v, ca.vertsplit(numbers))
        for joint in self.robot.elastic:
            effort, (link, motor) = joint.effort(self._configuration(q), v), joint.at_v
            total[link] += effort
            total[motor] -= effort
        return total

    def potential_energy(self, q: ca.SX) -> ca.SX:
        """Potential energy of gravity and of the force elements [J]."""
        energy = self._call(self.functions.potential_energy, q)[0]
        for index in range(len(self.robot.forces)):
            energy += force_element_energy(index, self, q)
        for joint in self.robot.elastic:
            energy += joint.energy(self._configuration(q))
        return energy

    def centre_of_mass(self, q: ca.SX) -> ca.SX:
        """Centre of mass in the world, shape (3,) [m]."""
        return self._call(self.functions.center_of_mass, q)[0]

    def centroidal_momentum(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Momentum about the centre of mass, axes of the world, linear first, shape (6,) [kg m/s, N m s]."""
        return self._call(self.functions.centroidal_momentum, q, v)[0]

    def frame_rotation(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Axes of a frame in the world, shape (3, 3)."""
        return self._call(self.functions.frame_placement(frame_id), q)[0]

    def frame_translation_jacobian(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Velocity of a frame's origin in world axes per velocity, shape (3, nv)."""
        return self._call(self.functions.frame_jacobian(frame_id, "local_world_aligned"), q)[0][:3, :]

    def frame_rotation_jacobian(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Angular velocity of a frame in world axes per velocity, shape (3, nv)."""
        return self._call(self.functions.frame_jacobian(frame_id, "local_world_aligned"), q)[0][3:, :]

    def frame_position(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Position of a frame's origin in the world, shape (3,) [m]."""
        return self._call(self.functions.frame_placement(frame_id), q)[1]

    def frame_inertia(self, frame_id: int) -> ca.SX:
        """Inertia of the body that carries a frame, about its origin and in its axes, shape (6, 6).

        Times the velocity of the frame it is the momentum, linear before angular.
        """
        joint = int(self.robot.model.frames[frame_id].parentJoint)
        body = self._of_model([ModelNumber("inertia", joint, k) for k in range(10)])
        placement = self._of_model([ModelNumber("frame_placement", frame_id, k) for k in range(12)])
        R, mass = ca.reshape(placement[:9], 3, 3), body[0]
        xx, xy, yy, xz, yz, zz = ca.vertsplit(body[4:])
        about_com = ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        c = ca.skew(R.T @ (body[1:4] - placement[9:]))
        about_origin = R.T @ about_com @ R - mass * (c @ c)
        return ca.blockcat([[mass * ca.SX.eye(3), -mass * c], [mass * c, about_origin]])

    def element_numbers(self, index: int) -> dict[str, ca.SX]:
        """Stiffness, length at rest and the like of a force element."""
        element = self.robot.forces[index]
        numbers = [ModelNumber("force", index, entry) for entry in range(len(element.units))]
        return dict(zip(element.units, ca.vertsplit(self._of_model(numbers)), strict=True))

    def _of_model(self, numbers: Sequence[ModelNumber]) -> ca.SX:
        """Numbers of the model, a column: those that vary as `numbers` has them."""
        given = {number: self.numbers[k] for k, number in enumerate(self.robot.varying)}
        constants = self.robot.values_of(numbers)
        return ca.vertcat(*[given.get(n, ca.SX(c)) for n, c in zip(numbers, constants, strict=True)])

    def joint_displacement(self, joint_id: int, q: ca.SX) -> ca.SX:
        """Angle [rad] or length [m] of a joint with one velocity; of continuous ones in -pi ... pi."""
        start = self.robot.model.joints[joint_id].idx_q
        numbers = next(q[part.at_z] for part in self.space.parts if part.at_q.start == start)
        return ca.atan2(numbers[1], numbers[0]) if numbers.shape[0] == 2 else numbers

    def constraints(self, q: ca.SX) -> ca.SX:
        """Holonomic constraints Phi(q), the rows that are kept, shape (nc,) [m, rad, m^2 for rods]."""
        rows = [one.equations(self, self._within(one.frame_ids, q)) for one in self.robot.constraints]
        if not rows:
            return ca.SX.zeros(0, 1)
        return ca.vertcat(*rows)[list(self.robot.kept_rows)]

    def _within(self, frames: Sequence[int], q: ca.SX) -> ca.SX:
        """Put the joints that carry all of these frames at zero.

        Where frames are in each other does not depend on them, but Pinocchio's placements in the world do.
        """
        model = self.robot.model
        if not frames or len(model.mimicking_joints):  # which may lie in the loop with leaders that carry it
            return q
        chains = [set(model.supports[model.frames[frame].parentJoint]) for frame in frames]
        carrying = {model.joints[joint].idx_q for joint in set.intersection(*chains) if joint > 0}
        zero = self.space.coordinates(self.robot.neutral()[np.newaxis])[0]
        inside = ca.SX(q)
        for part in self.space.parts:
            if part.at_q.start in carrying:
                inside[part.at_z] = zero[part.at_z]
        return inside

    def constraint_jacobian(self, q: ca.SX) -> ca.SX:
        """Derivative of Phi in tangent coordinates, shape (nc, nv)."""
        if self.nc == 0:
            return ca.SX.zeros(0, self.nv)
        return self.derivative(self.constraints, q)

    def evaluate(self, function: ca.Function, q: ca.SX, *others: ca.SX) -> ca.SX:
        """First output of a function of `mbocp.symbolic`, whatever the coordinates of the attitudes are."""
        return self._call(function, q, *others)[0]

    def _call(self, function: ca.Function, q: ca.SX, *others: ca.SX) -> list[ca.SX]:
        """Outputs of one of Pinocchio's functions, whatever the coordinates of the attitudes are."""
        matrices = [(p.at_q.stop - 4, ca.reshape(q[p.at_matrix : p.at_matrix + 9], 3, 3)) for p in self._dcm]
        others = (*others, *self._given)
        if not matrices:
            return list(function.call([q, *others]))
        return call_with_matrices(function, self._configuration(q), matrices, others)

    def _configuration(self, q: ca.SX) -> ca.SX:
        """Configuration of the robot; zero in place of the quaternions of attitudes that are matrices."""
        if not self._dcm:
            return q
        configuration = ca.SX.zeros(self.robot.nq)
        for part in self.space.parts:
            size = part.at_q.stop - part.at_q.start - (4 if part.at_matrix >= 0 else 0)
            if size:
                start = part.at_q.start
                configuration[start : start + size] = q[part.at_z][:size]
        return configuration
