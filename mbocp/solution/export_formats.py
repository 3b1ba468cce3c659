"""A motion for other tools: CSV, a ROS 2 JointTrajectory, URScript, NumPy, Parquet, recordings."""

from __future__ import annotations

import io
import json
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from mbocp._arrays import Array
from mbocp._text import list_names, printable, show, warn_caller
from mbocp.exceptions import InvalidValue, LimitsExceeded, MbocpError, ResultFileError
from mbocp.robot import Robot
from mbocp.solution.atomic import csv_of, replace_file
from mbocp.solution.fitting import MOST
from mbocp.solution.joints_sent import EFFORT_RATE, Excess
from mbocp.solution.recordings import RECORDINGS, SENT, record, ros_duration
from mbocp.solution.sampled import JointSamples, sample
from mbocp.solution.sent import NotCheckedWarning, Sent, compute_motion_sent
from mbocp.solution.solution_data import SolutionData

_MOST_NAMES = 3
_TRIES = 4  # at a slower motion: within 1.3 % of the duration that it needs
_ROUND_OFF = 1e-9
_UR_JOINTS = 6
_UR_RATE = 125.0  # [1/s] of servoj, unless another is asked for
_SUFFIXES = {
    ".csv": "csv",
    ".yaml": "ros2",
    ".yml": "ros2",
    ".script": "urscript",
    ".npz": "npz",
    ".parquet": "parquet",
    ".mcap": "mcap",
    ".rrd": "rerun",
}
_MOVIES = (".gif", ".mp4")


def format_of(path: Path, name: str | None = None) -> str:
    """The format that is asked for, or that the suffix of the file says.

    Raises
    ------
    InvalidValue
        If there is no such format.
    """
    chosen = name or _SUFFIXES.get(path.suffix.lower())
    if chosen is None:
        listed = ", ".join(f"{suffix} ({kind})" for suffix, kind in _SUFFIXES.items())
        if path.suffix.lower() in _MOVIES:
            listed += f"; `mbocp replay RESULT --movie {path.name}` films a motion"
        raise InvalidValue("format", show(path.suffix or path.name), f"a suffix that says it: {listed}")
    known = (*FORMATS, *RECORDINGS)
    if chosen not in known:
        raise InvalidValue.of_choice("format", chosen, known)
    return chosen


def export_motion(
    solution: SolutionData,
    path: str | Path,
    *,
    kind: str | None = None,
    rate: float | None = None,
    interpolation: str | None = None,
    fit: bool = True,
    check: bool = True,
    part: str | None = None,
    load_robot: Callable[[], Robot] | None = None,
) -> Path:
    """Write the motion of the joints that slide or turn about an axis; as a recording, of all of them.

    Parameters
    ----------
    solution : Solution
    path : str or Path
        An old file is replaced only when the new one is complete.
    kind : {"csv", "ros2", "urscript", "npz", "parquet", "mcap", "rerun", "multidof"}, optional
        By default what the suffix says: .csv, .yaml, .script, .npz, .parquet, .mcap, .rrd.
    rate : float, optional
        Samples a second [1/s]; the nodes by default, for URScript 125.
    interpolation : {"cubic", "quintic"}, optional
        Between the nodes. Default: cubics; for ROS 2, whose controllers put the same between points,
        quintics, or cubics where jerks are free and quintics leave limits that cubics keep.
    fit : bool
        Whether the motion is fitted into its limits, see `mbocp.solution.sent`.
    check : bool
        Whether a motion that leaves limits as it is sent is refused, see `all_excesses` and `base_excesses`;
        with a robot alone.
    part : str, optional
        Write the joints of this one of several robots alone, as its own controller calls them. All of them
        are fitted and checked together.
    load_robot : callable, optional
        Loads the robot of the solution, which says the efforts that the motion takes as it is sent.

    Raises
    ------
    InvalidValue
        If format, rate or part cannot be right.
    ResultFileError
        If the robot does not fit the format, or the file cannot be written.
    LimitsExceeded
        If the motion leaves limits.

    Warns
    -----
    NotCheckedWarning
        If some limits cannot be looked at.
    """
    path = Path(path)
    name = format_of(path, kind)
    if name in RECORDINGS:
        return write_recording(solution, path, name, rate, interpolation, part, check=check)
    if load_robot is None or not check:
        sent = prepare(name, solution, rate, interpolation, fit=fit)
    else:
        sent, excesses = prepare_within(name, solution, rate, interpolation, fit=fit, load_robot=load_robot)
        if excesses:
            raise LimitsExceeded(path, excesses, what_helps(sent, excesses, lacks_rate=fit and rate is None))
    return write_samples(sample(sent, load_robot, part), solution, path, name)


def what_helps(
    sent: Sent, excesses: Sequence[Excess], result: Path | str = "RESULT.h5", *, lacks_rate: bool = False
) -> str:
    """Say what may keep a motion within limits that it leaves as it is sent, the worst first.

    Of one that is no solution: what says why; `result` is its file. One that `lacks_rate` is not fitted where
    it is sent at its nodes alone.
    """
    if not sent.solution.is_stationary:
        return f"the solve did not converge; `mbocp explain {result}` says why"
    if sent.is_nearest and excesses[0].kind in ("position", "speed", "acceleration"):
        return "the state in which it begins leads there: begin slower, or with less acceleration"
    if sent.curves.has_impacts and excesses[0].kind in ("acceleration", "jerk"):
        return 'its velocities leap, at impacts: let holds begin at rest, or meeting = "soft"'
    if excesses[0].kind == "path" and (sent.mean or sent.is_nearest):
        return _what_helps_paths(sent, max(excess.over_tolerance for excess in excesses))
    if lacks_rate and len(sent.times) == len(sent.solution.t) and not sent.words:
        return "say the controller's rate, --rate 1000 for one, at which it is fitted into its limits"
    return "take more steps"


def _what_helps_paths(sent: Sent, over: float) -> str:
    """Say what makes smoothing leave paths by less, which it does by so many times what may be left.

    A mean over a step keeps jerks whose accelerations are constant in steps, and leaves a path by the square
    of its time.
    """
    step, steps = float(np.diff(sent.solution.t).max()), sent.solution.num_steps
    if not sent.curves.is_from_rest_to_rest:
        return (
            "take more steps: what begins or ends in motion is sent as the nearest motion of each joint alone"
        )
    if sent.is_nearest or sent.mean > (1.0 + _ROUND_OFF) * step:
        kept = 'take scheme = "midpoint" and controls = "constant", whose jerks a mean over a step keeps'
        return f"{kept}: here accelerations leap within steps"
    words = f"accelerations that change from step to step are smoothed over {1e3 * sent.mean:.0f} ms"
    many = math.ceil(steps * math.sqrt(over) / 10.0) * 10 + 10
    return f"take about {many} steps, or give cost.acceleration a weight: {words}"


def write_recording(
    solution: SolutionData,
    path: Path,
    name: str,
    rate: float | None = None,
    interpolation: str | None = None,
    part: str | None = None,
    *,
    check: bool = True,
) -> Path:
    """Write a motion with the poses of its robot, see `mbocp.solution.recordings`.

    Raises
    ------
    InvalidValue, RobotError
        If the rate cannot be right, an interpolation or a part is asked for, or there is no robot.
    ResultFileError
        If an extra is missing, or the file cannot be written.
    LimitsExceeded
        With `check`, if bases and balls for ROS 2 leave limits from point to point.
    """
    from mbocp.solution.bases_sent import base_excesses
    from mbocp.solution.its_robot import robot_of

    for key, value in (("interpolation", interpolation), ("part", part)):
        if value is not None:
            raise InvalidValue(key, value, f"none: {name} has the motion of all as it was solved")
    robot = robot_of(solution)
    motion = record(solution, robot, rate)
    try:
        written = RECORDINGS[name](motion)
    except InvalidValue as error:
        raise ResultFileError(path, str(error)) from error
    if check and name == SENT and (excesses := base_excesses(motion, solution, robot)):
        raise LimitsExceeded(path, excesses, "take more steps")
    return replace_file(path, written)


def prepare(
    name: str,
    solution: SolutionData,
    rate: float | None,
    interpolation: str | None,
    *,
    fit: bool,
    slower: float = 1.0,
    mean: float = 0.0,
) -> Sent:
    """What a format sends of a motion, as `export_motion` asks for it."""
    rate, is_joined = _rate_of(name, rate), name == "ros2"
    return compute_motion_sent(
        solution, rate, interpolation, is_joined=is_joined, fit=fit, slower=slower, mean=mean
    )


def _rate_of(name: str, rate: float | None) -> float | None:
    return _UR_RATE if name == "urscript" and rate is None else rate


def prepare_within(
    name: str,
    solution: SolutionData,
    rate: float | None,
    interpolation: str | None,
    *,
    fit: bool,
    load_robot: Callable[[], Robot],
) -> tuple[Sent, tuple[Excess, ...]]:
    """What a format sends of a motion, and by what it leaves its limits: see `all_excesses`.

    One that is fitted, and leaves limits of efforts alone, takes as much more time as these need, if a tenth
    of it is enough; where it leaves limits of their rates, after a moving mean over a step.
    """
    sent, mean = prepare(name, solution, rate, interpolation, fit=fit), 0.0
    excesses = all_excesses(sent, load_robot)
    if fit and any(excess.kind == EFFORT_RATE for excess in excesses):
        step = float(np.diff(solution.t).max())
        smooth = prepare(name, solution, rate, interpolation, fit=True, mean=step)
        if smooth.mean == step:  # it is short enough
            sent, mean, excesses = smooth, step, _excesses_again(smooth, load_robot)
    if not (fit and excesses and all(excess.falls_with_speed for excess in excesses)):
        return sent, excesses
    found, low, pause = (sent, excesses), sent.slower, 1.0 / (_rate_of(name, rate) or math.inf)
    most = (1.0 + MOST - _ROUND_OFF) * solution.duration - pause
    high = max(low, low * most / float(sent.curves.nodes[-1]))
    for _ in range(_TRIES):
        factor = high if found[1] else (low + high) / 2.0
        tried = prepare(name, solution, rate, interpolation, fit=True, slower=factor, mean=mean)
        left = _excesses_again(tried, load_robot)
        if not left:
            found, high = (tried, left), factor
        elif found[1]:
            break
        else:
            low = factor
    return found


def _excesses_again(sent: Sent, load_robot: Callable[[], Robot]) -> tuple[Excess, ...]:
    """Those of a motion that is sent in another way: what cannot be looked at is told already."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotCheckedWarning)
        return all_excesses(sent, load_robot)


def all_excesses(sent: Sent, load_robot: Callable[[], Robot]) -> tuple[Excess, ...]:
    """By what a motion leaves its limits as it is sent: those of joints, of efforts, of paths, of obstacles.

    Warns
    -----
    NotCheckedWarning
        If efforts or paths cannot be looked at.
    """
    solution, facts = sent.solution, sent.solution.facts
    limits = (facts.path, facts.elastic, facts.limits_more_of_controls)
    if not (np.isfinite(solution.limits_u).any() or any(limits)):
        return sent.excesses
    from mbocp.solution.its_problem import problem_to_check  # as slow to import as all else
    from mbocp.solution.sent_checks import check_sent

    try:
        excesses, unknown = check_sent(sent, problem_to_check(solution, load_robot))
    except MbocpError as error:
        warn_caller(
            f"efforts and path constraints are not checked as the motion is sent: {error}", NotCheckedWarning
        )
        return sent.excesses
    if unknown:
        names = list_names(unknown, _MOST_NAMES)
        told = f"checked at the nodes alone, since positions of joints do not tell them between: {names}"
        warn_caller(told, NotCheckedWarning)
    return (*sent.excesses, *excesses)


def write_samples(motion: JointSamples, solution: SolutionData, path: Path, name: str) -> Path:
    """Write samples of a solution in a format.

    Raises
    ------
    ResultFileError
        If the robot does not fit the format, or the file cannot be written.
    """
    try:
        return replace_file(path, FORMATS[name](motion, solution))
    except InvalidValue as error:
        raise ResultFileError(path, str(error)) from error


def _table(motion: JointSamples) -> dict[str, Array]:
    """Columns by header."""
    columns = {"t [s]": motion.t}
    for prefix, values, more in (
        ("q", motion.positions, ""),
        ("v", motion.velocities, "/s"),
        ("a", motion.accelerations, "/s^2"),
    ):
        for k, (name, unit) in enumerate(zip(motion.joints, motion.units, strict=True)):
            columns[f"{prefix}:{name} [{unit}{more}]"] = values[:, k]
    for k, (name, unit) in enumerate(zip(motion.joints, motion.units, strict=True)):
        if np.isfinite(motion.efforts[:, k]).all():
            columns[f"u:{name} [{'N m' if unit == 'rad' else 'N'}]"] = motion.efforts[:, k]
    return columns


def _csv(motion: JointSamples, solution: SolutionData) -> bytes:
    columns = _table(motion)
    return csv_of(columns, np.column_stack(list(columns.values())).tolist())


def _ros2(motion: JointSamples, solution: SolutionData) -> bytes:
    """trajectory_msgs/msg/JointTrajectory as `ros2 topic pub` reads it."""
    lines = [
        f"joint_names: [{', '.join(json.dumps(name, ensure_ascii=False) for name in motion.joints)}]",
        "points:",
    ]
    has_efforts = bool(np.isfinite(motion.efforts).all())
    for k, t in enumerate(motion.t):
        lines += [
            f"- positions: {_list(motion.positions[k])}",
            f"  velocities: {_list(motion.velocities[k])}",
        ]
        if motion.interpolation == "quintic":  # controllers put cubics between points without
            lines.append(f"  accelerations: {_list(motion.accelerations[k])}")
        if has_efforts:
            lines.append(f"  effort: {_list(motion.efforts[k])}")
        lines.append(f"  time_from_start: {ros_duration(t)}")
    return ("\n".join(lines) + "\n").encode()


def _urscript(motion: JointSamples, solution: SolutionData) -> bytes:
    """A program that moves to the start, then servos along."""
    if len(motion.joints) != _UR_JOINTS or set(motion.units) != {"rad"}:
        raise InvalidValue(
            "format",
            "urscript",
            f"six joints that turn; got {len(motion.joints)} of {solution.robot_name}{_or_part(motion)}",
        )
    name = "".join(c if c.isascii() and c.isalnum() else "_" for c in solution.problem_name or "motion")
    steps = np.diff(motion.t)
    lines = [
        f"# {printable(solution.problem_name)}: {motion.t[-1]:.6g} s; joints {', '.join(motion.joints)}",
        f"def m_{name}():",
        f"  movej({_list(motion.positions[0])}, a=0.5, v=0.3)",
        *(
            f"  servoj({_list(q)}, t={dt:.9g}, lookahead_time=0.05, gain=500)"
            for q, dt in zip(motion.positions[1:], steps, strict=True)
        ),
        "  stopj(2.0)",
        "end",
        f"m_{name}()",
    ]
    return ("\n".join(lines) + "\n").encode()


def _or_part(motion: JointSamples) -> str:
    parts = dict.fromkeys(name.partition("/")[0] for name in motion.joints if "/" in name)
    return f"; or one of its parts: {', '.join(parts)}" if parts else ""


def _npz(motion: JointSamples, solution: SolutionData) -> bytes:
    file = io.BytesIO()
    np.savez(
        file,
        t=motion.t,
        joints=np.array(motion.joints),
        units=np.array(motion.units),
        q=motion.positions,
        v=motion.velocities,
        a=motion.accelerations,
        u=motion.efforts,
    )
    return file.getvalue()


def _parquet(motion: JointSamples, solution: SolutionData) -> bytes:
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise InvalidValue.of_missing("parquet", error) from error
    file = io.BytesIO()
    parquet.write_table(pyarrow.table(_table(motion)), file)
    return file.getvalue()


def _list(values: Array) -> str:
    return f"[{', '.join('0.0' if math.isclose(x, 0.0, abs_tol=1e-15) else repr(float(x)) for x in values)}]"


FORMATS: Mapping[str, Callable[[JointSamples, SolutionData], bytes]] = MappingProxyType(
    {"csv": _csv, "ros2": _ros2, "urscript": _urscript, "npz": _npz, "parquet": _parquet}
)
