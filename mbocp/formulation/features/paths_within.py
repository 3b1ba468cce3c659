r"""Path constraints that hold within steps, too: part of what states remember.

In a step of length h from (q_0, v_0) to (q_1, v_1), with the way d from q_0 to q_1, the cubic through its
nodes, see `mbocp.problem.step_cubics`, has at the share s

.. math:: q_0 \oplus \bigl(h (s - 2 s^2 + s^3) v_0 + h (s^3 - s^2) v_1 + (3 s^2 - 2 s^3) d\bigr), \qquad
    (1 - 4 s + 3 s^2) v_0 + (3 s^2 - 2 s) v_1 + 6 s (1 - s) \frac{d}{h}.

The square of a speed is a polynomial of degree four there, and stays between the least and the largest of its
Bernstein coefficients; other expressions nearly are. Nodes keep their bounds: where the three coefficients
between them do, so does the step. The state after it remembers these; of equations, which they would nearly
leave no room, the value in the middle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.feature import Feature, StepRequests, infinite_bounds
from mbocp.formulation.features.path_progress import progress_in_step
from mbocp.formulation.layout import Block
from mbocp.formulation.motion import Passage
from mbocp.mechanics import Mechanics
from mbocp.problem.path import PathConstraint
from mbocp.problem.paths_between_nodes import paths_within, rows_within, sides_within
from mbocp.problem.step_cubics import StepCubics
from mbocp.robot import Label
from mbocp.terms.path_term import PathTerm
from mbocp.terms.point import Point

if TYPE_CHECKING:
    from mbocp.problem import Problem

PATHS_WITHIN = "paths_within"  # the block
_SHARES = np.linspace(0.0, 1.0, 5)
_COEFFICIENTS = np.linalg.inv(
    [[math.comb(4, k) * s**k * (1.0 - s) ** (4 - k) for k in range(5)] for s in _SHARES]
)[1:4]
_FROM_VALUES = np.vstack([_COEFFICIENTS, _SHARES == 0.5])  # those between the nodes; the value in the middle
_WORDS = ("first coefficient", "second coefficient", "third coefficient", "middle")


@dataclass(frozen=True)
class PathsWithin(Feature):
    """Terms of the path constraints."""

    terms: tuple[PathTerm, ...]

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> PathsWithin | None:
        """Return those of a problem whose path constraints are to hold within steps."""
        pairs = zip(problem.path, asked.path, strict=False)
        terms = {id(path): term for path, term in pairs}  # those that follow paths know which is theirs
        found = tuple(terms[id(path)] for path in _paths(problem))
        return cls(found) if found else None

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """One entry for each coefficient and row."""
        return (Block(PATHS_WITHIN, len(_WORDS) * sum(term.rows for term in self.terms)),)

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Which constraints they are."""
        return {PATHS_WITHIN: [term.signature for term in self.terms]}

    @property
    def parameters(self) -> Mapping[str, int]:
        """Numbers of each constraint."""
        return {_name(k, key): size for k, term in enumerate(self.terms) for key, size in term.sizes.items()}

    def numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Numbers of each constraint."""
        paths = enumerate(_paths(problem))
        return {_name(k, key): value for k, path in paths for key, value in path.numbers.items()}

    def next_value(self, name: str, step: Passage) -> Any:
        """The coefficients of the expressions."""
        way, mechanics = step.way(), step.mechanics()
        numbers = {name: step.given[name] for name in self.parameters}
        cubic = StepCubics(0.0, step.dt, step.s0, step.s1, way / step.dt)
        found = []
        for share in _SHARES.tolist():
            place = [step.q0, cubic.ways(share), cubic.speeds(share)]
            if any(term.remembers for term in self.terms):
                place.append(step.before["progress"] + share * progress_in_step(step))
            if isinstance(way, np.ndarray):
                symbols = [ca.SX.sym("x", values.shape[1]) for values in place]
                given = {key: ca.SX(ca.DM(value)) for key, value in numbers.items()}
                rows = ca.densify(self._expressions(mechanics, given, *symbols))
                function = ca.Function("within", symbols, [rows]).map(len(way))
                found.append(np.asarray(function(*(values.T for values in place))).T)
            else:
                found.append(self._expressions(mechanics, numbers, *place))
        sums = [sum(w * value for w, value in zip(row, found, strict=True)) for row in _FROM_VALUES.tolist()]
        return np.hstack(sums) if isinstance(way, np.ndarray) else ca.vertcat(*sums)

    def _expressions(self, mechanics: Mechanics, numbers: Mapping[str, ca.SX], *place: ca.SX) -> ca.SX:
        q0, way, v, *progress = place
        point = Point(mechanics, mechanics.integrate(q0, way), v)
        point = replace(point, remembered={"progress": progress[0]}) if progress else point
        given = [{key: numbers[_name(k, key)] for key in term.sizes} for k, term in enumerate(self.terms)]
        return ca.vertcat(*[term.within(point, own) for term, own in zip(self.terms, given, strict=True)])

    def state_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Those of the path constraints; an equation is held in the middle alone."""
        found = []
        for word in _WORDS:
            for path in _paths(problem):
                held = rows_within(path, problem) & ((path.lower == path.upper) == (word == _WORDS[-1]))
                pairs = zip(sides_within(path), infinite_bounds(problem.num_steps, path.rows), strict=True)
                found.append([np.where(held, own, free) for own, free in pairs])
        lower, upper = (np.hstack(side) for side in zip(*found, strict=True))
        return {PATHS_WITHIN: (lower, upper)}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Of which constraint."""
        return names_of_paths(problem)

    def state_words(self, problem: Problem) -> Mapping[str, str]:
        """What its limits are called."""
        return {PATHS_WITHIN: "path constraint within a step"}


def names_of_paths(problem: Problem) -> tuple[str, ...]:
    """Return names for the rows within steps of a problem, as of path constraints; none without any."""
    labels = [label for path in _paths(problem) for label in path.labels]
    return tuple(f"{label.name} within steps, {word}" for word in _WORDS for label in labels)


def slopes_of_paths(problem: Problem, multipliers: Array) -> Array:
    """Return derivatives of the expressions in the values, shape (N, rows), at the bounds that pull."""
    paths = _paths(problem) * len(_WORDS)
    pulls = np.split(multipliers, np.cumsum([path.rows for path in paths])[:-1], axis=1)
    pairs = zip(paths, pulls, strict=True)
    sides = [(path, np.where(pull > 0.0, path.upper, path.lower)) for path, pull in pairs]
    return np.hstack([path.slopes(np.where(np.isfinite(side), side, 0.0)) for path, side in sides])


def _name(k: int, key: str) -> str:
    return f"within.{k}.{key}"


def _paths(problem: Problem) -> tuple[PathConstraint, ...]:
    return paths_within(problem) if "p" in problem.limits_within else ()
