"""What a formulation chooses, and a programme is made of: unknowns, and numbers by name and place."""

from __future__ import annotations

from collections.abc import Container, Mapping
from functools import cached_property
from typing import TypeVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.exceptions import DimensionMismatch, TranscriptionError
from mbocp.formulation.end_rows import EndRows, EndTarget
from mbocp.formulation.layout import StateLayout, places
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.steps import HAS_BEFORE, unit_of
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import Space
from mbocp.problem import Problem
from mbocp.robot import Label
from mbocp.terms.point import Sizes

S = TypeVar("S", ca.SX, ca.MX)

NUMBERS = "robot"  # what varies of the robot


@dataclass(frozen=True)
class ParameterLayout:
    """Sizes of the named pieces of theta (whole horizon), rho (a stage) and rho of the end, in order.

    Attributes
    ----------
    theta, stage, terminal : mapping of str to int
    weights : frozenset of str
        Pieces in which the costs are linear: all of them scaled, the costs are.
    """

    theta: Mapping[str, int]
    stage: Mapping[str, int]
    terminal: Mapping[str, int]
    weights: frozenset[str] = frozenset()

    def weighing(self, sizes: Mapping[str, int]) -> BoolArray:
        """Which entries of a vector of pieces the costs are linear in."""
        return mask(sizes, self.weights)


def parameter_layout(signature: FunctionSignature, sizes: Sizes) -> ParameterLayout:
    """Parameters that the stage functions of `signature` take."""
    theta: dict[str, int] = {"dt": 1, "force": 1}
    stage: dict[str, int] = {}
    terminal, weights = _terminal_parameters(signature, sizes)
    for term in signature.cost:
        _add(theta, term.parameters(sizes))
        _add(stage, term.stage_parameters(sizes))
        weights.update(term.weights)
    if signature.asks_for_first:
        stage[HAS_BEFORE] = 1
    for feature in signature.features:
        _add(stage, feature.stage_parameters)
        _add(theta, feature.parameters)
        weights.update(feature.weights)
    _add(theta, signature.steps.parameters)
    for feature in signature.features:
        _add(theta, {unit_of(block.name): 1 for block in feature.blocks(0, 0) if block.has_unit})
    for k, constraint in enumerate(signature.path):
        _add(theta, {path_parameters(k, name): size for name, size in constraint.sizes.items()})
    if signature.num_numbers:
        theta[NUMBERS] = terminal[NUMBERS] = signature.num_numbers
    return ParameterLayout(theta, stage, terminal, frozenset(weights))


def _terminal_parameters(signature: FunctionSignature, sizes: Sizes) -> tuple[dict[str, int], set[str]]:
    """Parameters of the functions of the end, but for numbers of one's own, and which of them are weights."""
    terminal, weights = signature.goal.parameters(sizes), set[str]()
    for feature in signature.features:
        _add(terminal, feature.end_parameters)
    if signature.terminal is not None:
        _add(terminal, signature.terminal.parameters(sizes))
        weights.update(signature.terminal.weights)
    for end in signature.ends:
        _add(terminal, end.parameters())
        weights.update(end.weights)
    return terminal, weights


def path_parameters(k: int, name: str) -> str:
    """Name of a parameter of the path constraint k."""
    return f"path.{k}.{name}"


def _add(pieces: dict[str, int], more: Mapping[str, int]) -> None:
    for name, size in more.items():
        if name in pieces:
            raise TranscriptionError(f"two terms have a parameter of the name {name!r}")
        pieces[name] = size


def mask(sizes: Mapping[str, int], names: Container[str]) -> BoolArray:
    """Which entries of a vector of pieces belong to those of certain names."""
    belongs = np.fromiter((name in names for name in sizes), dtype=np.bool_, count=len(sizes))
    return np.repeat(belongs, list(sizes.values()))


def pieces(vector: S, sizes: Mapping[str, int]) -> dict[str, S]:
    """Named pieces of a symbolic vector."""
    bounds = [0]
    for size in sizes.values():
        bounds.append(bounds[-1] + size)
    return {name: vector[bounds[i] : bounds[i + 1]] for i, name in enumerate(sizes)}


def symbols_for(name: str, sizes: Mapping[str, int], numbers: ca.SX) -> ca.SX:
    """Vector of symbols with those of a robot's numbers in the place of their piece."""
    count = sizes.get(NUMBERS, 0)
    if not count:
        return ca.SX.sym(name, sum(sizes.values()))
    start = places(sizes)[NUMBERS].start
    after = sum(sizes.values()) - start - count
    return ca.vertcat(ca.SX.sym(name, start), numbers, ca.SX.sym(f"{name}_after", after))


def concatenate(named: Mapping[str, Array], sizes: Mapping[str, int]) -> Array:
    """One vector of the pieces that `sizes` names, in its order.

    Raises
    ------
    DimensionMismatch
        If a piece is not of its size.
    """
    found = [np.asarray(named[name], dtype=float).ravel() for name in sizes]
    for (name, size), piece in zip(sizes.items(), found, strict=True):
        if piece.size != size:
            raise DimensionMismatch(f"parameter {name}", piece.size, size)
    return np.concatenate(found) if found else np.zeros(0)


@dataclass(frozen=True, eq=False)
class Algebraic:
    """Factors from the programme's rows and unknowns to the reported ones, see `StageKind`.

    Attributes
    ----------
    scale_c, scale_y, scale_m : ndarray, shape (ny,)
        Of the rows that belong to these unknowns, of the unknowns, of the rows' multipliers.
    is_force : ndarray of bool, shape (ny,)
        Unknowns that count in the unit of force.
    is_balance : ndarray of bool, shape (ny,)
        Rows that count in it.
    """

    scale_c: Array
    scale_y: Array
    scale_m: Array
    is_force: BoolArray
    is_balance: BoolArray

    @property
    def size(self) -> int:
        """Number of unknowns, and of rows."""
        return len(self.scale_y)


def impulses(size: int, dt: float) -> Algebraic:
    """Impulses of constraints, whose rows are Phi / dt."""
    return Algebraic(
        scale_c=np.full(size, dt),
        scale_y=np.full(size, 1 / dt),
        scale_m=np.full(size, 1 / dt),
        is_force=np.ones(size, dtype=np.bool_),
        is_balance=np.zeros(size, dtype=np.bool_),
    )


@dataclass(frozen=True)
class RowLabels:
    """Names of what the rows of a step speak of.

    Attributes
    ----------
    positions : tuple of Label
        Of the kinematic rows, where these are as many as tangent directions.
    balance : str
        What the rows after them are: a balance of momenta, or rates.
    speeds : tuple of Label
        Of these rows.
    constraints : tuple of Label
        Of the constraints' rows.
    of_stages : tuple of str
        What the rows before those are, where a step has stages.
    """

    positions: tuple[Label, ...]
    balance: str
    speeds: tuple[Label, ...]
    constraints: tuple[Label, ...] = ()
    of_stages: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Pieces:
    """What a formulation chooses, and a programme is made of.

    Attributes
    ----------
    problem : Problem
    joints : ConfigurationSpace
        Of the joints, which costs and goals speak of.
    space : Space
        Of the states.
    signature : FunctionSignature
        What the stage functions depend on.
    layout : StateLayout
    algebraic : Algebraic
        Unknowns of a step beside states and controls: multipliers of constraints, and those of stages.
    groups : tuple of (int, int, tuple of int)
        See `StageKind`.
    end_rows : EndRows
        Projections of the end condition, of the joints.
    end : EndTarget
        The end condition in the states' coordinates.
    turning : ndarray, shape (ndx,)
        See `StageKind`.
    x_start : ndarray, shape (nx,)
    speed_bounds : tuple of ndarray, shapes (ns,), (1, ns) or (N, ns)
        Lower and upper ones.
    labels : RowLabels
        Names for messages.
    """

    problem: Problem
    joints: ConfigurationSpace
    space: Space
    signature: FunctionSignature
    layout: StateLayout
    algebraic: Algebraic
    groups: tuple[tuple[int, int, tuple[int, ...]], ...]
    end_rows: EndRows
    end: EndTarget
    turning: Array
    x_start: Array
    speed_bounds: tuple[Array, Array]
    labels: RowLabels

    @cached_property
    def parameters(self) -> ParameterLayout:
        """Pieces of the programme's parameters."""
        space, joints, robot = self.space, self.joints, self.problem.robot
        return parameter_layout(self.signature, Sizes(space.nz, space.nv, robot.nu, joints.nz, robot.nv))
