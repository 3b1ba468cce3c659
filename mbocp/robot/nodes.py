"""Configurations of many nodes at once; of robots whose joints are plain vectors without a loop over them.

The arithmetic is Pinocchio's in either case; compilers may round it differently.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, IntArray
from mbocp.robot.kinematics import difference
from mbocp.robot.model import RobotModel

_ROUND_OFF = 1e-9  # [rad, m], of the way of a step


def interpolate(robot: RobotModel, q0: Array, q1: Array, shares: Array) -> Array:
    """Configurations at shares of the way from one to another, shape (n, nq)."""
    if _is_plain(robot):
        return np.asarray(q0) + np.asarray(shares)[:, None] * (np.asarray(q1) - np.asarray(q0))
    return _rows([pin.interpolate(robot.model, q0, q1, share) for share in shares], robot.nq)


def between(robot: RobotModel, q0s: Array, q1s: Array, shares: Array) -> Array:
    """Configurations at a share of the way from one to another each; shapes (n, nq), (n, nq), (n,)."""
    if _is_plain(robot):
        return q0s + np.asarray(shares)[:, None] * (q1s - q0s)
    pairs = zip(q0s, q1s, shares, strict=True)
    return _rows([pin.interpolate(robot.model, *at) for at in pairs], robot.nq)


def along(robot: RobotModel, t: Array, qs: Array, vs: Array | None, times: Array) -> Array:
    """Configurations of a motion at times between its nodes, shape (n, nq).

    They are on the cubics that nodes and velocities say: cubics of the tangent vector from the node before.

    Parameters
    ----------
    robot : RobotModel
    t : ndarray, shape (N + 1,)
        Times of the nodes [s].
    qs : ndarray, shape (N + 1, nq)
    vs : ndarray, shape (N + 1, nv), optional
        Without, or where each is that of the whole step before, as of SE1, geodesics lead from node to node.
    times : ndarray, shape (n,)
        [s].
    """
    at, ways, _ = _tangents(robot, t, qs, vs, times)
    return move(robot, qs[at], ways)


def along_with_velocities(
    robot: RobotModel, t: Array, qs: Array, vs: Array, times: Array
) -> tuple[Array, Array]:
    """Configurations as of `along`, shape (n, nq), and velocities with which they change, shape (n, nv)."""
    at, ways, rates = _tangents(robot, t, qs, vs, times)
    if not _is_plain(robot):
        turns = (pin.dIntegrate(robot.model, q, way, pin.ARG1) for q, way in zip(qs[at], ways, strict=True))
        rates = _rows([turn @ rate for turn, rate in zip(turns, rates, strict=True)], robot.nv)
    return move(robot, qs[at], ways), rates


def _tangents(
    robot: RobotModel, t: Array, qs: Array, vs: Array | None, times: Array
) -> tuple[IntArray, Array, Array]:
    """Nodes before times, tangent vectors from there, and how fast these change, shapes (n, nv)."""
    step = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 2)
    lengths, ways = np.diff(t)[:, None], steps_between(robot, qs)
    h = lengths[step]
    s = (times - t[step])[:, None] / h
    if vs is None or are_chords(ways, t, vs):
        return step, s * ways[step], ways[step] / h
    rates = vs[1:]
    if not _is_plain(robot):  # the exponential takes rates of tangent vectors to velocities of bodies
        pairs = zip(qs[:-1], qs[1:], vs[1:], strict=True)
        rates = _rows([pin.dDifference(robot.model, a, b, pin.ARG1) @ v for a, b, v in pairs], robot.nv)
    begins, ends = (lengths * vs[:-1] - ways)[step], (lengths * rates - ways)[step]
    way = s * ways[step] + s * (1.0 - s) * ((1.0 - s) * begins - s * ends)
    slope = ways[step] + (1.0 - s) * (1.0 - 3.0 * s) * begins - s * (2.0 - 3.0 * s) * ends
    return step, way, slope / h


def are_chords(ways: Array, t: Array, vs: Array) -> bool:
    """Whether velocities, shape (N + 1, nv), are those of the whole steps before, as of SE1."""
    return bool((np.abs(ways - np.diff(t)[:, None] * vs[1:]) < _ROUND_OFF).all())


def move(robot: RobotModel, qs: Array, steps: Array) -> Array:
    """Configurations, shape (n, nq), moved along tangent vectors, shape (n, nv)."""
    if _is_plain(robot):
        return qs + steps
    return _rows([pin.integrate(robot.model, *at) for at in zip(qs, steps, strict=True)], robot.nq)


def steps_between(robot: RobotModel, qs: Array) -> Array:
    """Tangent vectors from each configuration to the next, shape (n - 1, nv)."""
    if _is_plain(robot):
        return np.diff(qs, axis=0)
    return _rows([difference(robot.model, *at) for at in pairwise(qs)], robot.nv)


def _is_plain(robot: RobotModel) -> bool:
    return robot.is_vector_space and not len(robot.model.mimicking_joints)


def _rows(found: list[Array], width: int) -> Array:
    return np.array(found).reshape(len(found), width)
