"""Functions of the end: terminal cost, end condition and what guards it.

- terminal_values (x, rho), terminal_complete (x, eta, rho): like the functions of a stage, for psi and g_T
- guard (x, m, rho) -> h, dh_dx, upper Hessian of m'h: h >= 0 excludes other roots of the end condition
"""

from __future__ import annotations

import casadi as ca

from mbocp.formulation.parameters import parameter_layout, pieces, symbols_for
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.stage import state_space
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import Mechanics
from mbocp.terms.point import Point, Sizes


def build_end_functions(mechanics: Mechanics, signature: FunctionSignature) -> dict[str, ca.Function]:
    """Terminal cost, eq. (9), and end condition, eq. (14), with the projection D as a parameter."""
    layout = parameter_layout(signature, Sizes.of(mechanics)).terminal
    space = state_space(mechanics, signature)
    at = space.layout
    x, eta = ca.SX.sym("x", at.nx), ca.SX.sym("eta", signature.end_rows)
    rho = symbols_for("rho", layout, mechanics.numbers)
    d = x if at.is_flat else ca.SX.sym("d", at.ndx)
    moved = x if at.is_flat else space.retract(x, d)
    goal = pieces(rho, layout)
    q, s = moved[at.z], moved[at.s]
    remembered = {name: moved[where] for name, where in at.states.items()}  # in units of their own
    for feature in signature.features:
        mechanics = feature.equations(mechanics, remembered, goal)
    point = Point(mechanics, q, mechanics.velocity(q, s, ca.SX.zeros(mechanics.nu)), remembered=remembered)
    g = signature.goal.expression(point, goal)
    psi = (
        ca.SX(0) if signature.terminal is None else signature.terminal.expression(point, signature.goal, goal)
    )
    for term in signature.ends:
        value = term.expression(point, goal)
        psi, g = (psi + value, g) if term.is_cost else (psi, ca.vertcat(g, value))
    hessian, _ = ca.hessian(psi + ca.dot(eta, g), d)
    derivatives = [psi, ca.densify(g), ca.jacobian(g, d), ca.jacobian(psi, d), ca.triu(hessian)]
    derivatives = space.at_zero_tangents([x], derivatives, [eta, rho], [d])
    found = {
        "terminal_values": ca.Function("terminal_values", [x, rho], derivatives[:2]),
        "terminal_complete": ca.Function("terminal_complete", [x, eta, rho], derivatives),
    }
    if signature.guarded:
        found["guard"] = _guard(mechanics.joint_space, signature, x, x[at.z], goal["q"], rho)
    return found


def _guard(
    space: ConfigurationSpace, signature: FunctionSignature, x: ca.SX, q: ca.SX, goal: ca.SX, rho: ca.SX
) -> ca.Function:
    parts = space.parts
    wanted = [parts[i] for i in signature.guarded]
    h = ca.vertcat(*[value for part, value in space.guards(goal, q) if part in wanted])
    m = ca.SX.sym("m", h.numel())
    hessian, _ = ca.hessian(ca.dot(m, h), x)
    return ca.Function("guard", [x, m, rho], [ca.densify(h), ca.jacobian(h, x), ca.triu(hessian)])
