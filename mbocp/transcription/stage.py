"""Stage functions of a problem's shape, with exact first and second derivatives on the manifold.

A state is x = (q, v), its tangent dx = (dq, dv). Derivatives are taken along the retraction x -> (q exp(dq),
v + dv) at dx = 0, so that every Newton update stays on the joints' Lie group.

Inputs and outputs (see `mbocp/_native/kernel/programme.hpp`):

- values    (x0, x1, y, u, theta, rho)      -> c, l
- jacobian  (x0, x1, y, u, theta, rho)      -> c, l, dc_dz, dl_dz; z = (x1, y, x0, u)
- complete  (x0, x1, y, u, m, theta, rho)   -> c, l, dc_dz, dl_dz, upper Hessian of l + m'c
- terminal_values (x, rho), terminal_complete (x, eta, rho): likewise for psi and g_T
- retract   (x, dx) -> x, and its inverse, difference (x, x_moved) -> dx
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from mbocp.integrators import State, evaluation_point, step_rows
from mbocp.mechanics import JointMechanics
from mbocp.transcription.shape import Shape

__all__ = ["FUNCTION_NAMES", "ParameterLayout", "build_functions", "parameter_layout"]

FUNCTION_NAMES = (
    "values",
    "jacobian",
    "complete",
    "terminal_values",
    "terminal_complete",
    "retract",
    "difference",
)


@dataclass(frozen=True)
class ParameterLayout:
    """Sizes of the named pieces of theta (whole horizon), rho (a stage) and rho of the end, in order."""

    theta: Mapping[str, int]
    stage: Mapping[str, int]
    terminal: Mapping[str, int]


def parameter_layout(shape: Shape, nq: int, nv: int, nu: int) -> ParameterLayout:
    """Parameters that the stage functions of `shape` take."""
    theta = {"dt": 1, "effort": nu}
    stage = {}
    if shape.track_q:
        theta["weight_q"], stage["target_q"] = nv, nq
    if shape.track_p:
        theta["weight_p"], stage["target_p"] = nv, nv
    if shape.weigh_velocity:
        theta["velocity"] = nv
    terminal = {"q": nq, "rate": nv, "D_q": shape.ng_q * nv, "D_rate": shape.ng_rate * nv}
    if shape.penalise_q:
        terminal["weight_q"] = nv
    if shape.penalise_rate:
        terminal["weight_rate"] = nv
    return ParameterLayout(theta, stage, terminal)


def build_functions(mechanics: JointMechanics, shape: Shape) -> dict[str, ca.Function]:
    """All stage functions of `shape` as CasADi functions, by name."""
    layout = parameter_layout(shape, mechanics.nq, mechanics.nv, mechanics.nu)
    functions = _stage_functions(mechanics, shape, layout)
    functions.update(_terminal_functions(mechanics, shape, layout))
    x, dx = ca.SX.sym("x", mechanics.nq + mechanics.nv), ca.SX.sym("dx", 2 * mechanics.nv)
    functions["retract"] = ca.Function("retract", [x, dx], [ca.densify(_retract(mechanics, x, dx))])
    moved = ca.SX.sym("x_moved", x.shape[0])
    gap = _difference(mechanics, x, moved)
    functions["difference"] = ca.Function("difference", [x, moved], [ca.densify(gap)])
    return functions


def _retract(mechanics: JointMechanics, x: ca.SX, dx: ca.SX) -> ca.SX:
    nq, nv = mechanics.nq, mechanics.nv
    return ca.vertcat(mechanics.integrate(x[:nq], dx[:nv]), x[nq:] + dx[nv:])


def _difference(mechanics: JointMechanics, x: ca.SX, moved: ca.SX) -> ca.SX:
    nq = mechanics.nq
    return ca.vertcat(mechanics.difference(x[:nq], moved[:nq]), moved[nq:] - x[nq:])


def _pieces(vector: ca.SX, sizes: Mapping[str, int]) -> dict[str, ca.SX]:
    bounds = [0]
    for size in sizes.values():
        bounds.append(bounds[-1] + size)
    return {name: vector[bounds[i] : bounds[i + 1]] for i, name in enumerate(sizes)}


def _running_cost(
    mechanics: JointMechanics,
    shape: Shape,
    q: ca.SX,
    v: ca.SX,
    u: ca.SX,
    theta: dict[str, ca.SX],
    rho: dict[str, ca.SX],
) -> ca.SX:
    """Eq. (8) times the step length, eq. (18), with diagonal weights; q is compared in the tangent space."""
    cost = ca.dot(theta["effort"] * u, u) / 2
    if shape.track_q:
        error = mechanics.difference(rho["target_q"], q)
        cost += ca.dot(theta["weight_q"] * error, error) / 2
    if shape.track_p:
        error = mechanics.momentum(q, v) - rho["target_p"]
        cost += ca.dot(theta["weight_p"] * error, error) / 2
    if shape.weigh_velocity:
        cost += ca.dot(theta["velocity"] * v, v) / 2
    return theta["dt"] * cost


def _on_manifold(
    mechanics: JointMechanics,
    nodes: list[ca.SX],
    expressions: list[ca.SX],
    others: list[ca.SX],
    tangents: list[ca.SX],
) -> list[ca.SX]:
    """Expressions in retracted nodes, evaluated at zero tangents (nothing to do on a vector space)."""
    if mechanics.is_vector_space:
        return expressions
    function = ca.Function("at_zero", [*nodes, *others, *tangents], expressions)
    zeros = [ca.SX.zeros(t.shape) for t in tangents]
    return list(function(*nodes, *others, *zeros))


def _stage_functions(
    mechanics: JointMechanics, shape: Shape, layout: ParameterLayout
) -> dict[str, ca.Function]:
    nq, nv, nc = mechanics.nq, mechanics.nv, mechanics.nc
    x0, x1 = ca.SX.sym("x0", nq + nv), ca.SX.sym("x1", nq + nv)
    y, u = ca.SX.sym("y", nc), ca.SX.sym("u", mechanics.nu)
    m = ca.SX.sym("m", 2 * nv + nc)
    theta = ca.SX.sym("theta", sum(layout.theta.values()))
    rho = ca.SX.sym("rho", sum(layout.stage.values()))
    if mechanics.is_vector_space:
        d0, d1, at0, at1 = x0, x1, x0, x1
    else:
        d0, d1 = ca.SX.sym("d0", 2 * nv), ca.SX.sym("d1", 2 * nv)
        at0, at1 = _retract(mechanics, x0, d0), _retract(mechanics, x1, d1)
    parameters = _pieces(theta, layout.theta)
    dt, before, after = parameters["dt"], State(at0[:nq], at0[nq:]), State(at1[:nq], at1[nq:])
    at = evaluation_point(mechanics, shape.scheme, before, after, dt)
    rows = step_rows(mechanics, shape.scheme, before, after, at, y, u, dt)
    c = ca.densify(ca.vertcat(*rows))
    cost = _running_cost(mechanics, shape, at.q, at.v, u, parameters, _pieces(rho, layout.stage))

    z = ca.vertcat(d1, y, d0, u)
    dc_dz = ca.jacobian(c, z)
    hessian, _ = ca.hessian(cost + ca.dot(m, c), z)
    derivatives = [c, cost, dc_dz, ca.jacobian(cost, z), ca.triu(hessian)]
    tangents = [] if mechanics.is_vector_space else [d0, d1]
    derivatives = _on_manifold(mechanics, [x0, x1], derivatives, [y, u, m, theta, rho], tangents)
    c, cost = derivatives[:2]
    first_order = derivatives[:4]
    derivatives = ca.cse(derivatives)
    arguments = [x0, x1, y, u]
    return {
        "values": ca.Function("values", [*arguments, theta, rho], ca.cse([c, cost])),
        "jacobian": ca.Function("jacobian", [*arguments, theta, rho], ca.cse(first_order)),
        "complete": ca.Function("complete", [*arguments, m, theta, rho], derivatives),
    }


def _terminal_functions(
    mechanics: JointMechanics, shape: Shape, layout: ParameterLayout
) -> dict[str, ca.Function]:
    """Terminal cost, eq. (9), and end condition, eq. (14), with the projection D as a parameter."""
    nq, nv = mechanics.nq, mechanics.nv
    x, eta = ca.SX.sym("x", nq + nv), ca.SX.sym("eta", shape.ng_q + shape.ng_rate)
    rho = ca.SX.sym("rho", sum(layout.terminal.values()))
    d = x if mechanics.is_vector_space else ca.SX.sym("d", 2 * nv)
    at = x if mechanics.is_vector_space else _retract(mechanics, x, d)
    goal = _pieces(rho, layout.terminal)
    q, v = at[:nq], at[nq:]
    error_q = mechanics.difference(goal["q"], q)
    error_rate = (mechanics.momentum(q, v) if shape.rate == "p" else v) - goal["rate"]
    g = ca.vertcat(
        ca.reshape(goal["D_q"], shape.ng_q, nv) @ error_q,
        ca.reshape(goal["D_rate"], shape.ng_rate, nv) @ error_rate,
    )
    psi = ca.SX(0)
    if shape.penalise_q:
        psi += ca.dot(goal["weight_q"] * error_q, error_q) / 2
    if shape.penalise_rate:
        psi += ca.dot(goal["weight_rate"] * error_rate, error_rate) / 2
    hessian, _ = ca.hessian(psi + ca.dot(eta, g), d)
    derivatives = [psi, ca.densify(g), ca.jacobian(g, d), ca.jacobian(psi, d), ca.triu(hessian)]
    tangents = [] if mechanics.is_vector_space else [d]
    derivatives = _on_manifold(mechanics, [x], derivatives, [eta, rho], tangents)
    return {
        "terminal_values": ca.Function("terminal_values", [x, rho], ca.cse(derivatives[:2])),
        "terminal_complete": ca.Function("terminal_complete", [x, eta, rho], ca.cse(derivatives)),
    }
