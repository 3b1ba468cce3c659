"""What arithmetic says against a problem: planted causes are named, solvable problems have none."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.problem import Problem, load_problem
from mbocp.problem.integration import stiffest_joint
from mbocp.problem.reasons.causes import causes_of
from mbocp.problem.reasons.least_time import least_time
from mbocp.robot import load_robot
from tests.robot.urdfs import joint, link, write
from tests.robot.urdfs import robot as urdf

EXAMPLES = Path(__file__).parents[2] / "examples"
pytestmark = pytest.mark.filterwarnings("ignore")
GOAL = {"q": [2.0, -0.7, 1.5, -2.3, -1.57, 0.8], "v": 0}
START = {"q": [0, -1.57, 0, -1.57, 0, 0]}


def arm(duration: float = 2.0, steps: int = 100, **words) -> Problem:
    return Problem.create("ur5", duration, steps, start=START, **{"goal": GOAL, **words})


def first(problem: Problem) -> tuple[str, str, bool]:
    cause = causes_of(problem)[0]
    return cause.kind, cause.where, cause.is_certain


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_least_times_are_those_of_bang_coast_bang(sign):
    rest = {"to_rate": 0.0}
    assert least_time(sign * 2.0, 4.0) == 0.5
    assert least_time(sign * 1.0, acceleration=4.0, **rest) == pytest.approx(1.0)
    assert least_time(sign * 3.0, 1.0, 2.0, **rest) == pytest.approx(3.5)
    assert least_time(sign * 1.0, acceleration=2.0) == pytest.approx(1.0)  # arrives at speed
    assert least_time(sign * 1.5, 2.0, 2.0, from_rate=sign, to_rate=sign * 1.0) == pytest.approx(1.0)
    for v in (0.5, -0.5):  # there already, but for rounding
        assert least_time(sign * 1e-17, acceleration=2.0, from_rate=v, to_rate=v) == 0.0
    braked = 1.5 + 2.0 * math.sqrt(2.25 / 2.0)  # and 2.25 back
    assert least_time(0.0, acceleration=2.0, from_rate=sign * 3.0, to_rate=0.0) == pytest.approx(braked)
    assert least_time(
        2.25 - 2.0 * math.pi, acceleration=2.0, from_rate=3.0, to_rate=0.0, is_circle=True
    ) == pytest.approx(1.5)
    assert least_time(sign * 1.0, jerk=12.0, **rest) == pytest.approx(1.0)


def test_no_motion_of_random_accelerations_is_faster():
    rng = np.random.default_rng(0)
    for _ in range(200):
        a, dt = rng.uniform(0.5, 3.0), 1e-3
        pieces = np.repeat(rng.uniform(-a, a, 8), 100)
        v0 = rng.uniform(-1.0, 1.0)
        v = v0 + np.cumsum(pieces) * dt
        d = float(np.sum(v - 0.5 * pieces * dt) * dt)
        least = least_time(d, max(np.abs(v).max(), abs(v0)), a, from_rate=v0, to_rate=float(v[-1]))
        assert least <= 0.8 + 1e-9


@pytest.mark.parametrize(
    ("problem", "expected"),
    [
        (lambda: arm(0.5, limits={"velocity": True}), ("speed", "shoulder_pan_joint", True)),
        (lambda: arm(1.0, limits={"acceleration": 5.0}), ("acceleration", "shoulder_pan_joint", True)),
        (lambda: arm(1.0, limits={"jerk": 20.0}), ("jerk", "shoulder_pan_joint", True)),
        (lambda: arm(0.2, limits={"effort": True}), ("torque", "shoulder_lift_joint", False)),
        (lambda: arm(4.0, limits={"effort": 20.0}), ("weight", "shoulder_lift_joint", False)),
        (
            lambda: arm(path=[{"name": "slow", "kind": "speed", "frame": "tool0", "max": 0.2}]),
            ("frame_speed", "slow", True),
        ),
        (
            lambda: arm(
                via=[{"name": "gate", "time": 0.3, "q": [2.0, -1, 0, 0, 0, 0]}], limits={"velocity": 3.0}
            ),
            ("speed", "shoulder_pan_joint", True),
        ),
        (
            lambda: arm(steps=2, goal={**GOAL, "q": [3.0, -0.7, 1.5, -2.3, -1.57, 0.8]}),
            ("steps", "shoulder_pan_joint", False),
        ),
    ],
    ids=["speed", "acceleration", "jerk", "torque", "weight", "frame", "via", "steps"],
)
def test_what_is_planted_is_named(problem, expected):
    assert first(problem()) == expected


def test_the_words_have_the_numbers():
    (cause, *_) = causes_of(load_problem(EXAMPLES / "arms/ur5_limits.toml", {"horizon.duration": 0.6}))
    assert cause.words == (
        "shoulder_pan_joint needs 0.698 s for 2.2 rad to the goal at its 3.15 rad/s; the horizon is 0.6 s"
    )


def test_a_base_without_a_motor_falls():
    still = Problem.create("solo12", 1.0, 50, goal={"v": 0}).q_start
    (cause, *_) = causes_of(Problem.create("solo12", 1.0, 50, goal={"q": still, "v": 0}))
    assert (cause.kind, cause.is_certain) == ("fall", True)
    assert "4.9" in cause.words


@pytest.mark.parametrize(
    "name", ["arms/ur5_limits", "arms/minimum_time", "arms/via_points", "free_flyer/gates", "loops/stewart"]
)
def test_nothing_is_said_against_what_has_a_solution(name):
    assert causes_of(load_problem(EXAMPLES / f"{name}.toml")) == ()


SKATER = """<robot name="skater">
  <link name="floor"/>
  <link name="base"><inertial><mass value="2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0.25 0 0"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0.25 0 0"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="slide" type="planar"><parent link="floor"/><child link="base"/><axis xyz="0 0 1"/></joint>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <dynamics damping="0.1"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 0 1"/></joint>
</robot>"""


@pytest.fixture(scope="module")
def skater(tmp_path_factory):
    """An arm of two links on a base that slides and turns on ice."""
    file = tmp_path_factory.mktemp("skater") / "skater.urdf"
    file.write_text(SKATER)
    return load_robot(str(file), actuated=["shoulder", "elbow"])


def skated(robot, goal, v_start=None, **words) -> Problem:
    start = {"q": [0, 0, 0, 0.1, 0.2]} | ({} if v_start is None else {"v": v_start})
    return Problem.create(robot, 1.0, 40, start=start, goal=goal, scheme="midpoint", **words)


def test_rest_that_holds_by_itself_is_named(skater):
    """And without it the same motion is found: the base comes to rest."""
    arm = {"shoulder": 0.5, "elbow": 1.0}
    problem = skated(skater, {"q": arm, "v": 0})
    (cause,) = causes_of(problem)
    assert (cause.kind, cause.where, cause.is_certain) == ("momentum", "slide", False)
    assert "nothing pushes skater along x, along y and about z" in cause.words
    assert cause.words.endswith("leave slide out of goal.v")
    assert mbocp.solve(problem).status in ("singular", "line_search_failed")  # as round-off has it
    mended = skated(skater, {"q": arm, "v": {"shoulder": 0, "elbow": 0}})
    assert causes_of(mended) == ()
    s = mbocp.solve(mended, check=True)
    assert np.abs(s.vs[-1]).max() < 1e-5  # a step turns the base, which keeps momenta to its order


def test_a_momentum_that_stays_contradicts_rest(skater):
    """Along the axes in which it has one, unless the goal leaves something free to have it."""
    problem = skated(skater, {"v": 0}, [0.5, 0, 0, 0, 0])
    causes = causes_of(problem)
    assert (causes[0].kind, causes[0].is_certain) == ("momentum", True)
    along_x = next(cause for cause in causes if cause.where == "translation along x")
    assert "its momentum of 2 kg m/s stays" in along_x.words  # 4 kg at 0.5 m/s
    assert causes_of(skated(skater, {"v": {"shoulder": 0, "elbow": 0}}, [0.5, 0, 0, 0, 0])) == ()


def test_a_centre_of_mass_stays_where_nothing_pushes_it(skater):
    rates = {"shoulder": 0, "elbow": 0}
    causes = causes_of(skated(skater, {"q": [0.5, 0, 0, 0.1, 0.2], "v": rates}))
    assert [(c.kind, c.where, c.is_certain) for c in causes] == [("momentum", "translation along x", True)]
    assert "stays where it is, and the goal has it 0.5 m elsewhere" in causes[0].words
    moved = skated(skater, {"q": [0.5, 0, 0, 0.1, 0.2], "v": rates}, [0.5, 0, 0, 0, 0])
    assert causes_of(moved) == ()


CART = """<robot name="cart">
  <link name="rail"/>
  <link name="body"><inertial><mass value="2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="pole"><inertial><origin xyz="0 0 -0.5"/><mass value="1"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="rolls" type="prismatic"><parent link="rail"/><child link="body"/><axis xyz="1 0 0"/>
    <limit lower="-9" upper="9" effort="9" velocity="9"/><dynamics damping="DAMPING"/></joint>
  <joint name="swings" type="continuous"><parent link="body"/><child link="pole"/><axis xyz="0 1 0"/></joint>
</robot>"""


@pytest.mark.parametrize(
    ("damping", "actuated", "is_kept"),
    [("0", ["swings"], True), ("1", ["swings"], False), ("0", ["rolls"], False)],
)
def test_what_is_damped_or_pushed_keeps_no_momentum(tmp_path, damping, actuated, is_kept):
    file = tmp_path / "cart.urdf"
    file.write_text(CART.replace("DAMPING", damping))
    robot = load_robot(str(file), actuated=actuated)
    causes = causes_of(Problem.create(robot, 1.0, 40, goal={"q": {"swings": 1.0}, "v": 0}))
    assert any(cause.kind == "momentum" for cause in causes) is is_kept
    if is_kept:
        assert "nothing pushes cart along x" in causes[-1].words


FLOATER = """<robot name="floater">
  <link name="body"><inertial><mass value="2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="arm"><inertial><origin xyz="0.25 0 0"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="continuous"><parent link="body"/><child link="arm"/>
    <origin xyz="0.1 0 0"/><axis xyz="0 0 1"/></joint>
</robot>"""


def floats(folder, **words):
    """A body with one link, which floats and falls."""
    file = folder / "floater.urdf"
    file.write_text(FLOATER)
    return load_robot(str(file), free_flyer=True, **words)


def test_a_goal_of_the_base_alone_is_out_of_reach_of_a_fall(tmp_path):
    """By what the rest of the robot cannot make up for: its mass is at most 0.35 m / 3 from the base."""
    there = {"q": {"root_joint": [1, 0, 0, 0, 0, 0, 1]}}
    weightless = floats(tmp_path, gravity=[0, 0, 0])
    (cause,) = causes_of(Problem.create(weightless, 1.0, 40, goal=there))
    assert (cause.kind, cause.where, cause.is_certain) == ("fall", "root_joint", True)
    c0 = 0.35 / 3.0
    assert f"at least {1.0 - c0 - c0:.3g} m from where the goal has it" in cause.words
    near = {"q": {"root_joint": [0.9 * 2.0 * c0, 0, 0, 0, 0, 0, 1]}}
    assert causes_of(Problem.create(weightless, 1.0, 40, goal=near)) == ()


@pytest.mark.parametrize("duration", [{}, {"duration": {"min": 0.5, "max": 2.0}}], ids=["given", "free"])
def test_what_falls_is_not_at_rest(tmp_path, duration):
    rest = {"q": {"shoulder": 1.0}, "v": 0}
    words = {"duration": 1.0, "steps": 40} | duration
    (cause, *_) = causes_of(Problem.create(floats(tmp_path), goal=rest, **words))
    assert (cause.kind, cause.is_certain) == ("fall", True)
    least = 9.81 * (0.5 if duration else 1.0)
    assert f"at {least:.3g} m/s" in cause.words
    thrown = {"start": {"v": [0, 0, 9.81, 0, 0, 0, 0]}}  # is at rest in place after a second
    causes = causes_of(Problem.create(floats(tmp_path), 1.0, 40, goal=rest, **thrown))
    assert not any(cause.kind == "fall" for cause in causes)


BODY = """<robot name="body"><link name="body"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""

TUG = """urdf = "body.urdf"
free_flyer = true
""" + "".join(
    f"""[[actuator]]
type = "thruster"
frame = "body"
name = "r{i}"
position = [{x}, {y}, 0]
torque_ratio = {0.02 * x * y}
"""
    for i, (x, y) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)])
)


@pytest.mark.parametrize(("load", "is_kept"), [("ball", True), ("tug", False)])
def test_nothing_turns_a_ball_on_a_rod_that_ends_in_its_middle(tmp_path, load, is_kept):
    """And the rod does turn a body that it holds beside its centre of mass."""
    (tmp_path / "body.urdf").write_text(BODY)
    (tmp_path / "tug.toml").write_text(TUG)
    tug = str(tmp_path / "tug.toml")
    what = {"mass": 0.3, "sphere": 0.06} if load == "ball" else {"robot": tug}
    rod = {"name": "cable", "type": "rod", "frames": ["tug/body", "load/body"], "length": 0.8}
    places = {"tug": [0, 0, 1.5, 0, 0, 0, 1], "load": [0, 0, 0.7, 0, 0, 0, 1]}
    world = {
        "part": [{"name": "tug", "robot": tug}, {"name": "load", **what}],
        "constraint": [rod],
        "initial": {"q": places},
    }
    problem = Problem.create(world, 2.0, 20, start={"q": places}, goal={"v": {"tug": 0, "load": 0}})
    found = [cause.words for cause in causes_of(problem) if cause.kind == "momentum"]
    assert bool(found) is is_kept
    if is_kept:
        assert found[0].startswith("nothing turns load about x, about y and about z")
        assert "load/root_joint.wx, load/root_joint.wy and load/root_joint.wz out of goal.v" in found[0]


@pytest.mark.parametrize(("friction", "settles_in"), [("none", 0.02 / 5.0), ("smooth", 0.02 / 35.0)])
def test_the_joint_that_damping_stops_soonest(tmp_path, friction, settles_in):
    resists = '<dynamics damping="5" friction="3"/><limit lower="-2" upper="2" effort="9" velocity="4"/>'
    # 2 kg whose centre is 0.1 m off the axis, and no inertia about it but that.
    body = (
        '<link name="l1"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>'
        '<inertia ixx="0.01" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    hinge = joint("j1", "revolute", "base", "l1", axis="0 1 0", extra=resists)
    robot = load_robot(write(tmp_path, urdf(link("base"), body, hinge)), friction=friction)
    name, times = stiffest_joint(robot, 1.0)
    assert name == "j1"
    assert times == pytest.approx(1.0 / settles_in, rel=1e-4)  # friction 3 N m / 0.1 rad/s near rest
    ringing = Problem.create(robot, 2.0, 4, scheme="gauss2", goal={"q": [1.0], "v": 0})
    (cause,) = (one for one in causes_of(ringing) if one.kind == "damping")
    assert cause.where == "j1"
    assert "radau2" in cause.words
    assert not [one for one in causes_of(ringing.with_(scheme="radau2")) if one.kind == "damping"]
