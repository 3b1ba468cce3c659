"""Optima as functions in PyTorch, with forward and reverse derivatives and batches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch

from mbocp.autodiff.solution_map import Batches, SolutionMap
from mbocp.problem import Problem


def solve(problem: Problem | str | Path, wrt: Sequence[str]) -> Callable[..., dict[str, Any]]:
    """The optimum of a problem as a function of some of its numbers.

    Parameters
    ----------
    problem : Problem, str or Path
        A problem that has an optimum, where all solves begin.
    wrt : sequence of str
        Words of parameters, as in `mbocp.sensitivities`.

    Returns
    -------
    callable
        Takes a tensor for each word, of the shape that the problem has, behind axes of a batch if you like.
        Returns `cost`, `t`, `qs`, `vs` and `us` behind the same axes. Rows with no optimum warn, and are NaN.

    Raises
    ------
    MbocpError
        As `mbocp.solve` and `mbocp.sensitivities` do.
    """
    batches = Batches(SolutionMap.of(problem, wrt))

    def optimum(*parameters: Any) -> dict[str, Any]:
        given = [torch.as_tensor(parameter) for parameter in parameters]
        batch = batches.batch_of([tuple(value.shape) for value in given])
        own = [value.shape for value in batches.of_one.values]
        rows = [v.expand(batch + shape).reshape(*batch, -1) for v, shape in zip(given, own, strict=True)]
        found = _Solve.apply(torch.cat(rows, dim=-1), batches)
        return {name: found[..., at].reshape(batch + shape) for name, (at, shape) in batches.parts.items()}

    return optimum


def _outside(function: Callable[..., Any], *given: Any) -> Any:
    """A function of rows of numbers, outside of PyTorch."""
    return torch.as_tensor(function(*(value.detach().cpu().numpy() for value in given))).to(given[0])


class _Solve(torch.autograd.Function):  # type: ignore[misc]
    """Outputs by parameters."""

    @staticmethod
    def forward(values: Any, batches: Batches) -> Any:
        return _outside(batches.solve, values)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        values, ctx.batches = inputs
        ctx.save_for_backward(values)
        ctx.save_for_forward(values)

    @staticmethod
    def backward(ctx: Any, bar: Any) -> Any:
        return _Product.apply(*ctx.saved_tensors, bar, ctx.batches, True), None

    @staticmethod
    def jvp(ctx: Any, moves: Any, _: Any) -> Any:
        return _Product.apply(*ctx.saved_tensors, moves, ctx.batches, False)

    @staticmethod
    def vmap(info: Any, axes: Any, values: Any, batches: Batches) -> Any:
        return _Solve.apply(values.movedim(axes[0], 0), batches), 0


class _Product(torch.autograd.Function):  # type: ignore[misc]
    """A product of the Jacobian, or of its transpose, with a vector, in which it is linear."""

    @staticmethod
    def forward(values: Any, vector: Any, batches: Batches, is_adjoint: bool) -> Any:
        return _outside(batches.pull if is_adjoint else batches.push, values, vector)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        values, _, ctx.batches, ctx.is_adjoint = inputs
        ctx.save_for_backward(values)

    @staticmethod
    def backward(ctx: Any, bar: Any) -> Any:
        if ctx.needs_input_grad[0]:
            raise NotImplementedError("mbocp.autodiff.torch: optima have first derivatives alone")
        return None, _Product.apply(*ctx.saved_tensors, bar, ctx.batches, not ctx.is_adjoint), None, None

    @staticmethod
    def vmap(info: Any, axes: Any, values: Any, vector: Any, batches: Batches, is_adjoint: bool) -> Any:
        given = (
            value.expand(info.batch_size, *value.shape) if axis is None else value.movedim(axis, 0)
            for value, axis in ((values, axes[0]), (vector, axes[1]))
        )
        return _Product.apply(*given, batches, is_adjoint), 0
