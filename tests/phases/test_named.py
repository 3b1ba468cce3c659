"""Phases with names: what they come to, what they refuse, and that they are written as they are read."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbocp import Problem, load_robot
from mbocp.exceptions import MbocpError
from mbocp.problem.file.load import parse_problem
from mbocp.problem.file.overrides import apply_overrides
from mbocp.problem.file.tables import problem_to_toml
from tests.timelines import numbers_of

UR5 = load_robot("ur5")
GOAL = {"q": [0.5, -1.0, 1.0, 0.0, 0.5, 0.0], "v": 0}
FREE = {"min": 0.2, "max": 0.8, "guess": 0.4}


def made(*phases: dict[str, Any], **more: Any) -> Problem:
    named = [{"name": f"p{i}", "steps": 5, "duration": 0.5, **phase} for i, phase in enumerate(phases)]
    return Problem.create(
        UR5,
        phase=named,
        **{"integrator": {"scheme": "se1"}, "goal": GOAL, "cost": {"velocity": 10.0}, **more},
    )


def test_phases_say_how_long_all_is() -> None:
    problem = made({"duration": 0.4}, {"duration": FREE, "steps": 7})
    assert problem.num_steps == 12
    assert problem.duration == pytest.approx(0.8)
    assert problem.duration_range == pytest.approx((0.6, 1.2))
    assert problem.timeline.times()[[0, 5, 12]] == pytest.approx([0.0, 0.4, 0.8])


def test_a_total_that_is_given_leaves_no_free_duration() -> None:
    problem = made({"duration": FREE}, {"duration": FREE}, duration=1.0)
    assert problem.duration_range is None
    assert problem.timeline.has_free_lengths
    assert sum(phase.duration for phase in problem.phase) == pytest.approx(1.0)
    end = problem.timeline.junctions[-1]
    assert end.latest == end.earliest == 1.0


@pytest.mark.parametrize(
    ("phases", "more", "message"),
    [
        ([{}, {"name": "p0"}], {}, "phase 'p0': there are several of this name"),
        ([{}], {"steps": 6}, "horizon.steps: got 6, but the phases have 5 in all"),
        ([{}, {}], {"duration": 2.0}, "horizon.duration: got 2 s, but the phases take 1 s in all"),
        ([{}], {"duration": {"min": 0.1, "max": 2}}, "horizon.duration: got 0.1 to 2 s, but the phases"),
        ([{"duration": FREE}], {"duration": 3.0}, "horizon.duration: got 3 s, but the phases take 0.2 to"),
        ([{"duration": {"min": 2, "max": 1}}], {}, "phase 'p0': duration.max: got 1.0, expected more"),
        ([{"duration": {"min": 2}}], {}, "phase 'p0': duration: max is missing"),
        ([{"steps": 0}], {}, "phase 'p0': steps: got 0"),
        ([{"limits": {"velocity": {"elbow": 1}}}], {}, "phase 'p0': limits.velocity: "),
        ([{"limits": {"velocity": [[1, 2]] * 6}}], {}, "start.v: "),
        ([{"cost": {"effort": -1.0}}], {}, "phase 'p0': cost.effort"),
        ([{"cost": {"tracking": 1.0}}], {}, "unknown key, did you mean cost.tracking"),
        ([{"color": "red"}], {}, "phase.0.color: unknown key"),
        ([{"via": [{"q": {"elbow_joint": 0}, "time": 0.1}]}], {}, "phase 'p0': via: time: it is at the end"),
        ([{}, {"duration": FREE}], {"via": [{"time": 0.2, "q": {"elbow_joint": 0}}]}, "of several lengths"),
        ([{}, {}], {"via": [{"time": "lift", "q": {"elbow_joint": 0}}]}, "no phase 'lift'; there are 'p0'"),
        ([{}, {}], {"via": [{"time": "free", "q": {"elbow_joint": 0}}]}, "times that are found are those"),
        (
            [{}, {}],
            {"via": [{"time": "p1", "q": {"elbow_joint": 0}}]},
            "the end of the motion; say it in goal",
        ),
    ],
)
def test_refusals_name_the_phase(phases: list[dict[str, Any]], more: dict[str, Any], message: str) -> None:
    with pytest.raises(MbocpError) as error:
        made(*phases, **more)
    assert message in str(error.value)


def test_a_via_at_the_end_itself_is_not_told_to_take_more_steps() -> None:
    with pytest.raises(MbocpError, match=r"the end of the motion; say it in goal$"):
        made({}, {}, via=[{"time": "p1", "q": {"elbow_joint": 0}}])


def test_limits_of_neighbours_have_to_overlap() -> None:
    apart = ({"limits": {"position": {"elbow_joint": [-1, 0.2]}}},) * 1
    with pytest.raises(MbocpError, match="no elbow_joint is within it"):
        made(*apart, {"limits": {"position": {"elbow_joint": [0.5, 2]}}})


def test_limits_hold_where_their_phase_is() -> None:
    problem = made({}, {"limits": {"velocity": 2.0, "effort": 30.0}}, limits={"velocity": 3.0})
    along = problem.limits_along()
    assert (along["v"][1][:4] == 3.0).all()
    assert (along["v"][1][4:] == 2.0).all()
    assert np.isinf(along["u"][1][:5]).all()
    assert (along["u"][1][5:] == 30.0).all()
    assert (problem.widest_limits.v_upper == 3.0).all()
    assert (problem.widest_limits.u_upper == 30.0).all()


def test_weights_are_shares_of_the_heaviest() -> None:
    problem = made({"cost": {"effort": 4.0}}, {"cost": {"potential": -2.0}})
    assert (np.asarray(problem.heaviest_cost.effort) == 4.0).all()
    assert problem.heaviest_cost.potential == -2.0
    shares = problem.weight_shares
    assert (shares["effort"][:5] == 1.0).all()
    assert (shares["effort"][5:] == 0.25).all()
    assert (shares["potential"][:5] == 0.0).all()
    assert (shares["potential"][5:] == 1.0).all()


def test_overrides_name_phases() -> None:
    document = {"phase": [{"name": "lift", "steps": 5}, {"name": "swing", "steps": 7}]}
    changed = apply_overrides(document, ["phase.swing.duration={min=0.1, max=0.5}", "phase.0.steps=9"])
    assert changed["phase"][1]["duration"] == {"min": 0.1, "max": 0.5}
    assert changed["phase"][0]["steps"] == 9


def test_with_changes_phases() -> None:
    problem = made({}, {"duration": FREE})
    changed = problem.with_(phase=[{"name": "all", "steps": 8, "duration": 0.9}])
    assert changed.num_steps == 8
    assert changed.duration == 0.9
    assert changed.duration_range is None
    again = problem.with_(phase=problem.phase[:1])
    assert again.num_steps == 5
    assert again.duration == 0.5


DURATIONS = st.one_of(
    st.floats(0.1, 2.0),
    st.tuples(st.floats(0.1, 1.0), st.floats(1.1, 3.0)).map(lambda s: {"min": s[0], "max": s[1]}),
)
PHASES = st.lists(
    st.fixed_dictionaries(
        {"steps": st.integers(4, 6), "duration": DURATIONS},
        optional={
            "limits": st.fixed_dictionaries(
                {"velocity": st.floats(3.0, 9.0)}, optional={"jerk": st.just(900.0)}
            ),
            "cost": st.fixed_dictionaries(
                {"effort": st.floats(0.1, 9.0)}, optional={"velocity": st.floats(0.0, 5.0)}
            ),
            "path": st.just([{"kind": "speed", "frame": "tool0", "max": 2.0}]),
        },
    ),
    min_size=1,
    max_size=4,
)


@settings(max_examples=25)
@given(phases=PHASES, with_via=st.booleans())
def test_what_is_written_reads_back_as_the_same(phases: list[dict[str, Any]], with_via: bool) -> None:
    if with_via and len(phases) > 1:
        phases[0] = {**phases[0], "via": [{"name": "there", "q": {"elbow_joint": 0.7}}]}
    problem = made(*phases)
    text = problem_to_toml(problem)
    again = parse_problem(text)
    assert problem_to_toml(again) == text
    assert numbers_of(again.timeline) == numbers_of(problem.timeline)
    assert np.array_equal(again.timeline.times(), problem.timeline.times())
    for letter, sides in problem.limits_along().items():
        assert np.array_equal(sides, again.limits_along()[letter])


def test_via_points_without_names_have_distinct_ones_in_a_phase() -> None:
    there = [{"q": {"elbow_joint": 0.1 * (i + 1)}, "share": share} for i, share in enumerate((0.4, 0.8, 1.0))]
    problem = made({"via": there}, {})
    assert [point.name for point in problem.via] == ["0.4 of p0", "0.8 of p0", "end of p0"]
    again = parse_problem(problem_to_toml(problem))
    assert [point.name for point in again.via] == [point.name for point in problem.via]
