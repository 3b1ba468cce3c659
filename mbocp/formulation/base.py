r"""What a formulation is: a problem's programme, and the way between its numbers and motions of the robot.

A formulation chooses coordinates and a family of integrators. There are four: `ImplicitFormulation` (joint
coordinates, tau schemes), `PartitionedFormulation` (joint coordinates, Gauss and Lobatto schemes),
`ExplicitFormulation` (joint coordinates, explicit Runge-Kutta schemes) and `NaturalFormulation` (points and
directors of bodies, tau schemes). Whatever depends on that choice is a member of theirs, so that nothing else
has to ask which one it is. What the tau schemes have stands in `Formulation`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from functools import lru_cache
from typing import ClassVar, TypeVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.build import build_programme
from mbocp.formulation.end_rows import EndRows
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.motion import Motion, NodeSlopes
from mbocp.formulation.pieces import Pieces
from mbocp.formulation.states import States
from mbocp.integrators import TAU, VELOCITY_TAU, evaluation_points
from mbocp.mechanics import Space
from mbocp.mechanics.diagnostics import ConstraintViolation
from mbocp.problem import Problem
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.robot import Label

F = TypeVar("F", bound="Formulation")

_KEPT = 16  # functions of spaces


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


@dataclass(frozen=True, eq=False)
class Formulation(ABC):
    """A problem in some coordinates, with some family of integrators.

    Attributes
    ----------
    problem : Problem
    programme : StagewiseProgramme
        All that a solver sees.
    layout : StateLayout
        What a state consists of.
    space : Space
        The group that a state's configuration belongs to, or natural coordinates.
    end_rows : EndRows
        Projections of the end condition, of the joints.
    pieces : Pieces
        What its programme is made of.
    end_rows_may_depend : bool
        Whether the dynamics may meet some rows of the end condition by themselves.
    counts_turns : bool
        Whether states tell how often a joint has turned.
    solves_for_lams : bool
        Whether multipliers of constraints are unknowns, not read off the equations of motion.
    """

    problem: Problem
    programme: StagewiseProgramme
    layout: StateLayout
    space: Space
    end_rows: EndRows
    pieces: Pieces

    end_rows_may_depend: ClassVar[bool] = False
    counts_turns: ClassVar[bool] = True
    solves_for_lams: ClassVar[bool] = True

    @classmethod
    @abstractmethod
    def pieces_of(cls, problem: Problem) -> Pieces:
        """What the programme of a problem is made of, before any function is loaded."""

    @classmethod
    def of(cls: type[F], problem: Problem, *, deadline: float = math.inf) -> F:
        """Return the formulation with its programme, compiled or from the cache."""
        pieces = cls.pieces_of(problem)
        programme = build_programme(pieces, deadline=deadline)
        return cls(problem, programme, pieces.layout, pieces.space, pieces.end_rows, pieces)

    @property
    def states(self) -> States:
        """What its states and controls are."""
        return States(self.problem, self.pieces.signature.features, self.layout)

    @property
    @abstractmethod
    def constraint_labels(self) -> tuple[Label, ...]:
        """Name and unit of each holonomic constraint."""

    @property
    def keeps_adjoints(self) -> bool:
        """Whether the rows' multipliers are what a solution stores, so that it can start Newton's method."""
        return False

    @property
    def can_drift(self) -> bool:
        """Whether configurations can leave the space that they belong to."""
        return not self.space.is_vector

    @property
    def start_velocity(self) -> Array:
        """Velocity of the joints with which the steps begin, shape (nv,) [m/s, rad/s]."""
        return self.problem.v_start

    @property
    def tau(self) -> float:
        """Where in a step the velocity is that its kinematics take, between 0 and 1."""
        return VELOCITY_TAU[self.problem.scheme]

    @property
    def force_tau(self) -> float:
        """Where in a step its forces are taken; its adjoint belongs to what remains of 1."""
        return TAU[self.problem.scheme]

    def start_state(self, q: Array, v: Array) -> Array:
        """First state of the programme at a state of the robot, without what it remembers.

        A velocity is taken as it is, though the scheme may begin with one that fits its constraints.
        """
        return np.concatenate([self.space.coordinates(q[None])[0], v])

    def evaluation_points(self, qs: Array, vs: Array, dts: Array) -> tuple[Array, Array]:
        """Configurations (N, nq) and velocities (N, nv) at which the forces of each step are taken.

        Steps have the lengths `dts` [s], shape (N,).
        """
        return evaluation_points(self.problem.robot, self.force_tau, qs, vs, dts)

    @abstractmethod
    def iterate_of(self, motion: Motion, lams: Array) -> Iterate:
        """Iterate at a motion with multipliers (N, nc) of the robot's constraints; adjoints are zero.

        The first state is the given one.
        """

    @abstractmethod
    def motion_of(self, iterate: Iterate) -> Motion:
        """Motion of the joints that an iterate stands for."""

    @abstractmethod
    def node_slopes(self, iterate: Iterate, motion: Motion) -> NodeSlopes:
        """How configurations and velocities of its motion move with an iterate."""

    @abstractmethod
    def duals_of(self, iterate: Iterate, motion: Motion) -> Duals:
        """Multipliers and adjoints of an iterate and its motion."""

    @abstractmethod
    def hamiltonians(self, iterate: Iterate, motion: Motion, duals: Duals) -> Array:
        """H = L + mu . f + zeta . Phi of every step, eq. (11), shape (N,)."""

    @abstractmethod
    def control_momenta(
        self, iterate: Iterate, motion: Motion, duals: Duals
    ) -> tuple[Array, tuple[str, ...]]:
        """Control momenta, eq. (15), of the problem's symmetries, shape (N + 1, k), and their names."""

    @abstractmethod
    def violation(self, iterate: Iterate, motion: Motion) -> ConstraintViolation:
        """Largest violation of any constraint, of positions and of velocities."""

    def drifts(self, xs: Array) -> Array:
        """Largest defect of the configurations of states (k, nx), shape (k,); zero in their space."""
        found = np.abs(np.asarray(_defects_of(self.space).map(len(xs))(xs[:, self.layout.z].T)))
        return found.max(axis=0, initial=0.0)

    @abstractmethod
    def velocity_multipliers(self, multipliers: Array) -> Array:
        """Multipliers of limits of velocities (N + 1, nv) from those of states (N + 1, nx)."""


@lru_cache(maxsize=_KEPT)
def _defects_of(space: Space) -> ca.Function:
    """Coordinates -> what vanishes where they are a configuration."""
    z = ca.SX.sym("z", space.nz)
    return ca.Function("defects", [z], [ca.densify(space.defects(z))])
