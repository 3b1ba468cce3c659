"""A wrong problem file is an error that names the file, the key, what was got and what is allowed."""

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbocp.exceptions import (
    MbocpError,
    ProblemError,
    ProblemFileError,
    StudyFileError,
    UnknownJoint,
    UnknownRobot,
)
from mbocp.problem import Problem, load_problem, parse_problem
from mbocp.robot import Robot
from mbocp.study import Study

Loader = Callable[..., Problem]


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ProblemFileError, match=r"nothing\.toml: no such file"):
        load_problem(tmp_path / "nothing.toml")


def test_folder_instead_of_file(tmp_path: Path) -> None:
    with pytest.raises(ProblemFileError, match="is a folder"):
        load_problem(tmp_path)


def test_result_instead_of_problem_file(tmp_path: Path) -> None:
    path = tmp_path / "result.h5"
    path.write_bytes(b"\x89HDF\r\n\x1a\n\xff\xfe")
    with pytest.raises(ProblemFileError, match=r"is a result, .*Solution\.load\('.*'\)\.load_problem\(\)"):
        load_problem(path)


def test_binary_instead_of_text(tmp_path: Path) -> None:
    path = tmp_path / "result.bin"
    path.write_bytes(b"\x89HDF\r\n\x1a\n\xff\xfe")
    with pytest.raises(ProblemFileError, match="not a text file"):
        load_problem(path)


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("robot = \n[horizon]", r"line 1, column 9"),
        ('robot = "ur5"\n[horizon\nsteps = 3', r"line 2, column 9"),
        ("robot =", r"line 1, column 8"),
        ("a = 1\na = 2\n", r"line \d, column \d"),
    ],
)
def test_malformed_toml_names_line_and_column(tmp_path: Path, text: str, where: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ProblemFileError, match=rf"bad\.toml: malformed TOML: .*{where}"):
        load_problem(path)


@pytest.mark.parametrize(
    ("setting", "key", "reason"),
    [
        (
            "horizon.step=3",
            "horizon.step",
            r"unknown key, did you mean 'steps'\? \(allowed in \[horizon\]: duration, steps",
        ),
        ("duration=3", "duration", r"unknown key, did you mean horizon.duration or gait.duration\?"),
        ("cost.alpha=3", "cost.alpha", r"did you mean cost\.effort\?"),
        ("cost.enforce='exact'", "cost.enforce", r"did you mean goal\.enforce\?"),
        ("goal.tool='tool0'", "goal.tool", "unknown key, did you mean 'frame'"),
        ("limits.torque=true", "limits.torque", "unknown key, did you mean 'effort'"),
        ("start.positions=[0]", "start.positions", "unknown key, did you mean 'q'"),
        ("limits.q=[1]", "limits.q", "unknown key, did you mean 'position'"),
        ("robot.urdf='a.urdf'", "robot.urdf", "unknown key, did you mean 'name'"),
        ("integrator.method='rk4'", "integrator.method", "unknown key, did you mean 'scheme'"),
        ("obstacle=[{kind='box', clearance=0.01}]", "obstacle.0.kind", "unknown key, did you mean 'shape'"),
        ("limits.acceleration=true", "limits.acceleration", "got true, but URDFs have no such limits; give"),
        ("limits.effort_rate=[[1, 2, 3]]", "limits.effort_rate", "."),
        ("limits.power={elbow=1}", "limits.power", "has no control 'elbow'"),
        (
            "goal.frame={tool0={x=1}}",
            "goal.frame.0.tool0",
            "if it is a name, write name = 'tool0' among its keys",
        ),
        ("via={a={time=1}}", "via", r"got {'a': {'time': 1}}, expected tables, each \[\[via\]\]"),
        ("zzz=3", "zzz", r"unknown key \(allowed here: robot, "),
        ("horizon.steps=0", "horizon.steps", "got 0, expected a whole number of at least 1"),
        ("horizon.steps=-3", "horizon.steps", "got -3, expected a whole number"),
        ("horizon.steps=1.5", "horizon.steps", r"got 1\.5, expected a whole number"),
        ("horizon.steps=true", "horizon.steps", "got True, expected a whole number"),
        ("horizon.duration=0", "horizon.duration", r"got 0\.0, expected a positive number \[s\]"),
        ("horizon.duration=-1.0", "horizon.duration", r"got -1\.0, expected a positive number"),
        ("horizon.duration=nan", "horizon.duration", "got nan, expected a finite number"),
        ("horizon.duration=inf", "horizon.duration", "got inf, expected a finite number"),
        ("horizon.duration='long'", "horizon.duration", "got 'long', expected a number, or { min"),
        ("horizon=3", "horizon", "got 3, expected a table"),
        ("robot=3", "robot", "got 3, expected a name, a path or a table"),
        ("robot.gravity=[0,0]", "robot.gravity", r"got \[0, 0\], expected a list of 3"),
        ("robot.gravity=[0,0,nan]", "robot.gravity.2", "got nan, expected a finite number"),
        ("robot.lock=3", "robot.lock", "got 3, expected a list of joint names or a table"),
        ("robot.free_flyer=1", "robot.free_flyer", "got 1, expected true or false"),
        ("start.q=[0,0]", "start.q", r"got shape \(2,\), expected \(6,\); joints: shoulder_pan_joint, "),
        ("start.q=3", "start.q", "got 3, expected a list of numbers or a table by joint name"),
        ("start.q=[0,0,0,nan,0,0]", "start.q", "got nan at index 3, expected a finite number"),
        ("start.q=[0,0,0,true,0,0]", "start.q", "got True at index 3, expected a number"),
        ("start.q={elbow_joint='up'}", "start.q", "got 'up' for 'elbow_joint', expected a number"),
        ("start.q={elbow_joint=[1,2]}", "start.q.elbow_joint", r"got shape \(2,\), expected \(1,\)"),
        ("start.v=[0]", "start.v", r"got shape \(1,\), expected \(6,\)"),
        ("start.v=[0,0,0,0,0,inf]", "start.v", "got inf at index 5"),
        ("goal.q=[0,0,0,0,0,0,0]", "goal.q", r"got shape \(7,\), expected \(6,\)"),
        ("goal.v=[0,0]", "goal.v", r"got shape \(2,\), expected \(6,\)"),
        ("goal={v=0,p=[0,0,0,0,0,0]}", "goal", "give v or p, not both"),
        (
            "goal.enforce='exakt'",
            "goal.enforce",
            r"""got 'exakt', expected "exact" \| .* \(did you mean 'exact'\?\)""",
        ),
        ("goal.enforce=true", "goal.enforce", r'got True, expected "exact" \| "penalty"'),
        ("robot.friction=false", "robot.friction", r'got False, expected "none" \| "smooth"'),
        ("robot.friction=smoth", "robot.friction", r"\| \"smooth\" \(did you mean 'smooth'\?\)"),
        ("robot.friction_speed=0", "robot.friction_speed", "got 0, expected a number greater than 0"),
        ("robot.rotations=euler", "robot.rotations", r'got \'euler\', expected "quaternion" \| "dcm"'),
        (
            "phase=[{name='carry', steps=3, duration=1, payload=[{mass=1}]}]",
            "phase.0.payload",
            r"a \[\[robot\.part\]\] with its mass, which \[\[phase\.hold\]\] joins to the tool",
        ),
        (
            "phase=[{name='a', steps=3, duration=1, path=[{kind='position', frame='tool0', z=[1, 0]}]}]",
            "phase.0.path.0",
            r"got \[1\.0, 0\.0\], expected a finite bound",
        ),
        (
            "phase=[{name='a', steps=3, duration=1, via=[{q=[0, 0]}]}]",
            "phase.0.via.0.q",
            r"got shape \(2,\), expected \(6,\)",
        ),
        (
            "path=[{kind='speed', frame='tool0', max=-1}]",
            "path.0",
            r"'speed of tool0': max: got -1\.0, expected a speed, which is not below 0",
        ),
        (
            "parameter=[{of='robot.joint.elbow.length', min=0, max=1}]",
            "parameter.0.of",
            r"got 'joint\.elbow\.length', expected payload\.NAME\.mass",
        ),
        ("goal.vel=0", "goal.vel", "unknown key, did you mean 'v'"),
        ("limits.acc=3", "limits.acc", "unknown key, did you mean 'acceleration'"),
        ("goal={}", "", ""),
        (
            "cost.effort=0",
            "cost.effort",
            r"got 0\.0, expected a positive number: nothing else .* depends on the controls",
        ),
        ("cost.effort=-1", "cost.effort", r"got -1\.0"),
        ("cost.tracking=-1", "cost.tracking", r"got -1\.0, expected a weight >= 0"),
        ("cost.terminal=-1", "cost.terminal", r"got -1\.0, expected a weight >= 0"),
        (
            "cost.terminal=1",
            "cost.terminal",
            """which goal.enforce = "exact" does not use; say enforce = "both", or""",
        ),
        ("goal.enforce='penalty'", "cost.terminal", """goal.enforce = "penalty" needs a weight above 0"""),
        (
            "cost.tracking_weights=[1,2]",
            "cost.tracking_weights",
            r"got shape \(2,\), expected \(12,\); on \(q, p\)",
        ),
        (
            "cost.tracking_weights=[1,2,3,4,5,6,7,8,9,10,11,-12]",
            r"cost.tracking_weights[11]",
            r"got -12\.0, expected a weight",
        ),
        (
            "guess.kind='magic'",
            "guess.kind",
            r"""got 'magic', expected "auto" \| "control" \| "line" \| .* \| "solution\"""",
        ),
        ("guess.u=[1]", "guess.u", r"got shape \(1,\), expected \(6,\); actuators: shoulder_pan_joint, "),
        ("guess.u={motor=1}", "guess.u", "robot 'ur5' has no actuator 'motor'"),
        ("guess.u=nan", "guess.u", "got nan, expected a finite number"),
        ("guess.file='gone.h5'", "guess.file", "no such file"),
        ("guess.kind='control'", "guess", "needs the key 'u'"),
        ("guess.kind='solution'", "guess", "needs the key 'file'"),
        ("coordinates='polar'", "coordinates", """got 'polar', expected "joint" | "natural\""""),
        (
            "integrator.scheme='rk3'",
            "integrator.scheme",
            r"""got 'rk3', expected "se1" \| "se2" \| "midpoint\"""",
        ),
        ("solver.method='magic'", "solver.method", """got 'magic', expected "auto\""""),
        (
            "solver.globalisation='some'",
            "solver.globalisation",
            r"""got 'some', expected "default" \| "none\"""",
        ),
        ("solver.tolerance=0", "solver.tolerance", r"got 0\.0, expected a positive number"),
        ("solver.starts=1.5", "solver.starts", "got 1.5, expected a whole number, or string"),
        ("self_collision={margin='far'}", "self_collision.margin", "got 'far', expected a number"),
        ("self_collision='far'", "self_collision", "got 'far', expected true, false or a table"),
        ("obstacle=[{shape='mesh', scale='x'}]", "obstacle.0.scale", "got 'x', expected a number > 0, or 3"),
        ("gait.swings=3", "gait.swings", "got 3, expected a string, or list of lists"),
        (
            "robot.motor=[{joint='elbow_joint', effort=-1}]",
            "robot.motor.0.effort",
            "got -1, expected a number greater than 0",
        ),
        ("solver.max_iterations=0", "solver.max_iterations", "got 0, expected a whole number of at least 1"),
    ],
)
def test_wrong_value_names_file_key_got_and_allowed(
    load: Loader, setting: str, key: str, reason: str
) -> None:
    if setting == "goal={}":
        with pytest.warns(UserWarning, match="asks for nothing"):
            load(setting)
        return
    weight = ("cost.tracking=1",) if key.startswith("cost.tracking_weights") else ()
    with pytest.raises(ProblemFileError, match=reason) as caught:
        load(setting, *weight)
    assert caught.value.key == key
    assert re.match(rf".*arm\.toml: {re.escape(key)}: ", str(caught.value))


HUGE = "1" + 400 * "0"


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        (f"horizon.duration={HUGE}", "an integer of about 401 digits, expected an integer of 64 bits"),
        (f"horizon.steps={HUGE}", "an integer of about 401 digits"),
        ("horizon.steps=1" + 5000 * "0", "an integer that does not fit into 64 bits"),
        ("horizon.steps=5000000000", "would take about .* GB of memory"),
        ("solver.max_iterations=5000000000", "at most 2147483647"),
        ("horizon.duration=1e13", r"of at most 1e\+12"),
        ("horizon.duration=1e-320", "of at least 1e-12"),
        ("horizon.duration=1e300", r"expected a number of at most 1e\+100"),
        ("start.q=[1e200,0,0,0,0,0]", r"at index 0, expected a number of at most 1e\+100"),
        ("start.q=" + 5000 * "[" + 5000 * "]", "nested more than 64 deep"),
        ("start.q=[2e9,0,0,0,0,0]", r"got 2000000000\.0, expected at most 1e\+09 rad either way"),
        (
            "goal.q=[0,0,-1e99,0,0,0]",
            r"goal\.q: elbow_joint: got -1e\+99, expected at most 1e\+09 rad either",
        ),
        ("start.v=[0,0,0,0,0,1e16]", r"start\.v: wrist_3_joint: got 1e\+16, expected at most 1e\+15 rad/s"),
        (
            "goal={p=[0,2e15,0,0,0,0]}",
            r"goal\.p: shoulder_lift_joint: got 2.*, expected at most 1e\+15 N m s",
        ),
        (".".join(5000 * ["a"]) + "=1", "is not a key"),
        ("guess.file='" + 5000 * "x" + "'", "no such file"),
        ("cost.target_file='" + 300 * "x" + ".csv'", "no such file"),
        ("limits.velocity='" + 100_000 * "x" + "'", r"x\.\.\.x"),
    ],
    ids=lambda text: text[:24],
)
def test_what_no_float_or_file_can_be_is_one_short_line(load: Loader, setting: str, words: str) -> None:
    with pytest.raises(MbocpError, match=words) as caught:
        load(setting)
    assert len(str(caught.value)) < 1000
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("digits", [400, 5000])
def test_integers_beyond_all_floats_in_python(ur5: Robot, digits: int) -> None:
    value = 10**digits
    for words in (
        {"duration": value, "steps": 10},
        {"duration": 1.0, "steps": value},
        {"duration": 1.0, "steps": 10, "goal": {"q": [value, 0, 0, 0, 0, 0]}},
        {"duration": 1.0, "steps": 10, "limits": {"effort": float("nan")}, "cost": {"effort": value}},
    ):
        with pytest.raises(MbocpError, match=r"an integer of about|GB of memory"):
            Problem.create(ur5, **words)


def test_a_robot_is_no_problem_but_there_is_a_smallest_one_for_it(tmp_path: Path) -> None:
    links = "".join(
        f'<link name="{name}"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for name in "abc"
    )
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="0.25" effort="10" velocity="1"/></joint>'
        for name, parent, child in (("hip", "a", "b"), ("left knee", "b", "c"))
    )
    path = tmp_path / "leg.urdf"
    path.write_text(f'<robot name="leg">{links}{joints}</robot>')
    with pytest.raises(ProblemFileError, match=r"leg\.urdf: is a robot, expected a problem file") as caught:
        load_problem(path)
    (tmp_path / "leg.toml").write_text("\n".join(str(caught.value).splitlines()[1:]))
    problem = load_problem(tmp_path / "leg.toml")
    np.testing.assert_array_equal(problem.goal.q, [0.25, 0.25])  # within the limits
    assert problem.goal.rate_active.all()
    path.write_text("<robot")
    with pytest.raises(ProblemFileError, match="is a robot, expected a problem file"):
        load_problem(path)


def test_a_study_and_a_problem_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text('problem = "reach.toml"\ngrid = { "horizon.steps" = [10, 20] }')
    with pytest.raises(ProblemFileError, match="is a study, expected a problem file: `mbocp study"):
        load_problem(tmp_path / "study.toml")
    (tmp_path / "reach.toml").write_text('robot = "double_pendulum"\nhorizon = { duration = 1, steps = 9 }')
    with pytest.raises(StudyFileError, match=r"expected a study that says problem = 'reach\.toml'"):
        Study.load(tmp_path / "reach.toml")
    with pytest.raises(ProblemFileError, match=r"robot\.toml: is a robot, expected a problem file"):
        load_problem(Path(__file__).parents[3] / "robots" / "four_bar" / "robot.toml")


def test_a_pipe_and_a_device_are_no_problem_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ProblemFileError, match=r"is a pipe, expected a problem file \(TOML\)"):
        load_problem(tmp_path / "pipe")
    with pytest.raises(ProblemFileError, match="is a device, expected a problem file"):
        load_problem("/dev/zero")
    with pytest.raises(ProblemFileError, match="cannot be read"):
        load_problem("x" * 5000)


def test_all_mistakes_of_the_file_are_told_at_once(load: Loader) -> None:
    with pytest.raises(ProblemFileError) as caught:
        load("horizon.step=3", "cost.effort='much'", "start.q=3")
    lines = str(caught.value).splitlines()
    assert len(lines) == 3
    assert all("arm.toml: " in line for line in lines)


@pytest.mark.parametrize("key", ["robot", "horizon"])
def test_missing_table(tmp_path: Path, key: str) -> None:
    text = "[horizon]\nduration = 1\nsteps = 2\n" if key == "robot" else 'robot = "ur5"\n'
    with pytest.raises(ProblemFileError, match=f"{key}: this key is missing"):
        parse_problem(text)


def test_unknown_robot_names_file_key_and_suggests(load: Loader) -> None:
    with pytest.raises(UnknownRobot, match=r"arm\.toml: robot: unknown robot 'ur55'.*did you mean 'ur5'"):
        load("robot='ur55'")


def test_unknown_joint_names_file_key_and_suggests(load: Loader) -> None:
    with pytest.raises(
        UnknownJoint, match=r"arm\.toml: start\.q: robot 'ur5' has no joint 'elbow'.*'elbow_joint'"
    ):
        load("start.q={elbow=1.0}")


def test_unknown_joint_to_lock(load: Loader) -> None:
    with pytest.raises(UnknownJoint, match=r"arm\.toml: robot: robot 'ur5' has no joint 'elbow'"):
        load("robot.lock=['elbow']")


def test_empty_goal_cannot_be_enforced(load: Loader) -> None:
    with pytest.raises(ProblemFileError, match='goal: enforce = "exact" needs something to enforce'):
        load("goal={enforce='exact'}")


@pytest.mark.parametrize("setting", ["robot={}", "robot=''", "robot.name=[]", "start=[]", "goal.q=[]"])
def test_every_error_is_one_of_ours(load: Loader, setting: str) -> None:
    with pytest.raises(MbocpError, match=r"arm\.toml"):
        load(setting)


@pytest.mark.parametrize("setting", ["start.q={}", "goal.q={}", "cost.target={}", "guess={}", "solver={}"])
def test_empty_tables_say_nothing(load: Loader, setting: str) -> None:
    load(setting)


def test_direct_construction_is_validated_too(load: Loader) -> None:
    problem = load()
    for change in ({"num_steps": 0}, {"duration": -1.0}, {"q_start": [0.0]}, {"coordinates": "polar"}):
        with pytest.raises(MbocpError):
            problem.with_(**change)
    with pytest.raises(ProblemError):
        problem.with_(goal=problem.goal.__class__(**{**vars(problem.goal), "enforce": "penalty"}))
