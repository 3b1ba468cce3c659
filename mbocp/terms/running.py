"""The terms of the running cost."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp._keys import Key, Table
from mbocp.mechanics import Mechanics
from mbocp.mechanics.forces import controls_beside, controls_for
from mbocp.terms.cost import (
    CostTableReader,
    CostWeights,
    RunningCost,
    TermNumbers,
    WeightedCost,
    half_square,
    shortest,
)
from mbocp.terms.point import Point, Sizes
from mbocp.terms.written import ControlOrAuto, ControlWeights, Finite, NonNegative, TargetTable, Weights


@dataclass(frozen=True)
class Effort(WeightedCost):
    """Second term of Eq. (8), with a weight for each control."""

    key = "effort"
    over = "u"

    class Keys(Table):
        """Keys."""

        effort: Annotated[
            ControlWeights, Key("alpha; 0 only where a control has a `control_rate` or limits")
        ] = 1.0

    @classmethod
    def of(cls, given: TermNumbers) -> Effort:
        """Always there: a weight of zero is one, too."""
        return cls()

    @classmethod
    def write(cls, cost: CostWeights) -> dict[str, Any]:
        """The weights, zero or not."""
        return {"effort": shortest(np.asarray(cost.weight("effort")))}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Half the weighted square of the controls."""
        return half_square(p["effort"], at.control)


@dataclass(frozen=True)
class Tracking(RunningCost):
    """First term of Eq. (8), with diagonal weights; configurations are compared in the tangent space.

    Attributes
    ----------
    q, p : bool
        Whether configurations and momenta have weights.
    parts : tuple of int or None
        Parts of the configuration space that have; None: all.
    """

    q: bool
    p: bool
    parts: tuple[int, ...] | None = None

    key = "tracking"

    class Keys(Table):
        """Keys."""

        tracking: Annotated[NonNegative, Key("beta")] = 0.0
        tracking_weights: Annotated[
            Weights | None,
            Key("diagonal of Q on (q, p)", default="1 where the target says something", weight="tracking"),
        ] = None
        target: Annotated[
            TargetTable | None,
            Key(
                "y_d: one row, or one for every step",
                default="the goal",
                takes="table with `q` and `p`",
                weight="tracking",
            ),
        ] = None
        target_file: Annotated[
            str | None,
            Key(
                "y_d from a result, or a CSV table with the columns `t`, `q:NAME`, `p:NAME`",
                takes="path",
                weight="tracking",
            ),
        ] = None

    @classmethod
    def of(cls, given: TermNumbers) -> Tracking | None:
        """The term where a weight is not zero."""
        nv, weights = given.robot.nv, _find_tracking_weights(given.cost)
        q, p = bool(np.any(weights[:nv])), bool(np.any(weights[nv:]))
        return cls(q, p, given.joints.find_weighed_parts(weights[:nv])) if q or p else None

    @classmethod
    def read(cls, table: Any, reader: CostTableReader) -> dict[str, Any]:
        """Weight, weights, targets."""
        target_q, target_p, given = reader.targets(table.target, table.target_file)
        key = "cost.tracking_weights"
        weights = reader.on_states(table.tracking_weights, given, key)
        if table.tracking > 0.0:
            reader.check_weighed(weights, given, key, "cost.target (or the goal)")
        return {
            "tracking": table.tracking,
            "tracking_weights": weights,
            "target_q": target_q,
            "target_p": target_p,
        }

    @classmethod
    def write(cls, cost: CostWeights) -> dict[str, Any]:
        """The weight, and where it is not zero weights and targets as numbers."""
        if not cost.weight("tracking") > 0.0:
            return {"tracking": cost.weight("tracking")}
        return {
            "tracking": cost.weight("tracking"),
            "tracking_weights": cost.weight("tracking_weights"),
            "target": {"q": cost.weight("target_q"), "p": cost.weight("target_p")},
        }

    def parameters(self, sizes: Sizes) -> dict[str, int]:
        """Diagonals of beta Q."""
        return dict.fromkeys(self.weights, sizes.joint_nv)

    @property
    def weights(self) -> tuple[str, ...]:
        """Both diagonals."""
        return (*(("weight_q",) if self.q else ()), *(("weight_p",) if self.p else ()))

    def stage_parameters(self, sizes: Sizes) -> dict[str, int]:
        """What each step is compared with."""
        targets = {"target_q": sizes.joint_nz} if self.q else {}
        return targets | ({"target_p": sizes.joint_nv} if self.p else {})

    def numbers(self, given: TermNumbers) -> dict[str, Array]:
        """Diagonals of beta Q."""
        nv, weights = given.robot.nv, _find_tracking_weights(given.cost)
        return {"weight_q": weights[:nv], "weight_p": weights[nv:]}

    def stage_numbers(self, given: TermNumbers) -> dict[str, Array]:
        """What each step is compared with."""
        joints, rows = given.joints, {}
        if self.q:
            target_q = joints.coordinates(np.atleast_2d(given.cost.weight("target_q")))
            rows["target_q"] = np.broadcast_to(target_q, (given.num_steps, joints.nz))
        if self.p:
            target_p = np.asarray(given.cost.weight("target_p"))
            rows["target_p"] = np.broadcast_to(target_p, (given.num_steps, given.robot.nv))
        return rows

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Half the weighted square of the distance."""
        return sum(self.addends(at, p), ca.SX(0))

    def addends(self, at: Point, p: Mapping[str, ca.SX]) -> list[ca.SX]:
        """The parts of configurations and momenta."""
        found = []
        if self.q:
            error = at.joint_difference(p["target_q"], self.parts)
            found.append(half_square(p["weight_q"], error))
        if self.p:
            error = at.joint_momentum() - p["target_p"]
            found.append(half_square(p["weight_p"], error))
        return found

    def touches(self, given: TermNumbers) -> BoolArray:
        """Components with a weight."""
        return _find_tracking_weights(given.cost) != 0.0


def _find_tracking_weights(cost: CostWeights) -> Array:
    return cost.weight("tracking") * np.asarray(cost.weight("tracking_weights"))


@dataclass(frozen=True)
class Velocity(WeightedCost):
    """Half the weighted square of the velocities of the joints."""

    key = "velocity"
    over = "v"

    class Keys(Table):
        """Keys."""

        velocity: Annotated[
            ControlOrAuto,
            Key(
                'W; `"auto"`: [from forces and duration](#a-problem-without-cost)',
                default='0; `"auto"` without [cost]',
            ),
        ] = None

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Half the weighted square."""
        return half_square(p["velocity"], at.joint_velocity())


@dataclass(frozen=True)
class Potential(WeightedCost):
    """Second term of Eq. (33) of [Manara2017]_: energy of gravity and of the force elements [J]."""

    key = "potential"
    over = ""
    is_signed = True

    class Keys(Table):
        """Keys."""

        potential: Annotated[
            Finite,
            Key("of the [potential energy](#smooth-controls-and-potential-energy), of any sign", "1/J"),
        ] = 0.0

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """The weighted energy."""
        return p["potential"] * at.mechanics.potential_energy(at.q)


@dataclass(frozen=True)
class EffortAboutGravity(WeightedCost):
    """Efforts beyond those that hold the weight: u less the smallest nearest to B u + J' lambda = g(q).

    Closed loops, holds and feet that stand push with what forces J' lambda they like. Where all of these
    cannot hold the weight, as in the air, what is left over is least in its squares.
    """

    key = "effort_about_gravity"
    over = "u"

    class Keys(Table):
        """Keys."""

        effort_about_gravity: Annotated[
            ControlWeights,
            Key("on squares of the controls less what holds the weight, beside loops, holds and feet"),
        ] = 0.0

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Half the weighted square of the differences."""
        return half_square(p[self.key], at.control - self._compute_holding_controls(at))

    @staticmethod
    def _compute_holding_controls(at: Point) -> ca.SX:
        mechanics = at.mechanics
        weight, (ties, acts) = mechanics.gravity(at.q), at.constraints()
        weight, actuation = _at_motors(mechanics, weight), mechanics.robot.actuation
        if actuation.is_constant and not acts.numel():
            return controls_for(mechanics, weight)
        pushes, ties = _at_motors(mechanics, at.pushes()), _at_motors(mechanics, ties.T).T
        return controls_beside(actuation.lengths, pushes, ties, acts, weight)


def _at_motors(mechanics: Mechanics, forces: ca.SX) -> ca.SX:
    """Columns of forces at rest, where springs of elastic joints hand those on links on to the motors."""
    handed = ca.SX(forces)
    for joint in mechanics.robot.elastic:
        link, motor = joint.at_v
        handed[motor, :] += handed[link, :]
        handed[link, :] = 0
    return handed


@dataclass(frozen=True)
class ControlRate(WeightedCost):
    """Third term of Eq. (33) of [Manara2017]_, from the second step on."""

    key = "control_rate"
    over = "u"
    couples_steps = True

    class Keys(Table):
        """Keys."""

        control_rate: Annotated[
            ControlWeights,
            Key("on the [rates of the controls](#smooth-controls-and-potential-energy)", "s^2"),
        ] = 0.0

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Half the weighted square of the change."""
        return half_square(p["control_rate"], at.control_change)


@dataclass(frozen=True)
class Acceleration(WeightedCost):
    """Half the weighted square of the accelerations of the joints: the mean of a step, (v_n - v_{n-1}) / dt.

    Explicit schemes take the acceleration at the beginning of the step. Where controls vary within steps, it
    is the derivative of the velocity at each stage.
    """

    key = "acceleration"
    over = "v"

    class Keys(Table):
        """Keys."""

        acceleration: Annotated[ControlWeights, Key("on accelerations of joints", default="0")] = None

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Half the weighted square."""
        return half_square(p["acceleration"], at.joint_acceleration())


@dataclass(frozen=True)
class ConstraintForce(WeightedCost):
    """Half the weighted square of the forces of constraints: of feet that stand, holds and closed loops."""

    key = "constraint_force"

    class Keys(Table):
        """Keys."""

        constraint_force: Annotated[
            NonNegative, Key("on squares of the [forces of feet](contact.md#costs), holds and closed loops")
        ] = 0.0

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Half the weighted square, by components."""
        return p[self.key] * ca.sumsqr(at.constraint_forces()) / 2


@dataclass(frozen=True)
class Fuel(WeightedCost):
    """The weighted controls themselves: what jets burn, which push and cannot pull.

    Linear in the controls: an optimum switches them between their limits, which have to be finite below.
    """

    key = "fuel"
    over = "u"

    class Keys(Table):
        """Keys."""

        fuel: Annotated[
            ControlWeights, Key("on controls that are limited from below, not on their squares")
        ] = 0.0

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Weights times controls."""
        return ca.dot(p["fuel"], at.control)
