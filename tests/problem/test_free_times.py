"""Via points of free times: where they are, how they are written, and what is refused, without a solve."""

from __future__ import annotations

import re
from typing import Any

import pytest

import mbocp
from mbocp.exceptions import MbocpError
from mbocp.problem import ProblemWarning, parse_problem, problem_to_toml
from tests.test_free_times import ANY_TIME, PATH, bead
from tests.timelines import numbers_of


def test_without_a_share_steps_go_by_the_way() -> None:
    via = [{"name": "a", "time": "free", "q": [0.75, 0.0]}, {"name": "b", "time": "free", "q": [2.25, 0.0]}]
    problem = bead(2.0, via)
    assert [point.node for point in problem.timeline.waypoints] == [10, 30]
    assert [phase.duration for phase in problem.timeline.phases] == pytest.approx([0.5, 1.0, 0.5])
    guessed = bead(2.0, [{**via[0], "time": {"guess": 1.2}}, {**via[1], "time": {"min": 1.9}}])
    assert guessed.timeline.waypoints[0].node == 24
    assert [phase.duration for phase in guessed.timeline.phases[:1]] == pytest.approx([1.2])
    assert guessed.timeline.junctions[1].earliest == 1.9
    held = bead(2.0, [{"name": "a", "time": "free", "q": [0.0, 0.0]}])  # no way: as a quarter of the mean one
    assert held.timeline.waypoints[0].node == 4


@pytest.mark.parametrize(
    "time", ["free", {"min": 0.3}, {"min": 0.3, "max": 0.9}, {"guess": 0.7}, {"min": 0.5, "max": 0.5}]
)
def test_problems_are_written_and_read_back(time: Any) -> None:
    problem = bead(2.0, [{"name": "a", "time": time, "q": [1.5, 0.3]}])
    again = parse_problem(problem_to_toml(problem))
    assert again.via[0].time == problem.via[0].time
    assert numbers_of(again.timeline) == numbers_of(problem.timeline)
    assert problem_to_toml(again) == problem_to_toml(problem)


def test_problems_change_between_free_and_given_times() -> None:
    problem = bead(2.0, [{"name": "a", "time": "free", "q": [1.5, 0.3]}])
    assert problem.timeline.has_free_lengths
    assert problem.duration_range is None
    assert problem.with_(steps=80).timeline.waypoints[0].node == 2 * problem.timeline.waypoints[0].node
    given = problem.with_(via=[{"name": "a", "time": 1.0, "q": [1.5, 0.3]}])
    assert (given.timeline.free_phases, given.timeline.has_free_lengths) == ((), False)
    free = problem.with_(duration={"min": 1.0, "max": 4.0, "guess": 2.0})
    assert free.timeline.junctions[-1].latest == 4.0
    assert free.timeline.name_of(free.timeline.phases[0]) == "a"
    assert not problem.with_(via=[]).timeline.has_free_lengths


def at(time: Any, name: str = "a", x: float = 1.5, **words: Any) -> dict[str, Any]:
    return {"name": name, "time": time, "q": [x, 0.3], **words}


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "a word": (
        {"via": [at("soon")]},
        """time: got 'soon', expected a number of seconds, "free", or a table""",
    ),
    "a key": ({"via": [at({"gues": 1.0})]}, "unknown key 'gues'"),
    "min above max": ({"via": [at({"min": 1.0, "max": 0.5})]}, "via 'a': time.max: got 0.5"),
    "min below 0": ({"via": [at({"min": -1.0})]}, "via 'a': time.min: got -1.0"),
    "guess outside": ({"via": [at({"min": 1.0, "guess": 0.5})]}, "via 'a': time.guess: got 0.5"),
    "after the end": (
        {"via": [at({"min": 2.5})]},
        "via 'a': time.min: got 2.5, expected a time within",
    ),
    "guess after the end": ({"via": [at({"guess": 2.5})]}, "within the horizon of 2 s"),
    "share": ({"via": [at("free", share=1.0)]}, "share: got 1.0"),
    "out of order": (
        {"via": [at({"min": 1.5}, share=0.3), at({"max": 1.0}, "b", share=0.6)]},
        "via 'b': time: at most 1 s, but via 'a' before it is not before 1.5 s",
    ),
    "given out of order": (
        {"via": [at(1.5, share=None), at("free", "b", share=0.2), at({"max": 0.5}, "c", share=0.9)]},
        "via 'c': time: at most 0.5 s",
    ),
    "guesses out of order": (
        {"via": [at({"guess": 1.5}, share=0.3), at({"guess": 1.0}, "b", share=0.6)]},
        "via 'a': time.guess: 1.5 s is not before the guess of via 'b', 1 s",
    ),
    "written out of order": (
        {"via": [at("free", share=0.6), at("free", "b"), at("free", "c", share=0.3)]},
        "via 'c': it is written after via 'a' and comes before it",
    ),
    "no node": ({"via": [at("free", str(i)) for i in range(4)], "steps": 4}, "there is no node for it"),
    "one node": ({"via": [at("free", share=0.5), at("free", "b", share=0.5)]}, "at node 20, as via 'a'"),
    "a share of a free duration": (
        {"duration": ANY_TIME, "via": [at("free"), {"name": "b", "share": 0.8, "q": [2, 0]}]},
        "via 'b': share is part of a duration that is free",
    ),
    "after the guess": (
        {"duration": ANY_TIME, "via": [at(6.0)]},
        "not before the guess of the duration, 5 s; give a greater horizon.duration.guess",
    ),
    "end before": ({"duration": ANY_TIME, "via": [at({"min": 60.0})]}, "within the horizon of 50 s"),
    "solver": (
        {"via": [at("free")], "solver": {"method": "fbsm_newton"}},
        "which cannot find a free time of [via]",
    ),
    "span of times": (
        {"via": [at("free")], "path": [{**PATH, "from": 0.5}]},
        "path 'slow': from: a time of given steps, and lengths of steps are free or differ; name a via point",
    ),
    "span of shares": (
        {"via": [at("free")], "path": [{**PATH, "until": {"share": 0.5}}]},
        "path 'slow': until: a share of equal steps, and lengths of steps are free or differ",
    ),
    "span of times of a free duration": (
        {"duration": ANY_TIME, "via": [], "path": [{**PATH, "from": 0.5}]},
        "or give { share = number }",
    ),
    "span of nothing": (
        {"via": [at("free")], "path": [{**PATH, "from": "b"}]},
        "no via point or phase 'b'; there are 'a'",
    ),
    "span backwards": (
        {"via": [at("free"), at("free", "b")], "path": [{**PATH, "from": "b", "until": "a"}]},
        "no node after the start is between from = via 'b' and until = via 'a'",
    ),
    "span share": ({"via": [], "path": [{**PATH, "from": {"share": 1.5}}]}, "from: got 1.5, expected a part"),
    "span table": (
        {"via": [], "path": [{**PATH, "from": {"part": 0.5}}]},
        "the name of a via point or of a phase, { share",
    ),
    "target file": (
        {"via": [at("free")], "cost": {"effort": 1.0, "tracking": 1.0, "target_file": "motion.csv"}},
        "cost.target_file: a file says when the robot is where, and via.time is free",
    ),
}


@pytest.mark.parametrize(("words", "message"), REFUSED.values(), ids=REFUSED)
def test_refusals_say_which_and_why(words: dict[str, Any], message: str) -> None:
    words = {"duration": 2.0, **words}
    via = [{k: v for k, v in point.items() if v is not None} for point in words.pop("via")]
    with pytest.raises(MbocpError, match=re.escape(message)):
        bead(words.pop("duration"), via, **words)


def test_natural_coordinates_refuse_them() -> None:
    words: dict[str, Any] = {"steps": 12, "coordinates": "natural", "goal": {"q": [0.5] * 6, "v": 0}}
    frame = {"name": "tool0", "z": 0.5}
    with pytest.raises(MbocpError, match="via 'a': time: natural coordinates take steps of a given length"):
        mbocp.Problem.create("ur5", 1.0, via=[{"name": "a", "time": "free", "frame": frame}], **words)


def test_a_weight_of_time_needs_a_free_duration_and_no_free_times() -> None:
    with pytest.warns(ProblemWarning, match="cost.time: the duration is given"):
        bead(2.0, [at("free")], cost={"effort": 1.0, "time": 1.0})
