"""From an iterate with few steps to one of the same problem with more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.formulation import Formulation, Motion
from mbocp.programme import Iterate
from mbocp.robot.nodes import between


def finer(coarse: Formulation, iterate: Iterate, formulation: Formulation) -> Iterate:
    """Iterate of a formulation from one of the same problem with fewer steps.

    States are interpolated between nodes, on the manifold; controls, impulses and multipliers between the
    middles of steps. Multipliers of closed loops begin anew: they are not smooth in time. Steps have the
    lengths that the problem gives.

    Parameters
    ----------
    coarse : Formulation
        With two steps at least.
    iterate : Iterate
        Of it.
    formulation : Formulation
        Of the same robot, with the same rows and the same duration.
    """
    problem, motion = formulation.problem, coarse.motion_of(iterate)
    dts = problem.timeline.lengths()
    few, many = coarse.problem.num_steps, problem.num_steps
    nodes, share = _between(np.linspace(0.0, few, many + 1), few)
    qs = between(problem.robot, motion.qs[nodes], motion.qs[nodes + 1], share)
    vs = _interpolate(motion.vs, nodes, share)
    middles, share = _between((np.arange(many) + 0.5) * few / many - 0.5, few - 1)
    us = _interpolate(motion.us, middles, share)
    lams = _interpolate(coarse.duals_of(iterate, motion).lams, middles, share)
    made = formulation.iterate_of(Motion(qs, vs, us, dts), lams)
    if formulation.programme.kind.ny or iterate.eta.shape != made.eta.shape:
        return made
    ms = _interpolate(iterate.ms, middles, share)
    return replace(made, ms=frozen_array(ms), eta=iterate.eta)


def _between(places: Array, last: int) -> tuple[Array, Array]:
    """Number before each place and the share of the way to the next, from 0 to `last`."""
    inside = np.clip(places, 0.0, last)
    left = np.minimum(inside.astype(int), last - 1)
    return left, inside - left


def _interpolate(values: Array, left: Array, share: Array) -> Array:
    out: Array = values[left] + share[:, None] * (values[left + 1] - values[left])
    return out
