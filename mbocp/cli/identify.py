"""`mbocp identify` and `excite`: parameters of a robot from a log, and motions that tell most about them."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from mbocp._arrays import plain_json
from mbocp._dataclass import dataclass
from mbocp._files import RESULT_SUFFIXES
from mbocp.cli import signals
from mbocp.cli.console import count, output, plain_table
from mbocp.cli.results import tell
from mbocp.cli.robot_options import RobotOptions
from mbocp.cli.solve import IMAGES, check_output, problem_of
from mbocp.exceptions import InvalidValue

if TYPE_CHECKING:
    from mbocp.identification import Identification
    from mbocp.robot.parts import Label


@dataclass(frozen=True)
class Asked:
    """What the options say, in the words of `mbocp.identify`."""

    held_out: Path | None
    payload: str | None
    friction: str
    rotors: bool
    offsets: bool
    friction_speed: float | None
    torque_constants: Sequence[str]


def identify_robot(
    name: str,
    log: Path,
    options: RobotOptions,
    asked: Asked,
    out: Path | None,
    plot: Path | None,
    *,
    as_json: bool,
    quiet: bool,
) -> None:
    """Print the parameters, and write URDF and plot where they are asked for.

    Raises
    ------
    MbocpError
        If robot, log or options cannot be right, or a file cannot be written.
    """
    if out is not None:
        check_output(out, "--out", (".urdf",))
    if plot is not None:
        check_output(plot, "--plot", IMAGES)
    from mbocp.identification import identify

    constants = dict(_constant(words) for words in asked.torque_constants)
    found = identify(
        options.load(name),
        log,
        held_out=asked.held_out,
        friction=asked.friction,
        rotors=asked.rotors,
        payload=asked.payload,
        offsets=asked.offsets,
        torque_constants=constants,
        friction_speed=asked.friction_speed,
    )
    for message in found.messages:
        warnings.warn(message, stacklevel=1)
    if out is not None:
        found.save(out)
    if plot is not None:
        from mbocp.identification.residual_plot import plot_residuals

        plot_residuals(found, plot)
    if as_json:
        typer.echo(json.dumps(plain_json(_facts(found)), indent=2))
    elif not quiet:
        _print(found)


def _constant(words: str) -> tuple[str, float]:
    joint, _, value = words.partition("=")
    try:
        return joint, float(value)
    except ValueError:
        raise InvalidValue(
            "--torque-constant", repr(words), "JOINT=VALUE with a number [N m/A, N/A]"
        ) from None


def _facts(found: Identification) -> dict[str, Any]:
    """All numbers by name."""
    return {
        "robot": found.robot.name,
        "parameters": {
            label.name: {"unit": label.unit, "value": value, "sd": sd, "file": file}
            for label, value, sd, file in zip(
                found.labels, found.values, found.sd, found.file_values, strict=True
            )
        },
        "friction_speed": {
            label.unit: {"value": value, "sd": sd, "file": file}
            for label, value, sd, file in _friction_speeds(found)
        },
        "base_parameters": {
            name: {"value": value, "sd": sd}
            for name, value, sd in zip(found.base.names, found.base_values, found.base_sd, strict=True)
        },
        "joints": {
            name: {
                "offset": found.offsets[k],
                "offset_sd": found.offset_sd[k],
                "position_noise": found.position_noise[k],
                "torque_noise": found.torque_noise[k],
                "held_out": found.held_out.rms[k],
                "held_out_before": found.held_out.rms_before[k],
            }
            for k, name in enumerate(found.joints)
        },
        "bodies": {
            body.name: {"mass": now.mass, "com": now.lever, "inertia": now.inertia}
            for body, now in found.bodies
        },
        "messages": list(found.messages),
    }


def _friction_speeds(found: Identification) -> Iterable[tuple[Label, float, float, float]]:
    return zip(found.speed_labels, found.speeds, found.speed_sd, found.file_speeds, strict=True)


def _print(found: Identification) -> None:
    from mbocp.identification.dynamics import PER_BODY

    console = output()
    console.print(
        f"{found.robot.name}: {count(len(found.labels), 'parameter')}, torques tell {found.base.rank} "
        "combinations of them",
        style="bold underline",
    )
    table = plain_table("body", "mass, kg", "+-", "file", "centre of mass, m", "principal inertias, kg m^2")
    for k, (body, now) in enumerate(found.bodies):
        table.add_row(
            body.name,
            f"{now.mass:.4g}",
            f"{1.96 * found.sd[PER_BODY * k]:.2g}",
            f"{body.values[0]:.4g}",
            " ".join(f"{x:.4g}" for x in now.lever),
            " ".join(f"{x:.3g}" for x in np.linalg.eigvalsh(now.inertia)),
        )
    console.print(table)
    table = plain_table("parameter", "value", "+-", "file", "unit")
    for k in range(PER_BODY * len(found.bodies), len(found.labels)):
        label = found.labels[k]
        numbers = (found.values[k], 1.96 * found.sd[k], found.file_values[k])
        table.add_row(label.name, *(f"{x:.4g}" for x in numbers), label.unit)
    for label, value, sd, file in _friction_speeds(found):
        table.add_row(label.name, f"{value:.4g}", f"{1.96 * sd:.2g}", f"{file:.4g}", label.unit)
    if found.offset_sd.any():
        for name, offset, sd in zip(found.joints, found.offsets, found.offset_sd, strict=True):
            table.add_row(f"{name}.offset", f"{offset:.4g}", f"{1.96 * sd:.2g}", "0", "rad, m")
    if table.rows:
        console.print(table)
    table = plain_table(
        "joint", "torque left, samples held out", "with the file's numbers", "torque noise", "position noise"
    )
    for k, name in enumerate(found.joints):
        left = (found.held_out.rms[k], found.held_out.rms_before[k])
        noise = (found.torque_noise[k], found.position_noise[k])
        table.add_row(name, *(f"{x:.3g}" for x in left + noise))
    console.print(table)


def print_exciting(
    file: Path,
    settings: Sequence[str],
    output: Path | None,
    options: Mapping[str, Any],
    *,
    as_json: bool,
) -> int:
    """Print the information of the motion, save it, and return the exit status."""
    if output is not None:
        check_output(output, "-o", RESULT_SUFFIXES)
    from mbocp.identification import information
    from mbocp.solving import solve, to_excite

    signals.leave_in_order()
    given = {key: value for key, value in options.items() if value is not None}
    problem = to_excite(problem_of(file, settings), given)
    asked = problem.excite
    assert asked is not None
    solution = solve(problem)
    told = information(solution, torque_noise=asked.torque_noise, friction=asked.friction)
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
