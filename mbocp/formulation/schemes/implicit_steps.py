"""Steps of the tau family: implicit schemes, whose rows are the same in joint and natural coordinates."""

from __future__ import annotations

from functools import partial

import casadi as ca

from mbocp._arrays import dataclass
from mbocp.formulation.features.accelerations import mean_acceleration
from mbocp.formulation.steps import StepDerivatives, Steps, StepSymbols
from mbocp.integrators import TAU, State, evaluation_point, step_rows
from mbocp.integrators.switched import evaluate_switched_point, write_switched_rows
from mbocp.mechanics import Mechanics, natural_mechanics
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
        at, scheme = symbols, self.scheme
        mechanics, space, layout = at.mechanics, at.space, at.space.layout
        dt, force = at.dt, at.given["force"]
        before = State(at.at0[layout.z], at.at0[layout.s])
        after = State(at.at1[layout.z], at.at1[layout.s])
        impulse, difference = force * at.y, space.configuration_difference
        states = (mechanics, scheme, before, after)
        if at.switched is not None:
            point = evaluate_switched_point(*states, dt, at.switched)
            own = (impulse, at.controls, dt, at.switched)
            rows = write_switched_rows(*states, point, *own, difference=difference)
        else:
            point = evaluation_point(*states, dt)
            rows = step_rows(*states, point, impulse, at.controls, dt, difference=difference)
        momentum = (1.0 / force) * rows.momentum
        c = ca.densify(ca.vertcat(rows.kinematic, momentum, at.memory_rows, at.own_rows, rows.constraint))
        cost = at.running_cost(point.q, point.v, partial(mean_acceleration, mechanics, before, after, dt))
        z = ca.vertcat(at.d1, at.y, at.d0, at.inputs)
        hessian, _ = ca.hessian(cost + ca.dot(at.m, c), z)
        derivatives = [c, cost, ca.jacobian(c, z), ca.jacobian(cost, z), ca.triu(hessian)]
        others = [at.y, at.inputs, at.m, at.theta, at.rho]
        c, cost, dc_dz, dl_dz, hessian = space.at_zero_tangents(
            [at.x0, at.x1], derivatives, others, [at.d0, at.d1]
        )
        return StepDerivatives(c, cost, dc_dz, dl_dz, hessian)


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
