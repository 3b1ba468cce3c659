"""A motion that goes over into its stop, and how it is sent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mbocp.exceptions import InvalidValue
from mbocp.solution import Solution
from mbocp.solution.joined import join_motions
from mbocp.solution.sent import motion_as_sent

from .test_sent import JERK, swing

NODE, STEPS = 6, 10


def stop_from(motion: Solution, node: int) -> Solution:
    """To rest in the time that the motion took to get there, on the other half of the way."""
    t = np.linspace(0.0, motion.t[node], STEPS + 1)
    q, v = motion.qs[node] + motion.vs[node] * t[:, None], np.tile(motion.vs[node], (STEPS + 1, 1))
    deceleration = motion.vs[node] / t[-1]
    qs, vs = q - 0.5 * deceleration * t[:, None] ** 2, v - deceleration * t[:, None]
    us = np.tile(-deceleration, (STEPS, 1))
    made = swing(steps=STEPS)
    return replace(made, t=t, qs=qs, vs=vs, us=us)


def test_both_are_one_motion() -> None:
    motion = swing()
    stop = stop_from(motion, NODE)
    joined = join_motions(motion, NODE, stop)
    np.testing.assert_array_equal(joined.t[: NODE + 1], motion.t[: NODE + 1])
    np.testing.assert_allclose(joined.t[NODE:], motion.t[NODE] + stop.t)
    np.testing.assert_array_equal(joined.qs[NODE:], stop.qs)
    np.testing.assert_array_equal(joined.us, [*motion.us[:NODE], *stop.us])
    np.testing.assert_array_equal(joined.facts.bounds_of_rate("jerk"), motion.facts.bounds_of_rate("jerk"))


def test_controls_after_the_end_are_those_of_the_stop() -> None:
    motion = swing()
    stop = stop_from(motion, NODE)
    motion = replace(motion, facts_kept=replace(motion.facts, u_start=(0.5,), u_goal=(1.0,)))
    for facts in (
        replace(stop.facts, u_goal=(3.0,)),
        replace(stop.facts, u_goal=(), ends_held=True),
    ):
        joined = join_motions(motion, NODE, replace(stop, facts_kept=facts)).facts
        assert joined.u_start == (0.5,)
        assert (joined.u_goal, joined.ends_held) == (facts.u_goal, facts.ends_held)


def test_it_is_sent_as_the_motion_was() -> None:
    motion = swing()
    sent = motion_as_sent(motion, is_joined=True, fit=True)
    assert sent.mean > 0.0
    joined = motion_as_sent(join_motions(motion, NODE, stop_from(motion, NODE)), is_joined=True, like=sent)
    assert (joined.mean, joined.slower, joined.is_of_spline) == (sent.mean, sent.slower, sent.is_of_spline)
    before = np.linspace(0.0, sent.slower * motion.t[NODE - 3], 50)
    for mine, its, size in zip(joined.curves.at(before), sent.curves.at(before), (1e-4, 1e-2), strict=False):
        np.testing.assert_allclose(mine, its, atol=size)
    assert np.abs(joined.curves.v[-1]).max() < 1e-9
    leap = 2.0 * 4.0 / sent.mean  # the mean spreads a leap of accelerations over its time
    assert np.abs(joined.curves.places(20)[1][3]).max() <= 1.1 * max(leap, JERK)


def test_what_does_not_fit_is_refused() -> None:
    motion = swing()
    with pytest.raises(InvalidValue, match="a node from 1 to 20"):
        join_motions(motion, 0, motion)
    with pytest.raises(InvalidValue, match="begins at that of node 7"):
        join_motions(motion, 7, stop_from(motion, 6))
