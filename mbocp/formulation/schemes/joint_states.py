"""States and controls of a programme at a motion of the joints, and the motion they stand for.

All formulations in joint coordinates store their states (z, s), coordinates and speeds, in the same way.
"""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.base import Motion
from mbocp.formulation.features.control_values import means_of, values_of, with_values
from mbocp.formulation.features.moved_start import moved_start, with_moves
from mbocp.formulation.features.progress import with_paces
from mbocp.formulation.features.step_lengths import solved_lengths, with_lengths
from mbocp.formulation.layout import StateLayout
from mbocp.lie import ConfigurationSpace
from mbocp.problem import Problem
from mbocp.programme import Iterate

__all__ = ["positions_and_speeds", "states_and_controls"]


def states_and_controls(
    problem: Problem, at: StateLayout, space: ConfigurationSpace, motion: Motion, speeds: Array, start: Array
) -> tuple[Array, Array]:
    """States, shape (N + 1, nx), and controls, shape (N, nu), of a programme at a motion.

    `speeds`, shape (N + 1, ns), are the motion's velocities, or what a formulation has in their place.
    `start`, shape (nx,), is the programme's first state. Memory of the step before is left at zero.
    """
    xs = np.zeros((len(motion.qs), at.nx))
    xs[:, at.z], xs[:, at.s] = space.coordinates(motion.qs), speeds
    us = with_paces(problem, at, with_values(at, motion.us, motion.values, motion.dts), motion.qs)
    us = with_moves(problem, at, us, motion.qs[0], motion.vs[0])
    xs, us = with_lengths(problem, at, xs, us, motion.dts)
    xs[0] = start
    return xs, us


def positions_and_speeds(
    problem: Problem, at: StateLayout, space: ConfigurationSpace, iterate: Iterate
) -> Motion:
    """Configurations, speeds in the place of velocities, controls and step lengths of an iterate."""
    zs, speeds = iterate.xs[:, at.z], iterate.xs[:, at.s]
    qs = space.configurations(zs) if at.is_flat or at.nz != problem.robot.nq else zs
    if at.num_moves:
        qs, speeds = np.array(qs), np.array(speeds)
        qs[0], speeds[0] = moved_start(problem, at, iterate.us)
    dts, us = solved_lengths(problem, at, iterate), iterate.us
    return Motion(qs, speeds, means_of(at, us), dts, values_of(at, us), at.shares)
