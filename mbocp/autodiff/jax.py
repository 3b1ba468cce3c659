"""Optima as functions in JAX, with forward and reverse derivatives, jit and vmap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

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
        Takes an array for each word, of the shape that the problem has, behind axes of a batch if you like.
        Returns `cost`, `t`, `qs`, `vs` and `us` behind the same axes. Rows with no optimum warn, and are NaN.

    Raises
    ------
    MbocpError
        As `mbocp.solve` and `mbocp.sensitivities` do.
    """
    batches = Batches(SolutionMap.of(problem, wrt))

    def derivative(primals: Any, tangents: Any) -> Any:
        (values,), (moves,) = primals, tangents
        return flat(values), _product.bind(values, moves, batches=batches, is_adjoint=False)

    flat = jax.custom_jvp(lambda values: _call(batches.solve, batches.num_outputs, values))
    flat.defjvp(derivative)

    def optimum(*parameters: Any) -> dict[str, Any]:
        given = [jnp.asarray(parameter, dtype=float) for parameter in parameters]
        batch = batches.batch_of([value.shape for value in given])
        own = [value.shape for value in batches.of_one.values]
        pairs = zip(given, own, strict=True)
        rows = [jnp.broadcast_to(v, batch + shape).reshape(*batch, int(np.prod(shape))) for v, shape in pairs]
        found = flat(jnp.concatenate(rows, axis=-1))
        return {name: found[..., at].reshape(batch + shape) for name, (at, shape) in batches.parts.items()}

    return optimum


def _call(function: Callable[..., Any], size: int, *given: Any) -> Any:
    """A function of rows of numbers, outside of JAX."""
    dtype = jnp.result_type(float)
    shape = jax.ShapeDtypeStruct((*given[0].shape[:-1], size), dtype)

    def outside(*rows: Any) -> Any:
        return function(*map(np.asarray, rows)).astype(dtype)

    return jax.pure_callback(outside, shape, *given, vmap_method="broadcast_all")


# A product of the Jacobian, or of its transpose, with a vector, which each other's transposes are: neither
# `jax.custom_jvp` nor `jax.custom_vjp` has both without forming the Jacobian.
_product = Primitive("mbocp_product")


def _evaluate(values: Any, vector: Any, *, batches: Batches, is_adjoint: bool) -> Any:
    function, size = _function(batches, is_adjoint)
    return _call(function, size, values, vector)


def _function(batches: Batches, is_adjoint: bool) -> tuple[Callable[..., Any], int]:
    return (batches.pull, batches.num_inputs) if is_adjoint else (batches.push, batches.num_outputs)


def _shape(values: Any, vector: Any, *, batches: Batches, is_adjoint: bool) -> Any:
    return jax.core.ShapedArray((*values.shape[:-1], _function(batches, is_adjoint)[1]), vector.dtype)


def _derivative(given: Any, moves: Any, **how: Any) -> Any:
    (values, vector), (of_values, of_vector) = given, moves
    if not isinstance(of_values, ad.Zero):
        raise NotImplementedError("mbocp.autodiff.jax: optima have first derivatives alone")
    return _product.bind(values, vector, **how), _product.bind(values, ad.instantiate_zeros(of_vector), **how)


def _transpose(bar: Any, values: Any, _: Any, *, batches: Batches, is_adjoint: bool) -> Any:
    found = _product.bind(values, ad.instantiate_zeros(bar), batches=batches, is_adjoint=not is_adjoint)
    return None, found


def _batch(given: Any, axes: Any, **how: Any) -> Any:
    pairs = list(zip(given, axes, strict=True))
    size = next(value.shape[axis] for value, axis in pairs if axis is not None)
    rows = (
        jnp.broadcast_to(value, (size, *value.shape)) if axis is None else jnp.moveaxis(value, axis, 0)
        for value, axis in pairs
    )
    return _product.bind(*rows, **how), 0


_product.def_impl(_evaluate)
_product.def_abstract_eval(_shape)
ad.primitive_jvps[_product] = _derivative
ad.primitive_transposes[_product] = _transpose
batching.primitive_batchers[_product] = _batch
mlir.register_lowering(_product, mlir.lower_fun(_evaluate, multiple_results=False))
