"""Motions as they are sent: moving means, and more time, until limits are kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from mbocp.solution import Column, Solution
from mbocp.solution.curves import Curves
from mbocp.solution.export_formats import what_helps
from mbocp.solution.joints_sent import Joints
from mbocp.solution.nearest import Ends
from mbocp.solution.problem_facts import Facts, PathRow
from mbocp.solution.sampled import sample
from mbocp.solution.sent import compute_motion_sent

from .fabricated import fabricate

JERK = 100.0


def swing(jerk: float | None = JERK, most: float = 4.0, steps: int = 20) -> Solution:
    """A joint that goes up with one acceleration and down with the other, 1 rad in 1 s."""
    t = np.linspace(0.0, 1.0, steps + 1)
    early = t <= 0.5
    q = np.where(early, 2.0 * t**2, 1.0 - 2.0 * (1.0 - t) ** 2)
    v = np.where(early, 4.0 * t, 4.0 * (1.0 - t))
    column = [Column("j", "rad")], [Column("j", "rad/s")], [Column("j", "N m")]
    rates = {"acceleration": ((-most,), (most,))}
    rates |= {} if jerk is None else {"jerk": ((-jerk,), (jerk,))}
    made = fabricate(*column, num_steps=steps)
    us = np.where(t[:-1] < 0.5, 4.0, -4.0)[:, None]
    return replace(made, t=t, qs=q[:, None], vs=v[:, None], us=us, facts_kept=Facts(rates=rates))


@given(seed=st.integers(0, 10_000), width=st.floats(0.003, 0.4))
@settings(max_examples=30)
def test_the_mean_of_cubics_is_their_mean(seed: int, width: float) -> None:
    """With an integral of its own; it is exact, unless nodes of both ends are nearly the same."""
    rng = np.random.default_rng(seed)
    t = np.cumsum([0.0, *rng.uniform(0.02, 0.1, 8)])
    assume(np.diff(np.sort([*t, *(t + width)])).min() > 1e-4)  # nearer ones are taken together
    q, v = rng.normal(size=(9, 1)), rng.normal(size=(9, 1))
    v[[0, -1]] = 0.0
    cubics = Curves(t, q, v)
    mean = cubics.mean(width)
    assert mean.nodes[-1] == pytest.approx(t[-1] + width)

    def at(time: float) -> float:
        return float(cubics.at(np.clip([time], 0.0, t[-1]))[0][0, 0])

    for time in rng.uniform(0.0, mean.nodes[-1], 5):
        begin, end = time - width, time  # the mean begins half its time earlier
        points = [p for p in (*t,) if begin < p < end]
        exact = quad(at, begin, end, points=points or None, epsabs=1e-12, limit=200)[0] / width
        found = mean.at(np.array([time]))
        assert found[0][0, 0] == pytest.approx(exact, abs=1e-9 + 1e-6 * np.abs(q).max())
        assert found[1][0, 0] == pytest.approx((at(end) - at(begin)) / width, abs=1e-5)


@given(seed=st.integers(0, 10_000), width=st.floats(0.003, 0.4))
@settings(max_examples=30)
def test_the_mean_keeps_what_the_cubics_keep(seed: int, width: float) -> None:
    rng = np.random.default_rng(seed)
    t = np.cumsum([0.0, *rng.uniform(0.02, 0.1, 8)])
    q, v = rng.normal(size=(9, 2)), rng.normal(size=(9, 2))
    v[[0, -1]] = 0.0
    cubics = Curves(t, q, v)
    before, after = cubics.places(40)[1], cubics.mean(width).places(40)[1]
    for one, other in zip(before[:3], after[:3], strict=True):
        room = 1e-3 * np.abs(one).max()
        assert (other <= np.maximum(one.max(axis=0), 0.0 if one is not before[0] else -np.inf) + room).all()
        assert (other >= np.minimum(one.min(axis=0), 0.0 if one is not before[0] else np.inf) - room).all()


def test_a_limit_of_jerk_takes_the_least_mean() -> None:
    """The acceleration leaps by 4 at both ends and by 8 within: 80 ms at 100 rad/s^3, exactly."""
    sent = compute_motion_sent(swing(), 1000.0, fit=True)
    assert sent.excesses == ()
    assert sent.mean == pytest.approx(8.0 / JERK, rel=1e-2)
    assert sent.curves.nodes[-1] == pytest.approx(1.0 + 8.0 / JERK, abs=2e-3)
    assert sent.words.startswith("moving mean over 80")
    motion = sample(sent)
    assert motion.positions[[0, -1], 0] == pytest.approx([0.0, 1.0], abs=1e-9)
    assert motion.accelerations[[0, -1], 0] == pytest.approx([0.0, 0.0], abs=1e-6)
    by_hand = np.diff(motion.positions[:, 0], 3) * 1000.0**3
    assert np.abs(by_hand).max() <= JERK * (1 + 1e-3)
    assert motion.efforts[[0, 20, -1], 0] == pytest.approx([4.0, 4.0, -4.0])
    assert motion.efforts[len(motion.t) // 2, 0] == pytest.approx(0.0, abs=1.1)


@pytest.mark.parametrize("leap", [0.02, 0.5])
def test_a_motion_that_rests_on_the_way_rests_there_as_it_is_sent(leap: float) -> None:
    """Up and down again; between them is a step of no duration, as where an arm lets go of what it holds."""
    up = swing(jerk=400.0, steps=40)
    t, qs = np.concatenate([up.t, 1.0 + up.t]), np.vstack([up.qs, 1.0 - up.qs])
    vs, us = np.vstack([up.vs, -up.vs]), np.vstack([up.us, up.us[:1], -up.us])
    vs[40] = leap
    column = [Column("j", "rad")], [Column("j", "rad/s")], [Column("j", "N m")]
    made = replace(fabricate(*column, num_steps=81), t=t, qs=qs, vs=vs, us=us, facts_kept=up.facts_kept)
    sent = compute_motion_sent(made, 500.0, fit=True)
    if leap == 0.5:  # more than what steps are wrong by
        assert sent.mean == 0.0
        assert "its velocities leap" in what_helps(sent, sent.excesses)
        assert (
            np.diff(compute_motion_sent(made, is_joined=True).times) > 0.0
        ).all()  # controllers ask for it
        return
    assert sent.excesses == ()
    assert sent.mean > 0.0
    rest = sent.times_of(np.array([1.0]))
    assert rest[0] == pytest.approx(sent.slower * (1.0 + sent.mean))
    np.testing.assert_allclose(np.hstack(sent.curves.at(rest)[:2]), [[1.0, 0.0]], atol=1e-6)
    samples = np.concatenate([[0.0, 0.0], sent.curves.at(sent.times)[0][:, 0], [0.0, 0.0]])
    assert np.abs(np.diff(samples, 3)).max() <= 400.0 / 500.0**3 * (1 + 1e-6)
    early, late = sent.controls(np.array([0.25, sent.curves.nodes[-1] - 0.25]))[:, 0]
    assert (early, late) == (4.0, 4.0)


def test_where_means_take_too_long_the_nearest_motion_is_sent() -> None:
    """The mean would take 8/70 s more, above a tenth; a ramp from 0 to 4 takes 4/70 s."""
    sent = compute_motion_sent(swing(jerk=70.0), 1000.0, fit=True)
    assert not sent.excesses
    assert 1.0 + 4.0 / 70.0 <= sent.curves.nodes[-1] <= 1.065
    positions = sent.curves.at(sent.times)[0]
    all_ = np.vstack([positions[:1], positions[:1], positions[:1], positions, positions[-1:], positions[-1:]])
    assert np.abs(np.diff(all_, 3, axis=0)).max() * 1e9 <= 70.0 * (1.0 + 1e-5)
    assert positions[[0, -1], 0] == pytest.approx([0.0, 1.0], abs=1e-9)


def test_a_long_mean_gives_way_to_a_shorter_motion_where_joints_alone_have_limits() -> None:
    """Half of the mean's 80 ms: leaps by 4 at both ends take 40 ms together, as those by 8 within."""
    kept = swing()
    sent = compute_motion_sent(replace(kept, facts_kept=replace(kept.facts, ties=0)), 1000.0, fit=True)
    assert (sent.is_nearest, sent.mean) == (True, 0.0)
    assert 1.0 + 4.0 / JERK <= sent.curves.nodes[-1] <= 1.0 + 4.5 / JERK
    assert not sent.excesses
    row = PathRow("height of tool", 0.0, 1.0, "m", 20)
    bound = compute_motion_sent(
        replace(kept, facts_kept=replace(kept.facts, ties=0, path=(row,))), 1000.0, fit=True
    )
    assert (bound.is_nearest, bound.mean) == (False, pytest.approx(8.0 / JERK, rel=1e-2))


def test_more_time_lowers_what_is_left() -> None:
    """Accelerations of 4 within 3.5: longer by the root of 4 / 3.5, and whole samples."""
    solution = swing(jerk=None, most=3.5)
    sent = compute_motion_sent(solution, 125.0, fit=True)
    assert sent.excesses == ()
    assert sent.mean == 0.0
    least = np.sqrt(4.0 / 3.5)
    assert least <= sent.slower <= least + 1.0 / 125.0 + 1e-3
    assert sent.curves.nodes[-1] * 125.0 == pytest.approx(round(sent.curves.nodes[-1] * 125.0), abs=1e-6)
    (excess,) = {excess.kind for excess in compute_motion_sent(solution, 125.0).excesses}
    assert excess == "acceleration"


@pytest.mark.parametrize("over", [2e-6, 9e-5])
def test_a_motion_that_is_fitted_keeps_its_limits_to_what_solvers_are_exact_by(over: float) -> None:
    """Controllers compare with the limit itself."""
    most = 4.0 / (1.0 + over)
    sent = compute_motion_sent(swing(jerk=None, most=most), is_joined=True, interpolation="cubic", fit=True)
    assert np.abs(sent.curves.places(50)[1][2]).max() <= most * (1.0 + 2e-7)
    assert sent.slower == pytest.approx(np.sqrt(1.0 + over), abs=1e-6)


def test_what_is_too_much_is_left_and_told() -> None:
    """Longer by a tenth at most."""
    far = compute_motion_sent(swing(jerk=None, most=2.0), 125.0, fit=True)
    assert (far.mean, far.slower) == (0.0, 1.0)
    assert far.excesses[0].ratio == pytest.approx(1.0, rel=1e-3)


def test_a_start_that_leads_beyond_a_limit_is_told() -> None:
    """Its speed grows by a^2 / 2j whatever follows; all else is kept, and the samples are whole."""
    v, a, jerk, most = 2.0, 3.0, 20.0, 2.1
    t = np.linspace(0.0, 1.2, 21)
    one = swing(jerk=jerk, most=8.0)
    rows = replace(one.facts, a_start=(a,), q_goal=(False,))
    moving = replace(
        one,
        t=t,
        qs=(v * (t - t**2 / 2.4))[:, None],
        vs=(v * (1.0 - t / 1.2))[:, None],
        limits_v=np.array([[-most], [most]]),
        facts_kept=rows,
    )
    sent = compute_motion_sent(moving, 125.0, fit=True)
    assert sent.is_nearest
    assert sent.words.startswith("nearest motion within limits")
    (excess,) = sent.excesses
    assert (excess.kind, excess.bound) == ("speed", most)
    assert excess.value == pytest.approx(v + a**2 / (2.0 * jerk), rel=1e-3)
    assert "the state in which it begins" in what_helps(sent, sent.excesses)
    np.testing.assert_allclose(np.diff(sent.times), 1.0 / 125.0)
    within = compute_motion_sent(replace(moving, limits_v=2.0 * moving.limits_v), is_joined=True, fit=True)
    assert (within.excesses, within.curves.interpolation) == ((), "quintic")
    assert within.curves.accelerations is not None
    assert within.curves.accelerations[[0, -1], 0] == pytest.approx([a, 0.0], abs=1e-9)


def test_controllers_that_join_samples_get_the_nodes() -> None:
    """So that what is between the samples is the motion itself, whatever the rate; without leaps of jerk."""
    for rate in (None, 30.0, 125.0):
        sent = compute_motion_sent(swing(), rate, is_joined=True, fit=True)
        assert sent.excesses == ()
        assert set(sent.curves.nodes.round(9)) <= set(sent.times)
        assert np.diff(sent.times).min() > 1e-4
    free = compute_motion_sent(swing(jerk=None), None, is_joined=True)
    assert (free.curves.interpolation, free.excesses) == ("cubic", ())  # quintics would swing over
    assert compute_motion_sent(swing(jerk=None), None, "quintic", is_joined=True).excesses


def test_a_joint_with_a_limit_of_jerk_that_stands_still_asks_for_nothing() -> None:
    """While another one, without such a limit, is too fast: that is slowed."""
    one = swing(jerk=None, most=3.5)
    still = np.zeros_like(one.qs)
    columns = [Column(name, "rad") for name in ("j", "k")], [Column(name, "rad/s") for name in ("j", "k")]
    rates = {"acceleration": ((-3.5, -3.5), (3.5, 3.5)), "jerk": ((-np.inf, -9.0), (np.inf, 9.0))}
    made = fabricate(*columns, [Column("j", "N m")], num_steps=20)
    solution = replace(
        made,
        t=one.t,
        qs=np.hstack([one.qs, still]),
        vs=np.hstack([one.vs, still]),
        us=one.us,
        facts_kept=Facts(rates=rates),
    )
    sent = compute_motion_sent(solution, 125.0, fit=True)
    assert sent.excesses == ()
    assert sent.slower >= np.sqrt(4.0 / 3.5) * (1.0 - 1e-3)


def test_a_leap_between_two_samples_is_a_jerk_of_positions() -> None:
    """Half of it in each of two differences of speeds, three quarters in one of positions."""
    rate, leap, most = 1000.0, 1.6, 1000.0  # [1/s], rad/s^2, rad/s^3
    nodes = np.array([0.0, 0.5005, 1.001])
    since = np.maximum(nodes - nodes[1], 0.0)[:, None]
    curves = Curves(nodes, nodes[:, None] + leap * since**2 / 2.0, 1.0 + leap * since)
    ends = Ends(np.array([np.nan]), np.array([True]), np.array([False]))
    joints = Joints(("j",), ("rad/s",), {"jerk": np.array([[-most], [most]])}, ((),), ends, is_joined=False)
    (excess,) = joints.excesses(curves, rate)
    assert excess.value == pytest.approx(0.75 * leap * rate, rel=1e-6)
    assert excess.time == pytest.approx(nodes[1], abs=1e-9)
    assert joints.factor(curves, rate) > 1.0
