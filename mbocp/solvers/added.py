"""Solvers that other packages add.

Their entry points in the group `mbocp.solvers` name a function each, which takes `SolverSettings` and returns
an object with `name`, `tolerance`, `init`, `step` and `terminate`, see `mbocp.solvers.protocol.Solver`.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from mbocp.exceptions import InvalidValue

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

    from mbocp.solvers.options import SolverSettings
    from mbocp.solvers.protocol import Solver

GROUP = "mbocp.solvers"


@cache
def find_added_solvers() -> EntryPoints:
    """Entry points of all that are installed; looking for them takes a while."""
    from importlib.metadata import entry_points  # slow to import, and few solves ask

    return entry_points(group=GROUP)


def make_added_solver(name: str, settings: SolverSettings) -> Solver[Any]:
    """Make the solver `name`, one of those that `find_added_solvers` lists.

    Raises
    ------
    InvalidValue
        If its package does not load.
    """
    point = find_added_solvers()[name]
    try:
        make = point.load()
    except (ImportError, AttributeError) as error:
        package = point.dist.name if point.dist else point.value
        raise InvalidValue(
            "solver.method", repr(name), f"a solver that loads ({package}: {error})"
        ) from error
    return make(settings)
