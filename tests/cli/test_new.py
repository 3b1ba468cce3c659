"""`mbocp new`: a problem file for any robot, and options of robots."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.cli.new import SCHEMA_FILE
from mbocp.problem.first_motion import find_holding_controls
from tests.mechanics.mimics import PAIR
from tests.robot.loading.test_sdf import COPTER
from tests.robot.urdfs import chain, joint, link, robot, write

pytestmark = pytest.mark.filterwarnings("ignore::mbocp.robot.warnings.NotModelledWarning")

BOUNDED = ("panda", "kinova", "z1", "asr_twodof", "xarm7")
FLOATING = ("hector", "borinot", "solo12")
CLOSED = ("delta", "five_bar", "four_bar", "parallelogram_arm", "rigid_pendulum", "slider_crank", "stewart")
OTHERS = ("chain_3", "cart_pendulum_rigid", "unicycle_pendulum")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", [*BOUNDED, *FLOATING, *CLOSED, *OTHERS])
def test_the_file_is_a_problem_from_rest_to_a_goal_elsewhere(run, here, name):
    done = run("new", name)
    assert done.exit_code == 0, done.stderr
    problem = mbocp.load_problem(here / f"{name}.toml")
    assert not problem.v_start.any()
    assert problem.goal.is_exact
    asked = problem.goal.q_active
    assert np.abs(problem.robot.difference(problem.q_start, problem.goal.q))[asked].max() > 0.02
    np.testing.assert_array_equal(problem.goal.value[problem.goal.rate_active], 0.0)
    assert problem.goal.rate_active[asked].all()


@pytest.mark.parametrize("name", BOUNDED)
def test_limits_of_arms_hold_with_something_to_spare(run, here, name):
    assert run("new", name).exit_code == 0
    problem = mbocp.load_problem(here / f"{name}.toml")
    for q in (problem.q_start, problem.goal.q):
        u = find_holding_controls(problem.robot, q)
        assert u is not None
        assert (np.abs(u) < problem.limits.u_upper).all()
    mean = np.abs(problem.robot.difference(problem.q_start, problem.goal.q)) / problem.duration
    assert (1.5 * mean < problem.limits.v_upper).all()


def test_a_multicopter_flies_a_little_way(run, here):
    (here / "copter.sdf").write_text(f'<sdf version="1.9"><model name="copter">{COPTER}</model></sdf>')
    done = run("new", "copter.sdf")
    assert done.exit_code == 0, done.stderr
    problem = mbocp.load_problem(here / "copter.toml")
    assert problem.goal.q_active.all()
    assert problem.goal.rate_active.all()
    np.testing.assert_allclose(problem.goal.q - problem.q_start, [0.2, 0, 0.2, 0, 0, 0, 0])
    solution = mbocp.solve(problem)
    assert solution.converged
    assert (solution.us > 0.0).all()


def test_a_motor_on_two_joints_is_asked_for_one_of_them(run, here):
    """The third is not driven; so not all can rest."""
    joints = ("a", "b", "c")
    text = robot(
        link("base", None),
        *(link(f"l{name}") for name in joints),
        *(
            joint(name, "revolute", parent, f"l{name}")
            for name, parent in zip(joints, ("base", "la", "lb"), strict=True)
        ),
    )
    tendon = '[[actuator]]\ntype = "tendon"\nname = "t"\njoints = ["a", "b"]\nratios = [1, -1]\n'
    write(here, text, f"[actuation]\njoints = []\n{tendon}")
    assert run("new", "robot.toml", "-o", "first.toml").exit_code == 0
    assert mbocp.load_problem(here / "first.toml").goal.q_active.tolist() == [True, False, False]


def test_what_floats_without_weight_has_no_goal_for_its_base(run, here):
    """Nothing has to carry it, and its motors cannot move it."""
    text = robot(link("a"), link("b"), joint("j", "revolute", "a", "b"))
    write(here, text, 'urdf = "robot.urdf"\nfree_flyer = true\ngravity = [0, 0, 0]\n')
    assert run("new", "robot.toml", "-o", "first.toml").exit_code == 0
    goal = mbocp.load_problem(here / "first.toml").goal
    assert not goal.q_active[:6].any()
    assert goal.q_active[6]


@pytest.mark.parametrize("name", ["rigid_pendulum", "four_bar", "hector"])
def test_it_solves_at_once(run, here, name):
    assert run("new", name).exit_code == 0
    solution = mbocp.solve(here / f"{name}.toml")
    assert solution.converged
    assert solution.iterations < 60


def test_stiff_damping_and_starts_at_limits_are_met(run, here):
    assert run("new", "tiago_no_hand").exit_code == 0
    assert "at limits of 'torso_lift_joint', 'arm_1_joint'" in (here / "tiago_no_hand.toml").read_text()
    problem = mbocp.load_problem(here / "tiago_no_hand.toml")
    limits = problem.robot.limits
    assert problem.scheme == "radau2"
    assert (problem.q_start > limits.position_lower).all()
    assert (problem.q_start < limits.position_upper).all()
    solution = mbocp.solve(problem)
    assert solution.converged
    assert solution.iterations < 10


def test_a_urdf_with_mimic_joints_beside_the_file(run, here):
    path = write(here, PAIR)
    assert re.search(r"^jb +mimic +no *$", run("robots", str(path)).stdout, re.MULTILINE)  # without a unit
    assert run("new", str(path)).exit_code == 0
    assert '[robot]\nname = "robot.urdf"' in (here / "robot.toml").read_text()
    assert "follows another joint" in (here / "robot.toml").read_text()
    assert mbocp.load_problem(here / "robot.toml").goal.is_exact


def test_motors_too_weak_for_their_own_weight_are_told(run, here):
    weak = '<limit lower="-1" upper="2" effort="0.5" velocity="4"/>'
    urdf = robot(
        link("base"), link("l1", 20.0), joint("j1", "revolute", "base", "l1", axis="0 1 0", extra=weak)
    )
    assert run("new", str(write(here, urdf)), "-o", "weak.toml").exit_code == 0
    text = (here / "weak.toml").read_text()
    assert "holding its own weight takes more than the 0.5 N m that its file gives j1" in text
    assert "effort = true" not in text


def test_robots_says_what_one_without_inertias_has(run, here):
    urdf = robot(link("base", None), link("l1", None), joint("j1", "revolute", "base", "l1"))
    done = run("robots", str(write(here, urdf)))
    assert done.exit_code == 0
    assert "note: test moves without dynamics" in done.stderr
    assert re.search(r"^j1 +revolute +yes", done.stdout, re.MULTILINE)


def test_a_single_body_floats(run, here):
    path = write(here, robot(link("body")))
    assert run("new", str(path)).exit_code == 0
    problem = mbocp.load_problem(here / "robot.toml")
    assert problem.robot.nu == 6
    assert problem.goal.rate_active.all()


def test_joints_are_locked_at_values_or_where_they_are(run, here):
    path = str(write(here, chain("revolute", "revolute", "revolute")))
    assert run("new", path, "--lock", "j2=0.3", "--fixed").exit_code == 0
    assert mbocp.load_problem(here / "robot.toml").robot.joint_names == ("j1", "j3")
    assert run("new", path, "--lock", "j2", "--force").exit_code == 0
    assert mbocp.load_problem(here / "robot.toml").robot.nv == 2
    for words, message in (
        (("--lock", "j2", "--lock", "j1=0"), "give each joint a value"),
        (("--lock", "j2=a"), "expected a number"),
        (("--lock", "j9"), "has no joint 'j9'"),
        ((), "is there already"),
    ):
        done = run("new", path, *words, *(["--force"] if words else []))
        assert done.exit_code == 2
        assert message in done.stderr
    assert '"nv": 8' in run("robots", path, "--lock", "j2", "--free-flyer", "--json").stdout


def test_solving_a_urdf_names_the_command(run, here):
    done = run("solve", str(write(here, chain("revolute"))))
    assert done.exit_code == 2
    assert "`mbocp new" in done.stderr


def test_rotors_without_a_floating_base_are_told(run, here):
    rotor = '<limit lower="-1e16" upper="1e16" effort="0" velocity="0"/>'
    links = ("body", "left", "right")
    joints = (joint(f"to_{name}", "revolute", "body", name, extra=rotor) for name in links[1:])
    (here / "flier.urdf").write_text(robot(*(link(name) for name in links), *joints))
    done = run("new", "flier.urdf")
    assert "mbocp new flier.urdf --free-flyer --lock to_left --lock to_right" in done.stderr
    again = run("new", "flier.urdf", *done.stderr.split("flier.urdf ")[1].split(), "--force")
    assert again.exit_code == 0, again.stderr
    assert "note" not in again.stderr
    assert mbocp.load_problem(here / "flier.toml").robot.nu == 6


def test_a_force_on_the_base_is_told(run, here):
    assert run("new", "hector").exit_code == 0
    text = (here / "hector.toml").read_text()
    assert "# pushes it sideways, too, as no quadrotor can: rotors are [[actuator]] of a robot.toml" in text
    said = " ".join(run("robots", "hector").stdout.split())
    assert 'nothing drives them: robot.actuated = ["root_joint"]' in said


def test_fingers_that_mimic_in_the_file_are_told(run, here):
    told = run("new", "panda").stderr.splitlines()
    assert [line for line in told if line.startswith("note: ")] == told
    assert len(told) == 1
    assert told[0].endswith("robot.mimic = true couples them")
    assert "note" not in run("new", "panda", "--lock", "panda_finger_joint2", "-o", "held.toml").stderr


def test_an_arm_has_no_rotors(run, here):
    assert "note" not in run("new", "ur5").stderr


def test_editors_find_the_schema_that_is_beside_the_file(run, here):
    assert run("new", "ur5", "-o", "before.toml").exit_code == 0
    assert "#:schema" not in (here / "before.toml").read_text()
    assert run("schema", "-o", SCHEMA_FILE).exit_code == 0
    assert run("new", "ur5", "-o", "after.toml").exit_code == 0
    assert (here / "after.toml").read_text() == f"#:schema ./{SCHEMA_FILE}\n" + (
        here / "before.toml"
    ).read_text().replace("before", "after")


def test_the_joints_of_a_loop_are_no_rotors(run, here):
    (here / "bars.sdf").write_text(
        '<sdf version="1.9"><model name="bars">'
        + '<joint name="fix" type="fixed"><parent>world</parent><child>ground</child></joint>'
        + "".join(
            f'<link name="{name}"><pose>{place} 0 0 0 0 0</pose></link>'
            for name, place in (("ground", 0), ("crank", 0), ("coupler", 0.3), ("rocker", 1.0))
        )
        + "".join(
            f'<joint name="{child}_{parent}" type="revolute">'
            f'<pose relative_to="{child}">{at} 0 0 0 0 0</pose>'
            f"<parent>{parent}</parent><child>{child}</child><axis><xyz>0 1 0</xyz></axis></joint>"
            for parent, child, at in (
                *(("ground", "crank", 0), ("crank", "coupler", 0)),
                *(("ground", "rocker", 0), ("rocker", "coupler", 0.5)),
            )
        )
        + "</model></sdf>"
    )
    done = run("new", "bars.sdf")
    assert done.exit_code == 0, done.stderr
    assert "turn without end" not in done.stderr
