"""How large the functions of a stage become, estimated before CasADi builds them.

A function with millions of operations takes minutes to build and to compile, and gigabytes. In natural
coordinates operations grow with the number of bodies; in joint coordinates with the square of the velocities,
since second derivatives of a tree are dense; explicit schemes repeat this for each stage of each substep.
"""

from __future__ import annotations

from mbocp._environment import number_from
from mbocp.exceptions import TooManyOperations
from mbocp.formulation.signature import FunctionSignature
from mbocp.integrators.tableaux import TABLEAUX

__all__ = ["check_operations", "estimated_operations"]

_NAME = "MBOCP_OPERATIONS_LIMIT"
_LIMIT = 10e6
# Of "complete" with chains, arms and legged robots: the estimate is between a third and fifteen times of what
# they have.
_IMPLICIT, _EXPLICIT, _NATURAL = 525, 3000, 400


def check_operations(robot: str, nv: int, signature: FunctionSignature) -> None:
    """Refuse a signature whose functions would be too large.

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
    operations, limit = estimated_operations(nv, signature), _limit()
    if operations <= limit:
        return
    remedy = "Lock joints"
    if signature.substeps > 1:
        remedy = f"Take fewer integrator.substeps than {signature.substeps} and more horizon.steps"
    elif not signature.is_natural and not signature.is_explicit:
        remedy = 'Take coordinates = "natural", or lock joints'
    raise TooManyOperations(robot, nv, operations, limit, remedy)


def estimated_operations(nv: int, signature: FunctionSignature) -> float:
    """Operations of a step with its derivatives, to within a factor of ten or so."""
    if signature.is_natural:
        return float(_NATURAL * nv)
    if signature.is_explicit:
        return float(_EXPLICIT * nv**2 * len(TABLEAUX[signature.scheme].b)) * min(signature.substeps, 10**100)
    return float(_IMPLICIT * nv**2)


def _limit() -> float:
    limit = number_from(_NAME, "a number > 0")
    return _LIMIT if limit is None else limit
