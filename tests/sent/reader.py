"""Violations of limits in files of motions, by a program that shares no code with mbocp."""

from __future__ import annotations

import csv
import re
import sys
from pathlib import Path

import numpy as np

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_COLUMN = re.compile(r"([qva]):(\S+) \[")
_KINDS = ("position", "velocity", "acceleration", "jerk")


def limits_of(profile: Path, **more: float) -> dict[str, np.ndarray]:
    """Limits of a robot's maker by kind, shape (2, joints) [rad, s]; speeds by position as "braking"."""
    table = {**tomllib.loads(profile.read_text()), **more}
    count, scale = len(table["joints"]), np.pi / 180.0 if table.get("degrees") else 1.0
    sides = {}
    for kind in (kind for kind in _KINDS if kind in table):
        values = np.asarray(table[kind], dtype=float) * (1.0 if kind in more else scale)
        both = values.T if values.ndim == 2 else np.array([-values, values])
        sides[kind] = np.broadcast_to(both.reshape(2, -1), (2, count))
    if "braking" in table:
        sides["braking"] = np.array([table["braking"]["reserve"], table["braking"]["deceleration"]])
    return sides


def samples_of(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and positions."""
    with file.open() as lines:
        header, *rows = csv.reader(lines)
    table = np.array(rows, dtype=float)
    columns = [k for k, name in enumerate(header) if (m := _COLUMN.match(name)) and m[1] == "q"]
    return table[:, 0], table[:, columns]


def violation_of_samples(
    file: Path, rate: float, limits: dict[str, np.ndarray], before: np.ndarray | None = None
) -> dict[str, float]:
    """The largest excess of each limit, relative to its size, as differences of the sampled positions.

    Of a motion that begins moving `before` are the three samples before it.
    """
    t, q = samples_of(file)
    steps = np.diff(t)
    assert np.allclose(steps[:-1], 1.0 / rate, rtol=1e-6), f"{file}: samples are not {1e3 / rate:g} ms apart"
    still = np.repeat(q[:1], 3, axis=0), np.repeat(q[-1:], 3, axis=0)  # at rest before and after
    values = {"position": q}
    moved = np.vstack([still[0] if before is None else before, q, still[1]])
    for order, kind in enumerate(("velocity", "acceleration", "jerk"), start=1):
        values[kind] = np.diff(moved, order, axis=0) * rate**order
    found = {kind: _excess(values[kind], limits[kind]) for kind in limits if kind in _KINDS}
    if "braking" in limits:
        found["braking"] = _beyond_braking(q, values["velocity"][3:-3], limits)
    return found


def _beyond_braking(q: np.ndarray, v: np.ndarray, limits: dict[str, np.ndarray]) -> float:
    """By which part of the speed's limit v is above sqrt(2 a d) - r, d before the limit of the position."""
    (reserve, slowing), (least, most), speed = limits["braking"], limits["position"], limits["velocity"][1]
    before, after = q[:-1], q[1:]
    room = np.maximum(most - before, most - after), np.maximum(before - least, after - least)
    allowed = [np.maximum(np.sqrt(2.0 * slowing * np.maximum(d, 0.0)) - reserve, 0.0) for d in room]
    return float(max(((v - allowed[0]) / speed).max(), ((-v - allowed[1]) / speed).max(), 0.0))


def violation_of_points(file: Path, limits: dict[str, np.ndarray], parts: int = 50) -> dict[str, float]:
    """The same of a JointTrajectory: controllers put polynomials of degree three or five between points."""
    t, points = _points(file)
    derivatives = [
        np.array(points[key]) for key in ("positions", "velocities", "accelerations") if points[key]
    ]
    found = dict.fromkeys((kind for kind in limits if kind in _KINDS), 0.0)
    powers = np.arange(2 * len(derivatives))
    for k, h in enumerate(np.diff(t)):
        begin, end = [d[k] for d in derivatives], [d[k + 1] for d in derivatives]
        rows = [_row(powers, 0.0, order) for order in range(len(derivatives))]
        rows += [_row(powers, 1.0, order) for order in range(len(derivatives))]
        right = np.array([x * h ** (i % len(derivatives)) for i, x in enumerate([*begin, *end])])
        right[0], right[len(derivatives)] = 0.0 * begin[0], end[0] - begin[0]
        c = np.linalg.solve(np.array(rows), right)
        shares = np.linspace(0.0, 1.0, parts + 1)
        for order, kind in enumerate(_KINDS):
            values = np.array([_row(powers, s, order) for s in shares]) @ c / h**order
            values = values + begin[0] if order == 0 else values
            if kind in limits and (kind != "jerk" or len(derivatives) == 3):
                found[kind] = max(found[kind], _excess(values, limits[kind]))
    if "jerk" in limits and len(derivatives) == 2:
        found["jerk"] = float("inf")  # accelerations leap
    return found


def ends_of_points(file: Path) -> tuple[float, float]:
    """The largest velocity and acceleration of the first and the last point."""
    _, points = _points(file)
    largest = [
        max(np.abs(points[key][n]).max() for n in (0, -1))
        for key in ("velocities", "accelerations")
        if points[key]
    ]
    return largest[0], largest[1] if len(largest) > 1 else float("nan")


def _points(file: Path) -> tuple[np.ndarray, dict[str, list[list[float]]]]:
    """Times and values of each point; message files of that plain form need no reader of YAML."""
    text = file.read_text()
    times = [int(s) + 1e-9 * int(ns) for s, ns in re.findall(r"sec: (\d+), nanosec: (\d+)", text)]
    values = {
        key: [[float(x) for x in one.split(",")] for one in re.findall(rf"{key}: \[(.*)\]", text)]
        for key in ("positions", "velocities", "accelerations")
    }
    return np.array(times), values


def _row(powers: np.ndarray, s: float, order: int) -> np.ndarray:
    """Derivative of the powers of s."""
    factors = np.ones(len(powers))
    for i in range(order):
        factors = factors * (powers - i)
    return factors * np.where(powers >= order, float(s) ** np.maximum(powers - order, 0), 0.0)


def _excess(values: np.ndarray, sides: np.ndarray) -> float:
    size = np.abs(np.where(np.isfinite(sides), sides, 0.0)).max(axis=0)
    over = np.maximum(sides[0] - values, values - sides[1]) / np.maximum(size, 1e-9)
    return float(max(np.where(np.isfinite(over), over, 0.0).max(), 0.0))
