"""`mbocp export`: the motion of a result for controllers and other tools."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import typer

from mbocp._files import is_folder
from mbocp._text import show
from mbocp.exceptions import ResultFileError


def export_result(
    result: Path,
    output: Path,
    kind: str | None,
    rate: float | None,
    interpolation: str | None,
    *,
    quiet: bool,
) -> bool:
    """Write the motion, and warn of joints that leave their limits, the worst first, or are left out.

    Returns
    -------
    is_good : bool
        Whether the motion keeps all limits as it is sent.

    Raises
    ------
    MbocpError
        If the result cannot be read, or the motion not written.
    """
    from mbocp.solution import Solution
    from mbocp.solution.formats import format_of, interpolation_of, rate_of
    from mbocp.solution.sampled import excesses, sample

    name = format_of(output, kind)
    if is_folder(output) or not is_folder(output.parent):
        raise ResultFileError(
            output, f"-o: there is no folder {show(str(output.parent))}, or it is one itself"
        )
    solution = Solution.load(result)
    solution.export(output, kind=name, rate=rate, interpolation=interpolation)
    between = interpolation_of(name, interpolation)
    nodes = sample(solution, None, between)
    if nodes.left_out:
        warnings.warn(f"left out, no joints of one velocity: {', '.join(nodes.left_out)}", stacklevel=1)
    found = excesses(solution, rate_of(name, rate), between)
    of_joints: dict[str, list[str]] = {}  # in the order of their worst
    for excess in found:
        of_joints.setdefault(excess.name, []).append(excess.words)
    for joint, words in of_joints.items():
        warnings.warn(f"{joint} leaves its limits: {'; '.join(words)}", stacklevel=1)
    if not solution.converged:
        warnings.warn(f"the solve ended with {solution.status}: this is no solution", stacklevel=1)
    if not quiet:
        first, last = (np.abs(nodes.accelerations[n]).max() for n in (0, -1))
        typer.echo(
            f"{name}: {output}; {between}s, accelerations at its ends up to {first:.3g} and {last:.3g}"
        )
    return not found
