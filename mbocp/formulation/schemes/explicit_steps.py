"""Steps of explicit Runge-Kutta schemes: rows F(x0, u) - x1, differentiated link by link."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import casadi as ca

from mbocp._arrays import dataclass
from mbocp.formulation.features.accelerations import rate_of_speeds
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.steps import StepDerivatives, Steps, StepSymbols
from mbocp.integrators import TABLEAUX
from mbocp.integrators.chain import Affine, Chain
from mbocp.integrators.runge_kutta import CoordinateState, ExplicitStep, Gains
from mbocp.mechanics import Mechanics, symbols_of
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.robot import Robot

_OPERATIONS = 3000  # of "complete" by nv^2 and stage of the method


@dataclass(frozen=True)
class ExplicitSteps(Steps):
    """Maps from a state to the next one; see `Steps`.

    Attributes
    ----------
    scheme : str
        Name of its tableau.
    rotations : {"quaternion", "dcm"}
        Coordinates of attitudes.
    lie : {"plain", "baumgarte", "munthe_kaas"}
        How attitudes are integrated.
    substeps : int
        Steps of equal length in each.
    """

    rotations: str
    lie: str
    substeps: int

    rows_are_gaps = True
    tau = 0.0

    @property
    def state_key(self) -> Mapping[str, str]:
        """What tells the states apart."""
        return {"coordinates": self.coordinates, "rotations": self.rotations}

    @property
    def stage_key(self) -> Mapping[str, str | int]:
        """What else the functions of a step depend on."""
        return {"scheme": self.scheme, "lie": self.lie, "substeps": self.substeps}

    @property
    def parameters(self) -> Mapping[str, int]:
        """Rates of the stabilisation."""
        return {"gains": 3}

    @property
    def remedy(self) -> str:
        """What to do where the functions become too large."""
        if self.substeps > 1:
            return f"Take fewer integrator.substeps than {self.substeps} and more horizon.steps"
        return "Lock joints"

    def operations(self, nv: int) -> float:
        """Second derivatives of a tree are dense, and repeated for each slope of each substep."""
        in_one = float(_OPERATIONS * nv**2 * TABLEAUX[self.scheme].num_stages)
        return in_one * min(self.substeps, 10**100)

    def mechanics(self, robot: Robot) -> Mechanics:
        """Forward dynamics."""
        return ForwardMechanics(robot, self.rotations, numbers=symbols_of(robot))

    def num_algebraic(self, mechanics: Mechanics, num_held: int) -> int:
        """None: accelerations are projected, and multipliers no unknowns."""
        return 0

    def derivatives(self, symbols: StepSymbols) -> StepDerivatives:
        """Rows and cost of a step, with exact first and second derivatives."""
        mechanics, linked = symbols.mechanics, symbols.mechanics_of_links
        if not (isinstance(mechanics, ForwardMechanics) and isinstance(linked, ForwardMechanics)):
            raise TypeError("an explicit scheme needs ForwardMechanics")
        is_free = symbols.has_free_length
        step = ExplicitStep(linked, self.scheme, self.lie, self.substeps, is_free=is_free)
        return _explicit_derivatives(mechanics, step, symbols)


def _explicit_derivatives(
    mechanics: ForwardMechanics, step: ExplicitStep, at: StepSymbols
) -> StepDerivatives:
    """F(x0, u) - x1, and the cost at the beginning of the step as in Eq. (39) of [Manara2017]_.

    `mechanics`: those of the cost; links have their own, see `StepSymbols.linked`.
    """
    space, layout, gains = at.space, at.space.layout, at.given["gains"]
    unknowns = ca.vertcat(at.d1, at.d0, at.inputs)
    chain = Chain(unknowns if layout.is_flat else ca.vertcat(ca.SX.zeros(2 * layout.ndx), at.inputs))
    root = chain.root()
    d1, d0, inputs = root.split(layout.ndx, layout.ndx, at.inputs.numel())
    controls = {name: inputs.take(where) for name, where in layout.controls.items()}
    u = controls["own"]
    before = _state(chain, mechanics, layout, _from_start(chain, at, d0, controls), at.x0)
    after = _state(chain, mechanics, layout, d1, at.x1)
    units = ca.diag(at.units_of_u)
    pushed = Affine(units @ u.value, {k: units @ matrix for k, matrix in u.parts.items()})
    dt, between = (
        Affine(length, {0: ca.jacobian(length, unknowns)}) if at.has_free_length else length
        for length in (at.dt, at.spacing)
    )
    if at.found.numel():
        pushed = Affine.join([pushed, Affine(at.found, {0: ca.jacobian(at.found, unknowns)})])
    reached = step(chain, before, pushed, dt, Gains(gains[0], gains[1], gains[2]))
    if layout.is_flat:
        kinematic = reached.z - after.z
    else:
        (kinematic,) = chain.apply(_differences(mechanics), [after.z, reached.z])
    pieces = [kinematic, reached.s - after.s]
    if layout.nr:
        kept = d1.take(layout.dr)
        moving = (before.s, reached.s, d0.take(layout.dr))
        following = _memory_after(chain, at, moving, controls, (dt, between))
        pieces.append(following - (kept if layout.is_flat else kept + at.x1[layout.r]))
    if at.own_rows.numel():
        pieces.append(Affine(at.own_rows, {0: ca.jacobian(at.own_rows, unknowns)}))
    c = Affine.join(pieces)
    q, s = at.at0[layout.z], at.at0[layout.s]
    acceleration = partial(rate_of_speeds, mechanics, q, s, at.controls, gains[2])
    cost = at.running_cost(q, mechanics.velocity(q, s, at.controls), acceleration)
    slope = ca.jacobian(cost, unknowns)
    curvature, _ = ca.hessian(cost, unknowns)
    cost, slope, curvature = space.at_zero_tangents(
        [at.x0, at.x1], [cost, slope, curvature], [at.inputs, at.theta, at.rho], [at.d0, at.d1]
    )
    hessian = ca.triu(curvature + chain.hessian(c, at.m))
    return StepDerivatives(ca.densify(c.value), cost, chain.jacobian(c), slope, hessian)


def _state(chain: Chain, mechanics: Mechanics, at: StateLayout, d: Affine, x: ca.SX) -> CoordinateState:
    """State moved along the tangent d."""
    if at.is_flat:
        return CoordinateState(d.take(at.z), d.take(at.s))
    (z,) = chain.apply(_retraction(mechanics), [d.take(slice(at.nw))], [x[at.z]])
    return CoordinateState(z, d.take(at.ds) + x[at.s])


def _from_start(chain: Chain, at: StepSymbols, d: Affine, controls: Mapping[str, Affine]) -> Affine:
    """The tangent d, or the state d where states are flat, with the move of the start in the first step."""
    layout = at.space.layout
    if at.start_move is None:
        return d
    moves = controls["moves"]
    x, w = ca.SX.sym("x", layout.ndx), ca.SX.sym("w", moves.value.numel())
    move = at.start_move(w)
    if not layout.is_flat:
        moved = x + ca.vertcat(move, ca.SX.zeros(layout.ndx - move.numel()))
    else:
        moved = at.space.move(x, ca.SX.zeros(layout.ndx), move)
    function = ca.Function("moved", [x, w, at.rho], [ca.densify(moved)])
    return chain.apply(function, [d, moves], [at.rho])[0]


def _memory_after(
    chain: Chain,
    at: StepSymbols,
    moving: tuple[Affine, Affine, Affine],
    controls: Mapping[str, Affine],
    lengths: tuple[Affine | ca.SX, Affine | ca.SX],
) -> Affine:
    """What the state after the step has to remember.

    `moving`: speeds before and after, and what is remembered.
    """
    layout = at.space.layout
    s0, s1, d = (ca.SX.sym("of", piece.value.numel()) for piece in moving)
    inputs = {name: ca.SX.sym(name, piece.value.numel()) for name, piece in controls.items()}
    r = d if layout.is_flat else d + at.x0[layout.r]
    step, between, start = ca.SX.sym("dt"), ca.SX.sym("spacing"), layout.r.start
    remembered = [block.name for block in layout.blocks if block.is_remembered]
    places = {name: layout.states[name] for name in remembered}
    before = {name: r[where.start - start : where.stop - start] for name, where in places.items()}
    passage = replace(
        at.passage_with(s0, s1, before), u=inputs["own"], dt=step, spacing=between, controls=inputs
    )
    rows = ca.vertcat(*at.follow(passage).values())
    given = [at.x0, at.theta, at.rho]
    own, *more = inputs.values()
    symbols = [s0, s1, own, d, *more, step, between]
    function = ca.Function("remembered", [*symbols, *given], [ca.densify(rows)])
    of_unknowns = [length for length in lengths if isinstance(length, Affine)]
    numbers = [length for length in lengths if not isinstance(length, Affine)]
    own_value, *more_values = controls.values()
    speeds, memory = moving[:2], moving[2]
    arguments = [*speeds, own_value, memory, *more_values, *of_unknowns]
    return chain.apply(function, arguments, [*numbers, *given])[0]


def _retraction(mechanics: Mechanics) -> ca.Function:
    d, z = ca.SX.sym("d", mechanics.nv), ca.SX.sym("z", mechanics.nq)
    return ca.Function("retraction", [d, z], [ca.densify(mechanics.integrate(z, d))])


def _differences(mechanics: Mechanics) -> ca.Function:
    z0, z1 = ca.SX.sym("z0", mechanics.nq), ca.SX.sym("z1", mechanics.nq)
    return ca.Function("differences", [z0, z1], [ca.densify(mechanics.difference(z0, z1))])
