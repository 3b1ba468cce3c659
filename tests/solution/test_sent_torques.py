"""Torques of a motion as it is sent."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import typer

import mbocp
from mbocp.cli.results import export
from mbocp.exceptions import LimitsExceeded
from mbocp.solution.export_formats import prepare_within
from mbocp.solution.sampled import sample
from mbocp.solution.sent import compute_motion_sent
from mbocp.solution.sent_checks import controls_along, joint_excesses
from mbocp.solution.sent_states import Follower

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize("name", ["ur5_reach", "panda_reach", "kinova_reach"])
def test_torques_are_those_of_the_solution_as_steps_get_short(name: str) -> None:
    problem = mbocp.load_problem(EXAMPLES / "arms" / f"{name}.toml")
    apart = []
    for steps in (50, 150):
        s = mbocp.solve(problem.with_(steps=steps, controls="linear", scheme="gauss2"))
        follower = Follower.of(compute_motion_sent(s), problem.robot)
        assert follower.has_controls
        times, _, _, controls = controls_along(follower)
        apart.append(np.abs(controls - s.controls_at(times)).max() / np.abs(s.us).max())
    assert apart[0] < 0.1
    assert apart[1] < 0.4 * apart[0]


def test_what_takes_too_much_is_told() -> None:
    s = mbocp.solve(EXAMPLES / "arms" / "ur5_fastest.toml")
    robot, sent = s.load_robot(), compute_motion_sent(s)
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
    table = tmp_path / "a.csv"
    export(result, table, interpolation="cubic", **given)
    table.unlink()
    warned = pytest.warns(UserWarning, match=r"shoulder_lift_joint leaves its limits: effort -45\.\d+ N m at")
    with warned, pytest.raises(typer.Exit):
        export(result, table, interpolation="quintic", **given)
    assert not table.exists()
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
    export(result, table, interpolation="quintic", **given)
    assert table.exists()
    (sent, excesses) = prepare_within("csv", saved, 500.0, "quintic", fit=True, load_robot=saved.load_robot)
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
    with (
        pytest.warns(UserWarning, match="efforts are those of the solution, not of what is sent"),
        pytest.warns(
            UserWarning, match=r"efforts and path constraints are not checked .*gone.urdf: no such file"
        ),
    ):
        export(gone.save(tmp_path / "b.h5"), tmp_path / "b.csv", interpolation="quintic", **given)
    assert (tmp_path / "b.csv").exists()


def test_rates_of_torques_are_kept_between_samples(tmp_path: Path) -> None:
    """Torques of cubics leap from step to step; the moving mean over a step makes slopes of these."""
    most, rate = 150.0, 500.0
    problem = mbocp.load_problem(EXAMPLES / "arms" / "ur5_reach.toml").with_(
        limits={"effort_rate": most}, duration=1.2
    )
    s = mbocp.solve(problem, check=True)
    with pytest.raises(LimitsExceeded, match=r": effort rate -?\d+ N m/s at .* s, 1\d+\.\d % beyond -?150"):
        s.export(tmp_path / "leaps.csv", rate=rate, fit=False)
    file, model = s.export(tmp_path / "kept.csv", rate=rate), problem.robot.model
    header = file.read_text().splitlines()[0].split(",")
    columns = np.loadtxt(file, delimiter=",", skiprows=1).T
    q, v, a = (columns[[k for k, name in enumerate(header) if name.startswith(f"{x}:")]].T for x in "qva")
    torques = np.array([pin.rnea(model, model.createData(), *row) for row in zip(q, v, a, strict=True)])
    assert s.duration < columns[0, -1] < 1.1 * s.duration
    still = np.zeros(model.nv)
    ends = [pin.rnea(model, model.createData(), row, still, still) for row in (q[0], q[-1])]
    largest = np.abs(np.diff(np.vstack([ends[0], torques, ends[1]]), axis=0) * rate).max()
    assert 0.95 * most < largest < 1.01 * most
    fast = compute_motion_sent(s, rate, fit=True, mean=float(s.t[1]))
    fast = dataclasses.replace(fast, curves=fast.curves.slow(0.9))
    assert {one.kind for one in joint_excesses(Follower.of(fast, problem.robot))} == {"effort rate"}


def test_loops_and_accelerations_as_controls_do_not_say_torques() -> None:
    four_bar = mbocp.load_problem(EXAMPLES / "loops" / "four_bar.toml")
    assert not Follower.of(compute_motion_sent(mbocp.solve(four_bar)), four_bar.robot).has_controls
    kinematic = mbocp.load_robot("double_pendulum", dynamics=False)
    problem = mbocp.Problem.create(kinematic, goal={"q": [1.0, 0.5], "v": 0.0}, duration=1.0, steps=10)
    assert not Follower.of(compute_motion_sent(mbocp.solve(problem)), kinematic).has_controls


@pytest.mark.parametrize("changes", [{"limits": {"jerk": 60.0, "effort": True}}, {"scheme": "se1"}])
def test_efforts_in_a_file_are_those_of_the_motion_in_it(tmp_path: Path, changes: dict[str, Any]) -> None:
    """Fitted, and slower for it, or quintics through few steps: Pinocchio alone says what it takes."""
    problem = mbocp.load_problem(EXAMPLES / "arms" / "ur5_reach.toml").with_(steps=40, **changes)
    solution = mbocp.solve(problem, check=True)
    path = solution.export(tmp_path / "a.csv", rate=250.0, interpolation="quintic", check=False)
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    model = problem.robot.model
    assert table.shape[1] == 1 + 4 * model.nv
    rows = np.split(table[:, 1:], 4, axis=1)
    data, damping = model.createData(), model.damping
    efforts = [pin.rnea(model, data, q, v, a) + damping * v for q, v, a in zip(*rows[:3], strict=True)]
    np.testing.assert_allclose(rows[3], efforts, atol=1e-9)
    sent = compute_motion_sent(solution, 250.0, "quintic", fit=True)
    assert np.abs(rows[3] - sample(sent).efforts).max() > 0.5  # [N m]; those of the solution are others
