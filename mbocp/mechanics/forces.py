"""Generalised forces and energies of the force elements between two frames, and losses of joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import casadi as ca

from mbocp._arrays import Array
from mbocp.robot import QuarticSpring, Robot, SpringDamper
from mbocp.robot.resistance import JointResistance

_DAMPING = 3e-4  # of squares of columns of length 1: its inverse multiplies round-off
_ROUNDS = 6  # of which each divides errors by 3000, and by 30 where motors need ten times the force


class Frames(Protocol):
    """Positions of frames and derivatives along the tangent space, in any coordinates."""

    robot: Robot

    def frame_position(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Position of a frame's origin in the world, shape (3,) [m]."""

    def element_numbers(self, index: int) -> Mapping[str, ca.SX]:
        """Stiffness, length at rest and the like of a force element of the robot."""

    def derivative(self, function: Callable[[ca.SX], ca.SX], q: ca.SX) -> ca.SX:
        """Derivative of a function of the configuration along its tangent, shape (rows, nv)."""


class GearedMotors(Protocol):
    """Motors with gears, in any coordinates."""

    robot: Robot

    def gear_ratio(self, dof: int) -> ca.SX:
        """Turns of the motor for one of a joint with this velocity; 1 without a gear."""


def controls_for(mechanics: GearedMotors, force: ca.SX) -> ca.SX:
    """Controls with B u = force, or nearest to it, shape (nu,) [N, N m]; of frames that turn and drives 0.

    Parameters
    ----------
    mechanics : JointMechanics or NaturalMechanics
        Gives gear ratios.
    force : casadi.SX, shape (nv,)
        Generalised force [N, N m].
    """
    robot = mechanics.robot
    found = ca.sparsify(ca.SX(ca.DM(robot.actuation.inverse))) @ force
    for motor in robot.opened_motors:  # their ratios are found, or parameters
        found[motor.column] *= motor.gear_ratio / mechanics.gear_ratio(motor.dof)
    return ca.vertcat(found, ca.SX.zeros(robot.nu - found.numel(), 1))


def controls_beside(lengths: Array, pushes: ca.SX, ties: ca.SX, acts: ca.SX, force: ca.SX) -> ca.SX:
    r"""Smallest controls that come, with forces of constraints, nearest to a force: B u + J' lambda = f.

    They are :math:`u = B^T \nu` with :math:`B B^T \nu + J^T \lambda = f` and :math:`J \nu = 0`, in units in
    which columns of B have the length 1: gears do not count. The proximal method finds them, whose rounds
    add :math:`\epsilon` times the change of :math:`\nu` to the first equation: they are smooth where controls
    are redundant, where nothing pushes along some direction, and in a dead centre, where none suffice.

    Parameters
    ----------
    lengths : ndarray, shape (nu,)
        Of columns of B, more or less.
    pushes : casadi.SX, shape (nv, nu)
        B.
    ties : casadi.SX, shape (nc, nv)
        J, the derivative of the constraints.
    acts : casadi.SX, shape (nc,)
        1 for rows that act, else 0.
    force : casadi.SX, shape (nv,)
        Generalised force f [N, N m].

    Returns
    -------
    u : casadi.SX, shape (nu,)
        [N, N m]
    """
    units = ca.DM(1.0 / lengths)
    B, J = pushes @ ca.diag(units), acts * ties
    damped = ca.ldl(B @ B.T + _DAMPING * ca.SX.eye(force.numel()))
    columns = ca.ldl_solve(J.T, *damped)
    borne = ca.ldl(J @ columns + ca.diag(1 - acts))
    nu = ca.SX.zeros(force.numel())
    for _ in range(_ROUNDS):
        free = ca.ldl_solve(force + _DAMPING * nu, *damped)
        nu = free - columns @ ca.ldl_solve(J @ free, *borne)
    return units * (B.T @ nu)


def force_element_force(index: int, mechanics: Frames, q: ca.SX, v: ca.SX) -> ca.SX:
    """Generalised force of one element, shape (nv,) [N, N m].

    Parameters
    ----------
    index : int
        Which of the robot's force elements.
    mechanics : JointMechanics or NaturalMechanics
        Gives the frames' positions and the tangent map.
    q, v : casadi.SX
        Configuration (nq,), velocity (nv,).
    """
    element, numbers = mechanics.robot.forces[index], mechanics.element_numbers(index)
    if isinstance(element, QuarticSpring):
        return -mechanics.derivative(lambda at: force_element_energy(index, mechanics, at), q).T

    def span(at: ca.SX) -> ca.SX:
        return _span(element, mechanics, at)

    d, dd_dq = span(q), mechanics.derivative(span, q)  # (3, nv)
    stiffness, damping, length = (numbers[key] for key in ("stiffness", "damping", "length"))
    if length.is_zero():  # no direction needed, and none defined where the ends meet
        return -dd_dq.T @ (stiffness * d + damping * (dd_dq @ v))
    distance = ca.norm_2(d)
    direction = d / distance
    rate = ca.dot(direction, dd_dq @ v)
    return -dd_dq.T @ direction * (stiffness * (distance - length) + damping * rate)


def resistance_torque(resistance: JointResistance, v: ca.SX, numbers: Sequence[ca.SX] | None = None) -> ca.SX:
    """Force or torque of a joint's damping and friction on the velocity component that it acts on [N, N m].

    Parameters
    ----------
    resistance : JointResistance
    v : casadi.SX, shape (nv,)
        Velocities of the joints.
    numbers : sequence of casadi.SX, optional
        Damping and friction in place of those that it has.
    """
    damping, friction = numbers or (ca.SX(resistance.damping), ca.SX(resistance.friction))
    w = resistance.ratio * v[resistance.dof]
    lost = damping * w
    if not friction.is_zero():
        lost += friction * ca.tanh(w / resistance.speed)
    return -resistance.ratio * lost


def force_element_energy(index: int, mechanics: Frames, q: ca.SX) -> ca.SX:
    """Potential energy of one element [J]."""
    element, numbers = mechanics.robot.forces[index], mechanics.element_numbers(index)
    d, length = _span(element, mechanics, q), numbers["length"]
    if isinstance(element, QuarticSpring):  # V = c/4 (|d|^2 - l^2)^2, before eq. (45) and in section 6.3.2
        return numbers["coefficient"] / 4 * (ca.dot(d, d) - length**2) ** 2
    if length.is_zero():
        return numbers["stiffness"] / 2 * ca.dot(d, d)
    return numbers["stiffness"] / 2 * (ca.norm_2(d) - length) ** 2


def _span(element: QuarticSpring | SpringDamper, mechanics: Frames, q: ca.SX) -> ca.SX:
    return mechanics.frame_position(element.frame_a, q) - mechanics.frame_position(element.frame_b, q)
