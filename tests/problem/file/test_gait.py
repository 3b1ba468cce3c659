"""`[gait]`: the phases that follow from it, cycles, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import MbocpError
from mbocp.problem import Problem, parse_problem, problem_to_toml
from tests.problem.file.test_ground import EXAMPLES, FEET, GROUND, LEVEL, solo

BIPED = {"left": "left_sole_link", "right": "right_sole_link"}


def walks(gait: dict[str, Any], **words: Any) -> Problem:
    return solo([], **{"gait": {"duration": 0.2, "steps": 4, **gait}, **words})


def contacts(problem: Problem) -> dict[str, list[str]]:
    return {phase.name: [held.hold.name for held in phase.holds] for phase in problem.phase}


@pytest.mark.parametrize(
    ("word", "stands"),
    [
        ("trot", ["FR HL", "FL HR"]),
        ("pace", ["FR HR", "FL HL"]),
        ("bound", ["HL HR", "FL FR"]),
        ("walk", ["FL FR HR", "FR HL HR", "FL FR HL", "FL HL HR"]),
    ],
)
def test_words_are_swings_of_feet_by_their_places(word: str, stands: list[str]) -> None:
    found = contacts(walks({"swings": word}))
    assert found == {
        **{f"swing_{k}": names.split() for k, names in enumerate(stands, start=1)},
        "stand": list(FEET),
    }
    listed = walks({"swings": [[foot for foot in FEET if foot not in names.split()] for names in stands]})
    assert contacts(listed) == found
    back = walks({"swings": word}).with_(start={"q": {"root_joint": [0, 0, 0.235, 0, 0, 1, 0]}})
    assert contacts(back) == found


def test_all_stand_or_none_between_swings() -> None:
    gait = {"swings": "hop", "cycles": 2, "stance": 0.1, "stand": {"min": 0.1, "max": 0.4, "guess": 0.3}}
    problem = walks(gait)
    assert contacts(problem) == {
        "stance_1": list(FEET),
        "swing_1": [],
        "stance_2": list(FEET),
        "swing_2": [],
        "stand": list(FEET),
    }
    assert [phase.steps for phase in problem.phase] == [2, 4, 2, 4, 6]
    assert problem.phase[-1].duration_range == (0.1, 0.4)
    flying = walks({"swings": "trot", "flight": 0.05, "steps": 8})
    assert [*contacts(flying)] == ["swing_1", "flight_1", "swing_2", "flight_2", "stand"]
    assert contacts(flying)["flight_1"] == []
    assert [phase.steps for phase in flying.phase] == [8, 2, 8, 2, 8]


def test_a_gait_is_its_phases() -> None:
    """The same problem as one with the phases by hand."""
    problem = walks({"swings": "trot", "cycles": 2})
    stands = [["FR", "HL"], ["FL", "HR"]] * 2 + [list(FEET)]
    phase = [
        {"name": one.name, "steps": 4, "duration": 0.2, "contacts": names}
        for one, names in zip(problem.phase, stands, strict=True)
    ]
    assert problem_to_toml(solo(phase)) == problem_to_toml(problem)
    assert problem_to_toml(parse_problem(problem_to_toml(problem))) == problem_to_toml(problem)
    longer = problem.with_(gait={"cycles": 3})
    assert [one.name for one in longer.phase][-2:] == ["swing_6", "stand"]
    assert longer.num_steps > problem.num_steps


def cycle(gait: dict[str, Any], **words: Any) -> Problem:
    still = ["root_joint.vx", "root_joint.vy", "root_joint.wz"]
    free = {"q": {"except": still}, "v": True}
    start = {"q": {"root_joint": [0, 0, 0.235, 0, 0, 0, 1]}, "free": free}
    goal = {"periodic": {"moved": {"root_joint": {"x": 0.1}}}}
    given = {"duration": 0.2, "steps": 6, **gait}
    ground = {**GROUND, "lift": 0.03}
    return Problem.create("solo12", gait=given, ground=ground, start=start, goal=goal, scheme="se1", **words)


def test_a_cycle_is_cut_in_the_middle_of_a_swing() -> None:
    problem = cycle({"swings": "trot", "stance": 0.1})
    assert contacts(problem) == {
        "begin": ["FR", "HL"],
        "stance_2": list(FEET),
        "swing_2": ["FL", "HR"],
        "stance_1": list(FEET),
        "end": ["FR", "HL"],
    }
    assert [phase.duration for phase in problem.phase] == [0.1, 0.1, 0.2, 0.1, 0.1]
    lifted = {
        one.name: one.nodes(problem.num_steps, problem.dt) for one in problem.path if "lifted" in one.name
    }
    assert set(lifted) == {
        "FL lifted in end",
        "HR lifted in end",
        "FR lifted in swing_2",
        "HL lifted in swing_2",
    }
    assert np.flatnonzero(lifted["FL lifted in end"].any(axis=1)).tolist() == [problem.num_steps - 1]


@pytest.mark.parametrize("turn", [0.0, 0.2])
def test_a_trot_that_goes_on_and_on(turn: float) -> None:
    """One cycle ends as it begins, further on and turned; feet stand, swing and land on the ground."""
    problem = cycle({"swings": "trot"}, cost={"effort": 1.0, "velocity": 0.01}, limits={"position": True})
    if turn:
        problem = problem.with_(goal={"periodic": {"moved": {"root_joint": {"x": 0.1, "yaw": turn}}}})
    solution = mbocp.solve(problem, check=True)
    assert solution.limit_violation < 1e-8
    robot, periodic = problem.robot, problem.goal.periodic
    assert periodic is not None
    ends = [(solution.qs[k], solution.vs[k]) for k in (0, -1)]
    wanted = robot.frame_placement("base_link", ends[0][0])
    c, s = np.cos(turn), np.sin(turn)
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    found = robot.frame_placement("base_link", ends[1][0])
    np.testing.assert_allclose(found.rotation, turned @ wanted.rotation, atol=1e-8)
    np.testing.assert_allclose(found.translation, turned @ wanted.translation + [0.1, 0, 0], atol=1e-8)
    stands = contacts(problem)
    for place in solution.named_phases:
        for foot, frame in FEET.items():
            nodes = solution.qs[place.first : place.last + 1]
            at = np.array([robot.frame_placement(frame, q).translation for q in nodes])
            if foot in stands[place.name]:
                assert np.abs(at - at[0]).max() < 1e-9
                np.testing.assert_allclose(at[:, 2], LEVEL, atol=1e-6)
            else:
                assert at[:, 2].min() > LEVEL - 1e-6


def test_two_legs_walk() -> None:
    problem = mbocp.load_problem(EXAMPLES / "talos_step.toml")
    q = np.asarray(problem.q_start)
    ground = {"feet": BIPED, "sole": [0.2, 0.12]}
    given = {"swings": "walk", "duration": 0.6, "stance": 0.3, "steps": 4}
    walk = Problem.create(
        problem.robot, gait=given, ground=ground, start={"q": q}, goal={"v": 0}, scheme="se1"
    )
    assert contacts(walk) == {
        "stance_1": ["left", "right"],
        "swing_1": ["right"],
        "stance_2": ["left", "right"],
        "swing_2": ["left"],
        "stand": ["left", "right"],
    }


@pytest.mark.parametrize(
    ("gait", "words", "message"),
    [
        ({"swings": "amble"}, {}, "gait.swings: got 'amble', expected 'walk', 'trot'"),
        ({"swings": [["FL", "XY"]]}, {}, r"gait\.swings: no foot 'XY'; \[ground\] has 'FL'"),
        ({"swings": [["FL"], []]}, {}, r"gait\.swings: got a swing without feet"),
        ({"swings": []}, {}, r"gait\.swings: got a swing without feet"),
        ({"swings": "trot", "duration": 0.0}, {}, r"gait\.duration: got 0"),
        ({"swings": "trot", "stance": -0.1}, {}, r"gait: stance_1: got -0\.1"),
        ({"swings": "trot", "steps": 1}, {}, r"gait\.steps: got 1"),
        ({"swings": "trot", "cycles": 0}, {}, r"gait\.cycles: got 0"),
        (
            {"swings": "hop", "cycles": 2},
            {},
            r"gait: no foot stands in swing_1 nor in swing_2; give a stance",
        ),
        ({"swings": "trot", "stride": 0.1}, {}, r"gait\.stride"),
        (
            {"swings": "trot"},
            {"ground": {"feet": {"FL": "FL_FOOT", "HR": "HR_FOOT"}}},
            "'trot' is for 4 feet",
        ),
        (
            {"swings": "trot"},
            {"ground": {"feet": dict.fromkeys(FEET, "FL_FOOT")}},
            "is for feet front and hind",
        ),
    ],
)
def test_what_is_no_gait_is_refused(gait: dict[str, Any], words: dict[str, Any], message: str) -> None:
    with pytest.raises(MbocpError, match=message):
        walks(gait, **words)


def test_a_gait_needs_a_ground_and_no_phases() -> None:
    gait = {"swings": "trot", "duration": 0.2, "steps": 4}
    with pytest.raises(MbocpError, match=r"gait: which feet does it move\? Say it in \[ground\]"):
        Problem.create("solo12", gait=gait, goal={"v": 0})
    with pytest.raises(MbocpError, match=r"gait: the phases follow from it; leave out \[\[phase\]\]"):
        solo([{"name": "a", "steps": 4, "duration": 0.2, "contacts": list(FEET)}], gait=gait)
