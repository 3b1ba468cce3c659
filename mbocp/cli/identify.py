"""`mbocp identify` and `excite`: parameters of a robot from a log, and motions that tell most about them."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mbocp._files import RESULT_SUFFIXES
from mbocp.cli import signals
from mbocp.cli.app import (
    Json,
    Locks,
    PackageDirs,
    ProblemFile,
    Quiet,
    Robot,
    Settings,
    argument,
    option,
    output_file,
)
from mbocp.cli.console import count, output, plain_table
from mbocp.cli.results import tell
from mbocp.cli.robot_options import RobotOptions
from mbocp.cli.solve import IMAGES, check_output, problem_of
from mbocp.exceptions import InvalidValue

if TYPE_CHECKING:
    from mbocp.identification import Identification
    from mbocp.robot.parts import Label


def identify(
    name: Robot,
    log: Annotated[
        Path, argument("LOG", "What was recorded: CSV, Parquet, MCAP; see docs/identification.md.")
    ],
    held_out: Annotated[
        Path | None, option("--held-out", "LOG", "Test the result on it. [default: the last fifth of LOG]")
    ] = None,
    payload: Annotated[
        str | None,
        option("--payload", "NAME", "Find this payload, or the body at this frame, and nothing else."),
    ] = None,
    friction: Annotated[
        str, option("--friction", "NAME", "What is unknown of it: both, viscous, coulomb or none.")
    ] = "both",
    friction_speed: Annotated[
        float | None,
        option("--friction-speed", "SPEED", "Over which friction turns [rad/s, m/s]. [default: found]"),
    ] = None,
    rotors: Annotated[bool, typer.Option("--rotors", help="Find rotor inertias, too.")] = False,
    offsets: Annotated[bool, typer.Option("--offsets", help="Find offsets of joint positions, too.")] = False,
    torque_constant: Annotated[
        list[str] | None,
        option("--torque-constant", "JOINT=VALUE", "Torque by motor current [N m/A, N/A]. Repeatable."),
    ] = None,
    out: Annotated[Path | None, option("--out", "NEW.urdf", "Write the URDF with the numbers found.")] = None,
    plot: Annotated[Path | None, option("--plot", "FILE.png", "Draw what is left of the torques.")] = None,
    package_dir: PackageDirs = None,
    lock: Locks = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find masses, inertias and friction from a recorded motion."""
    if out is not None:
        check_output(out, "--out", (".urdf",))
    if plot is not None:
        check_output(plot, "--plot", IMAGES)
    from mbocp.identification import identify as find_parameters

    signals.leave_in_order()
    constants = dict(_constant(words) for words in torque_constant or ())
    found = find_parameters(
        RobotOptions(package_dir, None, None, lock).load(name),
        log,
        held_out=held_out,
        friction=friction,
        rotors=rotors,
        payload=payload,
        offsets=offsets,
        torque_constants=constants,
        friction_speed=friction_speed,
    )
    for message in found.messages:
        warnings.warn(message, stacklevel=1)
    if out is not None:
        found.save(out)
    if plot is not None:
        from mbocp.identification.residual_plot import plot_residuals

        plot_residuals(found, plot)
    if as_json:
        from mbocp._arrays import plain_json

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
    import numpy as np

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


def excite(
    file: ProblemFile,
    settings: Settings = None,
    output: Annotated[Path | None, output_file("FILE.h5", "Save the motion as a result.")] = None,
    torque_noise: Annotated[
        float | None, option("--torque-noise", "VALUE", "Standard deviation of measured torques [N m, N].")
    ] = None,
    starts: Annotated[int | None, option("--starts", "N", "Random motions that are improved.")] = None,
    as_json: Json = False,
) -> None:
    """Find the motion that tells most about masses and friction.

    From start to goal within all limits, by [goal.excite] and the options. Exit status: 0 converged, 1 not, 2
    bad input.
    """
    if output is not None:
        check_output(output, "-o", RESULT_SUFFIXES)
    from mbocp.identification import information
    from mbocp.solving import solve, to_excite

    signals.leave_in_order()
    options = {"torque_noise": torque_noise, "starts": starts}
    given = {key: value for key, value in options.items() if value is not None}
    problem = to_excite(problem_of(file, settings or ()), given)
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
    raise typer.Exit(0 if solution.converged else 1)
