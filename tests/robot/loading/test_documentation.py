"""The example of docs/robot_toml.md loads, and uses every key that there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mbocp.robot import load_robot
from mbocp.robot.loading.readers.robot_yaml import RobotYaml, read_robot_yaml
from mbocp.robot.loading.robot_sources import robot_folders
from mbocp.robot.loading.robot_toml import TABLES, RobotTable
from tests.robot import urdfs

ROOT = Path(__file__).parents[3]
CRANE = urdfs.robot(
    *(urdfs.link(name) for name in ("rail", "trolley", "mast", "boom", "hook", "load")),
    urdfs.joint("cart", "prismatic", "rail", "trolley"),
    urdfs.joint("slew", "revolute", "trolley", "mast"),
    urdfs.joint("jib", "revolute", "mast", "boom", axis="0 1 0"),
    urdfs.joint("winch", "prismatic", "boom", "hook"),
    urdfs.joint("swing", "floating", "hook", "load").replace("0.3 0 0.1", "0 0 -2"),  # a tie of 2 m fits
)


@pytest.fixture
def example() -> str:
    (block,) = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "robot_toml.md").read_text(), re.DOTALL)
    return str(block)


def test_the_example_loads(tmp_path: Path, example: str) -> None:
    robot = load_robot(urdfs.write(tmp_path, CRANE, example))
    assert (robot.nc, len(robot.forces), len(robot.connectors)) == (1, 2, 3)


def test_the_example_has_every_key(example: str) -> None:
    own = (table for key, tables in TABLES.items() if key != "part" for table in tables)
    for table in (RobotTable, *own):
        for name, field in table.model_fields.items():
            key = field.alias or name
            assert re.search(rf"^(# )?{key} = |^\[+{key}\]+", example, re.MULTILINE), key


@pytest.mark.parametrize("name", sorted(p.parent.name for p in (ROOT / "robots").glob("*/robot.toml")))
def test_every_robot_has_a_readme_and_a_description(name: str) -> None:
    assert (ROOT / "robots" / name / "README.md").is_file()
    assert name in (ROOT / "robots" / "README.md").read_text()
    robot = load_robot(name)
    assert robot.name == name
    assert robot.description
    assert any(folder.joinpath(name).is_dir() for folder in robot_folders())


def test_the_robot_yaml_of_the_page_is_one(tmp_path: Path) -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / "robot_toml.md").read_text(), re.DOTALL)
    (tmp_path / "robot.yaml").write_text(block)
    found = read_robot_yaml(tmp_path / "robot.yaml")  # warns of keys that are not known
    assert found.joint_type == ["SPHERICAL", "UJOINT_XY"]
    assert found.model_fields_set == set(RobotYaml.model_fields)
