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
    fit: bool,
    check: bool,
    quiet: bool,
) -> bool:
    """Write the motion, and warn of joints and paths that leave their limits, and of joints left out.

    Returns
    -------
    is_written : bool
        Whether it keeps all limits as it is sent, or nobody asked: else no file is written.

    Raises
    ------
    MbocpError
        If the result cannot be read, or the motion not written.
    """
    from mbocp.solution import Solution
    from mbocp.solution.formats import all_excesses, format_of, sent_by, write_recording, write_samples
    from mbocp.solution.recordings import RECORDINGS
    from mbocp.solution.sampled import sample

    name = format_of(output, kind)
    if is_folder(output) or not is_folder(output.parent):
        raise ResultFileError(
            output, f"-o: there is no folder {show(str(output.parent))}, or it is one itself"
        )
    solution = Solution.load(result)
    if name in RECORDINGS:
        write_recording(solution, output, name, rate, interpolation)
        if not quiet:
            typer.echo(f"{name}: {output}; {solution.duration:.6g} s, the motion as it was solved")
        return True
    sent = sent_by(name, solution, rate, interpolation, fit=fit)
    motion = sample(sent)
    if motion.left_out:
        warnings.warn(f"left out, no joints of one velocity: {', '.join(motion.left_out)}", stacklevel=1)
    of_joints: dict[str, list[str]] = {}  # in the order of their worst
    for excess in all_excesses(sent, solution.load_robot):
        of_joints.setdefault(excess.name, []).append(excess.words)
    for joint, words in of_joints.items():
        warnings.warn(f"{joint} leaves its limits: {'; '.join(words)}", stacklevel=1)
    if not solution.converged:
        warnings.warn(f"the solve ended with {solution.status}: this is no solution", stacklevel=1)
    if of_joints and check:
        typer.echo(f"{output}: not written; take more steps, or --no-check", err=True)
        return False
    write_samples(motion, solution, output, name)
    if not quiet:
        first, last = (round(float(np.abs(motion.accelerations[n]).max()), 6) for n in (0, -1))
        fitted = f" ({sent.words})" if sent.words else ""
        typer.echo(
            f"{name}: {output}; {motion.interpolation}s over {motion.t[-1]:.6g} s{fitted}, accelerations at "
            f"its ends up to {first:.3g} and {last:.3g}"
        )
    return True
