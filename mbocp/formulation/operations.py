"""How large the functions of a stage become, estimated before CasADi builds them.

A function with millions of operations takes minutes to build and to compile, and gigabytes. How their number
grows with the robot is for each kind of `Steps` to say. With chains, arms and legged robots these estimates
are between a third and fifteen times of what "complete" has.
"""

from __future__ import annotations

from mbocp._environment import number_from
from mbocp.exceptions import TooManyOperations
from mbocp.formulation.signature import FunctionSignature

_NAME = "MBOCP_OPERATIONS_LIMIT"
_LIMIT = 10e6


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
    operations, limit = signature.steps.operations(nv), _limit()
    if operations > limit:
        raise TooManyOperations(robot, nv, operations, limit, signature.steps.remedy)


def _limit() -> float:
    limit = number_from(_NAME, "a number > 0")
    return _LIMIT if limit is None else limit
