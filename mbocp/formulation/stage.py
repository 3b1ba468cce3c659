"""Stage functions of a problem's signature, with exact first and second derivatives.

A state is x = (z, s, r): coordinates of the configuration, speeds, and the controls of the step before where
their rate costs something. Derivatives are taken along the retraction x -> (z exp(dq), s + ds, r + dr) at
dx = 0, so that every Newton update stays on the joints' Lie group; or, where the signature is flat, in the
coordinates themselves.

Inputs and outputs (see `mbocp/_native/kernel/kind.hpp`):

- values    (x0, x1, y, u, theta, rho)      -> c, l
- gradient  (x0, x1, y, u, theta, rho)      -> dl_dz; z = (x1, y, x0, u)
- jacobian  (x0, x1, y, u, theta, rho)      -> c, l, dc_dz, dl_dz
- complete  (x0, x1, y, u, m, theta, rho)   -> c, l, dc_dz, dl_dz, upper Hessian of l + m'c
- path      (x1, m, u, theta)               -> h, dh_dx1, upper Hessian of m'h in x1; with path constraints
- retract   (x, dx) -> x, and its inverse, difference (x, x_moved) -> dx

The rows of c are kinematics, momentum balance (or speeds), previous controls, constraints. Controls that are
forces, y and the momentum balance count in a unit of force that is one of the parameters, see `Units`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import casadi as ca

from mbocp.exceptions import TranscriptionError
from mbocp.formulation.layout import StateLayout, StateSpace
from mbocp.formulation.parameters import (
    HAS_BEFORE,
    TIME,
    ParameterLayout,
    Sizes,
    parameter_layout,
    path_parameters,
    pieces,
)
from mbocp.formulation.signature import FunctionSignature
from mbocp.integrators import State, evaluation_point, step_rows
from mbocp.integrators.chain import Affine, Chain
from mbocp.integrators.runge_kutta import ExplicitStep, Gains
from mbocp.integrators.runge_kutta import State as StepState
from mbocp.mechanics import JointMechanics, Mechanics, natural_mechanics
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.robot import Robot
from mbocp.terms import Point

__all__ = [
    "at_zero_tangents",
    "build_functions",
    "mechanics_for",
    "state_layout",
    "state_space",
]


def mechanics_for(robot: Robot, signature: FunctionSignature) -> Mechanics:
    """Equations of motion in the form that the signature's coordinates and scheme ask for."""
    if signature.is_natural:
        return natural_mechanics(robot)
    return ForwardMechanics(robot, signature.rotations) if signature.is_explicit else JointMechanics(robot)


def state_layout(robot: Robot, nz: int, nv: int, signature: FunctionSignature) -> StateLayout:
    """Pieces of the states of a signature; a configuration has `nz` coordinates and `nv` directions."""
    ns = robot.num_speeds if signature.is_explicit else nv
    nr = robot.nu if signature.has_previous_controls else 0
    is_flat = signature.is_flat or signature.is_natural or robot.is_vector_space
    return StateLayout(nz=nz, nv=nv, ns=ns, nr=nr, is_flat=is_flat)


def state_space(mechanics: Mechanics, signature: FunctionSignature) -> StateSpace:
    """Maps of the states of a signature."""
    at = state_layout(mechanics.robot, mechanics.nq, mechanics.nv, signature)
    return StateSpace(at, mechanics)


def build_functions(mechanics: Mechanics, signature: FunctionSignature) -> dict[str, ca.Function]:
    """All functions of a stage of `signature` as CasADi functions, by name."""
    layout = parameter_layout(signature, Sizes.of(mechanics))
    space = state_space(mechanics, signature)
    functions = _Stage(mechanics, signature, layout, space).functions()
    nx, ndx = space.layout.nx, space.layout.ndx
    x, dx, moved = ca.SX.sym("x", nx), ca.SX.sym("dx", ndx), ca.SX.sym("x_moved", nx)
    functions["retract"] = ca.Function("retract", [x, dx], [ca.densify(space.retract(x, dx))])
    functions["difference"] = ca.Function("difference", [x, moved], [ca.densify(space.difference(x, moved))])
    return functions


def at_zero_tangents(
    space: StateSpace,
    nodes: list[ca.SX],
    expressions: list[ca.SX],
    others: list[ca.SX],
    tangents: list[ca.SX],
) -> list[ca.SX]:
    """Expressions in retracted nodes, evaluated at zero tangents (nothing to do on a vector space)."""
    if space.layout.is_flat:
        return expressions
    function = ca.Function("at_zero", [*nodes, *others, *tangents], expressions)
    zeros = [ca.SX.zeros(t.shape) for t in tangents]
    return list(function(*nodes, *others, *zeros))


@dataclass
class _Stage:
    """The pieces of a step in symbols, and the functions made of them."""

    mechanics: Mechanics
    signature: FunctionSignature
    layout: ParameterLayout
    space: StateSpace

    def __post_init__(self) -> None:
        at, nc = self.space.layout, self._num_algebraic
        self.x0, self.x1 = ca.SX.sym("x0", at.nx), ca.SX.sym("x1", at.nx)
        self.y, self.u = ca.SX.sym("y", nc), ca.SX.sym("u", self.mechanics.nu)
        self.m = ca.SX.sym("m", at.ndx + nc)
        self.theta = ca.SX.sym("theta", sum(self.layout.theta.values()))
        self.rho = ca.SX.sym("rho", sum(self.layout.stage.values()))
        if at.is_flat:
            self.d0, self.d1, self.at0, self.at1 = self.x0, self.x1, self.x0, self.x1
        else:
            self.d0, self.d1 = ca.SX.sym("d0", at.ndx), ca.SX.sym("d1", at.ndx)
            self.at0 = self.space.retract(self.x0, self.d0)
            self.at1 = self.space.retract(self.x1, self.d1)
        self.of_horizon = pieces(self.theta, self.layout.theta)
        self.of_stage = pieces(self.rho, self.layout.stage)
        num_drives = len(self.mechanics.robot.drives)  # at the end of u; what they prescribe is no force
        forces = ca.repmat(self.of_horizon["force"], self.mechanics.nu - num_drives)
        self.units_of_u = ca.vertcat(forces, ca.SX.ones(num_drives))
        self.controls = self.units_of_u * self.u  # as the equations of motion and the cost count them

    @property
    def _num_algebraic(self) -> int:
        """Multipliers that are unknowns of a step: explicit schemes project the accelerations instead."""
        return 0 if self.signature.is_explicit else self.mechanics.nc

    def functions(self) -> dict[str, ca.Function]:
        """By name."""
        found = self._explicit() if self.signature.is_explicit else self._implicit()
        if self.signature.path:
            found["path"] = self._path()
        return found

    def _implicit(self) -> dict[str, ca.Function]:
        at, dt, mechanics = self.space.layout, self.of_horizon["dt"], self.mechanics
        before = State(self.at0[at.z], self.at0[at.s])
        after = State(self.at1[at.z], self.at1[at.s])
        point = evaluation_point(mechanics, self.signature.scheme, before, after, dt)
        force, scheme = self.of_horizon["force"], self.signature.scheme
        impulse, u = force * self.y, self.controls
        rows = step_rows(mechanics, scheme, before, after, point, impulse, u, dt, is_flat=at.is_flat)
        momentum = (1.0 / force) * rows.momentum
        c = ca.densify(ca.vertcat(rows.kinematic, momentum, self._previous_controls(), rows.constraint))
        acceleration = partial(_mean_acceleration, mechanics, before, after, dt)
        cost = self._running_cost(self._point(point.q, point.v, acceleration))
        z = ca.vertcat(self.d1, self.y, self.d0, self.u)
        hessian, _ = ca.hessian(cost + ca.dot(self.m, c), z)
        return self._made(c, cost, ca.jacobian(c, z), ca.jacobian(cost, z), hessian)

    def _explicit(self) -> dict[str, ca.Function]:
        """F(x0, u) - x1, and the cost at the beginning of the step as in Eq. (39) of [Manara2017]_."""
        mechanics = self.mechanics
        if not isinstance(mechanics, ForwardMechanics):
            raise TypeError("an explicit scheme needs ForwardMechanics")
        at, gains = self.space.layout, self.of_horizon["gains"]
        unknowns = ca.vertcat(self.d1, self.d0, self.u)
        chain = Chain(unknowns if at.is_flat else ca.vertcat(ca.SX.zeros(2 * at.ndx), self.u))
        root = chain.root()
        d1, d0, u = root[: at.ndx], root[at.ndx : 2 * at.ndx], root[2 * at.ndx :]
        before, after = self._states(chain, d0, self.x0), self._states(chain, d1, self.x1)
        step = ExplicitStep(mechanics, self.signature.scheme, self.signature.lie, self.signature.substeps)
        units = ca.diag(self.units_of_u)
        pushed = Affine(units @ u.value, {k: units @ matrix for k, matrix in u.parts.items()})
        reached = step(chain, before, pushed, self.of_horizon["dt"], Gains(gains[0], gains[1], gains[2]))
        if at.is_flat:
            kinematic = reached.z - after.z
        else:
            (kinematic,) = chain.apply(_differences(mechanics), [after.z, reached.z])
        pieces = [kinematic, reached.s - after.s]
        if self.signature.has_previous_controls:
            pieces.append(u - self._previous_controls_of(d1, self.x1))
        c = Affine.join(pieces)
        q, s = self.at0[at.z], self.at0[at.s]
        acceleration = partial(_rate_of_speeds, mechanics, q, s, self.controls, gains[2])
        cost = self._running_cost(self._point(q, mechanics.velocity(q, s, self.controls), acceleration))
        slope = ca.jacobian(cost, unknowns)
        curvature, _ = ca.hessian(cost, unknowns)
        tangents = [self.d0, self.d1]
        others = [self.u, self.theta, self.rho]
        cost, slope, curvature = at_zero_tangents(
            self.space, [self.x0, self.x1], [cost, slope, curvature], others, tangents
        )
        return self._made(
            ca.densify(c.value), cost, chain.jacobian(c), slope, curvature + chain.hessian(c, self.m)
        )

    def _states(self, chain: Chain, d: Affine, x: ca.SX) -> StepState:
        """State moved along the tangent d."""
        at = self.space.layout
        if at.is_flat:
            return StepState(d[at.z], d[at.s])
        (z,) = chain.apply(_retraction(self.mechanics), [d[: at.nw]], [x[at.z]])
        return StepState(z, d[at.ds] + x[at.s])

    def _previous_controls_of(self, d: Affine, x: ca.SX) -> Affine:
        at = self.space.layout
        return d[at.dr] if at.is_flat else d[at.dr] + x[at.r]

    def _previous_controls(self) -> ca.SX:
        return (
            self.u - self.at1[self.space.layout.r]
            if self.signature.has_previous_controls
            else ca.SX.zeros(0, 1)
        )

    def _point(self, q: ca.SX, v: ca.SX, acceleration: Callable[[], ca.SX]) -> Point:
        """Where the running cost is evaluated."""
        change = None
        if self.signature.has_previous_controls:
            change = self.units_of_u * (self.u - self.at0[self.space.layout.r])
        return Point(self.mechanics, q, v, self.controls, change, acceleration, self.of_stage.get(TIME))

    def _running_cost(self, at: Point) -> ca.SX:
        """Eq. (8) times the step length, eq. (18), and what couples steps, Eq. (33) of [Manara2017]_."""
        given, dt = {**self.of_horizon, **self.of_stage}, self.of_horizon["dt"]
        cost = between = ca.SX(0)
        for term in self.signature.cost:
            for addend in term.addends(at, given):
                if term.couples_steps:
                    between += given[HAS_BEFORE] * addend / dt
                else:
                    cost += addend
        return dt * cost + between

    def _made(
        self, c: ca.SX, cost: ca.SX, dc_dz: ca.SX, dl_dz: ca.SX, hessian: ca.SX
    ) -> dict[str, ca.Function]:
        derivatives = [c, cost, dc_dz, dl_dz, ca.triu(hessian)]
        others = [self.y, self.u, self.m, self.theta, self.rho]
        if not self.signature.is_explicit:
            derivatives = at_zero_tangents(
                self.space, [self.x0, self.x1], derivatives, others, [self.d0, self.d1]
            )
        c, cost = derivatives[:2]
        arguments, parameters = [self.x0, self.x1, self.y, self.u], [self.theta, self.rho]
        return {
            "values": ca.Function("values", [*arguments, *parameters], ca.cse([c, cost])),
            "gradient": ca.Function("gradient", [*arguments, *parameters], ca.cse(derivatives[3:4])),
            "jacobian": ca.Function("jacobian", [*arguments, *parameters], ca.cse(derivatives[:4])),
            "complete": ca.Function("complete", [*arguments, self.m, *parameters], ca.cse(derivatives)),
        }

    def _path(self) -> ca.Function:
        """Path constraints at the end of the step, in coordinates: only flat programmes have them."""
        at, mechanics = self.space.layout, self.mechanics
        q, s = self.x1[at.z], self.x1[at.s]
        v = mechanics.velocity(q, s, self.controls) if isinstance(mechanics, ForwardMechanics) else s
        at_node, rows = Point(mechanics, q, v), []
        if self.signature.has_previous_controls:
            u = self.units_of_u * self.x1[at.r]
            at_node = replace(at_node, u=u, acceleration=partial(_driven_acceleration, at_node, u))
        for k, term in enumerate(self.signature.path):
            rows.append(
                term.expression(at_node, {n: self.of_horizon[path_parameters(k, n)] for n in term.sizes})
            )
        h = ca.densify(ca.vertcat(*rows))
        m = ca.SX.sym("m", h.numel())
        hessian, _ = ca.hessian(ca.dot(m, h), self.x1)
        outputs = [h, ca.jacobian(h, self.x1), ca.triu(hessian)]
        return ca.Function("path", [self.x1, m, self.u, self.theta], ca.cse(outputs))


def _mean_acceleration(mechanics: Mechanics, before: State, after: State, dt: ca.SX) -> ca.SX:
    """Accelerations of the joints, their mean over a step."""
    ends = [Point(mechanics, state.q, state.v).joint_velocity() for state in (before, after)]
    return (ends[1] - ends[0]) / dt


def _rate_of_speeds(mechanics: ForwardMechanics, q: ca.SX, s: ca.SX, u: ca.SX, gamma: ca.SX) -> ca.SX:
    """Accelerations of the joints at the beginning of a step."""
    if mechanics.robot.drives:
        raise TranscriptionError(
            f"a term asks for accelerations, which explicit schemes do not have where controls prescribe "
            f"velocities (robot {mechanics.robot.name!r}: {mechanics.robot.drives[0].name!r}, ...)"
        )
    return mechanics.speed_rate(q, s, u, gamma)


def _driven_acceleration(node: Point, u: ca.SX) -> ca.SX:
    """Accelerations of the joints under a control, whatever the scheme makes of them."""
    parts = node.mechanics.joint_space.parts
    rotations = "dcm" if any(part.at_matrix >= 0 for part in parts) else "quaternion"
    forward = ForwardMechanics(node.mechanics.robot, rotations)
    return _rate_of_speeds(forward, node.joint_configuration(), node.joint_velocity(), u, ca.SX(0))


def _retraction(mechanics: Mechanics) -> ca.Function:
    d, z = ca.SX.sym("d", mechanics.nv), ca.SX.sym("z", mechanics.nq)
    return ca.Function("retraction", [d, z], [ca.densify(mechanics.integrate(z, d))])


def _differences(mechanics: JointMechanics) -> ca.Function:
    z0, z1 = ca.SX.sym("z0", mechanics.nq), ca.SX.sym("z1", mechanics.nq)
    return ca.Function("differences", [z0, z1], [ca.densify(mechanics.difference(z0, z1))])
