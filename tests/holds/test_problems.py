"""Problems with holds: soft landings, frames that meet, optima, rows that others imply, what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import InconsistentStart, InvalidValue, ProblemError
from mbocp.formulation import formulate
from mbocp.problem.timeline.hold import Hold, Release
from tests.holds.cases import arm, drone, four_bar, pendulum

SCHEMES = ("se1", "midpoint", "projected_midpoint")


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_soft_landing_has_no_leap(scheme: str) -> None:
    problem = pendulum(scheme, steps=20, holds=(replace(pendulum().holds[0], spans=((8, 14),)),), impacts=())
    s = mbocp.solve(problem, check=True)
    table = problem.timeline.switches
    assert table is not None
    rates = np.einsum("nij,nj->ni", table.jacobians(s.qs), s.vs)
    assert np.abs(rates[8]).max() < 1e-9
    assert np.abs(rates[7]).max() > 1e-3
    assert s.constraint_violation < 1e-9
    assert not s.lams[:8].any()
    assert not s.lams[14:].any()
    assert s.lams[8:14, 1].all()


def test_what_is_held_moves_within_steps_and_results_say_how_far() -> None:
    """A tip that slides along a vertical wire, and leaves it."""
    wire = Hold(name="wire", frame="tip", kind="line", spans=((0, 4),))
    start = {"q_start": np.array([0.3, 0.4]), "num_steps": 6}
    problem = pendulum(steps=6, holds=(), impacts=()).with_(holds=(wire,), **start)
    s = mbocp.solve(problem, check=True)
    middles = (s.qs[:4] + s.qs[1:5]) / 2.0
    sides = [problem.robot.frame_placement("tip", q).translation[1] for q in (s.qs[0], *middles)]
    assert s.violation_within == pytest.approx(np.abs(np.subtract(sides, sides[0])).max(), rel=1e-9)
    assert s.constraint_violation < 1e-3 * s.violation_within


def test_frames_that_are_to_coincide_meet_where_their_span_begins() -> None:
    """The tip of a pendulum in a plane through the world: softly, and with an impact."""
    at = {"kind": "plane", "axis": (0.0, 1.0, 0.0), "at": "coincide"}
    for impacts, steps in (((), 20), ((8,), 21)):
        hold = Hold(name="wall", frame="tip", spans=((8, steps - 4),), **at)
        problem = pendulum(steps=20, holds=(), impacts=()).with_(
            num_steps=steps, holds=(hold,), impacts=impacts, q_start=np.array([0.5, 0.3])
        )
        s = mbocp.solve(problem, check=True)
        table = problem.timeline.switches
        assert table is not None
        places = table.residuals(s.qs, s.qs)
        assert np.abs(places[8 : steps - 3]).max() < 1e-9
        assert np.abs(places[6]).max() > 1e-4
        if impacts:
            assert s.t[8] == s.t[9]
            assert s.t[-1] == pytest.approx(0.5, abs=1e-14)


@pytest.mark.parametrize("make", [pendulum, four_bar, arm])
def test_optima_are_those_of_ipopt(make: Any) -> None:
    problem = make()
    found = mbocp.solve(problem.with_(solver={"method": "monolithic"}), check=True)
    other = mbocp.solve(problem.with_(solver={"method": "ipopt"}), check=True)
    assert found.cost == pytest.approx(other.cost, rel=1e-7)
    assert np.abs(found.qs - other.qs).max() < 1e-5
    assert np.isfinite(found.control_hamiltonians).all()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_control_momenta_are_kept_through_holds_and_impacts(scheme: str) -> None:
    """What is held where it is moves along with the robot: the symmetries are still there."""
    s = mbocp.solve(drone(scheme), check=True)
    assert len(s.conserved) == 4
    assert all(abs(found.value) > 1.0 for found in s.conserved)
    assert all(found.relative_drift < 1e-12 for found in s.conserved)
    walled = drone(scheme, holds=(replace(drone().holds[0], kind="plane"),))
    assert not mbocp.solve(walled, check=True).conserved


def test_a_frame_at_rest_in_a_singular_start_can_be_held_later() -> None:
    """A double pendulum that hangs straight moves its tip in no height; in the middle of a motion it does."""
    at = {"frame": "tip", "kind": "plane", "axis": (0.0, 0.0, 1.0)}
    words = {"q_start": np.zeros(2), "impacts": ()}
    later = pendulum(holds=(Hold(name="height", spans=((4, 8),), **at),), **words)
    assert later.timeline.switches is not None
    assert later.timeline.switches.rows[4:8].all()
    with pytest.raises(ProblemError, match=r"start is a singular pose.*begin in another"):
        pendulum(holds=(Hold(name="height", spans=((0, 8),), **at),), **words)


def test_multipliers_have_names_and_impacts_are_told() -> None:
    s = mbocp.solve(pendulum(), check=True)
    assert [column.name for column in s.labels.lam] == ["tip.1", "tip.2"]
    assert s.t[4] == s.t[5]
    assert np.diff(s.t).min() == 0.0
    assert np.allclose(np.delete(np.diff(s.t), 4), 0.05)
    assert np.array_equal(s.us[4], s.us[3])


def test_rows_that_others_imply_are_left_out() -> None:
    """A planar pendulum moves in x and z alone: welding its tip holds two of six rows."""
    weld = Hold(name="weld", frame="tip", spans=((4, 8),))
    problem = pendulum(holds=(weld,))
    table = problem.timeline.switches
    assert table is not None
    assert table.rows[4:8].sum(axis=1).tolist() == [2, 2, 2, 2]
    assert not table.rows[:4].any()
    two = (weld, Hold(name="again", frame="link2", kind="point", spans=((4, 8),)))
    again = pendulum(holds=two).timeline.switches
    assert again is not None
    assert again.rows[5].sum() == 2  # all that there are


def test_the_same_functions_serve_other_spans() -> None:
    here, there = pendulum(), pendulum(holds=(replace(pendulum().holds[0], spans=((2, 6),)),), impacts=(2,))
    found = [formulate(problem).programme.functions for problem in (here, there)]
    assert found[0].tapes.held == found[1].tapes.held
    assert found[0].library == found[1].library


def test_memory_passes_through_impacts() -> None:
    """Limits of accelerations and rates of controls count the steps that take time."""
    limits = {"acceleration": 100.0, "effort_rate": 1e3, "jerk": 1e5}
    problem = pendulum(limits=limits, steps=11, cost={"effort": 1.0, "control_rate": 1e-3})
    s = mbocp.solve(problem, check=True)
    assert s.limit_violation < 1e-9
    assert np.isfinite(s.lam_path).all()


def test_free_durations_leave_impacts_out() -> None:
    problem = pendulum(duration={"min": 0.3, "max": 2.0, "guess": 0.5}, cost={"effort": 1.0, "time": 5.0})
    s = mbocp.solve(problem, check=True)
    lengths = np.diff(s.t)
    assert lengths[4] == 0.0
    assert np.ptp(np.delete(lengths, 4)) < 1e-12
    assert problem.dt == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"scheme": "se2"}, ProblemError, 'se2.*take "se1" | "midpoint"'),
        ({"scheme": "rk4"}, ProblemError, "rk4"),
        ({"impacts": (11,)}, InvalidValue, "impacts"),
        ({"holds": (Hold(name="a", frame="nowhere", spans=((1, 2),)),)}, Exception, "nowhere"),
        ({"holds": (Hold(name="a", frame="tip", spans=((1, 20),)),)}, InvalidValue, "'a'"),
        ({"holds": (Hold(name="a", frame="tip", to="tip"),)}, ProblemError, "at itself"),
        ({"holds": (Hold(name="a", frame="base_link"),)}, ProblemError, "nothing moves"),
        ({"holds": (Hold(name="a", frame="tip"),) * 2}, ProblemError, "several"),
        ({"releases": (Release(constraint="pin"),)}, ProblemError, "'pin'"),
        (
            {"holds": (Hold(name="a", frame="tip", at="coincide", spans=((0, 3),)),)},
            InconsistentStart,
            "hold 'a",
        ),
        (
            {"holds": (Hold(name="a", frame="tip", spans=((0, 3),)),), "v_start": np.ones(2)},
            InconsistentStart,
            "start.v",
        ),
    ],
)
def test_what_cannot_be_is_refused_by_name(changes: dict[str, Any], error: type, words: str) -> None:
    with pytest.raises(error, match=words):
        pendulum(**changes)


def test_spans_follow_each_other() -> None:
    for spans in (((3, 3),), ((5, 8), (8, 9)), ((-1, 2),), ((5, 8), (2, 3))):
        with pytest.raises(InvalidValue, match="spans"):
            Hold(name="a", frame="tip", spans=spans)


def test_results_are_written_and_read(tmp_path: Any) -> None:
    s = mbocp.solve(pendulum(), check=True)
    s.save(tmp_path / "held.h5")
    again = mbocp.Solution.load(tmp_path / "held.h5")
    assert np.array_equal(again.lams, s.lams)
    assert again.labels.lam == s.labels.lam
    assert np.array_equal(again.t, s.t)


def test_a_solution_is_a_guess(tmp_path: Any) -> None:
    problem = pendulum()
    s = mbocp.solve(problem, check=True)
    s.save(tmp_path / "held.h5")
    guess = replace(problem.guess, kind="solution", path=tmp_path / "held.h5")
    warm = mbocp.solve(problem.with_(guess=guess), check=True)
    assert warm.iterations <= 2


@pytest.mark.parametrize("scheme", ["se1", "midpoint"])
@pytest.mark.parametrize("make", [pendulum, four_bar])
def test_bodies_in_natural_coordinates_do_the_same(make: Any, scheme: str) -> None:
    """To the order of the scheme: velocities are chords there."""
    problem = make(scheme)
    bodies = problem.with_(coordinates="natural")
    found, other = (mbocp.solve(each, check=True) for each in (problem, bodies))
    assert other.cost == pytest.approx(found.cost, rel=0.02)
    assert other.constraint_violation < 1e-12
    table = problem.timeline.switches
    assert table is not None
    acts = np.hstack([table.own, table.rows])
    assert not other.lams[:, -acts.shape[1] :][~acts].any()


def test_impacts_of_bodies_leap_within_what_holds() -> None:
    problem = drone().with_(coordinates="natural", v_start=np.zeros(6))
    s = mbocp.solve(problem, check=True)
    table = problem.timeline.switches
    assert table is not None
    for step in problem.impacts:
        assert np.abs(s.qs[step] - s.qs[step + 1]).max() < 1e-12
        rate = table.jacobians(s.qs[[step + 1]])[0][table.rows[step]] @ s.vs[step + 1]
        assert np.abs(rate).max() < 1e-9
    assert all(found.relative_drift < 1e-12 for found in s.conserved)
