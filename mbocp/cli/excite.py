"""`mbocp excite`: a motion that tells most about base parameters, and what it tells."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import typer

from mbocp._files import RESULT_SUFFIXES
from mbocp.cli import signals
from mbocp.cli.results import tell
from mbocp.cli.solve import check_output, problem_of


def print_exciting(
    file: Path,
    settings: Sequence[str],
    output: Path | None,
    torque_noise: float,
    starts: int,
    *,
    as_json: bool,
) -> int:
    """Print the information of the motion, save it, and return the exit status."""
    if output is not None:
        check_output(output, "-o", RESULT_SUFFIXES)
    from mbocp.identification import excite, information

    signals.leave_in_order()
    solution = excite(problem_of(file, settings), torque_noise=torque_noise, starts=starts)
    told = information(solution, torque_noise=torque_noise)
    if output is not None:
        solution.save(output)
        tell(f"result: {output}", as_json)
    if as_json:
        facts = {"status": str(solution.status), "log_det": told.log_det, "condition": told.condition}
        typer.echo(json.dumps({**facts, "sd": dict(zip(told.base.names, told.sd.tolist(), strict=True))}))
    else:
        typer.echo(str(told))
    if not solution.converged:
        typer.echo(f"{file.name}: {solution.status}: {solution.advice}", err=True)
    return 0 if solution.converged else 1
