"""Problem files: from TOML to a `Problem`; of a robot in its place, the smallest one."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._files import RESULT_SUFFIXES, is_file, parse_toml, read_text
from mbocp.exceptions import MbocpError, ProblemFileError
from mbocp.problem.file.overrides import apply_overrides
from mbocp.problem.file.tables import toml_key
from mbocp.problem.problem import Problem, problem_from_tables
from mbocp.robot import Robot, load_robot
from mbocp.terms import OwnTerm

_ROBOTS = (".urdf", ".xacro", ".mjcf", ".sdf", ".xml")
_MAX_JOINTS = 12  # that are written out; the others may end anywhere
_DISPLACEMENT = 0.5  # [rad, m]


def load_problem(
    path: str | Path, overrides: Mapping[str, Any] | Sequence[str] = (), *, terms: Sequence[OwnTerm] = ()
) -> Problem:
    """Read a problem file.

    Parameters
    ----------
    path : str or Path
        TOML file; relative paths in it are relative to its folder.
    overrides : mapping or sequence of str
        Values that replace or add keys: ``{"horizon.steps": 200}`` or ``["horizon.steps=200"]``.
    terms : sequence of OwnTerm
        Terms of one's own, see `mbocp.terms.own`: those that `[[terms]]` names, and others.

    Raises
    ------
    ProblemFileError
        If the file is missing, is not TOML, or has a wrong key or value: the message names file and key, what
        was got and what is allowed. Of a result, `Solution.load_problem` gives the problem.
    """
    path = Path(path)
    if path.suffix.lower() in RESULT_SUFFIXES and is_file(path):
        reason = (
            f"is a result, expected a problem file (TOML): mbocp.Solution.load({str(path)!r}).load_problem()"
        )
        raise ProblemFileError(path, f"{reason} is the problem that it solves")
    if is_robot_file(path) and is_file(path):
        raise _robot_error(path)
    document = load_document(path)
    if "robot" not in document and path.name == "robot.toml":
        raise _robot_error(path)
    if "robot" not in document and "problem" in document:
        reason = f"is a study, expected a problem file: `mbocp study {path} -o rows.jsonl` solves its tasks"
        raise ProblemFileError(path, reason)
    return _problem(document, overrides, path, terms)


def load_document(path: Path, what: str = "a problem file") -> dict[str, Any]:
    """Read the tables of a problem file, or of `what` else is TOML, not looking at what is in them.

    Raises
    ------
    ProblemFileError
        If the file is missing or is not TOML.
    """
    with ProblemFileError.where_unreadable(path):
        return parse_toml(read_text(path, expected=f"{what} (TOML)"))


def parse_problem(
    text: str,
    overrides: Mapping[str, Any] | Sequence[str] = (),
    *,
    source: Path | None = None,
    terms: Sequence[OwnTerm] = (),
) -> Problem:
    """Read a problem from TOML text; `source` is the file it came from, if there is one."""
    with ProblemFileError.where_unreadable(source if source is not None else "<text>"):
        document = parse_toml(text)
    return _problem(document, overrides, source, terms)


def _problem(
    document: Mapping[str, Any],
    overrides: Mapping[str, Any] | Sequence[str],
    source: Path | None,
    terms: Sequence[OwnTerm],
) -> Problem:
    label = str(source) if source is not None else "<text>"
    return problem_from_tables(apply_overrides(document, overrides), source=source, label=label, terms=terms)


def is_robot_file(path: Path) -> bool:
    """Whether a file is a robot, by its name."""
    return path.suffix.lower() in _ROBOTS


def _robot_error(path: Path) -> ProblemFileError:
    reason = (
        f"is a robot, expected a problem file (TOML): `mbocp new {path}` writes one with comments; the "
        "smallest one for it, to be put beside it:"
    )
    return ProblemFileError(path, f"{reason}\n{smallest_problem(path)}")


def smallest_problem(path: Path) -> str:
    """Lines of a problem file that moves the joints of the robot in `path`, from its initial pose to rest."""
    try:
        goal = _goal(load_robot(path))
    except MbocpError:  # faults of the robot are reported when the problem is loaded
        goal = "JOINT = 0.5"
    return "\n".join(
        (
            f"robot = {json.dumps(path.name)}",
            "[horizon]",
            "duration = 2.0  # s",
            "steps = 100",
            "[goal]",
            f"q = {{ {goal} }}  # rad or m",
            "v = 0  # at rest",
        )
    )


def _goal(robot: Robot) -> str:
    """Positions within the limits, of joints with one coordinate."""
    limits = robot.limits
    words: list[str] = []
    for name, joint in zip(robot.model.names[1:], robot.model.joints[1:], strict=True):
        if joint.nq == joint.nv == 1 and len(words) < _MAX_JOINTS:
            i = joint.idx_q
            value = np.clip(robot.q0[i] + _DISPLACEMENT, limits.position_lower[i], limits.position_upper[i])
            words.append(f"{toml_key(name)} = {float(value):.3g}")
    return ", ".join(words) or "JOINT = 0.5"
