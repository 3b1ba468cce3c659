"""Functions of the end: terminal cost, end condition and what guards it.

- terminal_values (x, rho), terminal_complete (x, eta, rho): like the functions of a stage, for psi and g_T
- guard (x, m, rho) -> h, dh_dx, upper Hessian of m'h: h >= 0 excludes other roots of the end condition
"""

from __future__ import annotations

import casadi as ca

from mbocp.formulation.parameters import Sizes, parameter_layout, pieces
from mbocp.formulation.shape import Shape
from mbocp.formulation.stage import at_zero_tangents, compared, joint_rate, state_space
from mbocp.mechanics import JointMechanics, Mechanics
from mbocp.mechanics.forward import ForwardMechanics

__all__ = ["build_end_functions"]


def build_end_functions(mechanics: Mechanics, shape: Shape) -> dict[str, ca.Function]:
    """Terminal cost, eq. (9), and end condition, eq. (14), with the projection D as a parameter.

    Explicit schemes may leave the groups: their end condition is the null-space projected one, Eq. (37) of
    [Manara2017]_, which is smooth everywhere. Others compare in the tangent space of the goal.
    """
    nv = mechanics.nv
    layout = parameter_layout(shape, Sizes.of(mechanics)).terminal
    space = state_space(mechanics, shape)
    at = space.layout
    x, eta = ca.SX.sym("x", at.nx), ca.SX.sym("eta", shape.ng_q + shape.ng_rate)
    rho = ca.SX.sym("rho", sum(layout.values()))
    d = x if at.is_flat else ca.SX.sym("d", at.ndx)
    moved = x if at.is_flat else space.retract(x, d)
    goal = pieces(rho, layout)
    q, s = moved[at.z], moved[at.s]
    v = (
        s
        if not isinstance(mechanics, ForwardMechanics)
        else mechanics.velocity(q, s, ca.SX.zeros(mechanics.nu))
    )
    error_rate = (mechanics.momentum(q, v) if shape.rate == "p" else v) - goal["rate"]
    away = mechanics.space.projection if isinstance(mechanics, ForwardMechanics) else mechanics.difference
    g = ca.vertcat(
        ca.reshape(goal["D_q"], shape.ng_q, nv) @ away(goal["q"], q),
        ca.reshape(goal["D_rate"], shape.ng_rate, nv) @ error_rate,
    )
    psi = ca.SX(0)
    if shape.penalise_q:
        target = goal["joint_q"] if shape.is_natural else goal["q"]
        error = compared(mechanics, target, q, shape.penalised_parts)
        psi += ca.dot(goal["weight_q"] * error, error) / 2
    if shape.penalise_rate:
        if shape.is_natural:
            error_rate = joint_rate(mechanics, shape.rate, q, v) - goal["joint_rate"]
        psi += ca.dot(goal["weight_rate"] * error_rate, error_rate) / 2
    hessian, _ = ca.hessian(psi + ca.dot(eta, g), d)
    derivatives = [psi, ca.densify(g), ca.jacobian(g, d), ca.jacobian(psi, d), ca.triu(hessian)]
    derivatives = at_zero_tangents(space, [x], derivatives, [eta, rho], [d])
    found = {
        "terminal_values": ca.Function("terminal_values", [x, rho], ca.cse(derivatives[:2])),
        "terminal_complete": ca.Function("terminal_complete", [x, eta, rho], ca.cse(derivatives)),
    }
    if shape.guarded and isinstance(mechanics, JointMechanics):
        found["guard"] = _guard(mechanics, shape, x, x[at.z], goal["q"], rho)
    return found


def _guard(
    mechanics: JointMechanics, shape: Shape, x: ca.SX, q: ca.SX, goal: ca.SX, rho: ca.SX
) -> ca.Function:
    parts = mechanics.space.parts
    wanted = [parts[i] for i in shape.guarded]
    h = ca.vertcat(*[value for part, value in mechanics.space.guards(goal, q) if part in wanted])
    m = ca.SX.sym("m", h.numel())
    hessian, _ = ca.hessian(ca.dot(m, h), x)
    return ca.Function("guard", [x, m, rho], [ca.densify(h), ca.jacobian(h, x), ca.triu(hessian)])
