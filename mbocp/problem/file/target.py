"""A trajectory to track, read from a file and brought to the steps of the problem."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mbocp._arrays import Array
from mbocp._files import MEGABYTE, is_file, read_text
from mbocp._text import show
from mbocp.exceptions import ProblemError, ResultFileError, Unreadable
from mbocp.robot import Robot
from mbocp.storage.reading import read_image

_KEY = "cost.target_file"
_MAX_BYTES = 256 * MEGABYTE  # of a CSV table


class _Motion(NamedTuple):
    t: Array
    qs: Array
    ps: Array


def read_target(path: Path, robot: Robot, duration: float, num_steps: int) -> tuple[Array, Array]:
    """Return the target at the end of every step.

    Parameters
    ----------
    path : Path
        A result of ``mbocp solve -o``, or a CSV table with the columns ``t [s]``, ``q:NAME [unit]`` and
        ``p:NAME [unit]`` (as `Solution.to_csv` writes it); the time may be sampled in any way.
    robot : Robot
    duration : float
        [s].
    num_steps : int

    Returns
    -------
    target_q : ndarray, shape (N, nq)
    target_p : ndarray, shape (N, nv)
    """
    if not is_file(path):
        raise ProblemError(f"{_KEY}: no such file {show(str(path))}")
    motion = _read_csv(path, robot) if path.suffix.lower() == ".csv" else _read_result(path)
    _check(motion, robot, path, duration)
    times = np.arange(1, num_steps + 1) * (duration / num_steps)
    qs, ps = zip(*(_at(motion, robot, t) for t in times), strict=True)
    return np.array(qs), np.array(ps)


def _read_csv(path: Path, robot: Robot) -> _Motion:
    try:
        text = read_text(path, expected="a CSV table", limit=_MAX_BYTES)
        header, *rows = list(csv.reader(text.splitlines())) or [[]]
    except (Unreadable, csv.Error) as error:
        raise ProblemError(
            f"{_KEY}: {path} {getattr(error, 'reason', f'is no CSV table ({error})')}"
        ) from error
    names = [column.partition(" [")[0].strip() for column in header]
    wanted = ["t", *(f"q:{c.name}" for c in robot.q_labels), *(f"p:{c.name}" for c in robot.p_labels)]
    missing = [name for name in wanted if name not in names]
    if missing:
        listed = ", ".join(missing[:6]) + (", ..." if len(missing) > 6 else "")
        raise ProblemError(f"{_KEY}: {path} has no column {listed}; its columns are {', '.join(names[:12])}")
    columns = [names.index(name) for name in wanted]
    try:
        table = np.array([[float(row[i]) for i in columns] for row in rows if row])
    except (ValueError, IndexError) as error:
        raise ProblemError(f"{_KEY}: {path} has a row that is not all numbers ({error})") from error
    table = table.reshape(-1, len(wanted))
    return _Motion(table[:, 0], table[:, 1 : 1 + robot.nq], table[:, 1 + robot.nq :])


def _read_result(path: Path) -> _Motion:
    from mbocp.storage.hdf5 import content_of  # HDF5 only for those who track a saved motion

    try:
        arrays = content_of(path, read_image(path)).arrays
    except ResultFileError as error:
        raise ProblemError(f"{_KEY}: {path} {error.reason}") from error
    return _Motion(*(arrays[name] for name in _Motion._fields))


def _check(motion: _Motion, robot: Robot, path: Path, duration: float) -> None:
    if motion.t.ndim != 1 or motion.qs.ndim != 2 or motion.ps.ndim != 2:
        raise ProblemError(f"{_KEY}: {path} holds t, q or p of another shape than a row for each time")
    if motion.qs.shape != (len(motion.t), robot.nq) or motion.ps.shape != (len(motion.t), robot.nv):
        raise ProblemError(
            f"{_KEY}: {path} holds q with {motion.qs.shape[-1]} and p with {motion.ps.shape[-1]} columns, "
            f"expected {robot.nq} and {robot.nv} for robot {robot.name!r}"
        )
    if not all(np.isfinite(part).all() for part in motion):
        raise ProblemError(f"{_KEY}: {path} has entries that are not finite")
    if len(motion.t) < 2 or not (np.diff(motion.t) > 0.0).all():
        raise ProblemError(f"{_KEY}: {path} needs at least two rows with increasing times")
    if motion.t[0] > 1e-9 * duration or motion.t[-1] < duration * (1.0 - 1e-9):
        raise ProblemError(
            f"{_KEY}: {path} covers {motion.t[0]:g} to {motion.t[-1]:g} s, expected 0 to {duration:g} s"
        )


def _at(motion: _Motion, robot: Robot, t: float) -> tuple[Array, Array]:
    """Interpolate along the geodesics of the joints."""
    i = int(np.clip(np.searchsorted(motion.t, t, side="right") - 1, 0, len(motion.t) - 2))
    share = min((t - motion.t[i]) / (motion.t[i + 1] - motion.t[i]), 1.0)
    q = robot.integrate(motion.qs[i], share * robot.difference(motion.qs[i], motion.qs[i + 1]))
    p = (1.0 - share) * motion.ps[i] + share * motion.ps[i + 1]
    return q, p
