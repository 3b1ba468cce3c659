"""Torques of a motion as it is sent."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.cli.results import export_result
from mbocp.exceptions import LimitsExceeded
from mbocp.solution.export_formats import sent_within
from mbocp.solution.sent import motion_as_sent
from mbocp.solution.sent_checks import controls_along, joint_excesses
from mbocp.solution.sent_states import Follower

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize("name", ["ur5_reach", "panda_reach", "kinova_reach"])
def test_torques_are_those_of_the_solution_as_steps_get_short(name: str) -> None:
    problem = mbocp.load_problem(EXAMPLES / "arms" / f"{name}.toml")
    apart = []
    for steps in (50, 150):
        s = mbocp.solve(problem.with_(steps=steps, controls="linear", scheme="gauss2"))
        follower = Follower.of(motion_as_sent(s), problem.robot)
        assert follower.has_controls
        times, _, _, controls = controls_along(follower)
        apart.append(np.abs(controls - s.controls_at(times)).max() / np.abs(s.us).max())
    assert apart[0] < 0.1
    assert apart[1] < 0.4 * apart[0]


def test_what_takes_too_much_is_told() -> None:
    s = mbocp.solve(EXAMPLES / "arms" / "ur5_fastest.toml")
    robot, sent = s.load_robot(), motion_as_sent(s)
    assert not joint_excesses(Follower.of(sent, robot))
    fast = dataclasses.replace(sent, curves=sent.curves.slow(0.8))
    worst, *_ = joint_excesses(Follower.of(fast, robot))
    assert worst.kind == "effort"
    assert worst.ratio > 0.1
    assert abs(worst.value) > abs(worst.bound)
    assert worst.words.startswith("effort ")


def test_an_export_that_takes_too_much_is_told(tmp_path: Path) -> None:
    """Quintics swing over the torques of a motion that is at a limit."""
    limits = {"effort": {"shoulder_lift_joint": 45.0}}
    problem = mbocp.load_problem(EXAMPLES / "arms" / "ur5_reach.toml").with_(limits=limits, duration=1.5)
    result = mbocp.solve(problem, check=True).save(tmp_path / "a.h5")
    given = {"kind": None, "rate": 500.0, "fit": False, "check": True, "quiet": True}
    assert export_result(result, tmp_path / "a.csv", interpolation="cubic", **given)
    with pytest.warns(UserWarning, match=r"shoulder_lift_joint leaves its limits: effort -45\.\d+ N m at"):
        assert not export_result(result, tmp_path / "a.csv", interpolation="quintic", **given)
    saved, target = mbocp.Solution.load(result), tmp_path / "c.csv"
    for solution in (mbocp.solve(problem), saved):  # the library refuses what the command refuses
        with pytest.raises(LimitsExceeded, match=r"c.csv: not written, .*: effort -45\.\d+ N m at") as caught:
            solution.export(target, rate=500.0, interpolation="quintic", fit=False)
        assert not target.exists()
        assert caught.value.excesses[0].name == "shoulder_lift_joint"
        assert solution.export(target, rate=500.0).exists()
        target.unlink()
    assert saved.export(target, rate=500.0, interpolation="quintic", check=False).exists()
    given["fit"] = True  # in a little more time it takes less
    assert export_result(result, tmp_path / "a.csv", interpolation="quintic", **given)
    (sent, excesses) = sent_within("csv", saved, 500.0, "quintic", fit=True, load_robot=saved.load_robot)
    assert excesses == ()
    assert 1.0 < sent.slower < 1.1
    assert sent.curves.nodes[-1] * 500.0 == pytest.approx(round(sent.curves.nodes[-1] * 500.0))
    assert not joint_excesses(Follower.of(sent, saved.load_robot()))
    low = saved.problem.with_(limits={"effort": {"shoulder_lift_joint": 30.0}})
    heavy = dataclasses.replace(saved, limits_u=np.array(low.limits.fields["limits_u"]))
    with pytest.raises(LimitsExceeded, match="effort"):  # the weight alone takes more
        heavy.export(target, rate=500.0)
    gone = dataclasses.replace(
        saved, robot_spec={}, robot_files=None, problem_text=saved.problem_text.replace("ur5", "gone.urdf")
    )
    with pytest.warns(UserWarning, match=r"efforts and paths are not looked at .*gone.urdf: no such file"):
        assert export_result(
            gone.save(tmp_path / "b.h5"), tmp_path / "b.csv", interpolation="quintic", **given
        )


def test_loops_and_accelerations_as_controls_do_not_say_torques() -> None:
    four_bar = mbocp.load_problem(EXAMPLES / "loops" / "four_bar.toml")
    assert not Follower.of(motion_as_sent(mbocp.solve(four_bar)), four_bar.robot).has_controls
    kinematic = mbocp.load_robot("double_pendulum", dynamics=False)
    problem = mbocp.Problem.create(kinematic, goal={"q": [1.0, 0.5], "v": 0.0}, duration=1.0, steps=10)
    assert not Follower.of(motion_as_sent(mbocp.solve(problem)), kinematic).has_controls
