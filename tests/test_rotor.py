"""A rotor: a body with inertia and without mass. Mass on its axis would change nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mbocp import solve
from mbocp.exceptions import InvalidValue
from mbocp.mechanics.symmetries import find_symmetries
from mbocp.problem.file.load import parse_problem
from mbocp.robot import Robot, describe, load_robot
from mbocp.symbolic import model_functions
from mbocp.view.plots import plot_solution
from mbocp.view.replay import write_replay
from tests.robot import urdfs

AXIS = 'rpy="0.1 0.2 0.3"'


def rotor(name: str, mass: float, moments: tuple[float, float, float] = (0.1, 0.1, 0.15)) -> str:
    xx, yy, zz = moments
    inertia = f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/>'
    return urdfs.link(name, None, f'<inertial><mass value="{mass}"/>{inertia}</inertial>')


def alone(mass: float, moments: tuple[float, float, float] = (0.1, 0.1, 0.15), tilt: str = AXIS) -> str:
    joint = urdfs.joint("spin", "continuous", "base", "rotor").replace(AXIS, tilt)
    return urdfs.robot(urdfs.link("base"), rotor("rotor", mass, moments), joint)


def problem(robot: Robot, folder: Path, coordinates: str, scheme: str = "se1") -> str:
    goal = [0.6] if robot.nq == 1 else [float(x) for x in robot.q0]
    return f"""
coordinates = "{coordinates}"
robot = {json.dumps(str(folder / "robot.urdf"))}
horizon = {{duration = 1.0, steps = 8}}
integrator = {{scheme = "{scheme}"}}
goal = {{q = {goal}, v = {[0.4] * robot.nv}}}
"""


@pytest.mark.parametrize(
    ("coordinates", "scheme"), [("joint", "se1"), ("joint", "rk4"), ("natural", "midpoint")]
)
def test_mass_on_the_axis_changes_nothing(tmp_path, coordinates, scheme):
    solutions = []
    for mass in (0.0, 2.0):
        folder = tmp_path / str(mass)
        robot = load_robot(urdfs.write(folder, alone(mass)))
        solutions.append(solve(parse_problem(problem(robot, folder, coordinates, scheme)), check=True))
    rotor_, heavy = solutions
    np.testing.assert_allclose(rotor_.us, heavy.us, atol=1e-9)
    np.testing.assert_allclose(rotor_.cost, heavy.cost, rtol=1e-9)


def test_a_rotor_on_an_arm_is_solved_drawn_and_replayed(tmp_path):
    """In both kinds of coordinates the same motion, as far as the discretisations agree."""
    urdf = urdfs.robot(
        urdfs.link("base"),
        urdfs.link("arm"),
        rotor("rotor", 0.0),
        urdfs.joint("lift", "continuous", "base", "arm", axis="0 1 0"),
        urdfs.joint("spin", "continuous", "arm", "rotor"),
    )
    robot = load_robot(urdfs.write(tmp_path, urdf))
    costs = []
    for coordinates in ("joint", "natural"):
        solution = solve(parse_problem(problem(robot, tmp_path, coordinates, "midpoint")), check=True)
        costs.append(solution.cost)
        assert plot_solution(solution, tmp_path / "a.png").stat().st_size > 1000
        assert write_replay(robot, solution.t, solution.qs, tmp_path / "a.html").stat().st_size > 1000
    assert costs[0] == pytest.approx(costs[1], rel=0.02)


def test_a_robot_of_rotors_weighs_nothing(tmp_path):
    described = describe(load_robot(urdfs.write(tmp_path, alone(0.0))))
    assert described["mass"] == 0.0
    json.dumps(described)


def test_a_robot_of_rotors_has_no_centre_of_mass(tmp_path):
    functions = model_functions(load_robot(urdfs.write(tmp_path, alone(0.0))).model)
    for name in ("center_of_mass", "centroidal_momentum"):
        with pytest.raises(InvalidValue, match=r"mass: got 0\.0, expected a robot whose bodies have mass"):
            getattr(functions, name)


@pytest.mark.parametrize("moments", [(0.1, 0.1, 0.15), (0.0, 0.0, 0.1)])
def test_symmetries_of_a_rotor_move_it(tmp_path, moments):
    """Upright it turns with the world; where it is does not matter, but that is no conserved momentum."""
    robot = load_robot(urdfs.write(tmp_path, alone(0.0, moments, tilt='rpy="0 0 0"')))
    assert [symmetry.name for symmetry in find_symmetries(robot)] == ["rotation about z"]
    if moments[0] > 0:
        tilted = load_robot(urdfs.write(tmp_path / "tilted", alone(0.0, moments)))
        assert find_symmetries(tilted) == ()


def test_a_rotor_in_a_free_body_keeps_its_symmetries(tmp_path):
    urdf = urdfs.robot(
        urdfs.link("base"), rotor("rotor", 0.0), urdfs.joint("spin", "continuous", "base", "rotor")
    )
    heavy = urdf.replace('<mass value="0.0"/>', '<mass value="1.0"/>')
    names = [
        [s.name for s in find_symmetries(load_robot(urdfs.write(tmp_path / n, u), free_flyer=True))]
        for n, u in (("a", urdf), ("b", heavy))
    ]
    assert names[0] == names[1]
    assert "rotation about z" in names[0]
