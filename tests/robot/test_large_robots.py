"""Robots of many links: described in bounded memory, refused by name where that cannot be."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.exceptions import MemoryLimitExceeded, UnsupportedRobot
from mbocp.robot import load_robot
from mbocp.robot.large import composite_mass_matrix, is_large, make_working_data
from mbocp.robot.loading.readers.in_memory import chain_urdf


@pytest.mark.filterwarnings("ignore:.*Coulomb friction:mbocp.robot.NotModelledWarning")
@pytest.mark.parametrize("name", ["ur5", "talos", "hyq", "chain_8", "unicycle_pendulum"])
def test_both_ways_to_the_mass_matrix_agree(name: str) -> None:
    robot = load_robot(name)
    model = robot.model
    q = pin.integrate(model, np.array(robot.q0), np.random.default_rng(1).uniform(-1, 1, model.nv))
    expected = robot.mass_matrix(q)
    got = composite_mass_matrix(model, q)
    assert np.array_equal(got, got.T)
    assert np.abs(got - expected).max() < 1e-12 * np.abs(expected).max()


def test_a_large_chain_takes_little_memory() -> None:
    """Pinocchio's working memory alone would take 0.9 GB."""
    script = (
        "import resource, mbocp; from mbocp.robot import describe, load_robot\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "assert describe(load_robot('chain_300'))['nv'] == 300\n"
        "print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e3)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 100.0  # [MB]


def test_working_memory_is_looked_at_first(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = load_robot("chain_200")
    assert is_large(robot.model)
    monkeypatch.setenv("MBOCP_MEMORY_LIMIT", "200")
    words = r"robot 'chain_200': Pinocchio's working memory for its 200 velocities would take about 256 MB"
    with pytest.raises(MemoryLimitExceeded, match=words):
        make_working_data(robot.model)
    with pytest.raises(MemoryLimitExceeded, match=r"'chain_201'.* 201 velocities would take about 260 MB"):
        load_robot("chain_201", lock=["joint_1"])
    assert robot.mass_matrix(robot.q0).shape == (200, 200)


def chain_file(folder: Path, links: int, kind: str) -> Path:
    path = folder / f"{kind}_{links}.urdf"
    path.write_text(chain_urdf(links).text.replace('type="revolute"', f'type="{kind}"'))
    return path


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("fixed", r"joints one behind the other; supported are at most 1,200"),
        ("revolute", r"joints that move; supported are at most 1,000"),
    ],
)
@pytest.mark.parametrize("links", [1250, pytest.param(10_000, marks=pytest.mark.slow)])
def test_links_in_a_row_are_counted_before_anything_recurses(
    tmp_path: Path, links: int, kind: str, words: str
) -> None:
    with pytest.raises(UnsupportedRobot, match=words):
        load_robot(chain_file(tmp_path, links, kind))


def test_joints_that_move_are_counted(tmp_path: Path) -> None:
    star = ['<robot name="star"><link name="root"/>']
    for n in range(1100):
        star.append(
            f'<link name="l{n}"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" '
            f'izz="1"/></inertial></link><joint name="j{n}" type="revolute"><parent link="root"/>'
            f'<child link="l{n}"/><axis xyz="0 0 1"/><limit effort="1" velocity="1"/></joint>'
        )
    path = tmp_path / "star.urdf"
    path.write_text("\n".join([*star, "</robot>"]))
    with pytest.raises(UnsupportedRobot, match=r"1,100 joints that move.*at most 1,000"):
        load_robot(path)


def test_a_chain_of_too_many_links_is_refused() -> None:
    with pytest.raises(UnsupportedRobot, match="a chain has 1 to 1000 links"):
        load_robot("chain_2000")


@pytest.mark.slow
def test_the_longest_chain_is_loaded() -> None:
    assert mbocp.load_robot("chain_1000").nv == 1000
