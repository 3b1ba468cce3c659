"""The optimum of a problem as a function of its parameters, with products of its Jacobian."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from functools import cached_property
from itertools import accumulate, pairwise
from pathlib import Path

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp._text import warn_caller
from mbocp.exceptions import DimensionMismatch, MbocpError, NotConverged
from mbocp.lie import ConfigurationSpace
from mbocp.problem import Problem
from mbocp.sensitivity.change import ProblemNumbers
from mbocp.sensitivity.derivatives import Sensitivities, sensitivities
from mbocp.solution import Solution
from mbocp.solution.from_files import problem_from
from mbocp.solving import solve

_KEPT = 64  # optima with their factors, which a backward pass finds again


@dataclass(frozen=True, eq=False)
class SolutionMap:
    """Cost, times and motion by the values of parameters: each in plain numbers, as a solution has them.

    Solves begin at the optimum of the problem itself, so that neighbours are on one branch of optima. Values
    that are no configurations stand for those nearest to them.

    Attributes
    ----------
    first : Solution
        Of the problem itself.
    parameters : tuple of ProblemNumbers
        There.
    """

    first: Solution
    parameters: tuple[ProblemNumbers, ...]
    _found: OrderedDict[bytes, tuple[Solution, Sensitivities]] = field(default_factory=OrderedDict)

    @classmethod
    def of(cls, problem: Problem | str | Path, wrt: Sequence[str]) -> SolutionMap:
        """That of a problem in parameters by their words.

        Raises
        ------
        NotConverged
            If the problem itself is not solved.
        MbocpError
            As `mbocp.sensitivities` does.
        """
        first = solve(problem_from(problem), check=True)
        return cls(first, sensitivities(first, wrt).parameters)

    @cached_property
    def values(self) -> tuple[Array, ...]:
        """What the problem has of each parameter."""
        return tuple(parameter.value for parameter in self.parameters)

    @cached_property
    def _steps_given(self) -> Problem:
        """The problem itself, with the steps that were found where an accuracy asks for them."""
        return self.first.problem.with_steps_at(self.first.t)

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Of the outputs: `cost`, `t` (N + 1,), `qs` (N + 1, nq), `vs` (N + 1, nv) and `us` (N, nu)."""
        return {name: value.shape for name, value in _outputs(self.first).items()}

    def __call__(self, values: Sequence[Array]) -> dict[str, Array]:
        """Outputs at values of the parameters.

        Raises
        ------
        DimensionMismatch
            If one has another shape.
        NotConverged
            If there is no optimum, with the best that was found.
        """
        return _outputs(self.at(values)[0])

    def push(self, values: Sequence[Array], moves: Sequence[Array]) -> dict[str, Array]:
        """Derivatives of the outputs along moves of the values, by one solve."""
        solution, found = self.at(values)
        inner = {
            parameter.word: np.linalg.pinv(parameter.tangent) @ np.ravel(move)
            for parameter, move in zip(found.parameters, moves, strict=True)
        }
        along = found.along(**inner)
        qs = np.einsum("nij,nj->ni", _tangents(solution), along["qs"])
        t = np.append(0.0, np.cumsum(along["dts"]))
        return {"cost": along["cost"], "t": t, "qs": qs, "vs": along["vs"], "us": along["us"]}

    def pull(self, values: Sequence[Array], bars: Mapping[str, Array]) -> list[Array]:
        """Gradients, by parameter, of what has given derivatives in the outputs, by one adjoint solve."""
        solution, found = self.at(values)
        given = dict(bars)
        given["qs"] = np.einsum("nij,ni->nj", _tangents(solution), given["qs"])
        given["dts"] = np.cumsum(given.pop("t")[:0:-1])[::-1]
        inner = found.gradient(**{name: bar for name, bar in given.items() if np.any(bar)})
        return [
            (np.linalg.pinv(parameter.tangent).T @ inner[parameter.word]).reshape(value.shape)
            for parameter, value in zip(found.parameters, self.values, strict=True)
        ]

    def at(self, values: Sequence[Array]) -> tuple[Solution, Sensitivities]:
        """The optimum at values of the parameters, solved, or found again, and its derivatives.

        Raises
        ------
        DimensionMismatch, NotConverged
            As a call does.
        """
        given = [np.asarray(value, dtype=np.float64) for value in values]
        for parameter, value, own in zip(self.parameters, given, self.values, strict=True):
            if value.shape != own.shape:
                raise DimensionMismatch(parameter.word, value.shape, own.shape)
        key = b"".join(value.tobytes() for value in given)
        if key not in self._found:
            self._found[key] = self._solve(given)
            if len(self._found) > _KEPT:
                self._found.popitem(last=False)
        return self._found[key]

    def _solve(self, values: Sequence[Array]) -> tuple[Solution, Sensitivities]:
        problem = first = self._steps_given
        for parameter, value, own in zip(self.parameters, values, self.values, strict=True):
            if not np.array_equal(value, own):
                problem = parameter.put(problem, value)
        solution = self.first if problem is first else solve(problem, warm_start=self.first)
        if not solution.converged:
            raise NotConverged(solution)
        return solution, sensitivities(solution, [parameter.word for parameter in self.parameters])


def _outputs(solution: Solution) -> dict[str, Array]:
    found = {"t": solution.t, "qs": solution.qs, "vs": solution.vs, "us": solution.us}
    return {"cost": np.array(solution.cost), **{name: np.array(value) for name, value in found.items()}}


def _tangents(solution: Solution) -> Array:
    """Derivatives of the configurations along their tangents, shape (N + 1, nq, nv)."""
    robot = solution.problem.robot
    if robot.is_vector_space:
        return np.broadcast_to(np.eye(robot.nv), (len(solution.qs), robot.nv, robot.nv))
    return ConfigurationSpace(robot.model).tangents(np.asarray(solution.qs))


class UnsolvedWarning(UserWarning):
    """A row of a batch has no optimum, and is NaN."""


@dataclass(frozen=True, eq=False)
class Batches:
    """A map of flat vectors, with any axes of a batch before them: what libraries of derivatives call.

    Inputs are the parameters, one after the other; outputs those of the map, likewise. A row that cannot be
    solved warns, and is NaN.
    """

    of_one: SolutionMap

    @cached_property
    def num_inputs(self) -> int:
        """Numbers of all parameters."""
        return sum(value.size for value in self.of_one.values)

    @cached_property
    def num_outputs(self) -> int:
        """Numbers of all outputs."""
        return sum(math.prod(shape) for shape in self.of_one.shapes.values())

    @cached_property
    def parts(self) -> dict[str, tuple[slice, tuple[int, ...]]]:
        """Where each output is among all, and its shape."""
        shapes = self.of_one.shapes
        return dict(zip(shapes, _parts(list(shapes.values())), strict=True))

    def batch_of(self, shapes: Sequence[tuple[int, ...]]) -> tuple[int, ...]:
        """Axes of the batch of parameters with such shapes.

        Raises
        ------
        DimensionMismatch
            If one has not the shape of its parameter, behind axes of a batch.
        """
        parameters, found = self.of_one.parameters, []
        if len(shapes) != len(parameters):
            raise DimensionMismatch("parameters", (len(shapes),), (len(parameters),))
        for parameter, value, shape in zip(parameters, self.of_one.values, shapes, strict=True):
            batch = shape[: len(shape) - value.ndim]
            if batch + value.shape != shape:
                raise DimensionMismatch(parameter.word, shape, (None, *value.shape), "or without a batch")
            found.append(batch)
        return np.broadcast_shapes(*found)

    def solve(self, values: Array) -> Array:
        """Outputs."""
        return _rows(self.num_outputs, lambda row: self._join(self.of_one(self._cut(row))), values)

    def push(self, values: Array, moves: Array) -> Array:
        """Derivatives of outputs along moves."""

        def one(row: Array, move: Array) -> Array:
            return self._join(self.of_one.push(self._cut(row), self._cut(move)))

        return _rows(self.num_outputs, one, values, moves)

    def pull(self, values: Array, bars: Array) -> Array:
        """Gradients by derivatives in the outputs."""

        def one(row: Array, bar: Array) -> Array:
            cut = {name: bar[at].reshape(shape) for name, (at, shape) in self.parts.items()}
            return np.concatenate([part.ravel() for part in self.of_one.pull(self._cut(row), cut)])

        return _rows(self.num_inputs, one, values, bars)

    def _cut(self, row: Array) -> list[Array]:
        shapes = [value.shape for value in self.of_one.values]
        return [row[at].reshape(shape) for at, shape in _parts(shapes)]

    def _join(self, outputs: Mapping[str, Array]) -> Array:
        return np.concatenate([np.ravel(outputs[name]) for name in self.parts])


def _parts(shapes: Sequence[tuple[int, ...]]) -> list[tuple[slice, tuple[int, ...]]]:
    ends = accumulate((math.prod(shape) for shape in shapes), initial=0)
    return [(slice(*pair), shape) for pair, shape in zip(pairwise(ends), shapes, strict=True)]


def _rows(size: int, one: Callable[..., Array], *given: Array) -> Array:
    """A function of rows, of each row."""
    batch = given[0].shape[:-1]
    rows = [np.asarray(value, dtype=np.float64).reshape(-1, value.shape[-1]) for value in given]
    found = np.full((len(rows[0]), size), np.nan)
    for k, row in enumerate(zip(*rows, strict=True)):
        try:
            found[k] = one(*row)
        except MbocpError as error:
            warn_caller(f"row {k} of the batch is NaN: {error}", UnsolvedWarning)
    return found.reshape(*batch, size)
