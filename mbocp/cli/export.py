"""`mbocp export`: the motion of a result for controllers and other tools."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import typer

from mbocp._files import is_folder
from mbocp._text import list_names, show
from mbocp.exceptions import MbocpError, ResultFileError

if TYPE_CHECKING:
    from mbocp.solution import Solution
    from mbocp.solution.sent import Excess, Sent

_MOST_NAMES = 3


def export_result(
    result: Path,
    output: Path,
    kind: str | None,
    rate: float | None,
    interpolation: str | None,
    *,
    fit: bool,
    quiet: bool,
) -> bool:
    """Write the motion, and warn of joints and paths that leave their limits, and of joints left out.

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
    from mbocp.solution.formats import format_of, sent_by, write_samples
    from mbocp.solution.sampled import sample

    name = format_of(output, kind)
    if is_folder(output) or not is_folder(output.parent):
        raise ResultFileError(
            output, f"-o: there is no folder {show(str(output.parent))}, or it is one itself"
        )
    solution = Solution.load(result)
    sent = sent_by(name, solution, rate, interpolation, fit=fit)
    motion = sample(sent)
    write_samples(motion, solution, output, name)
    if motion.left_out:
        warnings.warn(f"left out, no joints of one velocity: {', '.join(motion.left_out)}", stacklevel=1)
    excesses = (*sent.excesses, *_robot_excesses(sent, solution))
    of_joints: dict[str, list[str]] = {}  # in the order of their worst
    for excess in excesses:
        of_joints.setdefault(excess.name, []).append(excess.words)
    for joint, words in of_joints.items():
        warnings.warn(f"{joint} leaves its limits: {'; '.join(words)}", stacklevel=1)
    if not solution.converged:
        warnings.warn(f"the solve ended with {solution.status}: this is no solution", stacklevel=1)
    if not quiet:
        first, last = (round(float(np.abs(motion.accelerations[n]).max()), 6) for n in (0, -1))
        fitted = f" ({sent.words})" if sent.words else ""
        typer.echo(
            f"{name}: {output}; {motion.interpolation}s over {motion.t[-1]:.6g} s{fitted}, accelerations at "
            f"its ends up to {first:.3g} and {last:.3g}"
        )
    return not excesses


def _robot_excesses(sent: Sent, solution: Solution) -> tuple[Excess, ...]:
    """What is beyond limits of effort and path constraints as the motion is sent; told where nobody knows."""
    from mbocp.solution.its_problem import problem_without
    from mbocp.solution.sent_checks import check_sent

    if not (np.isfinite(solution.limits_u).any() or solution.facts.path):
        return ()
    try:
        excesses, unknown = check_sent(sent, problem_without(solution, solution.load_robot, "terms"))
    except MbocpError as error:
        warnings.warn(f"efforts and paths are not looked at as they are sent: {error}", stacklevel=1)
        return ()
    if unknown:
        names = list_names(unknown, _MOST_NAMES)
        warnings.warn(f"not looked at as it is sent, positions do not say it: {names}", stacklevel=1)
    return excesses
