"""What a formulation says of its steps: which equations they are, and all that follows from their kind.

A formulation supplies one frozen value of a class that has the attributes and methods of `Steps`. The rest of
the folder asks that value, and never which one it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

import casadi as ca

from mbocp.formulation.features.length_terms import BEGINS_PHASE, STEP_SHARE
from mbocp.formulation.features.memory import HAS_BEFORE, MEMORY, Passage, unit_of
from mbocp.formulation.features.pace_terms import ADVANCES
from mbocp.formulation.features.switch_terms import NO_SWITCHES, Switches
from mbocp.formulation.layout import StateSpace
from mbocp.integrators import control_basis
from mbocp.integrators.switched import Switched
from mbocp.mechanics import Mechanics
from mbocp.robot import Robot

__all__ = ["EquationSteps", "RunningCost", "StepDerivatives", "StepSymbols", "Steps", "within"]

_ROUND_OFF = 1e-14  # of a weight that is zero


def within(shares: Sequence[float], values: Sequence[ca.SX], share: float) -> ca.SX:
    """Value at a share of a step of the polynomial through values at shares."""
    weights = control_basis(shares, [share])[0]
    terms = [float(w) * value for w, value in zip(weights, values, strict=True) if abs(w) > _ROUND_OFF]
    return sum(terms[1:], start=terms[0])


class RunningCost(Protocol):
    """Cost of a step, evaluated at one state in it."""

    def __call__(
        self,
        q: ca.SX,
        v: ca.SX,
        acceleration: Callable[[], ca.SX],
        share: float | None = None,
        control: ca.SX | None = None,
    ) -> ca.SX:
        """Cost with the state (q, v) at a share of the step; None: where the scheme evaluates it.

        `control`: that of the share, in the user's units; None: the one of the step.
        """


class StepDerivatives(NamedTuple):
    """Rows and cost of a step with their derivatives in z = (x1, y, x0, u), at zero tangents."""

    c: ca.SX  # (ndx + ny,)
    cost: ca.SX
    dc_dz: ca.SX
    dl_dz: ca.SX
    hessian: ca.SX  # of l + m'c, its upper triangle
    lengthening: Callable[[], ca.SX] | None = None  # derivative of l + m'c in log(dt)
    written: Callable[[Sequence[ca.SX]], Sequence[ca.SX]] = list  # some of these as outputs of a function


@dataclass(frozen=True, eq=False)
class StepSymbols:
    """What the rows of a step are written in.

    Attributes
    ----------
    mechanics : Mechanics
        Equations of motion, those of `Steps.mechanics`.
    space : StateSpace
    x0, x1 : casadi.SX, shape (nx,)
        States at both ends of the step.
    d0, d1 : casadi.SX, shape (ndx,)
        Tangents there, in which derivatives are taken; the states themselves where these are flat.
    at0, at1 : casadi.SX, shape (nx,)
        The states moved along the tangents; of the first step, that before it by the moves, too.
    y : casadi.SX, shape (ny,)
        Impulses of constraints, in the unit of force.
    u : casadi.SX, shape (nu,)
        Controls of the robot at the end of the step, forces among them in the unit of force.
    values : tuple of casadi.SX, shapes (nu,)
        Their values in the step, see `control_values`; u alone where they are constant.
    own : casadi.SX, shape (k nu,)
        The controls of the programme that they come from.
    paces : casadi.SX, shape (paths,)
        Controls of the progress along paths, see `progress`.
    moves : casadi.SX, shape (moves,)
        Controls that move the start, see `moved_start`.
    w : casadi.SX, shape (nh,)
        Control of the step length, see `step_lengths`.
    dt : casadi.SX
        Length of the step [s].
    spacing : casadi.SX
        Time from the middle of the step before, by which what changes from step to step has its rate [s].
    m : casadi.SX, shape (ndx + ny,)
        Multipliers of the rows.
    units_of_u : casadi.SX, shape (nu,)
        What the equations of motion and the cost multiply u by.
    theta, rho : casadi.SX
        Parameters of the horizon and of the step.
    given : mapping of str to casadi.SX
        Pieces of theta and rho, by name.
    reactions : casadi.SX, shape (rows,)
        Forces of the constraints' rows that states remember [N, N m].
    running_cost : RunningCost
    switches : Switches
        Constraints that begin and end along the way, and impacts.
    """

    mechanics: Mechanics
    space: StateSpace
    x0: ca.SX
    x1: ca.SX
    d0: ca.SX
    d1: ca.SX
    at0: ca.SX
    at1: ca.SX
    y: ca.SX
    u: ca.SX
    values: tuple[ca.SX, ...]
    own: ca.SX
    paces: ca.SX
    moves: ca.SX
    w: ca.SX
    dt: ca.SX
    spacing: ca.SX
    m: ca.SX
    units_of_u: ca.SX
    theta: ca.SX
    rho: ca.SX
    given: Mapping[str, ca.SX]
    reactions: ca.SX
    running_cost: RunningCost
    switches: Switches = NO_SWITCHES

    @property
    def switched(self) -> Switched:
        """What acts in the step."""
        return self.switches.in_symbols(self.mechanics.nc, self.given)

    @property
    def inputs(self) -> ca.SX:
        """All controls of the programme, shape (k nu + paths + moves + nh,)."""
        return ca.vertcat(self.own, self.paces, self.moves, self.w)

    def remembering(self, s0: ca.SX, s1: ca.SX, before: Mapping[str, ca.SX]) -> Passage:
        """The step as the rules of what is remembered see it, with these speeds and memories."""
        units = {name: self.given[unit_of(name)] for name in before if MEMORY[name].has_unit}
        has_before = self.given.get(HAS_BEFORE, ca.SX(1))
        advances = self.given.get(ADVANCES, ca.SX.zeros(0, 1))
        own = (self.units_of_u, self.dt, self.spacing, has_before, before, units, self.paces, advances)
        begin = self.values[0] if self.space.layout.is_continuous else None
        return Passage(s0, s1, self.u, *own, self.reactions, self.moves, begin)

    @property
    def memory_rows(self) -> ca.SX:
        """What the state after the step has to remember, less what it does, shape (nr,)."""
        at = self.space.layout
        before = {name: self.at0[where] for name, where in at.remembered.items()}
        passage, leap = self.remembering(self.at0[at.s], self.at1[at.s], before), self.switched.is_impact
        after = {name: MEMORY[name].following(passage) for name in before}
        if self.switches.has_impacts:  # they take no time, and leave it
            left = [name for name in before if not MEMORY[name].has_impacts]
            after |= {name: (1 - leap) * after[name] + leap * before[name] for name in left}
        rows = [after[name] - self.at1[where] for name, where in at.remembered.items()]
        return ca.vertcat(ca.SX.zeros(0, 1), *rows)

    @property
    def length_rows(self) -> ca.SX:
        """h0 + e w - h1 and t0 + (h0 + e w)/N - t1, shape (nh + nt,): how long steps are from here on."""
        at = self.space.layout
        if not at.nh:
            return ca.SX.zeros(0, 1)
        length = self.at0[at.h] + self.given[BEGINS_PHASE] * self.w
        rows = length - self.at1[at.h]
        if not at.nt:
            return rows
        passed = (1 - self.switched.is_impact) * self.given[STEP_SHARE] * length
        return ca.vertcat(rows, self.at0[at.t] + passed - self.at1[at.t])

    @property
    def controls(self) -> ca.SX:
        """Controls as the equations of motion and the cost count them; those at the end of the step."""
        return self.units_of_u * self.u

    def controls_at(self, share: float) -> ca.SX:
        """Controls at a share of the step, as the equations of motion and the cost count them."""
        shares = self.space.layout.shares
        return self.units_of_u * within(shares, self.values, share) if shares else self.controls


class Steps(Protocol):
    """Steps of a formulation with some scheme."""

    @property
    def state_key(self) -> Mapping[str, Any]:
        """What tells the states apart in the cache: the words "coordinates" and "rotations"."""

    @property
    def stage_key(self) -> Mapping[str, Any]:
        """What else the functions of a step depend on: the words "scheme", "lie" and "substeps"."""

    @property
    def end_key(self) -> Mapping[str, Any]:
        """What else the functions of the end depend on: the word "scheme"."""

    @property
    def rows_are_gaps(self) -> bool:
        """Whether rows are F(x0, u) - x1, in the units of states; others balance momenta."""

    @property
    def takes_numbers(self) -> bool:
        """Whether functions take what varies of a robot as parameters, see `Robot.varying`."""

    @property
    def parameters(self) -> Mapping[str, int]:
        """Names and sizes of parameters beside step length and unit of force."""

    @property
    def tau(self) -> float:
        """Where in a step its running cost is evaluated, between 0 and 1."""

    @property
    def remedy(self) -> str:
        """What to do where the functions become too large."""

    def operations(self, nv: int) -> float:
        """Operations of a step with its derivatives, to within a factor of ten or so."""

    def mechanics(self, robot: Robot) -> Mechanics:
        """Equations of motion in the form that the steps ask for."""

    def num_algebraic(self, mechanics: Mechanics) -> int:
        """Unknowns of a step beside states and controls: multipliers of constraints."""

    def derivatives(self, symbols: StepSymbols) -> StepDerivatives:
        """Rows and cost of a step, with exact first and second derivatives."""


@dataclass(frozen=True)
class EquationSteps:
    """Steps that are equations between two states, with quaternions: what all of them have in common."""

    scheme: str

    coordinates: ClassVar[str]
    rows_are_gaps = False
    takes_numbers = True

    @property
    def state_key(self) -> Mapping[str, str]:
        """What tells the states apart."""
        return {"coordinates": self.coordinates, "rotations": "quaternion"}

    @property
    def stage_key(self) -> Mapping[str, str | int]:
        """What else the functions of a step depend on."""
        return {"scheme": self.scheme, "lie": "", "substeps": 1}

    @property
    def end_key(self) -> Mapping[str, str]:
        """What else the functions of the end depend on."""
        return {"scheme": "implicit"}

    @property
    def parameters(self) -> Mapping[str, int]:
        """None of their own."""
        return {}
