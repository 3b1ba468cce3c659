"""The problem as a value: from Python, from files, and back to text."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbocp.exceptions import ProblemError
from mbocp.problem import Problem, load_problem, parse_problem, problem_to_toml
from mbocp.robot import Robot
from tests.robot import urdfs

from .conftest import EXAMPLES
from .same import same

Loader = Callable[..., Problem]
FILES = sorted(path for path in EXAMPLES.rglob("*.toml") if "[horizon]" in path.read_text())  # not studies


def test_all_examples_are_there() -> None:
    names = {str(path.relative_to(EXAMPLES)) for path in FILES}
    paper = {"elastic_pendulum", "rigid_pendulum", "cart_pendulum_rigid", "cart_pendulum_elastic"}
    arms = {"ur5_reach", "ur5_limits", "ur5_fastest", "panda_reach", "kinova_reach"}
    assert names >= {f"paper/{n}.toml" for n in paper} | {f"arms/{n}.toml" for n in arms} | {
        "free_flyer/drone_flip.toml",
        "so3/unicycle_pendulum.toml",
    }


@pytest.mark.parametrize(
    ("name", "dims", "y0", "u"),
    [
        ("elastic_pendulum", (3, 3, 0), [-2, -5, -5, -3, 0, 0], [0.001, 0.001, 0.001]),
        ("rigid_pendulum", (3, 3, 1), [5, 0, 0, 0, 10, 0], [0, -2, 0]),
        ("cart_pendulum_rigid", (3, 1, 1), [0, 0.5, 1, 0, 0, 0], [1]),
        ("cart_pendulum_elastic", (3, 1, 0), [0, 0.5, 1, 0, 0, 0], [1]),
    ],
)
def test_paper_data(name: str, dims: tuple[int, int, int], y0: list[float], u: list[float]) -> None:
    problem = load_problem(EXAMPLES / "paper" / f"{name}.toml")
    robot = problem.robot
    assert (robot.nv, robot.nu, robot.nc) == dims
    np.testing.assert_allclose([*problem.q_start, *problem.p_start], y0, atol=1e-14)
    assert problem.dt == pytest.approx(0.01)
    assert problem.guess.kind == "control"
    np.testing.assert_array_equal(problem.guess.u, u)


def test_create_is_the_file(load: Loader) -> None:
    created = Problem.create(
        "ur5",
        1.0,
        20,
        start={"q": np.array([0, -1.57, 0, -1.57, 0, 0])},
        goal={"q": (0.5, -1.2, 0.5, -0.3, 0.4, 0.2), "v": np.zeros(6)},
        cost={"effort": 1.0},
    )
    same(created, load())
    assert repr(created) == "<Problem problem: ur5, 1 s in 20 steps of gauss2>"


def test_robot_path_is_relative_to_the_file(tmp_path: Path, ur5: Robot) -> None:
    assert ur5.source is not None
    (tmp_path / "here.urdf").write_text(
        '<robot name="slider"><link name="base"/><link name="cart"><inertial><mass value="2"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
        '<joint name="rail" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>'
        '<limit effort="10" velocity="1" lower="-1" upper="1"/></joint></robot>'
    )
    path = tmp_path / "slide.toml"
    path.write_text('robot = "here.urdf"\n[horizon]\nduration = 1\nsteps = 10\n[goal]\nq = [0.5]\nv = [0]\n')
    problem = load_problem(path)
    assert problem.robot.joint_names == ("rail",)
    again = parse_problem(problem_to_toml(problem))  # from another folder
    assert again.robot.fingerprint == problem.robot.fingerprint
    with pytest.warns(
        UserWarning, match=r"goal\.q: outside the position limits of rail; limits are not enforced"
    ):
        load_problem(path, ["goal.q=[1.5]"])


def test_values_are_frozen(load: Loader) -> None:
    problem = load()
    with pytest.raises(dataclasses.FrozenInstanceError):
        problem.duration = 2.0  # type: ignore[misc]
    for array in (problem.q_start, problem.v_start, problem.goal.q, problem.cost.tracking_weights):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_start_without_q_is_the_initial_pose(ur5: Robot) -> None:
    problem = Problem.create(ur5, 1.0, 20, goal={"q": [0.5, -1.2, 0.5, -0.3, 0.4, 0.2]})
    np.testing.assert_array_equal(problem.q_start, ur5.q0)
    np.testing.assert_array_equal(problem.v_start, np.zeros(6))


@pytest.mark.parametrize(
    ("table", "kind"),
    [({}, "auto"), ({"u": 1.0}, "control"), ({"kind": "hold"}, "hold"), ({"kind": "line", "u": 1.0}, "line")],
)
def test_kind_of_the_guess(ur5: Robot, table: dict[str, object], kind: str) -> None:
    guess = Problem.create(ur5, 1.0, 20, goal={"q": [0.1] * 6}, guess=table).guess
    assert guess.kind == kind
    assert (guess.u is not None) == (kind == "control")


def test_guess_from_a_file_is_relative_to_the_problem(load: Loader, arm_file: Path) -> None:
    saved = arm_file.parent / "before.h5"
    saved.write_bytes(b"")
    guess = load("guess.file=before.h5").guess
    assert (guess.kind, guess.path) == ("solution", saved)


def test_another_robot_is_named_as_create_takes_it(tmp_path: Path) -> None:
    """By a name, a path from where the file is, or a table."""
    file = tmp_path / "motion.toml"
    file.write_text('robot = "double_pendulum"\n[horizon]\nduration = 1.0\nsteps = 10\n[goal]\nv = 0\n')
    beside = urdfs.write(tmp_path, urdfs.chain("revolute", "revolute"))
    problem = load_problem(file)
    assert problem.with_(robot=f"./{beside.name}").robot.joint_names == ("j1", "j2")
    carrying = {"name": "double_pendulum", "payload": [{"frame": problem.robot.frame_names[-1], "mass": 2.0}]}
    assert [load.mass for load in problem.with_(robot=carrying, steps=5).robot.payloads] == [2.0]
    for wrong, message in (({"nme": "x"}, r"robot\.nme: unknown key"), (3, "robot: got 3")):
        with pytest.raises(ProblemError, match=message):
            problem.with_(robot=wrong)
