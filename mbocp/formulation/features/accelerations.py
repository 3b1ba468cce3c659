"""Accelerations of the joints where a term is evaluated, shape (robot.nv,) [m/s^2, rad/s^2]."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from mbocp.exceptions import TranscriptionError
from mbocp.integrators import State, basis_slopes
from mbocp.mechanics import Mechanics
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.terms.point import Point


def mean_acceleration(mechanics: Mechanics, before: State, after: State, dt: ca.SX) -> ca.SX:
    """Their mean over a step."""
    ends = [Point(mechanics, state.q, state.v).joint_velocity() for state in (before, after)]
    return (ends[1] - ends[0]) / dt


def acceleration_at(
    mechanics: Mechanics, share: float, states: Sequence[tuple[float, State]], dt: ca.SX
) -> ca.SX:
    """At a share of a step, by the polynomial through velocities at shares of it.

    With those of Gauss's points and both ends its square is integrated to the order of the points: the errors
    at them cancel as far as their orthogonality goes.
    """
    shares, total = [at for at, _ in states], ca.SX(0)
    for slope, (_, state) in zip(basis_slopes(shares, share), states, strict=True):
        total += float(slope) * Point(mechanics, state.q, state.v).joint_velocity()
    return total / dt


def rate_of_speeds(mechanics: ForwardMechanics, q: ca.SX, s: ca.SX, u: ca.SX, gamma: ca.SX) -> ca.SX:
    """At the beginning of a step, from the forward dynamics."""
    if mechanics.robot.drives:
        raise TranscriptionError(
            f"a term asks for accelerations, which explicit schemes do not have where controls prescribe "
            f"velocities (robot {mechanics.robot.name!r}: {mechanics.robot.drives[0].name!r}, ...)"
        )
    return mechanics.speed_rate(q, s, u, gamma)


def accelerate_driven(node: Point, u: ca.SX) -> ca.SX:
    """Under a control, whatever the scheme makes of them."""
    parts = node.mechanics.joint_space.parts
    rotations = "dcm" if any(part.at_matrix >= 0 for part in parts) else "quaternion"
    forward = ForwardMechanics(node.mechanics.robot, rotations, numbers=node.mechanics.numbers)
    return rate_of_speeds(forward, node.joint_configuration(), node.joint_velocity(), u, ca.SX(0))
