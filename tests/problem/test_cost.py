"""Weights and targets."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mbocp.exceptions import MbocpError, ProblemFileError
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.robot import Robot
from mbocp.solution.files import FileContent, write_content
from mbocp.storage.content import QUANTITIES

Loader = Callable[..., Problem]
Maker = Callable[..., Problem]


def test_the_goal_is_the_target_and_says_the_weights(swing: Maker) -> None:
    cost = swing(goal={"q": [0, 0, -5], "enforce": "none"}, cost={"tracking": 2.0}).cost
    np.testing.assert_array_equal(cost.tracking_weights, [1, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(cost.target_q, [0, 0, -5])
    np.testing.assert_array_equal(cost.effort, [1, 1, 1])
    assert (cost.tracking, cost.terminal) == (2.0, 0.0)


def test_weights_as_list_or_by_name(swing: Maker) -> None:
    listed = swing(cost={"tracking": 1.0, "tracking_weights": [0, 0, 1, 2, 2, 2]}).cost
    name = swing().robot.joint_names[2]
    named = swing(cost={"tracking": 1.0, "tracking_weights": {"q": {name: 1}, "p": 2.0}}).cost
    np.testing.assert_array_equal(listed.tracking_weights, named.tracking_weights)


def test_a_weight_needs_a_target(swing: Maker) -> None:
    with pytest.raises(
        ProblemFileError, match=r"cost\.tracking_weights\[3\]: got 1 on p of .* does not say p there"
    ):
        swing(
            goal={"q": [0, 0, -5], "enforce": "none"},
            cost={"tracking": 1.0, "tracking_weights": [0, 0, 1, 1, 0, 0]},
        )
    with pytest.raises(
        ProblemFileError, match=r"cost\.terminal_weights\[3\]: got 1 .* the goal does not say"
    ):
        swing(
            goal={"q": [0, 0, -5], "enforce": "penalty"},
            cost={"terminal": 1.0, "terminal_weights": [1, 1, 1, 1, 1, 1]},
        )


def test_tracking_with_zero_weights_is_refused(swing: Maker) -> None:
    with pytest.raises(ProblemFileError, match="all weights are 0"):
        swing(cost={"tracking": 1.0, "tracking_weights": [0] * 6})


def test_tracking_of_nothing_names_its_key(ur5: Robot) -> None:
    goal = {"frame": {"name": "tool0", "z": 0.5}}
    with pytest.raises(
        MbocpError, match=r"cost\.tracking: cost\.target \(or the goal\) says neither q nor p"
    ):
        Problem.create(ur5, 1.0, 10, goal=goal, cost={"tracking": 1.0})


def test_velocity_weights(ur5: Robot) -> None:
    goal = {"q": [0.1] * 6}
    np.testing.assert_array_equal(Problem.create(ur5, 1.0, 10, goal=goal, cost={}).cost.velocity, np.zeros(6))
    every = Problem.create(ur5, 1.0, 10, goal=goal, cost={"velocity": 2.0}).cost.velocity
    np.testing.assert_array_equal(every, np.full(6, 2.0))
    one = Problem.create(ur5, 1.0, 10, goal=goal, cost={"velocity": {"wrist_3_joint": 2.0}}).cost.velocity
    np.testing.assert_array_equal(one, [0, 0, 0, 0, 0, 2])
    for wrong in (-1.0, [1.0], {"wrist_9_joint": 1.0}):
        with pytest.raises(MbocpError, match=r"cost\.velocity"):
            Problem.create(ur5, 1.0, 10, goal=goal, cost={"velocity": wrong})


def test_a_target_of_its_own(swing: Maker) -> None:
    cost = swing(cost={"tracking": 1.0, "target": {"q": [0, 5, 0]}}).cost
    np.testing.assert_array_equal(cost.target_q, [0, 5, 0])
    np.testing.assert_array_equal(cost.tracking_weights, [1, 1, 1, 0, 0, 0])


def test_a_target_trajectory(swing: Maker) -> None:
    rows = [[5.0, 0.0, 0.1 * n] for n in range(10)]
    cost = swing(cost={"tracking": 1.0, "target": {"q": rows}}).cost
    assert cost.is_trajectory
    assert [part.shape for part in cost.targets(10)] == [(10, 3), (10, 3)]
    with pytest.raises(
        ProblemFileError, match=r"cost\.target\.q: got shape \(9, 3\), expected \(3,\); or \(10, 3\)"
    ):
        swing(cost={"tracking": 1.0, "target": {"q": rows[1:]}})


def test_target_momentum_from_a_goal_velocity(ur5: Robot) -> None:
    q, v = np.linspace(0.1, 0.6, 6), np.linspace(-1.0, 1.0, 6)
    problem = Problem.create(ur5, 1.0, 10, goal={"q": q, "v": v, "enforce": "none"}, cost={"tracking": 1.0})
    np.testing.assert_allclose(problem.cost.target_p, ur5.momentum(q, v))
    np.testing.assert_array_equal(problem.cost.tracking_weights, np.ones(12))


def _motion(robot: Robot, num: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t = np.linspace(0.0, 1.0, num)
    qs = np.array([robot.integrate(robot.neutral(), np.full(robot.nv, 0.5 * time)) for time in t])
    return t, qs, np.outer(t, np.arange(1.0, robot.nv + 1))


@pytest.mark.filterwarnings("ignore:start.q. outside the position limits")
def test_target_file_csv(kinova: Robot, tmp_path: Path) -> None:
    t, qs, ps = _motion(kinova, 6)
    columns = [
        "t [s]",
        *(f"q:{c.name}" for c in kinova.q_labels),
        "u:x",
        *(f"p:{c.name} [N m s]" for c in kinova.p_labels),
    ]
    rows = np.column_stack([t, qs, np.zeros(6), ps])
    path = tmp_path / "motion.csv"
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="")
    problem = Problem.create(
        kinova, 1.0, 10, start={"q": kinova.neutral()}, cost={"tracking": 1.0, "target_file": str(path)}
    )
    fine = _motion(kinova, 11)
    np.testing.assert_allclose(problem.cost.target_q, fine[1][1:], atol=1e-12)
    np.testing.assert_allclose(problem.cost.target_p, fine[2][1:], atol=1e-12)


def _save(path: Path, **motion: np.ndarray) -> None:
    """A result file with this motion, and nothing else in it that counts."""
    rows = len(motion["t"])
    arrays = {name: np.zeros((rows, 1)) for name, row in QUANTITIES.items() if not row.may_lack} | motion
    columns = {
        name: (("x", ""),) * (array.shape[1] if array.ndim == 2 else 1) for name, array in arrays.items()
    }
    write_content(path, FileContent(arrays, columns, {}, {}, {}, {}))


def test_target_file_result(load: Loader, ur5: Robot, arm_file: Path) -> None:
    t, qs, ps = _motion(ur5, 21)
    _save(arm_file.parent / "motion.h5", t=t, qs=qs, ps=ps)
    problem = load("cost.target_file='motion.h5'", "cost.tracking=1")  # relative to the problem file
    np.testing.assert_allclose(problem.cost.target_q, qs[1:], atol=1e-14)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("t,a\n0,1\n", "has no column q:shoulder_pan_joint"),
        ("", "has no column t"),
    ],
)
def test_bad_target_file(load: Loader, arm_file: Path, content: str, reason: str) -> None:
    (arm_file.parent / "motion.csv").write_text(content)
    with pytest.raises(ProblemFileError, match=rf"cost\.target_file: .*{reason}"):
        load("cost.target_file='motion.csv'", "cost.tracking=1")


def test_target_file_that_ends_early(load: Loader, ur5: Robot, arm_file: Path) -> None:
    t, qs, ps = _motion(ur5, 21)
    _save(arm_file.parent / "motion.h5", t=0.5 * t, qs=qs, ps=ps)
    with pytest.raises(ProblemFileError, match=r"covers 0 to 0\.5 s, expected 0 to 1 s"):
        load("cost.target_file='motion.h5'", "cost.tracking=1")


def test_a_damaged_target_file_is_refused_like_any_result(load: Loader, ur5: Robot, arm_file: Path) -> None:
    """One bit of a number, which HDF5 itself does not see."""
    t, qs, ps = _motion(ur5, 21)
    path = arm_file.parent / "motion.h5"
    _save(path, t=t, qs=qs, ps=ps)
    content = bytearray(path.read_bytes())
    content[content.index(qs.tobytes()) + 100] ^= 1
    path.write_bytes(content)
    with pytest.raises(ProblemFileError, match=r"cost\.target_file: .*motion\.h5 is damaged, or was changed"):
        load("cost.target_file='motion.h5'", "cost.tracking=1")


def test_target_files_of_other_programs_and_shapes(load: Loader, ur5: Robot, arm_file: Path) -> None:
    t, qs, ps = _motion(ur5, 21)
    with h5py.File(arm_file.parent / "motion.h5", "w") as file:
        file["trajectories/t"] = t
    with pytest.raises(ProblemFileError, match=r"motion\.h5 is HDF5, but not a result file of mbocp"):
        load("cost.target_file='motion.h5'", "cost.tracking=1")
    for wrong in ({"t": t[:, None]}, {"qs": qs[0]}, {"ps": ps[..., None]}):
        _save(arm_file.parent / "motion.h5", **({"t": t, "qs": qs, "ps": ps} | wrong))
        with pytest.raises(ProblemFileError, match=r"another shape than a row for each time|1 columns"):
            load("cost.target_file='motion.h5'", "cost.tracking=1")


def test_missing_target_file(load: Loader) -> None:
    with pytest.raises(ProblemFileError, match=r"cost\.target_file: no such file"):
        load("cost.target_file='gone.h5'")


def test_weights_of_the_controls(load: Loader) -> None:
    for key in ("effort", "control_rate"):
        for written, expected in (
            ("2", [2] * 6),
            ("[1,2,3,4,5,6]", [1, 2, 3, 4, 5, 6]),
            ("{elbow_joint=3}", [0, 0, 3, 0, 0, 0]),
        ):
            problem = load(
                f"cost.{key}={written}", f"cost.{'control_rate' if key == 'effort' else 'effort'}=1"
            )
            np.testing.assert_array_equal(getattr(problem.cost, key), expected)
            again = parse_problem(problem_to_toml(problem))
            np.testing.assert_array_equal(getattr(again.cost, key), expected)


def test_potential_of_any_sign(load: Loader) -> None:
    for value in (-2.0, 0.5):
        problem = load(f"cost.potential={value}")
        assert parse_problem(problem_to_toml(problem)).cost.potential == problem.cost.potential == value


@pytest.mark.parametrize(
    ("setting", "key", "reason"),
    [
        ("cost.control_rate=-1", "cost.control_rate", r"got -1\.0, expected a weight >= 0"),
        (
            "cost.control_rate=[1]",
            "cost.control_rate",
            r"got shape \(1,\), expected \(6,\); actuators: shoulder",
        ),
        (
            "cost.control_rate={elbow=1}",
            "cost.control_rate",
            "no actuator 'elbow': did you mean 'elbow_joint'",
        ),
        ("cost.effort=[1,2,3,4,5,-6]", r"cost.effort[5]", r"got -6\.0, expected a weight >= 0"),
        ("cost.effort='much'", "cost.effort", "got 'much', expected a number"),
        ("cost.potential=nan", "cost.potential", "got nan, expected a finite number"),
        (
            "cost.effort={elbow_joint=1}",
            "cost.effort",
            r"got 0\.0 for shoulder_pan_joint, shoulder_lift_joint, .*, expected a positive number",
        ),
    ],
)
def test_wrong_weights_of_the_controls(load: Loader, setting: str, key: str, reason: str) -> None:
    with pytest.raises(ProblemFileError, match=reason) as caught:
        load(setting)
    assert caught.value.key == key


def test_a_control_without_effort_needs_a_rate_or_limits(load: Loader) -> None:
    with pytest.raises(ProblemFileError, match=r"cost\.effort: got 0\.0, expected .* or \[limits\]"):
        load("cost.effort=0")
    load("cost.effort=0", "cost.control_rate=1e-3")
    load("cost.effort=0", "limits.effort=true")
    load("cost.effort={elbow_joint=1}", "cost.control_rate=[1,1,0,1,1,0]", "limits.effort={wrist_3_joint=3}")
    with pytest.raises(ProblemFileError, match=r"cost\.effort: got 0\.0 for wrist_3_joint, expected"):
        load("cost.effort={elbow_joint=1}", "cost.control_rate=[1,1,0,1,1,0]")


def test_weights_of_the_controls_in_python(load: Loader) -> None:
    problem = load()
    wrong = dataclasses.replace(problem.cost, effort=np.ones(2))
    with pytest.raises(MbocpError, match=r"cost\.effort: got shape \(2,\), expected \(6,\)"):
        problem.with_(cost=wrong)
    one = dataclasses.replace(problem.cost, control_rate=np.array(2.0))
    np.testing.assert_array_equal(problem.with_(cost=one).cost.control_rate, np.full(6, 2.0))


@pytest.mark.parametrize(
    ("key", "value", "weight"),
    [
        ("target", {"q": [1.0, 1.0]}, "tracking"),
        ("tracking_weights", {"q": 1.0}, "tracking"),
        ("terminal_weights", {"q": 1.0}, "terminal"),
    ],
)
def test_weights_of_a_term_without_its_weight_are_refused(key: str, value: Any, weight: str) -> None:
    """Else a motion would be found that tracks nothing."""
    tables: dict[str, Any] = {"goal": {"q": [1.0, 0.5], "v": 0}, "cost": {"effort": 1.0, key: value}}
    words = rf"cost\.{key}: got no cost\.{weight}, expected cost\.{weight}, the weight"
    with pytest.raises(MbocpError, match=words):
        Problem.create("double_pendulum", 1.0, 10, **tables)
    tables["cost"][weight] = 0.0  # who says so means it
    assert Problem.create("double_pendulum", 1.0, 10, **tables).cost.tracking == 0.0


def test_a_tolerance_that_says_nothing_is_refused() -> None:
    with pytest.raises(MbocpError, match=r"solver\.tolerance: got 1e\+100, expected at most 0.01"):
        Problem.create("double_pendulum", 1.0, 10, goal={"q": [1.0, 0.5]}, solver={"tolerance": 1e100})
