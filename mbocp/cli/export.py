"""`mbocp export`: the motion of a result for controllers and other tools."""

from __future__ import annotations

import warnings
from pathlib import Path

import typer

from mbocp._files import is_folder
from mbocp._text import shown
from mbocp.exceptions import ResultFileError

__all__ = ["export_result"]

_MAX_TOLD = 4


def export_result(result: Path, output: Path, kind: str | None, rate: float | None, *, quiet: bool) -> None:
    """Write the motion, and warn of limits that it exceeds between nodes, and of joints that are left out.

    Raises
    ------
    MbocpError
        If the result cannot be read, or the motion not written.
    """
    from mbocp.solution import Solution
    from mbocp.solution.formats import format_of
    from mbocp.solution.sampled import excesses, sample

    name = format_of(output, kind)
    if is_folder(output) or not is_folder(output.parent):
        raise ResultFileError(
            output, f"-o: there is no folder {shown(str(output.parent))}, or it is one itself"
        )
    solution = Solution.load(result)
    solution.export(output, kind=name, rate=rate)
    left_out = sample(solution).left_out
    if left_out:
        warnings.warn(f"left out, no joints of one velocity: {', '.join(left_out)}", stacklevel=1)
    beyond = excesses(solution)
    if beyond:
        more = f"; and {len(beyond) - _MAX_TOLD} more" if len(beyond) > _MAX_TOLD else ""
        warnings.warn(
            f"the cubics between nodes leave the limits: {'; '.join(beyond[:_MAX_TOLD])}{more}", stacklevel=1
        )
    if not solution.converged:
        warnings.warn(f"the solve ended with {solution.status}: this is no solution", stacklevel=1)
    if not quiet:
        typer.echo(f"{name}: {output}")
