"""What a feature adds to a plain formulation: one class for each, and the members that it may have.

A plain formulation has states (z, s), the controls of the robot, and steps of one length. Whatever problems
add to that, free lengths of steps, a memory of the step before, progress along a path, is a `Feature`: a
frozen value in the signature of the functions, which holds no number of the problem. Layout, parameters,
bounds, rows, units, functions of a stage and motions loop over the features of a signature. To add one is to
write its class and to name it in `mbocp.formulation.features.all_features`, whose order is that of the
blocks in a state, of the controls and of the parameters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.layout import Block, StateLayout
from mbocp.formulation.motion import Motion, Passage
from mbocp.formulation.steps import StepSymbols
from mbocp.mechanics import Mechanics
from mbocp.robot import Label
from mbocp.terms.clearance_term import ClearanceTerm

if TYPE_CHECKING:
    from mbocp.problem import Problem

V = TypeVar("V")

_NOTHING: Mapping[str, Any] = {}


@dataclass(frozen=True)
class StepRequests:
    """What the terms of a problem ask of its steps.

    Attributes
    ----------
    cost : tuple of RunningTerm
    path, ends : tuple
        Terms of the path constraints and of the end.
    tau : float
        Where in a step its cost is evaluated, between 0 and 1.
    """

    cost: tuple[Any, ...] = ()
    path: tuple[Any, ...] = ()
    ends: tuple[Any, ...] = ()
    tau: float = 0.0

    @property
    def remembers(self) -> set[str]:
        """Names of what states have to remember of the step before."""
        return set().union(*(term.remembers for term in (*self.path, *self.ends)))

    @property
    def couples_steps(self) -> bool:
        """Whether the cost weighs the change from one step to the next."""
        return any(term.couples_steps for term in self.cost)

    @property
    def uses_time(self) -> bool:
        """Whether the cost depends on the time itself."""
        return any(term.uses_time for term in self.cost)

    @property
    def has_movers(self) -> bool:
        """Whether obstacles move by the time."""
        return any(isinstance(term, ClearanceTerm) and term.movers > 0 for term in self.path)


class Feature(ABC):
    """What a problem adds; members that a feature does not define add nothing."""

    @classmethod
    @abstractmethod
    def of(cls, problem: Problem, asked: StepRequests) -> Feature | None:
        """Return the feature of a problem; None where it has none."""

    # What the functions depend on

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """Return what it adds to states, for `ns` speeds and `nu` controls of the robot."""
        return ()

    def controls(self, nu: int) -> Mapping[str, int]:
        """Return names and sizes of the controls that it adds."""
        return _NOTHING

    @property
    def num_held(self) -> int:
        """Rows of constraints beside those of the mechanics."""
        return 0

    @property
    def weights(self) -> frozenset[str]:
        """Those of its parameters in which the costs are linear."""
        return frozenset()

    @property
    def parameters(self) -> Mapping[str, int]:
        """Names and sizes of parameters of the horizon."""
        return _NOTHING

    @property
    def stage_parameters(self) -> Mapping[str, int]:
        """Names and sizes of parameters of each step."""
        return _NOTHING

    @property
    def asks_for_first(self) -> bool:
        """Whether it looks at `HAS_BEFORE`, whether a step has one before it."""
        return False

    @property
    def state_key(self) -> Mapping[str, Any]:
        """What tells its states apart in the cache."""
        return _NOTHING

    @property
    def unknowns_key(self) -> Mapping[str, Any]:
        """What else tells its unknowns apart."""
        return _NOTHING

    @property
    def stage_key(self) -> Mapping[str, Any]:
        """What else the functions of a step depend on."""
        return _NOTHING

    @property
    def end_parameters(self) -> Mapping[str, int]:
        """Names and sizes of those of its parameters that functions of the end take, too."""
        return _NOTHING

    # A step in symbols

    def equations(
        self, plain: Mechanics, states: Mapping[str, ca.SX], given: Mapping[str, ca.SX]
    ) -> Mechanics:
        """Return the equations of motion at a node with these blocks of its state and parameters."""
        return plain

    def enter(self, at: StepSymbols) -> StepSymbols:
        """Return the symbols of a step with what it changes: features change them one after the other.

        Lengths of steps may depend on unknowns, linearly.
        """
        return at

    def next_value(self, name: str, step: Passage) -> Any:
        """Return the value of a remembered block after a step: of symbols, or of arrays with a row a step.

        Only features that remember something are asked.
        """
        raise NotImplementedError(name)

    def own_rows(self, at: StepSymbols) -> Sequence[ca.SX]:
        """Return the rows of blocks that are not remembered."""
        return ()

    def idle_cost(self, at: StepSymbols) -> ca.SX:
        """Return what makes controls zero on which nothing depends."""
        return ca.SX(0)

    def show(self, name: str, value: ca.SX) -> ca.SX:
        """Return a block as terms see it, from its entries in the user's units."""
        return value

    # Numbers of a problem

    def numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Return its parameters of the horizon."""
        return _NOTHING

    def stage_numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Return its parameters of all steps, shapes (N, size)."""
        return _NOTHING

    def units(self, problem: Problem) -> Mapping[str, float]:
        """Return the units of its blocks that have one."""
        return _NOTHING

    def first(self, problem: Problem) -> Mapping[str, Array]:
        """Return what the first state has of its blocks, where that is not zero."""
        return _NOTHING

    def state_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Return bounds of its blocks at the nodes 1..N, shapes (N, size), where there are some."""
        return _NOTHING

    def control_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Return bounds of its controls, shapes (N, size), or (1, size) where steps are alike."""
        return _NOTHING

    # Words for messages

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Return what the rows of its blocks are."""
        return ()

    def state_words(self, problem: Problem) -> Mapping[str, str]:
        """Return what limits of its blocks are called."""
        return _NOTHING

    def control_words(self, problem: Problem) -> Sequence[str]:
        """Return what limits of its controls are called."""
        return ()

    # From motions to states and controls, and back

    def states_of(self, problem: Problem, motion: Motion) -> Mapping[str, Array]:
        """Return what nodes of a motion have of the blocks that are not remembered, shapes (N + 1, size)."""
        return _NOTHING

    def controls_of(self, problem: Problem, motion: Motion) -> Mapping[str, Array]:
        """Return its controls at a motion, shapes (N, size)."""
        return _NOTHING

    def read(self, problem: Problem, at: StateLayout, xs: Array, us: Array, motion: Motion) -> Motion:
        """Return the motion with what it makes of states (N + 1, nx) and controls (N, any)."""
        return motion


def join(parts: Iterable[Mapping[str, V]]) -> dict[str, V]:
    """Return what all features say, as one mapping."""
    return {name: value for part in parts for name, value in part.items()}


def infinite_bounds(*shape: int) -> tuple[Array, Array]:
    """Return bounds that are none."""
    return np.full(shape, -np.inf), np.full(shape, np.inf)
