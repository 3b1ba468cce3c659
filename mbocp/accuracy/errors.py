r"""Errors of a discrete motion against the flow of the robot.

With :math:`\varphi_n` the flow over the step n under its control from the node itself, and E the energy,

.. math::
    e_n &= \varphi_n(x_{n-1})^{-1} x_n          && \text{local error,} \\
    E(x_n) - E(\varphi_n(x_{n-1}))              &&& \text{energy that the step makes,} \\
    \varphi_N \circ \dots \circ \varphi_1(x_0)  &&& \text{replay of the controls.}

Controls are constant in a step, or the polynomials through the values that a result has of them, see
`mbocp.integrators.controls`. Whatever the controls and dampers do along the flow is in its energy, so that
the second line is what work and energy differ by. A replay tells how the motion's errors grow; where the
robot is unstable, as an arm that holds its links up, they grow by many powers of ten in an open loop.

What a local error changes the cost by is, to leading order, its product with the adjoint of the node,
:math:`\mu^q_n \cdot e^q_n + \mu^p_n \cdot e^p_n`, with e^p that of the momentum. The sum over the components
of what these products are in size tells where errors cost, even where they cancel in a step.

Where constraints begin and end along the way, :math:`\varphi_n` is the flow under those that act in step n,
see `mbocp.accuracy.course`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.accuracy.course import Course, course_of
from mbocp.formulation import Motion
from mbocp.integrators import control_powers
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.robot import Robot
from mbocp.robot.drives import control_velocity_maps, speed_maps
from mbocp.robot.kinematics import momenta_of
from mbocp.solution import Accuracy

_MOST_PARTS = 64  # of a step: stiffer ones are not followed
_RESOLVED = 0.01  # of the local errors: what the flow itself may be wrong by
_ROUND_OFF = 1e-11  # [rad, m]: what no flow is better than
_EXACT = 1e-16  # [rad, m]: what a step is wrong by then
_TOLD = 0.005  # of what a replay misses: what the flow may be wrong by, for two digits
_STANDS = 0.1  # of the longest way in its unit: joints that hardly move
_AT_REST = 1e-7  # [rad, m]: a way that is round-off, what solvers leave in each of some hundred steps


def accuracy_of(
    robot: Robot,
    motion: Motion,
    *,
    table: SwitchTable | None = None,
    gains: Array | None = None,
    deadline: float = math.inf,
) -> Accuracy:
    """Compare a motion with the flow of the robot.

    Parameters
    ----------
    robot : Robot
    motion : Motion
    table : SwitchTable, optional
        Which constraints act in which step; without, those of the robot.
    gains : ndarray, shape (N, k nu, 2 nv), optional
        Of a feedback that keeps the robot near the motion.
    deadline : float
        Time of `time.perf_counter` at which compiling is given up.

    Returns
    -------
    Accuracy
        Of NaN where the motion is not finite, or where the robot is too stiff to be followed.
    """
    if not all(np.isfinite(array).all() for array in (motion.qs, motion.vs, motion.us)):
        return Accuracy()
    course = course_of(robot, table, len(motion.us), deadline=deadline)
    flow, qs, us, dts = course.flow, motion.qs, motion.us_at_ends, motion.dts
    starts, reached = course.starts(qs, motion.vs), course.end_velocities(qs, motion.vs)
    speeds = _speeds(robot, qs[:-1], starts)
    followed = _follow(course, motion, speeds)
    if followed is None:
        return Accuracy()
    ends, end_speeds, parts, own = followed
    errors = np.abs(flow.differences(ends, qs[1:]))
    ways = np.abs(flow.differences(qs[:-1], qs[1:])).sum(axis=0)
    ways = np.where(ways > _AT_REST, ways, 0.0)
    names = [label.name for label in robot.move_labels]
    step, joint = np.unravel_index(errors.argmax(), errors.shape)
    worst = _worst_share(errors.sum(axis=0), ways, [label.unit for label in robot.v_labels])
    replay = partial(course.replay, qs[0], speeds[0], motion.us_in_powers, dts)
    halvings = _useful_halvings(own, parts)
    left = _miss(course, replay, motion, parts, halvings)
    tracked = _track(course, motion, starts, parts, halvings, gains)
    vs = np.vstack([starts[:1], reached])
    energies = flow.energies(qs, vs)
    ended = _velocities(robot, qs[1:], _speeds(robot, qs[1:], reached), us)  # controls may leap at nodes
    after = flow.energies(ends, _velocities(robot, ends, end_speeds, us))
    made = np.cumsum(flow.energies(qs[1:], ended) - after)
    kinetic = energies - flow.energies(qs, np.zeros_like(vs))
    return Accuracy(
        local_error=float(errors.max()),
        local_joint=names[joint],
        local_time=float(dts[: step + 1].sum()),
        sum_of_errors=float(errors[:, worst].sum()),
        way=float(ways[worst]),
        way_joint=names[worst],
        replay_error=float(left.max()),
        replay_joint=names[int(left.argmax())],
        tracked_error=float(tracked.max()),
        tracked_joint=names[int(tracked.argmax())] if np.isfinite(tracked).any() else "",
        made_energy=float(made[np.abs(made).argmax()]),
        energy_range=float(max(np.ptp(energies), kinetic.max())),
        own_error=own,
    )


@dataclass(frozen=True, eq=False)
class StepErrors:
    """Errors of the steps of a motion.

    Attributes
    ----------
    largest : ndarray, shape (N,)
        Largest local error [rad, m]; infinite where the robot is too stiff to follow.
    costs : ndarray, shape (N,)
        What local errors may change the cost by, weighed with the adjoints, each component by its size; the
        largest local errors where nobody knows adjoints.
    """

    largest: Array
    costs: Array


def step_errors(
    robot: Robot,
    motion: Motion,
    *,
    table: SwitchTable | None = None,
    adjoints: Array | None = None,
    deadline: float = math.inf,
) -> StepErrors:
    """Errors of each step.

    Parameters
    ----------
    robot : Robot
    motion : Motion
    table : SwitchTable, optional
        Which constraints act in which step; without, those of the robot.
    adjoints : ndarray, shape (N + 1, 2 nv), optional
        Duals (mu_q, mu_p) of the states of the nodes.
    deadline : float
        Time of `time.perf_counter` at which compiling is given up.
    """
    course = course_of(robot, table, len(motion.us), deadline=deadline)
    speeds = _speeds(robot, motion.qs[:-1], course.starts(motion.qs, motion.vs))
    followed = _follow(course, motion, speeds)
    if followed is None:
        unknown = np.full(len(motion.us), np.inf)
        return StepErrors(unknown, unknown)
    (ends, end_speeds, *_), qs = followed, motion.qs[1:]
    errors = np.abs(course.flow.differences(ends, qs))
    largest: Array = errors.max(axis=1)
    if adjoints is None or robot.drives or not np.isfinite(adjoints).all():
        return StepErrors(largest, largest)
    reached = momenta_of(robot.model, qs, course.end_velocities(motion.qs, motion.vs))
    missed = np.abs(reached - momenta_of(robot.model, ends, end_speeds))
    weighed = np.abs(adjoints[1:]) * np.hstack([errors, missed])
    return StepErrors(largest, weighed.sum(axis=1))


def _follow(course: Course, motion: Motion, speeds: Array) -> tuple[Array, Array, int, float] | None:
    """States after the flows, parts of a step that this takes, and what they are wrong by."""
    start = (motion.qs[:-1], speeds, motion.us_in_powers, motion.dts)
    parts, coarse, flow = 1, course.ends(*start, 1), course.flow
    while parts < _MOST_PARTS:
        parts *= 2
        fine = course.ends(*start, parts)
        if np.isfinite(fine[0]).all() and np.isfinite(coarse[0]).all():
            own = np.abs(flow.differences(coarse[0], fine[0])).max()
            errors = np.abs(flow.differences(fine[0], motion.qs[1:])).max()
            if own <= max(_RESOLVED * errors, _ROUND_OFF):
                return *fine, parts, float(own)
        coarse = fine
    return None


def _useful_halvings(own: float, parts: int) -> int:
    """How often parts are halved until the flow is wrong by round-off alone, or they are the shortest.

    `own`: what the flow of a step is wrong by with half as many parts, by a method of order eight.
    """
    until_exact = max(1, math.ceil(math.log(max(own, _EXACT) / _EXACT, 2**8)))
    return min(until_exact, int(math.log2(_MOST_PARTS // parts)))


def _track(
    course: Course, motion: Motion, starts: Array, parts: int, halvings: int, gains: Array | None
) -> Array:
    """Errors at the end of the replay with feedback, shape (nv,); NaN without one."""
    if gains is None or not gains.size:
        return np.full(motion.vs.shape[1], np.nan)
    planned, us = (motion.qs[:-1], starts), motion.us_in_powers
    follow = partial(course.track, planned, us, motion.dts, gains=_in_powers(motion, gains))
    return _miss(course, follow, motion, parts, halvings)


def _in_powers(motion: Motion, gains: Array) -> Array:
    """Gains of the coefficients of controls, from those of their values; shape (N, k nu, 2 nv)."""
    if not motion.shares:
        return gains
    blocks = gains.reshape(len(gains), len(motion.shares), motion.us.shape[1], -1)
    found: Array = np.einsum("pk,nkux->npux", control_powers(motion.shares), blocks)
    return found.reshape(gains.shape)


def _miss(course: Course, end_of: Callable[[int], Array], motion: Motion, parts: int, halvings: int) -> Array:
    """What a replay misses the end of the motion by, to two digits, shape (nv,).

    Errors grow along a replay, and so does what the flow itself is wrong by: parts of a step are halved until
    the end stays. Infinite where it leaves all bounds, or has not stayed by then.
    """
    end, size = end_of(parts), motion.vs.shape[1]
    for _ in range(halvings):
        parts *= 2
        finer = end_of(parts)
        if not np.isfinite(finer).all():
            return np.full(size, np.inf)
        missed: Array = np.abs(course.flow.differences(finer[None], motion.qs[-1:])[0])
        moved = np.abs(course.flow.differences(finer[None], end[None])[0])
        if moved.max() <= max(_TOLD * missed.max(), _ROUND_OFF):  # not with NaN
            return missed
        end = finer
    return np.full(size, np.inf)


def _speeds(robot: Robot, qs: Array, vs: Array) -> Array:
    """Speeds nearest to velocities, shape (k, ns); see `mbocp.mechanics.forward`."""
    if not robot.drives:
        return vs
    return np.einsum("nij,ni->nj", speed_maps(robot, qs), vs)


def _velocities(robot: Robot, qs: Array, speeds: Array, us: Array) -> Array:
    """Velocities of speeds and controls, shape (k, nv)."""
    if not robot.drives:
        return speeds
    prescribed = np.einsum("nij,nj->ni", control_velocity_maps(robot, qs), us)
    return np.einsum("nij,nj->ni", speed_maps(robot, qs), speeds) + prescribed


def _worst_share(sums: Array, ways: Array, units: list[str]) -> int:
    """Component whose errors are largest against its way; of those that hardly move, nothing is asked."""
    longest = {unit: max(w for w, u in zip(ways, units, strict=True) if u == unit) for unit in units}
    moves = ways > _STANDS * np.array([longest[unit] for unit in units])
    return int(np.where(moves, sums / np.where(moves, ways, 1.0), -1.0).argmax())
