"""What phases hold and release: spans and impacts, the same motions as by `Problem.holds`, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp import Problem, Solution
from mbocp.cli.app import app
from mbocp.exceptions import MbocpError
from mbocp.problem.file.load import parse_problem
from mbocp.problem.file.overrides import apply_overrides
from mbocp.problem.file.tables import problem_to_toml
from mbocp.problem.timeline.hold import Hold, Release
from tests.holds.cases import four_bar, pendulum

TIP: dict[str, Any] = {"name": "tip", "frame": "tip", "kind": "line"}
PENDULUM = {"name": "double_pendulum", "payload": pendulum().robot.spec["payload"]}
FREE = {"min": 0.1, "max": 0.4}


def hits(*phases: dict[str, Any], **more: Any) -> Problem:
    """A double pendulum whose tip lands on a vertical line in the second of three phases."""
    named: list[dict[str, Any]] = [
        {"name": "fall", "steps": 4, "duration": 0.2},
        {"name": "slide", "steps": 3, "duration": 0.15, "hold": [TIP]},
        {"name": "leave", "steps": 3, "duration": 0.15},
    ]
    named = [{**phase, **own} for phase, own in zip(named, [*phases, {}, {}, {}][:3], strict=True)]
    words: dict[str, Any] = {"start": {"q": [0.3, 0.4]}, "goal": {"q": [-0.2, 0.9], "v": [0.0, 0.0]}}
    return Problem.create(PENDULUM, phase=named, **{"integrator": {"scheme": "se1"}, **words, **more})


def spans(**fields: Any) -> Problem:
    """The same by its spans: the last step of the hold takes no time, either."""
    hold = replace(pendulum().holds[0], spans=((4, 9),))
    return pendulum(steps=12, **{"holds": (hold,), "impacts": (4, 8), **fields})


def test_a_hold_that_begins_is_an_impact() -> None:
    problem = hits()
    assert problem.holds == spans().holds
    assert problem.impacts == (4, 8)  # the second: a parting
    assert (problem.num_steps, problem.timeline.num_timed_steps) == (12, 10)
    nodes = {phase.name: (phase.first, phase.last) for phase in problem.phase}
    assert nodes == {"fall": (0, 4), "slide": (4, 9), "leave": (9, 12)}
    assert problem.timeline.places["slide"] == (5, 9, 1)
    assert problem.timeline.times()[[4, 5, 8, 9, 12]] == pytest.approx([0.2, 0.2, 0.35, 0.35, 0.5])


def test_jerks_are_limited_across_an_impact_between_steps_of_other_lengths() -> None:
    """By the way from middle to middle of steps before and after it, and at the end by half of the last."""
    free = [{"duration": {"min": least, "max": 0.4}} for least in (0.1, 0.1, 0.08)]
    found = mbocp.solve(hits(*free, limits={"jerk": 400.0}, cost={"time": 5.0}), check=True)
    dts, timed = np.diff(found.t), np.diff(found.t) > 0.0
    rises = (found.vs[1:] - found.vs[:-1])[timed] / dts[timed, None]
    between = np.convolve(dts[timed], [0.5, 0.5], mode="valid")
    jerks = np.vstack([np.diff(rises, axis=0) / between[:, None], -rises[-1] / (dts[-1] / 2.0)])
    assert np.abs(jerks).max() == pytest.approx(400.0, rel=1e-6)
    assert np.ptp(dts[timed]) > 1e-3
    assert found.limit_violation < 1e-6


def test_what_two_phases_hold_alike_goes_on() -> None:
    problem = hits({"hold": [TIP]}, {}, {"hold": [{**TIP, "meeting": "soft"}]})
    assert [hold.spans for hold in problem.holds] == [((0, 10),)]
    assert problem.impacts == ()
    again = hits({"hold": [TIP]}, {"hold": []}, {"hold": [TIP]})
    assert [hold.spans for hold in again.holds] == [((0, 5), (8, 12))]
    assert again.impacts == (4, 8)


def test_softly_takes_no_step_more() -> None:
    problem = hits({}, {"hold": [{**TIP, "meeting": "soft"}]})
    assert (problem.impacts, problem.num_steps) == ((7,), 11)
    found = mbocp.solve(problem, check=True)
    table = problem.timeline.switches
    assert table is not None
    assert np.abs(table.jacobians(found.qs[[4]])[0] @ found.vs[4])[1] < 1e-9


def test_a_loop_that_was_open_closes_with_an_impact() -> None:
    def made(**release: Any) -> Problem:
        phases: Any = [
            {"name": "open", "steps": 3, "duration": 0.1, "release": ["pin"]},
            {"name": "closed", "steps": 3, "duration": 0.1},
        ]
        phases[0] |= release
        ends: Any = {"start": {"q": {"crank": 0.4}}, "goal": {"q": {"crank": 0.8}}}
        return Problem.create("four_bar", phase=phases, scheme="se1", **ends)

    problem = made()
    assert problem.releases == (Release(constraint="pin", spans=((0, 3),)),)
    assert problem.impacts == (3,)
    softly = made(release=[{"name": "pin", "meeting": "soft"}])
    assert (softly.releases, softly.impacts) == (problem.releases, ())
    with pytest.raises(MbocpError, match="no constraint of this name"):
        made(release=["pn"])


@pytest.mark.parametrize("coordinates", ["joint", "natural"])
def test_the_motion_is_that_of_spans(coordinates: str) -> None:
    found = mbocp.solve(hits(coordinates=coordinates), check=True)
    other = mbocp.solve(spans().with_(coordinates=coordinates), check=True)
    assert np.array_equal(found.qs, other.qs)
    assert np.array_equal(found.vs, other.vs)
    assert found.t[4] == found.t[5]
    assert found.phase_times["slide"] == pytest.approx((0.2, 0.35))


def test_durations_that_are_found_leave_impacts_out() -> None:
    words: dict[str, Any] = {"cost": {"effort": 1.0, "time": 0.5}}
    problem = hits({"duration": FREE}, {"limits": {"velocity": 4.0}}, {"duration": FREE}, **words)
    own = mbocp.solve(problem, check=True)
    other = mbocp.solve(problem.with_(solver={"method": "ipopt"}), warm_start=own, check=True)
    again = mbocp.solve(problem, warm_start=other, check=True)  # there is more than one optimum
    assert again.cost == pytest.approx(other.cost, rel=1e-6)
    assert own.cost <= other.cost * (1.0 + 1e-6)
    assert own.t[5] == own.t[4]
    assert own.phase_times["slide"][1] - own.phase_times["slide"][0] == pytest.approx(0.15)
    assert own.t[9] == own.t[8]
    assert np.abs(own.vs[5:10]).max() <= 4.0 + 1e-9


def test_velocities_before_an_impact_are_those_of_the_phase_before() -> None:
    problem = hits(
        {"limits": {"velocity": 9.0}}, {"limits": {"velocity": 2.0}}, {"limits": {"velocity": 9.0}}
    )
    upper = problem.limits_along()["v"][1][:, 0]
    assert upper.tolist() == [9.0] * 4 + [2.0] * 5 + [9.0] * 3
    soft = hits(
        {"limits": {"velocity": 9.0}},
        {"limits": {"velocity": 2.0}, "hold": [{**TIP, "meeting": "soft"}]},
        {"limits": {"velocity": 9.0}},
    )
    assert soft.limits_along()["v"][1][:, 0].tolist() == [9.0] * 3 + [2.0] * 5 + [9.0] * 3


def test_points_and_paths_of_a_phase_count_from_its_impact() -> None:
    problem = hits({}, {"steps": 4, "via": [{"q": {"joint1": 0.1}, "share": 0.5}]})
    assert problem.timeline.waypoints[0].node == 7
    path = {"path": [{"kind": "speed", "frame": "tip", "max": 2.0}]}
    span = hits({}, path).frame_constraints[0].span
    assert (span.since.node, span.until.node) == (5, 9)  # type: ignore[union-attr]


def test_what_is_written_reads_back_as_the_same() -> None:
    problem = hits({}, {"release": [], "hold": [TIP, {"frame": "link2", "kind": "hinge", "axis": [0, 1, 0]}]})
    text = problem_to_toml(problem)
    again = parse_problem(text)
    assert problem_to_toml(again) == text
    assert (again.holds, again.impacts) == (problem.holds, problem.impacts)
    assert problem.holds[1].name == "link2 at world"
    changed = problem.with_(limits={"velocity": 30.0})
    assert (changed.holds, changed.impacts) == (problem.holds, problem.impacts)


def test_other_phases_take_their_own_holds() -> None:
    problem = hits()
    free = problem.with_(phase=[{"name": "all", "steps": 8, "duration": 0.5}])
    assert (free.holds, free.impacts, free.num_steps) == ((), (), 8)
    first = problem.with_(phase=problem.phase[:1])
    assert (first.holds, first.impacts, first.num_steps) == ((), (), 4)


def test_holds_without_phases_are_kept_through_changes() -> None:
    for problem in (pendulum(), four_bar()):
        changed = problem.with_(limits={"velocity": 30.0})
        assert changed.holds == problem.holds
        assert (changed.releases, changed.impacts) == (problem.releases, problem.impacts)


def test_overrides_name_holds() -> None:
    document = {"phase": [{"name": "slide", "hold": [{**TIP}]}]}
    changed = apply_overrides(document, ["phase.slide.hold.tip.meeting=soft"])
    assert changed["phase"][0]["hold"][0]["meeting"] == "soft"


def test_results_keep_what_their_phases_hold(tmp_path: Path) -> None:
    found = mbocp.solve(hits({}, {"limits": {"velocity": 5.0}}), check=True)
    found.save(tmp_path / "held.h5")
    again = Solution.load(tmp_path / "held.h5")
    assert [place.has_impact for place in again.named_phases] == [False, True, False]
    assert [place.has_parting for place in again.named_phases] == [False, True, False]
    assert again.phase_times == found.phase_times
    assert parse_problem(again.problem_text).holds == hits().holds
    told = CliRunner(env={"COLUMNS": "200"}).invoke(app, ["info", str(tmp_path / "held.h5")])
    assert "double_pendulum: 2 degrees of freedom, 2 controls" in told.output
    warm = mbocp.solve(hits({"steps": 6}), warm_start=again)
    assert warm.converged


@pytest.mark.parametrize(
    ("hold", "more", "message"),
    [
        ({"frame": "nowhere"}, {}, "phase 'slide': robot 'double_pendulum' has no frame 'nowhere'"),
        ({"frame": "tip", "to": "tip"}, {}, "phase 'slide': hold 'tip at tip': holds frame 'tip' at itself"),
        ({"frame": "tip", "kind": "rod"}, {}, "kind: got 'rod'"),
        ({"frame": "tip", "at": "here"}, {}, "at: got 'here'"),
        ({"frame": "tip", "meeting": "hard"}, {}, "meeting: got 'hard'"),
        ({"frame": "tip", "axis": [0, 0, 1]}, {}, "axis: one of kind 'weld' has none"),
        ({**TIP, "axis": [0, 0, 0]}, {}, "axis: got (0.0, 0.0, 0.0)"),
        ({"kind": "line"}, {}, "phase.1.hold.0.frame: this key is missing"),
        ({**TIP, "color": "red"}, {}, "phase.1.hold.0.color: unknown key"),
        (TIP, {"scheme": "se2"}, "takes no constraints that begin or end along the way"),
        (TIP, {"scheme": "rk4"}, "takes no constraints that begin or end along the way"),
        (TIP, {"scheme": "gauss2"}, "takes no constraints that begin or end along the way"),
        (TIP, {"scheme": "lobatto3"}, "takes no constraints that begin or end along the way"),
        ({**TIP, "meeting": "soft"}, {"coordinates": "natural"}, "natural coordinates have no soft landing"),
        (TIP, {"steps": 10}, "horizon.steps: got 10, but the phases have 12 in all"),
    ],
)
def test_what_cannot_be_is_refused_by_name(hold: dict[str, Any], more: dict[str, Any], message: str) -> None:
    with pytest.raises(MbocpError) as error:
        hits({}, {"hold": [hold]}, **more)
    assert message in str(error.value)


def test_all_that_begin_together_begin_alike() -> None:
    other = {"frame": "link2", "kind": "plane", "meeting": "soft"}
    with pytest.raises(MbocpError, match="phase 'slide': hold 'tip' begins with meeting"):
        hits({}, {"hold": [TIP, other]})
    with pytest.raises(MbocpError, match="hold 'tip': there are several of it"):
        hits({}, {"hold": [TIP, TIP]})


def test_phases_and_spans_do_not_contradict_each_other() -> None:
    with pytest.raises(MbocpError, match="follow from what the phases hold"):
        hits().with_(holds=(Hold(name="tip", frame="tip", spans=((1, 2),)),))
    with pytest.raises(MbocpError, match="impacts: phases have none of their own"):
        hits({}, {"hold": []}).with_(impacts=(3,))
