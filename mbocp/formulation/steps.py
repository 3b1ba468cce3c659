"""What a formulation says of its steps: which equations they are, and all that follows from their kind.

A formulation supplies one frozen value of a class of `Steps`. The rest of the folder asks that value, and
never which one it is.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import NamedTuple, Protocol, TypeVar

import casadi as ca

from mbocp._arrays import Array, dataclass
from mbocp.formulation.layout import StateSpace
from mbocp.formulation.motion import Passage
from mbocp.integrators import control_basis
from mbocp.integrators.switched import ActiveForces
from mbocp.mechanics import JointMechanics, Mechanics, symbols_of
from mbocp.mechanics.held_frames import write_held_jacobian
from mbocp.robot import Robot

Unknowns = TypeVar("Unknowns", ca.SX, Array)

HAS_BEFORE = "has_before"  # the stage parameter: 1 in steps that have one before them, else 0

_ROUND_OFF = 1e-14  # of a weight that is zero


def unit_of(name: str) -> str:
    """Return the name of the parameter that holds the unit of a block."""
    return f"unit.{name}"


def within(shares: Sequence[float], values: Sequence[ca.SX], share: float) -> ca.SX:
    """Value at a share of a step of the polynomial through values at shares."""
    weights = control_basis(shares, [share])[0]
    terms = [float(w) * value for w, value in zip(weights, values, strict=True) if abs(w) > _ROUND_OFF]
    return sum(terms[1:], start=terms[0])


class StepCost(Protocol):
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
        Unknowns of the step.
    impulses : casadi.SX
        Those of the constraints among them, in the unit of force.
    named_inputs : mapping of str to casadi.SX
        All controls of the programme, by name.
    u : casadi.SX, shape (nu,)
        Controls of the robot at the end of the step, forces among them in the unit of force.
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
    tau : float
        Where in the step its cost is evaluated.
    values : tuple of casadi.SX, shapes (nu,)
        Controls of the robot at `shares` of the step; empty where they are constant.
    shares : tuple of float
    begin : casadi.SX, shape (nu,), or None
        Controls at the begin of the step, where they are linear in it.
    moment : casadi.SX or None
        Time at which the step is evaluated, where somebody asks for it [s].
    start_move : callable or None
        Controls that move the start -> move of (q, v), shape (2 nv,), where it is free.
    switched : ActiveForces or None
        What acts in the step, where constraints begin and end along the way.
    found : casadi.SX
        What numbers of the robot depend on that are found with the motion.
    of_found : callable or None
        From there to the equations of motion.
    follow : callable
        The step -> what states remember after it, by name.
    own_rows : casadi.SX
        Rows of the blocks that are not remembered.
    running_cost : StepCost
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
    impulses: ca.SX
    named_inputs: Mapping[str, ca.SX]
    u: ca.SX
    dt: ca.SX
    spacing: ca.SX
    m: ca.SX
    units_of_u: ca.SX
    theta: ca.SX
    rho: ca.SX
    given: Mapping[str, ca.SX]
    tau: float
    values: tuple[ca.SX, ...] = ()
    shares: tuple[float, ...] = ()
    begin: ca.SX | None = None
    moment: ca.SX | None = None
    start_move: Callable[[ca.SX], ca.SX] | None = None
    switched: ActiveForces | None = None
    found: ca.SX = field(default_factory=lambda: ca.SX.zeros(0, 1))
    of_found: Callable[[ca.SX], Mechanics] | None = None
    follow: Callable[[Passage], Mapping[str, ca.SX]] = lambda _: {}
    own_rows: ca.SX = field(default_factory=lambda: ca.SX.zeros(0, 1))
    running_cost: StepCost = lambda *_, **__: ca.SX(0)

    @property
    def has_before(self) -> ca.SX:
        """1 where a step has one before it, else 0."""
        return self.given.get(HAS_BEFORE, ca.SX(1))

    @property
    def mechanics_of_links(self) -> Mechanics:
        """Equations of which links are made: with symbols in the place of `found`."""
        if self.of_found is None:
            return self.mechanics
        return self.of_found(ca.SX.sym("found", self.found.numel()))

    @property
    def is_impact(self) -> ca.SX:
        """1 in an impact, else 0."""
        return ca.SX(0) if self.switched is None else self.switched.is_impact

    @property
    def has_free_length(self) -> bool:
        """Whether the length of the step depends on the unknowns."""
        return bool(ca.depends_on(self.dt, ca.vertcat(self.d0, self.d1, self.inputs)))

    @property
    def inputs(self) -> ca.SX:
        """All controls of the programme, one after the other."""
        return ca.vertcat(*self.named_inputs.values())

    def passage_with(self, s0: ca.SX, s1: ca.SX, before: Mapping[str, ca.SX]) -> Passage:
        """Return the step as the rules of what is remembered see it, with these speeds and memories."""
        units = {name: self.given[unit_of(name)] for name in before if unit_of(name) in self.given}
        own = (self.units_of_u, self.dt, self.spacing, self.has_before, before, units)
        rules = (self.named_inputs, self.given, self._forces, self.at0[self.space.layout.z], self._way)
        return Passage(s0, s1, self.u, *own, *rules, lambda: self.mechanics, self.begin)

    def _way(self) -> ca.SX:
        at = self.space.layout
        return self.mechanics.difference(self.at0[at.z], self.at1[at.z])

    def forces(self) -> ca.SX:
        """Forces of all rows of constraints; those of bodies and joints come before them [N, N m]."""
        first = self.mechanics.nc - self.mechanics.robot.nc
        return self.given["force"] * self.impulses[first:] / self.dt

    def ties(self, q: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Derivatives of all constraints at a configuration, shape (rows, nv), and which act, 1 or 0."""
        jacobian = self.mechanics.constraint_jacobian(q)
        if self.switched is None:
            return jacobian, ca.SX.ones(jacobian.shape[0])
        held = write_held_jacobian(self.switched.held, self.mechanics, q)
        return ca.vertcat(jacobian, held), self.switched.active

    def _forces(self, rows: Sequence[int]) -> ca.SX:
        return self.forces()[list(rows)]

    @property
    def memory_rows(self) -> ca.SX:
        """What the state after the step has to remember, less what it does, shape (nr,)."""
        at, leap = self.space.layout, self.is_impact
        before = {name: self.at0[where] for name, where in at.states.items()}
        after = dict(self.follow(self.passage_with(self.at0[at.s], self.at1[at.s], before)))
        if not leap.is_zero():  # impacts take no time, and leave what they have no value of
            left = [block.name for block in at.blocks if block.is_remembered and not block.has_impacts]
            after |= {name: (1 - leap) * after[name] + leap * before[name] for name in left}
        rows = [value - self.at1[at.states[name]] for name, value in after.items()]
        return ca.vertcat(ca.SX.zeros(0, 1), *rows)

    @property
    def controls(self) -> ca.SX:
        """Controls as the equations of motion and the cost count them; those at the end of the step."""
        return self.units_of_u * self.u

    def controls_at(self, share: float) -> ca.SX:
        """Controls at a share of the step, as the equations of motion and the cost count them."""
        if not self.shares:
            return self.controls
        return self.units_of_u * within(self.shares, self.values, share)


@dataclass(frozen=True)
class Steps(ABC):
    """Steps of a formulation with some scheme; members that a class does not define are those of the joints.

    Attributes
    ----------
    scheme : str
    coordinates : str
        Of the states.
    rows_are_gaps : bool
        Whether rows are F(x0, u) - x1, in the units of states; others balance momenta.
    takes_numbers : bool
        Whether functions take what varies of a robot as parameters, see `Robot.varying`.
    """

    scheme: str

    coordinates = "joint"
    rows_are_gaps = False
    takes_numbers = True

    @property
    def state_key(self) -> Mapping[str, str]:
        """What tells the states apart in the cache."""
        return {"coordinates": self.coordinates, "rotations": "quaternion"}

    @property
    def stage_key(self) -> Mapping[str, str | int]:
        """What else the functions of a step depend on."""
        return {"scheme": self.scheme, "lie": "", "substeps": 1}

    @property
    def end_key(self) -> Mapping[str, str]:
        """What else the functions of the end depend on."""
        return {"scheme": "explicit" if self.rows_are_gaps else "implicit"}

    @property
    def parameters(self) -> Mapping[str, int]:
        """Names and sizes of parameters beside step length and unit of force."""
        return {}

    @property
    @abstractmethod
    def tau(self) -> float:
        """Where in a step its running cost is evaluated, between 0 and 1."""

    @property
    @abstractmethod
    def remedy(self) -> str:
        """What to do where the functions become too large."""

    @abstractmethod
    def operations(self, nv: int) -> float:
        """Operations of a step with its derivatives, to within a factor of ten or so."""

    def mechanics(self, robot: Robot) -> Mechanics:
        """Equations of motion in the form that the steps ask for."""
        return JointMechanics(robot, numbers=symbols_of(robot))

    def num_algebraic(self, mechanics: Mechanics, num_held: int) -> int:
        """Unknowns of a step beside states and controls: an impulse for each row of constraints."""
        return mechanics.nc + num_held

    def impulses_of(self, unknowns: Unknowns, num_rows: int) -> Unknowns:
        """Impulses of the constraints' rows among these unknowns, along the first axis."""
        return unknowns

    @abstractmethod
    def derivatives(self, symbols: StepSymbols) -> StepDerivatives:
        """Rows and cost of a step, with exact first and second derivatives."""
