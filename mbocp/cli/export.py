"""`mbocp export`: the motion of a result for controllers and other tools."""

from __future__ import annotations

import warnings
from pathlib import Path

import typer

from mbocp._files import is_folder
from mbocp._text import show
from mbocp.exceptions import ResultFileError


def export_result(
    result: Path, output: Path, kind: str | None, rate: float | None, *, check: bool, quiet: bool
) -> bool:
    """Write the motion, and warn of joints that leave their limits, the worst first, or are left out.

    Returns
    -------
    is_good : bool
        False if `check`, and a limit is exceeded.

    Raises
    ------
    MbocpError
        If the result cannot be read, or the motion not written.
    """
    from mbocp.solution import Solution
    from mbocp.solution.formats import format_of, rate_of
    from mbocp.solution.sampled import excesses, sample

    name = format_of(output, kind)
    if is_folder(output) or not is_folder(output.parent):
        raise ResultFileError(
            output, f"-o: there is no folder {show(str(output.parent))}, or it is one itself"
        )
    solution = Solution.load(result)
    solution.export(output, kind=name, rate=rate)
    left_out = sample(solution).left_out
    if left_out:
        warnings.warn(f"left out, no joints of one velocity: {', '.join(left_out)}", stacklevel=1)
    found = excesses(solution, rate_of(name, rate))
    of_joints: dict[str, list[str]] = {}  # in the order of their worst
    for excess in found:
        of_joints.setdefault(excess.name, []).append(excess.words)
    for joint, words in of_joints.items():
        warnings.warn(f"{joint} leaves its limits: {'; '.join(words)}", stacklevel=1)
    if not solution.converged:
        warnings.warn(f"the solve ended with {solution.status}: this is no solution", stacklevel=1)
    if not quiet:
        typer.echo(f"{name}: {output}")
    return not (check and found)
