"""`mbocp check`, and what is odd in URDFs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from mbocp.robot import load_parts, load_robot
from mbocp.robot.loading.readers.urdf_checks import find_oddities
from mbocp.robot.robot_facts import find_oddities as oddities_of
from tests.cli.conftest import ARM
from tests.robot.urdfs import chain, joint, link, robot
from tests.view.pages import read_page

EXAMPLES = Path(__file__).parents[2] / "examples"
BALLS = {f"l{i}": {"mass": 1.0, "com": [0, 0, 0], "inertia": [0.01, 0.01, 0.01]} for i in range(1, 7)}


def told(tmp_path, urdf: str) -> str:
    return "\n".join(odd.words for odd in find_oddities(tmp_path / "r.urdf", ElementTree.fromstring(urdf)))


def inertial(mass: float, xx: float, yy: float, zz: float) -> str:
    return (
        f'<link name="l1"><inertial><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/></inertial></link>'
    )


def arm(body: str, limit: str = '<limit lower="-1" upper="1" effort="3" velocity="4"/>') -> str:
    return robot(link("base"), body, joint("j1", "revolute", "base", "l1", extra=limit))


def test_it_says_what_would_be_solved_and_draws_it(run, tmp_path):
    (tmp_path / "arm.toml").write_text(ARM)
    page = tmp_path / "page.html"
    done = run("check", str(tmp_path / "arm.toml"), "-o", str(page), "--set", "limits.velocity=0.1")
    assert done.exit_code == 0, done.stderr
    for words in (
        "6 degrees of freedom",
        "1 s in 10 steps",
        "at rest (exact)",
        "velocity of 6",
        "impossible",
    ):
        assert words in done.stdout
    drawn = read_page(page).objects()
    assert any("/ghost_0/" in path for path in drawn)


def test_impacts_are_no_steps(run: Any) -> None:
    """As in what a solve says."""
    done = run("check", str(EXAMPLES / "arms" / "throw_into_bucket.toml"))
    assert "1.8 s in 45 steps and 1 impact by" in done.stdout


def checked(run: Any, file: Any, *words: str) -> dict[str, Any]:
    done = run("check", str(file), "--json", *words)
    found: dict[str, Any] = json.loads(done.stdout)
    assert done.exit_code == found["exit_status"] == run("check", str(file), *words).exit_code
    assert (found["status"], bool(found["errors"])) in (("ok", False), ("error", True))
    return found


def test_it_says_which_numbers_of_the_robot_are_found(run):
    found = run("check", str(EXAMPLES / "design" / "gear_ratio.toml"))
    assert re.search(r"to find .*robot\.motor\..*gear_ratio between \d+ and \d+", found.stdout)


def test_each_mistake_has_a_place(run, tmp_path):
    file = tmp_path / "arm.toml"
    file.write_text(ARM.replace("steps", "stepps").replace("v = [", "v = [true, "))
    unknown, wrong = checked(run, file)["errors"]
    assert unknown == {
        "code": "ProblemFileError",
        "key": "horizon.stepps",
        "file": str(file),
        "line": 5,
        "column": 1,
        "message": "unknown key, " + unknown["advice"],
        "advice": unknown["advice"],
    }
    assert unknown["advice"].startswith("did you mean 'steps'?")
    assert (wrong["key"], wrong["line"], wrong["column"]) == ("goal.v", 8, 1)
    assert wrong["advice"] == "expected a number"


@pytest.mark.parametrize(
    ("old", "new", "code", "place"),
    [
        ("[goal]", "[goal", "ProblemFileError", (6, 6)),
        ("v = [0,", "v = [", "ProblemFileError", (8, 1)),
        ('"ur5"', '"ur55"', "UnknownRobot", (2, 1)),
        ("q = [0.5", "q = { elbow = 1 }\n#", "UnknownJoint", (7, 1)),
    ],
)
def test_errors_of_each_kind_have_a_place(run, tmp_path, old, new, code, place):
    file = tmp_path / "arm.toml"
    file.write_text(ARM.replace(old, new))
    (error,) = checked(run, file)["errors"]
    assert (error["code"], error["line"], error["column"]) == (code, *place)
    assert str(file) not in error["message"]


def test_what_the_file_does_not_have_has_no_place(run, tmp_path):
    file = tmp_path / "arm.toml"
    file.write_text(ARM)
    (error,) = checked(run, file, "--set", "horizon.steps=0.5")["errors"]
    assert (error["key"], error["line"], error["column"]) == ("horizon.steps", None, None)
    (error,) = checked(run, tmp_path / "none.toml")["errors"]
    assert (error["key"], error["line"], error["message"]) == (None, None, "no such file")


def test_a_mistake_in_the_robot_s_own_file_is_placed_there(run, tmp_path):
    (tmp_path / "robot.toml").write_text('urdf = "arm.urdf"\n\ndampping = 3\n')
    (tmp_path / "arm.urdf").write_text(chain("revolute"))
    file = tmp_path / "arm.toml"
    file.write_text(ARM.replace("ur5", "robot.toml"))
    (error,) = checked(run, file)["errors"]
    assert (error["file"], error["line"]) == (str(tmp_path / "robot.toml"), 3)


def test_warnings_have_places_too(run, tmp_path):
    file = tmp_path / "arm.toml"
    file.write_text(ARM.replace("q = [0.5,", "q = [50.0,"))
    found = checked(run, file)
    codes = {warning["code"]: warning for warning in found["warnings"]}
    assert codes["ProblemWarning"]["key"] == "goal.q"
    assert codes["ProblemWarning"]["line"] == 7
    file.write_text(ARM)
    causes = checked(run, file, "--set", "limits.velocity=0.1")["warnings"]
    assert ("impossible", None) in [(cause["code"], cause["key"]) for cause in causes]


def test_odd_inertias_are_told(tmp_path):
    assert told(tmp_path, arm(inertial(1, 0.02, 0.03, 0.04))) == ""
    assert "violate the triangle inequality" in told(tmp_path, arm(inertial(1, 0.5, 0.03, 0.03)))
    assert "1 kg without inertia" in told(tmp_path, arm(inertial(1, 0, 0, 0)))
    assert "inertia without mass" in told(tmp_path, arm(inertial(0, 0.02, 0.03, 0.04)))
    assert "are the units right" in told(tmp_path, arm(inertial(0.1, 20, 30, 40)))


def test_joints_of_which_the_same_is_odd_share_a_line_but_for_locked_ones(tmp_path):
    zero = '<limit lower="-1" upper="1" effort="0" velocity="2"/>'
    joints = (joint(f"j{i}", "revolute", f"l{i}", f"l{i + 1}", extra=zero) for i in range(6))
    path = tmp_path / "chain.urdf"
    path.write_text(robot(*(link(f"l{i}") for i in range(7)), *joints))
    (line,) = oddities_of(load_robot(path, inertias={"links": BALLS}))
    assert line.startswith("joints 'j0', 'j1', 'j2', 'j3' and 2 more: zero effort in <limit>")
    held = {"lock": [f"j{i}" for i in range(5)], "inertias": {"links": BALLS}}
    assert len(lines := oddities_of(load_robot(path, **held))) == 1
    assert lines[0].startswith("joint 'j5': zero effort")
    parts = [{"name": "held", "robot": str(path), **held}]
    assert oddities_of(load_parts(parts)) == lines
    parts.append({"name": "free", "robot": str(path), "inertias": held["inertias"]})
    assert oddities_of(load_parts(parts)) == (line,)
    assert not oddities_of(load_robot(path, inertias={"links": BALLS}, actuated=[]))


def test_odd_limits_are_told(tmp_path):
    body = inertial(1, 0.02, 0.03, 0.04)
    for limit, words in (
        ('<limit lower="0.5" upper="1" effort="3" velocity="4"/>', "exclude zero"),
        ('<limit lower="1" upper="0" effort="3" velocity="4"/>', "each is taken for the other"),
        ('<limit lower="1" upper="1" effort="3" velocity="4"/>', "limits.position = true does not bound it"),
        ('<limit lower="-1" upper="1" effort="0" velocity="4"/>', "; without a motor, leave it out of"),
        ('<limit lower="-1" upper="1" velocity="4"/>', "no effort"),
    ):
        assert words in told(tmp_path, arm(body, limit))


def test_what_is_told_of_limits_is_what_is_read(tmp_path):
    def limits_of(limit):
        path = tmp_path / "arm.urdf"
        path.write_text(arm(inertial(1, 0.02, 0.03, 0.04), limit))
        return load_robot(path).limits

    turned = limits_of('<limit lower="1" upper="0" effort="0" velocity="4"/>')
    assert (turned.position_lower.item(), turned.position_upper.item()) == (0.0, 1.0)
    assert np.isinf(turned.effort).all()
    assert np.isinf(limits_of('<limit lower="1" upper="1" effort="3" velocity="4"/>').position_upper).all()


def test_limits_without_zero_are_told_where_the_start_is_not_within_them():
    panda = load_robot("panda")
    q = panda.q0.copy()
    elbow = panda.configuration_indices("panda_joint4")
    q[elbow] = -1.5
    assert not any("exclude zero" in words for words in oddities_of(panda, q))
    q[elbow] = 0.0
    assert any("exclude zero" in words for words in oddities_of(panda, q))
    assert any("exclude zero" in words for words in oddities_of(panda))


def test_mimic_joints_and_those_of_the_examples_say_nothing(tmp_path):
    assert told(tmp_path, chain("revolute", "prismatic")) == ""


def test_joints_that_mimic_others_in_the_file_alone_are_told():
    (line,) = (words for words in oddities_of(load_robot("panda")) if "mimics" in words)
    assert line.startswith("joint 'panda_finger_joint2': mimics 'panda_finger_joint1' in the file")
    for other in (load_robot("panda", mimic=True), load_robot("panda", lock=["panda_finger_joint2"])):
        assert not any("mimics" in words for words in oddities_of(other))
