"""Generalised forces of the force elements between two frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca

from mbocp.robot import QuarticSpring, SpringDamper

if TYPE_CHECKING:
    from mbocp.mechanics.joint import JointMechanics

__all__ = ["force_element_force"]


def force_element_force(
    element: QuarticSpring | SpringDamper, mechanics: JointMechanics, q: ca.SX, v: ca.SX
) -> ca.SX:
    """Generalised force of one element, shape (nv,) [N, N m].

    Parameters
    ----------
    element : QuarticSpring or SpringDamper
        What acts between two frames.
    mechanics : JointMechanics
        Gives the frames' positions and the tangent map.
    q, v : casadi.SX
        Configuration (nq,), velocity (nv,).
    """

    def span(at: ca.SX) -> ca.SX:
        return mechanics.frame_position(element.frame_a, at) - mechanics.frame_position(element.frame_b, at)

    if isinstance(element, QuarticSpring):  # V = c/4 (|d|^2 - l^2)^2, before eq. (45) and in section 6.3.2

        def potential(at: ca.SX) -> ca.SX:
            stretch = ca.dot(span(at), span(at)) - element.length**2
            return element.coefficient / 4 * stretch**2

        return -mechanics.derivative(potential, q).T
    d, dd_dq = span(q), mechanics.derivative(span, q)  # (3, nv)
    if element.length == 0.0:  # no direction needed, and none defined where the ends meet
        return -dd_dq.T @ (element.stiffness * d + element.damping * (dd_dq @ v))
    distance = ca.norm_2(d)
    direction = d / distance
    rate = ca.dot(direction, dd_dq @ v)
    return -dd_dq.T @ direction * (element.stiffness * (distance - element.length) + element.damping * rate)
