"""`mbocp check`, and what is odd in URDFs."""

from __future__ import annotations

from xml.etree import ElementTree

from mbocp.robot.loading.readers.urdf_oddities import find_oddities
from tests.cli.conftest import ARM
from tests.robot.urdfs import chain, joint, link, robot
from tests.view.pages import read_page


def told(tmp_path, urdf: str) -> str:
    return "\n".join(find_oddities(tmp_path / "robot.urdf", ElementTree.fromstring(urdf)))


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


def test_odd_inertias_are_told(tmp_path):
    assert told(tmp_path, arm(inertial(1, 0.02, 0.03, 0.04))) == ""
    assert "violate the triangle inequality" in told(tmp_path, arm(inertial(1, 0.5, 0.03, 0.03)))
    assert "1 kg without inertia" in told(tmp_path, arm(inertial(1, 0, 0, 0)))
    assert "inertia without mass" in told(tmp_path, arm(inertial(0, 0.02, 0.03, 0.04)))
    assert "are the units right" in told(tmp_path, arm(inertial(0.1, 20, 30, 40)))


def test_joints_of_which_the_same_is_odd_share_a_line(tmp_path):
    urdf = robot(
        *(link(f"l{i}") for i in range(7)),
        *(
            joint(
                f"j{i}",
                "revolute",
                f"l{i}",
                f"l{i + 1}",
                extra='<limit lower="-1" upper="1" effort="0" velocity="2"/>',
            )
            for i in range(6)
        ),
    )
    (line,) = told(tmp_path, urdf).splitlines()
    assert line.startswith("joints 'j0', 'j1', 'j2', 'j3' and 2 more: zero effort in <limit>")


def test_odd_limits_are_told(tmp_path):
    body = inertial(1, 0.02, 0.03, 0.04)
    for limit, words in (
        ('<limit lower="0.5" upper="1" effort="3" velocity="4"/>', "exclude zero"),
        ('<limit lower="1" upper="0" effort="3" velocity="4"/>', "it cannot move"),
        ('<limit lower="-1" upper="1" effort="0" velocity="4"/>', "zero effort"),
        ('<limit lower="-1" upper="1" velocity="4"/>', "no effort"),
    ):
        assert words in told(tmp_path, arm(body, limit))


def test_mimic_joints_and_those_of_the_examples_say_nothing(tmp_path):
    assert told(tmp_path, chain("revolute", "prismatic")) == ""
