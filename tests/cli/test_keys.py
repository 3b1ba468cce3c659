"""`mbocp keys`."""

from __future__ import annotations

import json
from typing import Any

import pytest

from mbocp.problem.file.keys_page import all_keys, rows
from mbocp.robot.loading.robot_toml import TABLES

from .conftest import Run


def facts(run: Run, *words: str) -> dict[str, dict[str, Any]]:
    done = run("keys", *words, "--json")
    assert done.exit_code == 0, done.stderr
    return {entry["key"]: entry for entry in json.loads(done.stdout)}


def test_all_keys_are_there(run: Run) -> None:
    assert set(facts(run)) == set(rows()) <= {name for name, _ in all_keys()}
    shown = run("keys").stdout
    assert "limits.jerk" in shown
    assert "phase.limits.jerk" not in shown  # which the same declaration describes
    assert "](" not in shown


def test_one_key_and_those_in_it(run: Run) -> None:
    assert facts(run, "horizon.steps")["horizon.steps"]["takes"] == "whole number > 0"
    assert facts(run, "limits.jerk")["limits.jerk"]["unit"] == "m/s^3, rad/s^3"
    inner = facts(run, "phase.limits")
    assert all(f"{key}.".startswith("phase.limits.") for key in inner)
    assert len(inner) > 5
    assert "phase.limits.jerk" in run("keys", "phase.limits").stdout


def test_keys_beside_each_other_share_a_line(run: Run) -> None:
    (line,) = [line for line in run("keys", "goal.frame").stdout.splitlines() if "position, x" in line]
    assert line.startswith("goal.frame.position, x, y, z")


@pytest.mark.parametrize("name", ["path.0.kind", "path[0].kind"])
def test_names_of_messages_are_found(run: Run, name: str) -> None:
    assert set(facts(run, name)) == {"path.kind"}


def test_the_end_of_a_name_is_enough(run: Run) -> None:
    assert run("keys", "jerk").stdout.startswith("limits.jerk")
    assert {"limits.jerk", "phase.limits.jerk"} <= set(facts(run, "jerk"))


@pytest.mark.parametrize(
    ("word", "found"),
    [
        ("torque", {"limits.effort", "cost.effort", "path.stall"}),  # another word for it, and in meanings
        ("speed", {"robot.motor.speed", "limits.velocity", "path.min"}),
        ("tcp", {"goal.frame", "path.frame"}),
        ("Rotor", {"robot.motor.inertia"}),
    ],
)
def test_words_are_found(run: Run, word: str, found: set[str]) -> None:
    assert found <= set(facts(run, word))
    assert len(facts(run, word)) < len(rows()) / 10


def test_keys_of_what_a_robot_carries_are_told(run: Run) -> None:
    assert facts(run, "robot.payload")["robot.payload.mass"]["unit"] == "kg"
    assert {"robot.payload.com", "robot.part.payload.com"} <= set(facts(run, "payload"))
    assert "robot.payload.com" in facts(run, "centre of mass")


def test_keys_of_robot_toml_are_found_where_no_problem_has_them(run: Run) -> None:
    found = facts(run, "actuator")
    assert all(name.startswith("[[actuator]]") for name in found)
    assert len(found) == len(TABLES["actuator"])
    (thruster,) = facts(run, "thruster").values()
    assert "reaction torque about it; keys: frame, name, axis" in thruster["says"]
    assert thruster["says"].endswith("of robot.toml: docs/robot_toml.md")
    assert set(facts(run, "robot.spherical")) == {"spherical"}


@pytest.mark.parametrize(
    ("name", "meant"),
    [("velocty", "limits.velocity"), ("Velocty", "limits.velocity"), ("thrustr", "thruster")],
)
def test_last_parts_may_be_misspelt(run: Run, name: str, meant: str) -> None:
    assert run("keys", name).stderr.endswith(f"did you mean '{meant}'?\n")


@pytest.mark.parametrize("word", ["marmalade", "hover"])
def test_a_word_that_no_key_has_names_no_others(run: Run, word: str) -> None:
    done = run("keys", word)
    assert done.exit_code == 2
    assert done.stderr.endswith("`mbocp keys` lists them, docs/wishes.md has examples\n")


def test_a_name_that_is_none_is_refused(run: Run) -> None:
    done = run("keys", "horizon.stepps")
    assert done.exit_code == 2
    assert (
        "NAME: got 'horizon.stepps', expected a key of problem files; did you mean 'horizon.steps"
        in done.stderr
    )
