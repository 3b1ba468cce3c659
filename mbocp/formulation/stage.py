"""Functions of the stages and of the end of a problem's signature, with exact first and second derivatives.

A state is x = (z, s, b): coordinates of the configuration, speeds, and the blocks that features add, such as
what it remembers of the step before, see `mbocp.formulation.features.feature`. Derivatives are taken along
the retraction x -> (z exp(dq), s + ds, b + db) at dx = 0, so that every Newton update stays on the joints'
Lie group; or, where the signature is flat, in the coordinates themselves.

Inputs and outputs (see `mbocp/_native/kernel/kind.hpp`):

- values    (x0, x1, y, u, theta, rho)      -> c, l
- gradient  (x0, x1, y, u, theta, rho)      -> dl_dz; z = (x1, y, x0, u)
- jacobian  (x0, x1, y, u, theta, rho)      -> c, l, dc_dz, dl_dz
- complete  (x0, x1, y, u, m, theta, rho)   -> c, l, dc_dz, dl_dz, upper Hessian of l + m'c
- path      (x1, m, u, theta)               -> h, dh_dx1, upper Hessian of m'h in x1; with path constraints
- path_values (x1, u, theta)                -> h; likewise
- lengthening (x0, x1, y, u, m, theta, rho) -> derivative of l + m'c in log(dt); of some schemes
- retract   (x, dx) -> x, and its inverse, difference (x, x_moved) -> dx
- terminal_values (x, rho), terminal_complete (x, eta, rho): like values and complete, for psi and g_T
- guard     (x, m, rho) -> h, dh_dx, upper Hessian of m'h: h >= 0 excludes other roots of the end condition

A solve by Newton's method asks for neither `gradient` nor `jacobian`, but for a few first derivatives, which
`complete` has as well: so these are built when a solver asks for them. `lengthening`, which Hamiltonians come
from, is short, and to build it alone takes as long as to build all.

The rows of c are kinematics, momentum balance (or speeds), those of the blocks, constraints. Which
equations these are is for the formulation's `Steps` to say. Controls that are forces, y and the momentum
balance count in a unit of force that is one of the parameters, see `Units`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial

import casadi as ca

from mbocp._arrays import dataclass
from mbocp.formulation.features.feature import Feature
from mbocp.formulation.layout import StateSpace
from mbocp.formulation.motion import Passage
from mbocp.formulation.parameter_layout import parameter_layout, pieces, symbols_for
from mbocp.formulation.path_functions import build_path, build_path_values
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.steps import HAS_BEFORE, StepDerivatives, StepSymbols
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import Mechanics
from mbocp.terms.point import Point, Sizes

LATER = ("gradient", "jacobian")  # solvers ask for them that follow a motion step by step
_ALL = ("values", "complete", "path", "path_values", "retract", "difference", "lengthening", *LATER)
_AT_M = 4  # where the multipliers are among the inputs of `complete`


def state_space(mechanics: Mechanics, signature: FunctionSignature) -> StateSpace:
    """Maps of the states of a signature."""
    at = signature.state_layout(mechanics.nq, mechanics.nv, mechanics.ns, mechanics.nu)
    return StateSpace(at, mechanics)


def build_functions(
    mechanics: Mechanics, signature: FunctionSignature, names: Collection[str] | None = None
) -> dict[str, ca.Function]:
    """All functions of a stage of `signature` as CasADi functions, by name; or some of them.

    Parameters
    ----------
    mechanics : Mechanics
        Of the kind that `signature.steps.mechanics` gives.
    signature : FunctionSignature
    names : collection of str, optional
        Of those that are wanted.
    """
    space = state_space(mechanics, signature)
    symbols = _symbols(space, signature)
    makers = _makers(symbols, signature.steps.derivatives(symbols))
    if signature.path:
        makers["path"] = partial(build_path, symbols, signature)
        makers["path_values"] = partial(build_path_values, symbols, signature)
    nx, ndx = space.layout.nx, space.layout.ndx
    x, dx, moved = ca.SX.sym("x", nx), ca.SX.sym("dx", ndx), ca.SX.sym("x_moved", nx)
    makers["retract"] = lambda: ca.Function("retract", [x, dx], [ca.densify(space.retract(x, dx))])
    makers["difference"] = lambda: ca.Function(
        "difference", [x, moved], [ca.densify(space.difference(x, moved))]
    )
    return {name: make() for name, make in makers.items() if names is None or name in names}


def build_first_functions(mechanics: Mechanics, signature: FunctionSignature) -> dict[str, ca.Function]:
    """All functions of a stage but those of `LATER`, and what stands for these meanwhile.

    Gradient and Jacobian are then those of `complete`: there is no more to compile, and they take as long.
    """
    first = [name for name in _ALL if name not in LATER]
    found = build_functions(mechanics, signature, first)
    complete = found["complete"]
    sizes = [complete.size1_in(i) for i in range(complete.n_in())]
    given = [ca.MX.sym(f"i{i}", size) for i, size in enumerate(sizes)]
    alone = given[:_AT_M] + given[_AT_M + 1 :]
    outputs = complete.call([*given[:_AT_M], ca.MX.zeros(sizes[_AT_M]), *given[_AT_M + 1 :]])
    found["gradient"] = ca.Function("gradient", alone, outputs[3:4])
    found["jacobian"] = ca.Function("jacobian", alone, outputs[:4])
    return found


def _symbols(space: StateSpace, signature: FunctionSignature) -> StepSymbols:
    mechanics, at, features = space.configurations, space.layout, signature.features
    num_held = sum(feature.num_held for feature in features)
    y = ca.SX.sym("y", signature.steps.num_algebraic(mechanics, num_held))
    layout = parameter_layout(signature, Sizes.of(mechanics))
    theta = symbols_for("theta", layout.theta, mechanics.numbers)
    rho = ca.SX.sym("rho", sum(layout.stage.values()))
    x0, x1 = ca.SX.sym("x0", at.nx), ca.SX.sym("x1", at.nx)
    d0, d1, at0, at1 = x0, x1, x0, x1
    if not at.is_flat:
        d0, d1 = ca.SX.sym("d0", at.ndx), ca.SX.sym("d1", at.ndx)
        at0, at1 = space.retract(x0, d0), space.retract(x1, d1)
    inputs = {name: ca.SX.sym(name, size) for name, size in at.control_sizes}
    given = {**pieces(theta, layout.theta), **pieces(rho, layout.stage)}
    num_drives = len(mechanics.robot.drives)  # at the end of u; what they prescribe is no force
    symbols = StepSymbols(
        mechanics=mechanics,
        space=space,
        x0=x0,
        x1=x1,
        d0=d0,
        d1=d1,
        at0=at0,
        at1=at1,
        y=y,
        impulses=signature.steps.impulses_of(y, mechanics.nc + num_held),
        named_inputs=inputs,
        u=inputs["own"],
        dt=given["dt"],
        spacing=given["dt"],
        m=ca.SX.sym("m", at.ndx + y.numel()),
        units_of_u=ca.vertcat(ca.repmat(given["force"], mechanics.nu - num_drives), ca.SX.ones(num_drives)),
        theta=theta,
        rho=rho,
        given=given,
        tau=signature.steps.tau,
        follow=partial(_follow, _rules(signature, at.ns, mechanics.nu)),
    )
    for feature in features:
        symbols = feature.enter(symbols)
    own_rows = [row for feature in features for row in feature.own_rows(symbols)]
    return replace(
        symbols,
        own_rows=ca.vertcat(ca.SX.zeros(0, 1), *own_rows),
        running_cost=_RunningCost(signature, symbols),
    )


def _rules(signature: FunctionSignature, ns: int, nu: int) -> dict[str, Feature]:
    """By the name of each remembered block the feature that knows its rule."""
    pairs = ((block, feature) for feature in signature.features for block in feature.blocks(ns, nu))
    return {block.name: feature for block, feature in pairs if block.is_remembered}


def _follow(rules: Mapping[str, Feature], step: Passage) -> dict[str, ca.SX]:
    return {name: feature.next_value(name, step) for name, feature in rules.items()}


@dataclass(frozen=True, eq=False)
class _RunningCost:
    """Eq. (8) times the step length, eq. (18), and what couples steps, Eq. (33) of [Manara2017]_."""

    signature: FunctionSignature
    step: StepSymbols

    @cached_property
    def _node(self) -> Callable[..., Point]:
        step = self.step
        before = step.space.layout.states.get("control")
        change = None
        if before is not None:
            change = step.units_of_u * (step.u - (step.at0[before] if step.begin is None else step.begin))
        return partial(
            Point, step.mechanics, u=step.controls, change=change, forces=step.forces, ties=step.ties
        )

    @cached_property
    def _idle(self) -> ca.SX:
        """Cost of controls that do nothing."""
        costs = (feature.idle_cost(self.step) for feature in self.signature.features)
        return sum(costs, start=ca.SX(0))

    def __call__(
        self,
        q: ca.SX,
        v: ca.SX,
        acceleration: Callable[[], ca.SX],
        share: float | None = None,
        control: ca.SX | None = None,
    ) -> ca.SX:
        step = self.step
        dt, moment = step.dt, step.moment
        if moment is not None and share is not None:
            moment += (share - step.tau) * dt
        at = self._node(q, v, acceleration=acceleration, moment=moment)
        at = at if control is None else replace(at, u=control)
        cost = between = ca.SX(0)
        for term in self.signature.cost:
            for addend in term.addends(at, step.given):
                if term.couples_steps:
                    between += self._between(addend)
                else:
                    cost += addend
        return (1 - step.is_impact) * (dt * cost + between) + self._idle

    def _between(self, addend: ca.SX) -> ca.SX:
        """What couples steps; where controls are linear it is the rate within one."""
        step = self.step
        if step.begin is not None:
            return addend / step.dt
        return step.given[HAS_BEFORE] * addend / step.spacing


def _makers(at: StepSymbols, step: StepDerivatives) -> dict[str, Callable[[], ca.Function]]:
    derivatives = step[:5]
    arguments, parameters = [at.x0, at.x1, at.y, at.inputs], [at.theta, at.rho]
    all_inputs, with_m = [*arguments, *parameters], [*arguments, at.m, *parameters]

    def function(name: str, inputs: list[ca.SX], outputs: Sequence[ca.SX]) -> ca.Function:
        return ca.Function(name, inputs, list(step.written(outputs)))

    makers: dict[str, Callable[[], ca.Function]] = {
        "values": partial(function, "values", all_inputs, derivatives[:2]),
        "gradient": partial(function, "gradient", all_inputs, derivatives[3:4]),
        "jacobian": partial(function, "jacobian", all_inputs, derivatives[:4]),
        "complete": partial(function, "complete", with_m, derivatives),
    }
    slope = step.lengthening
    if slope is not None:
        makers["lengthening"] = lambda: ca.Function("lengthening", with_m, [slope()])
    return makers


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
