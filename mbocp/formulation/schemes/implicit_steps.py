"""Steps of the tau family: implicit schemes, whose rows are the same in joint and natural coordinates."""

from __future__ import annotations

from functools import partial

import casadi as ca

from mbocp._arrays import dataclass
from mbocp.formulation.features.accelerations import mean_acceleration
from mbocp.formulation.steps import StepDerivatives, Steps, StepSymbols, Unknowns
from mbocp.integrators import TAU, State, evaluation_point, step_rows
from mbocp.integrators.euler import StepRows
from mbocp.integrators.projection import write_projection_rows
from mbocp.integrators.switched import evaluate_switched_point, write_switched_rows
from mbocp.mechanics import JointMechanics, Mechanics, natural_mechanics
from mbocp.robot import Robot

_OPERATIONS = 525  # of "complete" by nv^2, with arms and chains
_OPERATIONS_BY_COORDINATE = 400  # of "complete" of bodies: they grow with their number


@dataclass(frozen=True)
class ImplicitSteps(Steps):
    """Equations between two states in joint coordinates; see `Steps`."""

    remedy = 'Take coordinates = "natural", or lock joints'

    @property
    def tau(self) -> float:
        """Where in a step its running cost is evaluated."""
        return TAU[self.scheme]

    def operations(self, nv: int) -> float:
        """Second derivatives of a tree are dense."""
        return float(_OPERATIONS * nv**2)

    def derivatives(self, symbols: StepSymbols) -> StepDerivatives:
        """Kinematics, momentum balance, memory and constraints, with exact first and second derivatives."""
        at, space, layout = symbols, symbols.space, symbols.space.layout
        force = at.given["force"]
        before = State(at.at0[layout.z], at.at0[layout.s])
        after = State(at.at1[layout.z], at.at1[layout.s])
        point, rows = self._write_rows(at, before, after)
        momentum = (1.0 / force) * rows.momentum
        c = ca.densify(ca.vertcat(rows.kinematic, momentum, at.memory_rows, at.own_rows, rows.constraint))
        cost = self._write_cost(at, before, after, point)
        z = ca.vertcat(at.d1, at.y, at.d0, at.inputs)
        hessian, _ = ca.hessian(cost + ca.dot(at.m, c), z)
        derivatives = [c, cost, ca.jacobian(c, z), ca.jacobian(cost, z), ca.triu(hessian)]
        others = [at.y, at.inputs, at.m, at.theta, at.rho]
        c, cost, dc_dz, dl_dz, hessian = space.at_zero_tangents(
            [at.x0, at.x1], derivatives, others, [at.d0, at.d1]
        )
        return StepDerivatives(c, cost, dc_dz, dl_dz, hessian)

    def _write_cost(self, at: StepSymbols, before: State, after: State, point: State) -> ca.SX:
        acceleration = partial(mean_acceleration, at.mechanics, before, after, at.dt)
        return at.running_cost(point.q, point.v, acceleration)

    def _write_rows(self, at: StepSymbols, before: State, after: State) -> tuple[State, StepRows]:
        """Where forces are evaluated, and the rows of the step."""
        return self._write_own_rows(at, before, after, at.given["force"] * at.y)

    def _write_own_rows(
        self, at: StepSymbols, before: State, after: State, impulse: ca.SX
    ) -> tuple[State, StepRows]:
        difference = at.space.configuration_difference
        states = (at.mechanics, self.scheme, before, after)
        if at.switched is not None:
            point = evaluate_switched_point(*states, at.dt, at.switched)
            own = (impulse, at.controls, at.dt, at.switched)
            return point, write_switched_rows(*states, point, *own, difference=difference)
        point = evaluation_point(*states, at.dt)
        return point, step_rows(*states, point, impulse, at.controls, at.dt, difference=difference)


@dataclass(frozen=True)
class ProjectedSteps(ImplicitSteps):
    """Steps whose velocities are projected onto the constraints at their end.

    Unknowns are the leap of the velocity, the impulses of the step, and those of the projection, with the
    balance of the leap, Phi / dt, and J v as rows.
    """

    remedy = 'Take scheme = "midpoint", or lock joints'

    def operations(self, nv: int) -> float:
        """Those of a step, and of a momentum with its derivatives."""
        return 2.0 * super().operations(nv)

    def num_algebraic(self, mechanics: Mechanics, num_held: int) -> int:
        """None where nothing is to be projected."""
        rows = mechanics.nc + num_held
        return mechanics.nv + 2 * rows if rows else 0

    def impulses_of(self, unknowns: Unknowns, num_rows: int) -> Unknowns:
        """Sum of both."""
        first = unknowns.shape[0] - 2 * num_rows
        return unknowns[first : first + num_rows] + unknowns[first + num_rows :]

    def _write_cost(self, at: StepSymbols, before: State, after: State, point: State) -> ca.SX:
        """The mean of both ends: a mean velocity would not see what alternates from node to node."""
        acceleration = partial(mean_acceleration, at.mechanics, before, after, at.dt)
        first = at.running_cost(*before, acceleration, share=0.0)
        return (first + at.running_cost(*after, acceleration, share=1.0)) / 2

    def _write_rows(self, at: StepSymbols, before: State, after: State) -> tuple[State, StepRows]:
        if not at.y.numel():
            return super()._write_rows(at, before, after)
        if not isinstance(at.mechanics, JointMechanics):
            raise TypeError("a projection needs JointMechanics")
        force, nv = at.given["force"], at.mechanics.nv
        half = (at.y.numel() - nv) // 2
        leap, impulse, last = ca.vertsplit(at.y, [0, nv, nv + half, at.y.numel()])
        landed = State(after.q, after.v + leap)
        point, rows = self._write_own_rows(at, before, landed, force * impulse)
        projection = write_projection_rows(at.mechanics, after, leap, force * last, at.switched)
        balance = (1.0 / force) * projection.balance
        return point, rows._replace(constraint=ca.vertcat(balance, rows.constraint, projection.drift))


@dataclass(frozen=True)
class NaturalSteps(ImplicitSteps):
    """Equations between two states of the bodies; those of rigid bodies and joints are constraints, too."""

    coordinates = "natural"
    takes_numbers = False
    remedy = "Lock joints"

    def operations(self, nv: int) -> float:
        """Bodies know their neighbours alone."""
        return float(_OPERATIONS_BY_COORDINATE * nv)

    def mechanics(self, robot: Robot) -> Mechanics:
        """Equations of motion of the bodies."""
        return natural_mechanics(robot)
