r"""What a formulation is: a problem's programme, and the way between its numbers and motions of the robot.

A formulation chooses coordinates and a family of integrators. There are four: `ImplicitFormulation` (joint
coordinates, tau schemes), `PartitionedFormulation` (joint coordinates, Gauss and Lobatto schemes),
`ExplicitFormulation` (joint coordinates, explicit Runge-Kutta schemes) and `NaturalFormulation` (points and
directors of bodies, tau schemes). Whatever depends on that choice is a
method of theirs, so that nothing else has to ask which one it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from mbocp._arrays import Array
from mbocp.formulation.build import Pieces
from mbocp.formulation.goal import EndRows
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.motion import Motion
from mbocp.mechanics import Space
from mbocp.mechanics.diagnostics import ConstraintViolation
from mbocp.problem import Problem
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.robot import Label


@dataclass(frozen=True, eq=False)
class Duals:
    """Multipliers and adjoints of a motion, in the paper's scaling.

    Attributes
    ----------
    lams, zetas : ndarray, shape (N, nc)
        Multipliers of the constraints in the steps, and of these constraints' rows.
    states : ndarray, shape (N + 1, ndx)
        Derivatives of the Lagrangian of what follows each node in the programme's states.
    costates : ndarray, shape (N + 1, 2 nv)
        The same in the joints' (q, v).
    mus : ndarray, shape (N + 1, 2 nv)
        Adjoints mu_0 ... mu_N as the paper has them, of (q, p).
    """

    lams: Array
    zetas: Array
    states: Array
    costates: Array
    mus: Array


class Formulation(Protocol):
    """A problem in some coordinates, with some family of integrators."""

    @property
    def problem(self) -> Problem:
        """What was formulated."""

    @property
    def programme(self) -> StagewiseProgramme:
        """All that a solver sees."""

    @property
    def layout(self) -> StateLayout:
        """What a state consists of."""

    @property
    def space(self) -> Space:
        """The group that a state's configuration belongs to, or natural coordinates."""

    @property
    def end_rows(self) -> EndRows:
        """Projections of the end condition, of the joints."""

    @property
    def constraint_labels(self) -> tuple[Label, ...]:
        """Name and unit of each holonomic constraint."""

    @property
    def end_rows_may_depend(self) -> bool:
        """Whether the dynamics may meet some rows of the end condition by themselves."""

    @property
    def counts_turns(self) -> bool:
        """Whether states tell how often a joint has turned."""

    @property
    def keeps_adjoints(self) -> bool:
        """Whether the rows' multipliers are what a solution stores, so that it can start Newton's method."""

    @property
    def solves_for_lams(self) -> bool:
        """Whether multipliers of constraints are unknowns, not read off the equations of motion."""

    @property
    def can_drift(self) -> bool:
        """Whether configurations can leave the space that they belong to."""

    @property
    def start_velocity(self) -> Array:
        """Velocity of the joints with which the steps begin, shape (nv,) [m/s, rad/s]."""

    @property
    def tau(self) -> float:
        """Where in a step the velocity is that its kinematics take, between 0 and 1."""

    @property
    def force_tau(self) -> float:
        """Where in a step its forces are taken; its adjoint belongs to what remains of 1."""

    @property
    def pieces(self) -> Pieces:
        """What its programme is made of."""

    def start_state(self, q: Array, v: Array) -> Array:
        """First state of the programme at a state of the robot, without what it remembers.

        A velocity is taken as it is, though the scheme may begin with one that fits its constraints.
        """

    def evaluation_points(self, qs: Array, vs: Array, dts: Array) -> tuple[Array, Array]:
        """Configurations (N, nq) and velocities (N, nv) at which the forces of each step are taken.

        Steps have the lengths `dts` [s], shape (N,).
        """

    def iterate_of(self, motion: Motion, lams: Array) -> Iterate:
        """Iterate at a motion with multipliers (N, nc) of the robot's constraints; adjoints are zero.

        The first state is the given one.
        """

    def motion_of(self, iterate: Iterate) -> Motion:
        """Motion of the joints that an iterate stands for."""

    def duals_of(self, iterate: Iterate, motion: Motion) -> Duals:
        """Multipliers and adjoints of an iterate and its motion."""

    def hamiltonians(self, iterate: Iterate, motion: Motion, duals: Duals) -> Array:
        """H = L + mu . f + zeta . Phi of every step, eq. (11), shape (N,)."""

    def control_momenta(
        self, iterate: Iterate, motion: Motion, duals: Duals
    ) -> tuple[Array, tuple[str, ...]]:
        """Control momenta, eq. (15), of the problem's symmetries, shape (N + 1, k), and their names."""

    def violation(self, iterate: Iterate, motion: Motion) -> ConstraintViolation:
        """Largest violation of any constraint, of positions and of velocities."""

    def drifts(self, xs: Array) -> Array:
        """Largest defect of the configurations of states (k, nx), shape (k,); zero in their space."""

    def velocity_multipliers(self, multipliers: Array) -> Array:
        """Multipliers of limits of velocities (N + 1, nv) from those of states (N + 1, nx)."""
