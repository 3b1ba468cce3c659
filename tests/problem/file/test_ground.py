"""`[ground]` and `contacts`: what phases say of feet, and gaits that follow from it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.exceptions import ProblemError
from mbocp.problem import Problem, ProblemWarning, parse_problem, problem_to_toml
from mbocp.problem.contact_bounds import ContactBounds

EXAMPLES = Path(__file__).parents[3] / "examples" / "legged"
FEET = {name: f"{name}_FOOT" for name in ("FL", "FR", "HL", "HR")}
GROUND = {"feet": FEET, "friction": 0.7}
LEVEL = 0.0191028


def steps(*contacts: list[str], count: int = 4) -> list[dict[str, Any]]:
    return [
        {"name": f"s{k}", "steps": count, "duration": 0.1, "contacts": names}
        for k, names in enumerate(contacts)
    ]


def solo(phase: list[dict[str, Any]], ground: dict[str, Any] | None = None, **words: Any) -> Problem:
    start = {"q": {"root_joint": [0, 0, 0.235, 0, 0, 0, 1]}}
    ground = GROUND if ground is None else ground
    return Problem.create(
        "solo12", phase=phase, ground=ground, start=start, goal={"v": 0}, scheme="se1", **words
    )


def heights(problem: Problem, qs: np.ndarray, name: str) -> np.ndarray:
    return np.array([problem.robot.frame_placement(FEET[name], q).translation for q in qs])


@pytest.mark.parametrize("name", ["trot", "jump"])
def test_feet_stand_swing_and_land(name: str) -> None:
    problem = mbocp.load_problem(EXAMPLES / f"solo12_{name}.toml")
    assert problem.scheme == "projected_midpoint"  # chosen
    solution = mbocp.solve(problem, check=True)
    assert solution.limit_violation < 1e-8
    stands = {phase.name: {held.hold.name for held in phase.holds} for phase in problem.phase}
    for place in solution.named_phases:
        for foot in FEET:
            at = heights(problem, solution.qs[place.first : place.last + 1], foot)
            if foot in stands[place.name]:
                assert np.abs(at - at[0]).max() < 1e-9
                np.testing.assert_allclose(at[:, 2], LEVEL, atol=1e-6)
            else:
                assert at[:, 2].min() > LEVEL - 1e-6
    forces = [c for c in problem.path if isinstance(c, ContactBounds)]
    assert {c.contact.constraint for c in forces} == set(FEET)
    assert {c.contact.friction for c in forces} == {0.7}


def test_a_phase_has_what_its_contacts_say() -> None:
    phase = steps(["FL", "HR"], [], ["FL", "FR", "HL", "HR"])
    phase[1]["via"] = [{"frame": {"name": "base_link", "z": 0.3}}]
    problem = solo(phase)
    assert [[held.hold.name for held in one.holds] for one in problem.phase] == [
        ["FL", "HR"],
        [],
        ["FL", "FR", "HL", "HR"],
    ]
    (landing,) = problem.via
    asked = {frame.name: frame.target.position for frame in landing.goal.frames}
    assert set(asked) == {"base_link", *FEET.values()}
    assert asked["HL_FOOT"][2] == pytest.approx(LEVEL, abs=1e-6)
    above = {one.name: one.span for one in problem.path if "above the ground" in one.name}
    assert set(above) == {
        *(f"{foot} above the ground in s0" for foot in ("FR", "HL")),
        *(f"{foot} above the ground in s1" for foot in FEET),
    }
    lifted = problem.with_(ground={"lift": 0.05})
    (one,) = [one for one in lifted.path if one.name == "FL lifted in s1"]
    assert np.asarray(one.lower)[0] == pytest.approx(LEVEL + 0.05, abs=1e-6)
    assert one.nodes(lifted.num_steps, lifted.dt).any(axis=1).sum() == 1
    at = above["FR above the ground in s0"]
    nodes = np.flatnonzero(at.nodes(problem.num_steps, problem.dt)) + 1
    first = problem.phase[0]
    assert nodes[0] == first.first + 1
    assert nodes[-1] >= first.last - 1  # it does not land at the end of this phase


def test_the_text_says_all_by_itself() -> None:
    problem = solo(steps(["FL", "FR", "HL", "HR"], ["FL", "HR"]))
    text = problem_to_toml(problem)
    assert "[ground]" not in text
    again = parse_problem(text)
    assert [one.holds for one in again.phase] == [one.holds for one in problem.phase]
    assert [one.name for one in again.path] == [one.name for one in problem.path]
    assert problem_to_toml(again) == text


def test_what_is_changed_afterwards() -> None:
    problem = solo(steps(["FL", "FR", "HL", "HR"], ["FL", "HR"]))
    slippery = problem.with_(ground={"friction": 0.2})
    assert {c.contact.friction for c in slippery.path if isinstance(c, ContactBounds)} == {0.2}
    sole = problem.with_(ground={"sole": [0.04, 0.02]})
    assert {held.hold.kind for held in sole.phase[0].holds} == {"weld"}
    longer = problem.with_(phase=[*problem.phase]).with_(path=[])
    kept = longer.with_(phase=[*steps(["FL", "FR", "HL", "HR"])])
    assert [held.hold.name for held in kept.phase[0].holds] == list(FEET)


@pytest.mark.parametrize(
    ("phase", "ground", "words"),
    [
        (
            steps(["FL", "XY"]),
            GROUND,
            r"'s0': contacts: no foot 'XY'; \[ground\] has 'FL', 'FR', 'HL', ",
        ),
        (
            steps(["FL"]),
            {**GROUND, "height": 0.0},
            r"the start 'FL' is at z = 0\.0191028 m, and the ground",
        ),
        ([], GROUND, r"ground: phases say which feet stand"),
        (steps([]), {"feet": {}}, r"ground\.feet: there are none"),
        (steps([]), {"feet": {"A": "foot"}}, r"ground\.feet: .*'foot'"),
        (steps([]), {**GROUND, "meeting": "hard"}, r"ground\.meeting: "),
    ],
)
def test_what_cannot_stand_is_refused(phase: list[Any], ground: dict[str, Any], words: str) -> None:
    with pytest.raises(mbocp.exceptions.MbocpError, match=words):
        solo(phase, ground, **({} if phase else {"duration": 0.5, "steps": 10}))


def test_feet_of_a_free_start_stand_on_the_ground() -> None:
    problem = solo(steps(["FL", "HR"], ["FR", "HL"])).with_(start={"free": True})
    (begin, _) = problem.via
    assert (begin.time.name, begin.time.share) == ("s0", 0.25)
    asked = {frame.name: frame.target.position[2] for frame in begin.goal.frames}
    assert asked == pytest.approx({"FL_FOOT": LEVEL, "HR_FOOT": LEVEL}, abs=1e-6)
    with pytest.raises(ProblemError, match=r"start\.free: feet stand in phase 's0', and what is free cannot"):
        solo(steps(["FL", "HR"])).with_(start={"free": {"q": ["root_joint.vz"]}})
    still = solo(steps(["FL", "HR"])).with_(start={"free": {"q": ["FR_KFE"]}})
    assert not still.via


def test_contacts_without_a_ground_are_refused() -> None:
    with pytest.raises(ProblemError, match=r"phase 's0': contacts: of which feet\? Say it in \[ground\]"):
        Problem.create("solo12", phase=steps(["FL"]), goal={"v": 0})


def test_feet_that_land_anywhere_are_told() -> None:
    hold = [{"name": "FL", "frame": "FL_FOOT", "kind": "point"}]
    phase = [
        {"name": "fall", "steps": 4, "duration": 0.1},
        {"name": "stand", "steps": 4, "duration": 0.1, "hold": hold},
    ]
    with pytest.warns(ProblemWarning, match=r"points are held wherever .*: 'FL in stand'; say"):
        Problem.create("solo12", phase=phase, goal={"v": 0}, scheme="se1")
    phase[0]["path"] = [{"kind": "position", "frame": "FL_FOOT", "z": [0.0, 0.1]}]
    Problem.create("solo12", phase=phase, goal={"v": 0}, scheme="se1")


def test_feet_land_as_high_as_footholds_are() -> None:
    """Up a stair: each foot on its foothold, over the edge in between, and on both at the end."""
    problem = mbocp.load_problem(EXAMPLES / "talos_stairs.toml")
    solution = mbocp.solve(problem, check=True)
    assert solution.limit_violation < 1e-8
    shift, up, climb, follow, stand = solution.named_phases

    def soles(frame: str, place: Any) -> np.ndarray:
        nodes = solution.qs[place.first : place.last + 1]
        return np.array([problem.robot.frame_placement(frame, q).translation[2] for q in nodes])

    for frame, low, swing, high in (
        ("right_sole_link", (shift,), up, (climb, follow, stand)),
        ("left_sole_link", (shift, up, climb), follow, (stand,)),
    ):
        assert max(np.abs(soles(frame, place)).max() for place in low) < 1e-5
        assert max(np.abs(soles(frame, place) - 0.1).max() for place in high) < 1e-8
        in_air = soles(frame, swing)
        assert in_air[len(in_air) // 2] > 0.14 - 1e-5
        assert in_air.min() > -1e-5


def test_soles_stay_flat_and_land_flat() -> None:
    problem = mbocp.load_problem(EXAMPLES / "talos_step.toml")
    solution = mbocp.solve(problem, check=True)
    assert solution.limit_violation < 1e-8
    shift, step, stand = solution.named_phases
    for frame, phases in (("left_sole_link", (shift, step, stand)), ("right_sole_link", (shift, stand))):
        for place in phases:
            nodes = solution.qs[place.first : place.last + 1]
            soles = [problem.robot.frame_placement(frame, q) for q in nodes]
            assert max(abs(sole.translation[2]) for sole in soles) < 1e-5  # as high as at the start
            assert min(sole.rotation[2, 2] for sole in soles) > 1.0 - 1e-5
    middle = problem.robot.frame_placement("right_sole_link", solution.qs[(step.first + step.last) // 2])
    assert middle.translation[2] > 0.04 - 1e-5
    landed = problem.robot.frame_placement("right_sole_link", solution.qs[step.last])
    assert landed.translation[0] == pytest.approx(0.2, abs=1e-8)


def test_a_seat_bears_until_it_is_left() -> None:
    problem = mbocp.load_problem(EXAMPLES / "talos_sit_to_stand.toml")
    solution = mbocp.solve(problem, check=True)
    robot, (lean, rise) = problem.robot, solution.named_phases
    seat, *feet = (contact.wrenches(solution.lams)[:, 0] for contact in problem.contacts)
    weight = 9.81 * pin.computeTotalMass(robot.model)
    sits = slice(lean.first, lean.last - 1)  # the last step is the parting
    assert 0.5 * weight < seat[lean.first] < weight
    assert seat[sits].min() >= 0.0
    assert not seat[rise.first :].any()
    assert feet[0][-1] + feet[1][-1] == pytest.approx(weight, rel=0.05)
    pelvis = np.array([robot.frame_placement("base_link", q).translation for q in solution.qs])
    assert np.abs(pelvis[lean.first : lean.last] - pelvis[0]).max() < 1e-9
    assert pelvis[-1, 2] > pelvis[0, 2] + 0.2


def test_feet_that_stand_bear_a_little() -> None:
    """0.5 % of the weight where they may slip, unless it is said: at the tip of a cone solvers stall."""
    problem = solo(steps(["FL", "FR", "HL", "HR"]))
    weight = 9.81 * pin.computeTotalMass(problem.robot.model)

    def least(problem: Problem) -> list[float]:
        return [float(c.lower[0]) for c in problem.path if isinstance(c, ContactBounds)]

    assert least(problem) == pytest.approx([0.005 * weight] * 4)
    assert least(problem.with_(ground={"min_normal": 1.5})) == [1.5] * 4
    assert least(solo(steps(["FL", "FR", "HL", "HR"]), {"feet": FEET})) == [0.0] * 4
    with pytest.raises(ProblemError, match="min_normal"):
        problem.with_(ground={"min_normal": -1.0})
