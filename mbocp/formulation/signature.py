"""The signature of a problem: all that decides the stage functions, and nothing that is only a number.

Two problems of the same signature share their compiled functions; start, goal, weights, target, bounds and
step length are parameters.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from mbocp.formulation.features.memory import MEMORY, ordered
from mbocp.formulation.features.switch_terms import NO_SWITCHES, Switches
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.sources import sources_digest
from mbocp.formulation.steps import Steps
from mbocp.terms import (
    AccelerationEnd,
    ClearanceTerm,
    ContactTerm,
    Effort,
    ExactGoal,
    FrameEnd,
    MeetingTerm,
    OwnEnd,
    OwnPath,
    PathTerm,
    PeriodicEnd,
    RateTerm,
    RunningTerm,
    StartEnd,
    TerminalCost,
    ToleranceTerm,
    ViaTerm,
)

__all__ = ["FunctionSignature"]


@dataclass(frozen=True)
class FunctionSignature:
    """What the stage functions depend on.

    Attributes
    ----------
    robot : str
        Fingerprint of the robot's equations; without the numbers that the functions take as parameters.
    steps : Steps
        Choice of coordinates and integrator: what the formulation says of its steps.
    goal : ExactGoal
        End condition.
    cost : tuple of RunningTerm
        Terms of the running cost, in the order in which they are added.
    terminal : TerminalCost or None
    path : tuple of PathTerm, OwnPath, RateTerm, ToleranceTerm, ViaTerm, ClearanceTerm, ContactTerm and
        MeetingTerm
    ends : tuple of FrameEnd, OwnEnd, AccelerationEnd, PeriodicEnd and StartEnd
        Further costs of the end, and conditions, whose rows follow those of the goal.
    is_flat : bool
        See `StateLayout`.
    guarded : tuple of int
        Parts of the configuration space, by index, whose end condition is guarded.
    has_free_lengths : bool
        Whether states hold the length of the steps.
    has_clock : bool
        Whether they hold the time, too, as they do where there are several lengths.
    switches : Switches
        Constraints that begin and end along the way, and impacts.
    has_unequal_lengths : bool
        Whether lengths of steps are given, and differ: each step takes its own as a parameter.
    varying : tuple of str
        Weights that differ from step to step: each step takes its share of them as a parameter.
    moves : tuple of int
        See `StateLayout`.
    shares : tuple of float
        Where in a step controls have values, see `StateLayout`.
    has_linear_controls : bool
        Whether they are continuous and linear in each step.
    num_numbers : int
        How many numbers of the robot the functions take as parameters, see `Robot.varying`.
    """

    robot: str
    steps: Steps
    goal: ExactGoal
    cost: tuple[RunningTerm, ...] = (Effort(),)
    terminal: TerminalCost | None = None
    path: tuple[
        PathTerm | OwnPath | RateTerm | ToleranceTerm | ViaTerm | ClearanceTerm | ContactTerm | MeetingTerm,
        ...,
    ] = ()
    ends: tuple[FrameEnd | OwnEnd | AccelerationEnd | PeriodicEnd | StartEnd, ...] = ()
    is_flat: bool = False
    guarded: tuple[int, ...] = ()
    has_free_lengths: bool = False
    has_clock: bool = False
    switches: Switches = NO_SWITCHES
    has_unequal_lengths: bool = False
    varying: tuple[str, ...] = ()
    moves: tuple[int, ...] = ()
    shares: tuple[float, ...] = ()
    has_linear_controls: bool = False
    num_numbers: int = 0

    @property
    def couples_steps(self) -> bool:
        """Whether the cost weighs the change from one step to the next."""
        return any(term.couples_steps for term in self.cost)

    @property
    def memory(self) -> tuple[str, ...]:
        """Names of what a state remembers of the step that led to it, see `memory`."""
        of_cost = {"control"} if self.couples_steps or self.has_linear_controls else set()
        return ordered(of_cost.union(*(term.remembers for term in (*self.path, *self.ends))))

    @property
    def num_paths(self) -> int:
        """Number of paths that frames follow."""
        return sum("progress" in term.remembers for term in self.path)

    @property
    def reactions(self) -> tuple[int, ...]:
        """Rows of the robot's constraints whose forces states remember, in rising order."""
        contacts = (term for term in self.path if isinstance(term, ContactTerm))
        return tuple(sorted({row for term in contacts for row in term.of_rows}))

    @property
    def asks_for_first(self) -> bool:
        """Whether functions of a step ask whether it is the first."""
        asks = any(MEMORY[name].asks_for_first for name in self.memory)
        moves = bool(self.moves) or self.has_linear_controls
        return self.couples_steps or asks or moves or (self.has_clock and "jerk" in self.memory)

    @property
    def uses_time(self) -> bool:
        """Whether the cost depends on the time itself."""
        return any(term.uses_time for term in self.cost)

    @property
    def end_rows(self) -> int:
        """Number of end conditions."""
        return self.goal.rows + sum(term.rows for term in self.ends)

    def state_layout(self, nz: int, nv: int, ns: int, nu: int) -> StateLayout:
        """Pieces of a state, for configurations of `nz` coordinates and `nv` directions."""
        sizes = {"u": nu, "s": ns, "path": self.num_paths, "reaction": len(self.reactions)}
        sizes["start"] = len(self.moves)
        memory = tuple((name, sizes[MEMORY[name].of]) for name in self.memory)
        nh = int(self.has_free_lengths)
        nt = int(self.has_clock)
        return StateLayout(
            nz=nz,
            nv=nv,
            ns=ns,
            memory=memory,
            is_flat=self.is_flat,
            nh=nh,
            nt=nt,
            moves=self.moves,
            nu=nu,
            shares=self.shares,
            is_continuous=self.has_linear_controls,
        )

    @property
    def stage_text(self) -> str:
        """Canonical text of what the functions of a stage depend on, the material of their cache key."""
        return _text(
            {
                **self._state,
                **self.steps.stage_key,
                **({"switches": self.switches.signature} if self.switches else {}),
                "cost": [term.signature for term in self.cost],
                "path": [term.signature for term in self.path],
                **({"has_unequal_lengths": True} if self.has_unequal_lengths else {}),
                **({"varying": self.varying} if self.varying else {}),
                **({"shares": self.shares} if self.shares else {}),
            }
        )

    @property
    def end_text(self) -> str:
        """Canonical text of what the functions of the end depend on."""
        return _text(
            {
                **self._state,
                **self.steps.end_key,
                "goal": self.goal.signature,
                "terminal": self.terminal and self.terminal.signature,
                "own": [term.signature for term in self.ends],
                "guarded": self.guarded,
            }
        )

    @property
    def unknowns(self) -> str:
        """Canonical text of what the unknowns and the multipliers of the equations are."""
        material = {
            **self._state,
            **self.steps.stage_key,
            **self.steps.end_key,
            "switches": self.switches.signature if self.switches else None,
            "shares": self.shares,
            "goal": self.goal.signature,
            "own": [term.signature for term in self.ends],
            "guarded": self.guarded,
        }
        return json.dumps(material, sort_keys=True)

    @property
    def _state(self) -> dict[str, Any]:
        """What a state is."""
        return {
            "robot": self.robot,
            **self.steps.state_key,
            "is_flat": self.is_flat,
            "memory": self.memory,
            **({"num_paths": self.num_paths} if self.num_paths else {}),
            **({"reactions": self.reactions} if self.reactions else {}),
            **({"has_free_lengths": True} if self.has_free_lengths else {}),  # given ones keep their key
            **({"has_clock": True} if self.has_clock else {}),
            **({"moves": self.moves} if self.moves else {}),
        }


def _text(material: dict[str, Any]) -> str:
    return json.dumps({**material, "sources": sources_digest()}, sort_keys=True)
