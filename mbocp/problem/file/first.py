"""A problem file for a robot, with comments: what `mbocp new` writes."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.exceptions import MbocpError
from mbocp.integrators import SCHEMES
from mbocp.problem.file.load import parse_problem
from mbocp.problem.file.tables import toml_key
from mbocp.problem.first_motion import FirstMotion, first_motion
from mbocp.problem.integration import AUTO_SCHEME
from mbocp.robot import Robot
from mbocp.robot.joints import joint_kind

_STEPS = 100  # of schemes of low order; half of them for others
_HIGH_ORDER = 3
_WORDS = {1: "of first order", 2: "of second order", 3: "of third order", 4: "of fourth order"}
_MAX_ROWS = 60  # joints that are listed
_COLUMN = 36  # where comments begin


def first_file(robot: Robot, table: Mapping[str, Any], path: Path) -> str:
    """Text of a problem file that moves the robot a little, from rest, and to rest where it can rest.

    Parameters
    ----------
    robot : Robot
    table : mapping
        The `[robot]` of the file: with what it is loaded, from the folder of `path`.
    path : Path
        The file that is to hold it.

    Raises
    ------
    MbocpError
        If no such problem is well posed.
    """
    motion = first_motion(robot)
    refused: MbocpError | None = None
    for has_limits, enforce in ((True, "exact"), (False, "exact"), (False, "penalty")):
        write = partial(_text, robot, table, path, motion, has_limits=has_limits, enforce=enforce)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                problem = parse_problem(write(AUTO_SCHEME), source=path)
        except MbocpError as error:
            refused = refused or error
        else:
            return write(problem.scheme)
    raise refused or MbocpError(f"robot {robot.name!r}: no first motion was found")


def _text(
    robot: Robot,
    table: Mapping[str, Any],
    path: Path,
    motion: FirstMotion,
    scheme: str,
    *,
    has_limits: bool,
    enforce: str,
) -> str:
    stem = path.stem
    order = SCHEMES[scheme].order if scheme in SCHEMES else 0
    steps = _STEPS if order < _HIGH_ORDER else _STEPS // 2
    sections = [
        _head(robot, stem, motion),
        _robot(table),
        ["[horizon]", _with(f"duration = {motion.duration:.1f}", "s"), _with(f"steps = {steps}", "")],
        ["[start]", *_q(robot, motion, "start")],
        _goal(robot, motion, enforce),
        _limits(motion)
        if has_limits
        else ["# [limits]  # effort, velocity and position = true: the robot's own"],
        ["[integrator]", _with(f'scheme = "{scheme}"', _WORDS.get(order, ""))],
        _hints(robot),
    ]
    return "\n\n".join("\n".join(lines) for lines in sections if lines) + "\n"


def _head(robot: Robot, stem: str, motion: FirstMotion) -> list[str]:
    lines = [
        f"# A first motion of {robot.name}. Solve it, and look at it:",
        "#",
        f"#     mbocp solve {stem}.toml -o {stem}.h5 --replay {stem}.html",
        "#",
        f"# It has {robot.nv - robot.nc} degrees of freedom and {robot.nu} "
        f"control{'s' * (robot.nu != 1)}. What moves:",
        "#",
    ]
    rows = list(_rows(robot))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines += [
        "#   " + "  ".join(word.ljust(width) for word, width in zip(row, widths, strict=True)).rstrip()
        for row in rows[: _MAX_ROWS + 1]
    ]
    if len(rows) > _MAX_ROWS + 1:
        lines.append(f"#   and {len(rows) - _MAX_ROWS - 1} more: mbocp robots says them all")
    if not motion.rests:
        lines += ["#", *_falls(robot)]
    for note in motion.notes:
        lines += ["#", f"# Note: {note}."]
    return lines


def _falls(robot: Robot) -> list[str]:
    if robot.drives:
        return ["# Some controls prescribe velocities; those end as they like."]
    return [
        "# Not everything has a motor: the goal is about joints that have one, the rest moves as it will.",
        *(
            [
                "# The base falls: nothing holds it. Feet on the ground are [[phase]] with hold,",
                '# see examples/legged; robot.actuated = ["root_joint"] gives the base a force and a moment.',
            ]
            if "root_joint" in robot.joint_names
            else []
        ),
    ]


def _rows(robot: Robot) -> Iterator[tuple[str, ...]]:
    """What is said of each joint."""
    yield "joint", "kind", "from", "to", "speed", "effort"
    limits = robot.limits
    efforts = {label.name: value for label, value in zip(robot.u_labels, limits.effort, strict=True)}
    for joint in range(1, robot.model.njoints):
        name, kind, j = robot.model.names[joint], joint_kind(robot.model, joint), robot.model.joints[joint]
        if not kind.v:
            yield name, kind.word, "follows another joint", "", "", ""
            continue
        unit = kind.v[0][1]
        single = len(kind.v) == 1
        low, high = (
            [getattr(limits, f"position_{side}")[j.idx_q] for side in ("lower", "upper")]
            if single and kind.is_vector
            else [-math.inf, math.inf]
        )
        speed = limits.velocity[j.idx_v] if single else math.inf
        effort, others = efforts.get(name), _controls_of(robot, j)
        yield (
            name,
            kind.word,
            _size(low, ""),
            _size(high, unit),
            _size(speed, f"{unit}/s"),
            _size(effort, "N m" if unit == "rad" else "N") if effort is not None else others,
        )


def _controls_of(robot: Robot, joint: Any) -> str:
    """What moves a joint that no control is named after."""
    where = slice(joint.idx_v, joint.idx_v + joint.nv)
    names = [
        *(robot.u_labels[k].name for k in np.flatnonzero(robot.actuation.selection[where].any(axis=0))),
        *(drive.name for drive in robot.drives if any(where.start <= dof < where.stop for dof in drive.dofs)),
    ]
    return f"by {', '.join(names)}" if names else "no motor of its own"


def _size(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".rstrip() if math.isfinite(value) else "no limit"


def _robot(table: Mapping[str, Any]) -> list[str]:
    words = "pushes it sideways, too, as no quadrotor can: rotors are [[actuator]] of a robot.toml"
    comments = {"actuated": words}
    rows = ((f"{toml_key(key)} = {_value(value)}", comments.get(key, "")) for key, value in table.items())
    return ["[robot]", *(_with(*row) for row in rows)]


def _q(robot: Robot, motion: FirstMotion, which: str) -> list[str]:
    q = motion.q_start if which == "start" else motion.q_goal
    shown = motion.asked if which == "goal" or robot.nc else np.ones(robot.nv, dtype=np.bool_)
    return list(_joints(robot, q, shown))


def _joints(robot: Robot, q: Array, shown: BoolArray) -> Iterator[str]:
    """A line for each joint of which all directions are shown."""
    for joint in range(1, robot.model.njoints):
        j, kind = robot.model.joints[joint], joint_kind(robot.model, joint)
        if not j.nv or not shown[j.idx_v : j.idx_v + j.nv].all():
            continue
        numbers = q[j.idx_q : j.idx_q + j.nq].tolist()
        if kind.word in ("continuous", "planar"):
            numbers = [*numbers[:-2], math.atan2(numbers[-1], numbers[-2])]
        if kind.unit_groups and kind.word not in ("continuous", "planar"):
            words, unit = [repr(x) if x else "0" for x in numbers], "unit quaternion xyzw"
            unit = f"m, {unit}" if kind.word == "floating" else unit
        else:
            # On constraints every digit counts, but for the last, of round-off.
            words, unit = (
                [f"{x:.15g}" if robot.nc else _number(x) for x in numbers],
                ", ".join(dict.fromkeys(u for _, u in kind.v)),
            )
        value = words[0] if len(words) == 1 else f"[{', '.join(words)}]"
        yield _with(f"q.{toml_key(robot.model.names[joint])} = {value}", unit)


def _number(value: float) -> str:
    rounded = round(value, 6)
    return f"{rounded:g}" if rounded == float(f"{rounded:g}") else repr(rounded)


def _goal(robot: Robot, motion: FirstMotion, enforce: str) -> list[str]:
    lines = ["[goal]"]
    if enforce != "exact":
        lines.append(_with(f'enforce = "{enforce}"', "drawn there, not forced"))
    if motion.asked.all() or motion.rests:
        lines.append(_with("v = 0", "at rest"))
    else:
        names = [label.name for label, on in zip(robot.v_labels, motion.asked, strict=True) if on]
        lines += [_with(f"v.{toml_key(name)} = 0", "at rest") for name in names]
    return (
        lines + _q(robot, motion, "goal") + ([] if enforce == "exact" else ["", "[cost]", "terminal = 100.0"])
    )


def _limits(motion: FirstMotion) -> list[str]:
    words = {
        "effort": "of the motors, from the robot's file",
        "velocity": "of the joints; or a number for all, or a table by joint",
        "position": "of the joints",
    }
    kept = [_with(f"{key} = true", words[key]) for key in words if motion.is_limited.get(key)]
    return ["[limits]", *kept] if kept else []


def _hints(robot: Robot) -> list[str]:
    """What to try next; the frame is the last that the robot traces, else its last body."""
    bodies = (frame.name for frame in robot.model.frames if str(frame.type) == "BODY")
    name = json.dumps(["tool", *bodies, *robot.trace_frames][-1], ensure_ascii=False)
    return [
        "# What else one may ask of it, see docs/problem_files.md:",
        "#",
        "#     [goal.frame]                     # a pose for a frame, in place of q; the angles follow",
        f"#     name = {name}",
        "#     position = [0.4, 0.2, 0.3]",
        "#",
        "#     [horizon]                        # the least time within the limits:",
        "#     duration = { min = 0.2, max = 10.0, guess = 2.0 }",
        "#     [cost]",
        "#     effort = 1e-4",
        "#     time = 1.0",
        "#",
        "#     [[robot.payload]]                # a tool or a load",
        f"#     frame = {name}",
        "#     mass = 1.2",
    ]


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{toml_key(k)} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return f"[{', '.join(_value(entry) for entry in value)}]"
    return json.dumps(value, ensure_ascii=False)


def _with(line: str, comment: str) -> str:
    return f"{line.ljust(_COLUMN)} # {comment}" if comment else line
