"""Stage functions of a problem's signature, with exact first and second derivatives.

A state is x = (z, s, r, h, t): coordinates of the configuration, speeds, what it remembers of the step before
for terms that ask for it, the length of the steps where it is free, and the time where there are several.
Derivatives are taken along the retraction x -> (z exp(dq), s + ds, r + dr, h + dh, t + dt) at dx = 0, so that
every Newton update stays on the joints' Lie group; or, where the signature is flat, in the coordinates
themselves. Where the start is free, the first state is moved first, see
`mbocp.formulation.features.moved_start`.

Inputs and outputs (see `mbocp/_native/kernel/kind.hpp`):

- values    (x0, x1, y, u, theta, rho)      -> c, l
- gradient  (x0, x1, y, u, theta, rho)      -> dl_dz; z = (x1, y, x0, u)
- jacobian  (x0, x1, y, u, theta, rho)      -> c, l, dc_dz, dl_dz
- complete  (x0, x1, y, u, m, theta, rho)   -> c, l, dc_dz, dl_dz, upper Hessian of l + m'c
- path      (x1, m, u, theta)               -> h, dh_dx1, upper Hessian of m'h in x1; with path constraints
- path_values (x1, u, theta)                -> h; likewise
- lengthening (x0, x1, y, u, m, theta, rho) -> derivative of l + m'c in log(dt); of some schemes
- retract   (x, dx) -> x, and its inverse, difference (x, x_moved) -> dx

A solve by Newton's method asks for none of `gradient`, `jacobian` and `lengthening`, but for a few first
derivatives, which `complete` has as well: so these are compiled when a solver asks for them.

The rows of c are kinematics, momentum balance (or speeds), memory, step length, constraints. Which
equations these are is for the formulation's `Steps` to say. Controls that are forces, y and the momentum
balance count in a unit of force that is one of the parameters, see `Units`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import casadi as ca

from mbocp.formulation.features.length_terms import (
    BEGINS_PHASE,
    SPACING,
    STEP_SHARE,
    STRETCH,
    idle_cost,
    spacing,
)
from mbocp.formulation.features.memory import HAS_BEFORE
from mbocp.formulation.features.pace_terms import ADVANCES, resting_cost
from mbocp.formulation.features.reaction_terms import reaction_places
from mbocp.formulation.features.switch_terms import IS_IMPACT, idle_impact
from mbocp.formulation.layout import StateLayout, StateSpace, start_move
from mbocp.formulation.parameters import (
    TIME,
    Sizes,
    parameter_layout,
    pieces,
    share_of,
    symbols_for,
)
from mbocp.formulation.path import build_path, build_path_values
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.steps import StepDerivatives, StepSymbols, within
from mbocp.mechanics import Mechanics
from mbocp.terms import Point

__all__ = ["AT_EVERY_STEP", "LATER", "build_first_functions", "build_functions", "state_space"]

# Functions that are asked at all steps at once; the others follow a motion step by step.
AT_EVERY_STEP = ("values", "complete", "path", "path_values", "retract")
LATER = ("gradient", "jacobian", "lengthening")
_ALL = (*AT_EVERY_STEP, "difference", *LATER)
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
    mechanics, at = space.configurations, space.layout
    ny = signature.steps.num_algebraic(mechanics) + signature.switches.num_held
    layout = parameter_layout(signature, Sizes.of(mechanics))
    theta = symbols_for("theta", layout.theta, mechanics.numbers)
    rho = ca.SX.sym("rho", sum(layout.stage.values()))
    x0, x1 = ca.SX.sym("x0", at.nx), ca.SX.sym("x1", at.nx)
    d0, d1, at0, at1 = x0, x1, x0, x1
    if not at.is_flat:
        d0, d1 = ca.SX.sym("d0", at.ndx), ca.SX.sym("d1", at.ndx)
        at0, at1 = space.retract(x0, d0), space.retract(x1, d1)
    sizes = {"u": at.num_own, "w": at.nh, "paces": at.num_paces, "moves": at.num_moves}
    own, w, paces, moves = (ca.SX.sym(n, k) for n, k in sizes.items())
    given = {**pieces(theta, layout.theta), **pieces(rho, layout.stage)}
    given |= {name: given[name] * given[share_of(name)] for name in signature.varying}
    values = _values(at, own, at0, given)
    u = within(at.shares, values, 1.0) if at.shares else own
    if at.num_moves:
        along = ca.SX.zeros(at.ndx) if at.is_flat else d0
        at0 = space.moved(x0, along, start_move(at, 1 - given[HAS_BEFORE], moves))
    num_drives = len(mechanics.robot.drives)  # at the end of u; what they prescribe is no force
    units_of_u = ca.vertcat(ca.repmat(given["force"], mechanics.nu - num_drives), ca.SX.ones(num_drives))
    # As a linear row of the step makes it equal to h1 it could be that, but explicit steps know h0 alone.
    stretched = at0[at.h] + given[BEGINS_PHASE] * w if at.nh else ca.SX(1)
    moment = given.get(TIME)
    moment = None if moment is None else stretched * moment
    stretched = given.get(STRETCH, stretched)
    dt = stretched * given["dt"]
    between = given[SPACING] * given["dt"] if signature.has_unequal_lengths else dt
    if at.nt:
        moment = at0[at.t] * given["dt"] / given[STEP_SHARE] + signature.steps.tau * dt
        between = spacing(at0[at.h], stretched, given.get(HAS_BEFORE, ca.SX(1))) * given["dt"]
    controls = units_of_u * u
    before = at.remembered.get("control")
    begins = values[0] if at.is_continuous or before is None else at0[before]
    change = None if before is None else units_of_u * (u - begins)
    node = partial(Point, mechanics, u=controls, change=change)
    idle = idle_cost(given[BEGINS_PHASE], w) if at.nh else ca.SX(0)
    idle += resting_cost(given[ADVANCES], paces) if at.num_paces else ca.SX(0)
    leap = given.get(IS_IMPACT, ca.SX(0))
    idle += idle_impact(leap, u) if signature.switches.has_impacts else ca.SX(0)
    idle += given[HAS_BEFORE] * ca.sumsqr(own[: at.nu]) / 2.0 if at.is_continuous else ca.SX(0)
    y = ca.SX.sym("y", ny)
    idle += given[HAS_BEFORE] * ca.sumsqr(moves) / 2.0 if at.num_moves else ca.SX(0)
    return StepSymbols(
        mechanics=mechanics,
        space=space,
        x0=x0,
        x1=x1,
        d0=d0,
        d1=d1,
        at0=at0,
        at1=at1,
        y=y,
        u=u,
        values=values,
        own=own,
        paces=paces,
        moves=moves,
        w=w,
        dt=dt,
        spacing=between,
        m=ca.SX.sym("m", at.ndx + ny),
        units_of_u=units_of_u,
        theta=theta,
        rho=rho,
        given=given,
        reactions=given["force"] * y[reaction_places(mechanics, signature.reactions)] / dt,
        running_cost=_RunningCost(signature, node, given, dt, between, idle, leap, moment),
        switches=signature.switches,
    )


def _values(at: StateLayout, own: ca.SX, at0: ca.SX, given: Mapping[str, ca.SX]) -> tuple[ca.SX, ...]:
    """Values of the robot's controls in the step, see `control_values`."""
    values = [own[i * at.nu : (i + 1) * at.nu] for i in range(at.num_values)]
    if at.is_continuous:
        has_before = given[HAS_BEFORE]
        values[0] = (1 - has_before) * values[0] + has_before * at0[at.remembered["control"]]
    return tuple(values)


@dataclass(frozen=True, eq=False)
class _RunningCost:
    """Eq. (8) times the step length, eq. (18), and what couples steps, Eq. (33) of [Manara2017]_."""

    signature: FunctionSignature
    node: Callable[..., Point]
    given: Mapping[str, ca.SX]
    dt: ca.SX
    spacing: ca.SX
    idle: ca.SX  # cost of a control that does nothing
    is_impact: ca.SX
    moment: ca.SX | None  # at which a step is evaluated, at its share tau [s]

    def __call__(
        self,
        q: ca.SX,
        v: ca.SX,
        acceleration: Callable[[], ca.SX],
        share: float | None = None,
        control: ca.SX | None = None,
    ) -> ca.SX:
        dt, moment = self.dt, self.moment
        if moment is not None and share is not None:
            moment += (share - self.signature.steps.tau) * dt
        at = self.node(q, v, acceleration=acceleration, moment=moment)
        at = at if control is None else replace(at, u=control)
        cost = between = ca.SX(0)
        for term in self.signature.cost:
            for addend in term.addends(at, self.given):
                if term.couples_steps:
                    between += self._between(addend)
                else:
                    cost += addend
        return (1 - self.is_impact) * (dt * cost + between) + self.idle

    def _between(self, addend: ca.SX) -> ca.SX:
        """What couples steps; where controls are linear it is the rate within one."""
        if self.signature.has_linear_controls:
            return addend / self.dt
        return self.given[HAS_BEFORE] * addend / self.spacing


def _makers(at: StepSymbols, step: StepDerivatives) -> dict[str, Callable[[], ca.Function]]:
    derivatives = step[:5]
    arguments, parameters = [at.x0, at.x1, at.y, at.inputs], [at.theta, at.rho]
    all_inputs, with_m = [*arguments, *parameters], [*arguments, at.m, *parameters]

    def function(name: str, inputs: list[ca.SX], outputs: Sequence[ca.SX]) -> ca.Function:
        return ca.Function(name, inputs, ca.cse(list(step.written(outputs))))

    makers: dict[str, Callable[[], ca.Function]] = {
        "values": partial(function, "values", all_inputs, derivatives[:2]),
        "gradient": partial(function, "gradient", all_inputs, derivatives[3:4]),
        "jacobian": partial(function, "jacobian", all_inputs, derivatives[:4]),
        "complete": partial(function, "complete", with_m, derivatives),
    }
    slope = step.lengthening
    if slope is not None:
        makers["lengthening"] = lambda: ca.Function("lengthening", with_m, ca.cse([slope()]))
    return makers
