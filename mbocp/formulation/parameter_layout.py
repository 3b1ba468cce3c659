"""The numbers that the stage functions take beside the unknowns, by name and place."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import TypeVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.exceptions import DimensionMismatch, TranscriptionError
from mbocp.formulation.layout import places
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.steps import HAS_BEFORE, unit_of
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

    def weight_entries(self, sizes: Mapping[str, int]) -> BoolArray:
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
