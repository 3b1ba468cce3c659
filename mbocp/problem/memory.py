"""How much memory a horizon takes, estimated before anything of its length is allocated."""

from __future__ import annotations

from mbocp._memory import check_memory, is_given

# Fitted to the largest resident memory of solves of 10,000 to 40,000 steps; 10 to 30 % more than measured.
_MATRICES, _VECTORS, _REST = 2.5, 16.0, 3000.0
_INTERIOR = 4.5  # solvers of others keep their own Jacobians, Hessians and factors; IPOPT: 3.7 measured
_SMALL = 16e6  # [bytes]: less than a tenth of what the process has taken by then; nobody asks the system
_MAX_FLOAT = 10**300  # beyond, floats end


def check_horizon(steps: int, unknowns: int, *, by_others: bool = False) -> None:
    """Refuse more steps than there is memory for.

    Parameters
    ----------
    steps : int
        N.
    unknowns : int
        States at both ends of a step, impulses and controls.
    by_others : bool
        Whether IPOPT or fatrop solves the problem.

    Raises
    ------
    MemoryLimitExceeded
    """
    each = bytes_per_step(unknowns, by_others=by_others)
    if steps <= _SMALL / each and not is_given():  # an integer may be beyond all floats
        return
    check_memory(
        min(steps * round(each), _MAX_FLOAT),
        f"horizon.steps: {min(steps, _MAX_FLOAT):.4g} steps of {unknowns} unknowns "
        f"({each / 1e3:.3g} kB each)",
        "Take fewer steps",
    )


def bytes_per_step(unknowns: int, *, by_others: bool = False) -> float:
    """Memory of one step in a solve: a few matrices and vectors of its unknowns, and records [bytes]."""
    ours = 8.0 * (_MATRICES * unknowns**2 + _VECTORS * unknowns) + _REST
    return _INTERIOR * ours if by_others else ours
