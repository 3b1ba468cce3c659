"""The signature of a problem: all that decides the stage functions, and nothing that is only a number.

Two problems of the same signature share their compiled functions; start, goal, weights, target, bounds and
step length are parameters. The sources that write the functions belong to it: a change in them makes what
was written before stale.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from functools import cache, cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from mbocp import integrators, lie, mechanics, meshes, robot, symbolic, terms
from mbocp._arrays import dataclass
from mbocp._environment import number_from
from mbocp.exceptions import TooManyOperations
from mbocp.formulation.features.control_values import ControlValues
from mbocp.formulation.features.feature import Feature, join
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.steps import Steps
from mbocp.terms.clearance_term import ClearanceTerm
from mbocp.terms.contact import ContactConditionTerm, ContactTerm
from mbocp.terms.cost import RunningTerm
from mbocp.terms.frame_end import FrameEnd
from mbocp.terms.frame_tolerance import ToleranceTerm
from mbocp.terms.kinds import AccelerationEnd, Effort, ExactGoal, TerminalCost
from mbocp.terms.own_parts import OwnEnd, OwnPath
from mbocp.terms.path_term import PathTerm
from mbocp.terms.periodic_end import PeriodicEnd, StartEnd
from mbocp.terms.rates import RateTerm
from mbocp.terms.via_term import ViaTerm


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
        ContactConditionTerm
    ends : tuple of FrameEnd, OwnEnd, AccelerationEnd, PeriodicEnd and StartEnd
        Further costs of the end, and conditions, whose rows follow those of the goal.
    is_flat : bool
        See `StateLayout`.
    guarded : tuple of int
        Parts of the configuration space, by index, whose end condition is guarded.
    features : tuple of Feature
        What the problem adds to a plain formulation, in the order of `features.kinds`.
    num_numbers : int
        How many numbers of the robot the functions take as parameters, see `Robot.varying`.
    """

    robot: str
    steps: Steps
    goal: ExactGoal
    cost: tuple[RunningTerm, ...] = (Effort(),)
    terminal: TerminalCost | None = None
    path: tuple[
        PathTerm
        | OwnPath
        | RateTerm
        | ToleranceTerm
        | ViaTerm
        | ClearanceTerm
        | ContactTerm
        | ContactConditionTerm,
        ...,
    ] = ()
    ends: tuple[FrameEnd | OwnEnd | AccelerationEnd | PeriodicEnd | StartEnd, ...] = ()
    is_flat: bool = False
    guarded: tuple[int, ...] = ()
    features: tuple[Feature, ...] = (ControlValues(),)
    num_numbers: int = 0

    @property
    def control_values(self) -> ControlValues:
        """Where in a step controls have values."""
        return next(feature for feature in self.features if isinstance(feature, ControlValues))

    @property
    def asks_for_first(self) -> bool:
        """Whether functions of a step ask whether it is the first."""
        couples_steps = any(term.couples_steps for term in self.cost)
        return couples_steps or any(feature.asks_for_first for feature in self.features)

    @property
    def end_rows(self) -> int:
        """Number of end conditions."""
        return self.goal.rows + sum(term.rows for term in self.ends)

    def state_layout(self, nz: int, nv: int, ns: int, nu: int) -> StateLayout:
        """Pieces of states and controls, for configurations of `nz` coordinates and `nv` directions."""
        blocks = tuple(block for feature in self.features for block in feature.blocks(ns, nu))
        controls = tuple(item for feature in self.features for item in feature.controls(nu).items())
        return StateLayout(nz, nv, ns, self.is_flat, blocks, controls)

    @cached_property
    def stage_text(self) -> str:
        """Canonical text of what the functions of a stage depend on, the material of their cache key."""
        return _text(
            {
                **self._state,
                **self.steps.stage_key,
                **join(feature.unknowns_key for feature in self.features),
                **join(feature.stage_key for feature in self.features),
                "cost": [term.signature for term in self.cost],
                "path": [term.signature for term in self.path],
            }
        )

    @cached_property
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

    @cached_property
    def unknowns(self) -> str:
        """Canonical text of what the unknowns and the multipliers of the equations are."""
        material = {
            **self._state,
            **self.steps.stage_key,
            **self.steps.end_key,
            "switches": None,
            "shares": (),
            **join(feature.unknowns_key for feature in self.features),
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
            "memory": [b.name for f in self.features for b in f.blocks(0, 0) if b.is_remembered],
            **join(feature.state_key for feature in self.features),
        }


def _text(material: dict[str, Any]) -> str:
    return json.dumps({**material, "sources": sources_digest()}, sort_keys=True)


_LIMIT_OF_OPERATIONS = "MBOCP_OPERATIONS_LIMIT"
_LIMIT = 10e6


def check_operations(robot: str, nv: int, signature: FunctionSignature) -> None:
    """Refuse a signature whose functions would be too large, before CasADi builds them.

    A function with millions of operations takes minutes to build and to compile, and gigabytes. How their
    number grows with the robot is for each kind of `Steps` to say: with chains, arms and legged robots
    between a third and fifteen times of what "complete" has.

    Parameters
    ----------
    robot : str
        Its name, for the message.
    nv : int
        Velocities: of the joints, or of the bodies in natural coordinates.
    signature : FunctionSignature

    Raises
    ------
    TooManyOperations
    """
    operations, limit = signature.steps.operations(nv), number_from(_LIMIT_OF_OPERATIONS, "a number > 0")
    limit = _LIMIT if limit is None else limit
    if operations > limit:
        raise TooManyOperations(robot, nv, operations, limit, signature.steps.remedy)


_BRIDGE = "mbocp._native._bridge"  # Pinocchio's algorithms as expressions, compiled


def source_files() -> Iterator[Path]:
    """Files that have a part in writing stage functions: this folder, those that it builds on, the ground."""
    own = Path(__file__).parent
    for package in (integrators, lie, mechanics, meshes, robot, symbolic, terms):
        yield from sorted(Path(str(package.__file__)).parent.rglob("*.py"))
    yield from sorted(own.rglob("*.py"))
    yield from sorted(own.parent.glob("*.py"))
    bridge = find_spec(_BRIDGE)
    if bridge is not None and bridge.origin is not None:
        yield Path(bridge.origin)


@cache
def sources_digest() -> str:
    """Digest of these files."""
    digest = hashlib.sha256()
    for source in source_files():
        digest.update(source.name.encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()
