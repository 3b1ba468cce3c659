r"""Functions of quaternions as functions of rotation matrices.

Pinocchio takes attitudes as quaternions and turns them into rotation matrices, whose entries are sums of
products of two components. Products of a unit quaternion's components are linear in its rotation matrix, so
that a function evaluated on products of components, and not on components, needs no quaternion at all. No
square root and no case is taken, and a matrix that is no rotation goes in as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

from mbocp._arrays import dataclass
from mbocp.exceptions import UnsupportedRobot


@dataclass(frozen=True)
class _Component:
    """A number times one component of a quaternion."""

    quaternion: int
    index: int  # of x, y, z, w
    factor: float


def call_with_matrices(
    function: ca.Function, q: ca.SX, matrices: Sequence[tuple[int, ca.SX]], others: Sequence[ca.SX]
) -> list[ca.SX]:
    """Outputs of `function` (q, *others) with some quaternions in q given as rotation matrices.

    Parameters
    ----------
    function : casadi.Function
        Of SX type; its first argument is a configuration with quaternions xyzw.
    q : casadi.SX, shape (nq,)
        The configuration; entries of those quaternions are not looked at.
    matrices : sequence of (int, casadi.SX)
        Where in q each quaternion begins, and its matrix (3, 3).
    others : sequence of casadi.SX
        Further arguments.

    Raises
    ------
    UnsupportedRobot
        If the function uses a component of a quaternion otherwise than in products of two.
    """
    components = {start + i: (k, i) for k, (start, _) in enumerate(matrices) for i in range(4)}
    products = [_products(matrix) for _, matrix in matrices]
    arguments = [q, *others]
    outputs = [ca.SX.zeros(function.sparsity_out(i)) for i in range(function.n_out())]
    inputs = [_nonzeros(function.sparsity_in(i), a) for i, a in enumerate(arguments)]
    work: list[ca.SX | _Component] = [ca.SX(0)] * function.sz_w()
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        into, out_of = function.instruction_output(k), function.instruction_input(k)
        if operation == ca.OP_CONST:
            work[into[0]] = ca.SX(function.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            argument, entry = out_of
            if argument == 0 and entry in components:
                block, index = components[entry]
                work[into[0]] = _Component(block, index, 1.0)
            else:
                work[into[0]] = inputs[argument][entry]
        elif operation == ca.OP_OUTPUT:
            value = work[out_of[0]]
            if isinstance(value, _Component):
                raise _refusal(function)
            outputs[into[0]].nz[into[1]] = value
        else:
            work[into[0]] = _apply(function, operation, [work[i] for i in out_of], products)
    return outputs


def _apply(
    function: ca.Function, operation: int, values: list[ca.SX | _Component], products: list[list[list[ca.SX]]]
) -> ca.SX | _Component:
    components = [value for value in values if isinstance(value, _Component)]
    if not components:
        plain: list[Any] = values
        return ca.SX.unary(operation, *plain) if len(plain) == 1 else ca.SX.binary(operation, *plain)
    first, last = components[0], components[-1]
    is_product = operation == ca.OP_SQ or (operation == ca.OP_MUL and len(components) == 2)
    if is_product and first.quaternion == last.quaternion:
        return first.factor * last.factor * products[first.quaternion][first.index][last.index]
    factor = _factor(operation, values, components)
    if factor is None:
        raise _refusal(function)
    return _Component(first.quaternion, first.index, factor * first.factor)


def _factor(operation: int, values: list[ca.SX | _Component], components: list[_Component]) -> float | None:
    """By what an operation multiplies the first component; None where it does something else."""
    is_doubled = operation == ca.OP_ADD and components == [components[0]] * 2
    if operation == ca.OP_TWICE or is_doubled:
        return 2.0
    if operation == ca.OP_NEG:
        return -1.0
    numbers = [value for value in values if isinstance(value, ca.SX) and value.is_constant()]
    return float(numbers[0]) if operation == ca.OP_MUL and numbers else None


def _refusal(function: ca.Function) -> UnsupportedRobot:
    return UnsupportedRobot(
        f"{function.name()} of this robot does more with a quaternion than build a rotation matrix of it; "
        'take rotations = "quaternion"'
    )


def _nonzeros(sparsity: ca.Sparsity, argument: ca.SX) -> list[ca.SX]:
    placed = ca.project(argument, sparsity)
    return [placed.nz[i] for i in range(sparsity.nnz())]


def _products(R: ca.SX) -> list[list[ca.SX]]:
    """Products of the components x, y, z, w of the quaternion of R, linear in R."""
    diagonal = [R[0, 0], R[1, 1], R[2, 2]]
    trace = diagonal[0] + diagonal[1] + diagonal[2]
    table: list[list[ca.SX]] = [[ca.SX(0)] * 4 for _ in range(4)]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        table[i][i] = (1 - trace) / 4 + diagonal[i] / 2
        table[i][j] = table[j][i] = (R[i, j] + R[j, i]) / 4
        table[i][3] = table[3][i] = (R[k, j] - R[j, k]) / 4
    table[3][3] = (1 + trace) / 4
    return table
