"""Where a name or path leads."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from mbocp.exceptions import RobotError, RobotFileError, UnknownFrame, UnknownRobot
from mbocp.robot import list_robots, load_robot, robot_from_spec
from mbocp.robot.loading import robot_sources as sources
from tests.robot import urdfs

URDF = urdfs.chain("revolute", "prismatic", name="arm")


@pytest.fixture
def shelf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of robots by name."""
    folder = tmp_path / "shelf"
    folder.mkdir()
    monkeypatch.setenv(sources.PATH_VARIABLE, str(folder))
    return folder


@pytest.fixture
def descriptions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A stand-in for the package robot_descriptions."""
    package = tmp_path / "site" / "robot_descriptions"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(str(package.parent))
    for name in [n for n in sys.modules if n.startswith("robot_descriptions")]:
        monkeypatch.delitem(sys.modules, name)
    yield package
    for name in [n for n in sys.modules if n.startswith("robot_descriptions")]:
        del sys.modules[name]


def test_path_to_a_urdf_a_toml_or_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    toml = urdfs.write(tmp_path / "arm", URDF, 'description = "An arm."')
    monkeypatch.chdir(tmp_path)
    for spec in (toml, str(toml), "arm/robot.toml", "./arm", Path("arm")):
        robot = load_robot(spec)
        assert (robot.name, robot.description) == ("arm", "An arm.")
        assert robot.source == tmp_path / "arm" / "robot.urdf"
        assert robot.spec == {"name": str(toml)}
    assert load_robot("arm/robot.urdf").description == ""
    (tmp_path / "arm" / "robot.toml").unlink()
    assert load_robot("./arm").name == "arm"
    assert load_robot("robot.urdf", base=tmp_path / "arm").name == "arm"


def test_spec_of_a_path_works_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    urdfs.write(tmp_path / "a", URDF)
    monkeypatch.chdir(tmp_path)
    robot = load_robot(
        "a/robot.urdf", lock={"j2": 0.1}, free_flyer=True, mimic=False, package_dirs=["meshes"]
    )
    monkeypatch.chdir("/")
    spec = json.loads(json.dumps(dict(robot.spec)))
    assert spec["package_dirs"] == [str(tmp_path / "meshes")]
    assert robot_from_spec(spec).fingerprint == robot.fingerprint


def test_names_on_the_shelf_come_first(shelf: Path) -> None:
    urdfs.write(shelf / "panda", URDF, 'description = "Not the one."')
    urdfs.write(shelf / "rigid_pendulum", URDF, "")
    assert load_robot("panda").nv == 2
    assert load_robot("rigid_pendulum").nv == 2
    assert load_robot("ur5").nv == 6
    entries = {entry.name: entry for entry in list_robots()}
    assert entries["panda"].description == "Not the one."
    assert entries["panda"].source == "robots/"


def test_list() -> None:
    entries = {entry.name: entry for entry in list_robots()}
    assert {"elastic_pendulum", "rigid_pendulum", "cart_pendulum_rigid", "cart_pendulum_elastic"} <= set(
        entries
    )
    assert entries["ur5"].source == "example-robot-data"
    assert entries["ur5"].description == "ur5_robot.urdf, fixed base"
    assert entries["solo12"].description == "solo12.urdf, free-flying base"
    assert "SDF" in entries["cassie"].description
    assert len(entries) == len(list_robots()) >= 70


def test_a_broken_robot_does_not_hide_the_others(shelf: Path) -> None:
    urdfs.write(shelf / "broken", URDF, "name = ")
    entries = {entry.name: entry for entry in list_robots()}
    assert entries["broken"].description.startswith("cannot be read: malformed TOML")
    assert "ur5" in entries


def test_unknown_name() -> None:
    with pytest.raises(
        UnknownRobot, match=r"robot 'rigid_pendulun': did you mean 'rigid_pendulum'"
    ) as unknown:
        load_robot("rigid_pendulun")
    assert "panda" in unknown.value.valid
    with pytest.raises(UnknownRobot, match=r"robot 'UR5': did you mean 'ur5'"):
        load_robot("UR5")


def test_a_folder_beside_the_file_is_hinted_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    urdfs.write(tmp_path / "mine", URDF, "")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UnknownRobot, match=r"robot 'mine': did you mean the folder './mine'\?"):
        load_robot("mine")
    assert load_robot("./mine").nv == 2
    with pytest.raises(UnknownRobot):
        load_robot("m" * 3000)


def test_frames_are_listed_from_the_tips() -> None:
    robot = load_robot("ur5")
    with pytest.raises(UnknownFrame, match=r"valid names: tool0, .*wrist_3_link") as unknown:
        robot.frame_id("gripper")
    assert unknown.value.valid[-1] == "tool0"


def test_blank_lines_before_an_xml_declaration_are_forgiven(tmp_path: Path) -> None:
    text = urdfs.chain("revolute")
    (tmp_path / "blank.urdf").write_text("\n \n" + text)
    assert load_robot(tmp_path / "blank.urdf").joint_names == ("j1",)
    (tmp_path / "broken.urdf").write_text("\n \n" + text.replace("</robot>", "</robots>"))
    with pytest.raises(RobotFileError, match=r"malformed XML: .*line 4"):
        load_robot(tmp_path / "broken.urdf")


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"name": "ur5", "grvity": [0, 0, 0]}, r"robot: unknown key 'grvity'; did you mean 'gravity'"),
        ({"name": "ur5", "gravity": [0, 0]}, r"robot\.gravity: got"),
        ({"free_flyer": True}, r"robot\.name: .*required"),
        ({"name": "ur5", "lock": 3}, r"robot\.lock: got 3"),
    ],
)
def test_wrong_tables(spec: dict[str, object], message: str) -> None:
    with pytest.raises(RobotError, match=message):
        robot_from_spec(spec)


def test_table_form(tmp_path: Path) -> None:
    urdfs.write(tmp_path, URDF)
    robot = robot_from_spec(
        {"name": "./robot.urdf", "lock": ["j2"], "gravity": [0, 0, 0], "label": "lever"}, base=tmp_path
    )
    assert (robot.name, robot.nv) == ("lever", 1)
    assert not robot.model.gravity.linear.any()


def test_robot_descriptions(descriptions: Path) -> None:
    urdf = urdfs.write(descriptions / "data", URDF)
    (descriptions / "arm_description.py").write_text(
        "".join(
            f"{key} = {str(path)!r}\n" for key, path in [("URDF_PATH", urdf), ("PACKAGE_PATH", urdf.parent)]
        )
    )
    (descriptions / "empty_description.py").write_text("REPOSITORY_PATH = 'x'\n")
    ball = descriptions / "data" / "ball.xml"
    ball.write_text(
        '<mujoco model="ball"><worldbody><body name="b"><joint name="hinge"/>'
        '<geom size="0.1" pos="1 0 0"/></body></worldbody></mujoco>'
    )
    (descriptions / "ball_description.py").write_text(f"MJCF_PATH = {str(ball)!r}\n")
    (descriptions / "offline_description.py").write_text("raise OSError('no network')\n")
    robot = load_robot("arm_description")
    assert (robot.nv, robot.spec) == (2, {"name": "arm_description"})
    assert load_robot("ball_description").joint_names == ("hinge",)
    with pytest.raises(
        RobotFileError, match=r"robot_descriptions.empty_description: has no URDF and no MJCF"
    ):
        load_robot("empty_description")
    with pytest.raises(RobotFileError, match=r"could not be fetched: no network"):
        load_robot("offline_description")
    with pytest.raises(UnknownRobot):
        load_robot("nobody_description")


def test_without_example_robot_data(monkeypatch: pytest.MonkeyPatch) -> None:
    from mbocp.robot.loading.readers import example_robots as examples

    monkeypatch.setitem(sys.modules, "example_robot_data", None)
    examples._loaders.cache_clear()
    try:
        assert examples.names() == []
        with pytest.raises(UnknownRobot):
            load_robot("ur5")
        assert load_robot("rigid_pendulum").nv == 3
    finally:
        examples._loaders.cache_clear()


def test_a_folder_that_may_not_be_read_hides_no_other(tmp_path, monkeypatch):
    closed = tmp_path / "closed"
    closed.mkdir()
    monkeypatch.setenv("MBOCP_ROBOT_PATH", str(closed))
    whole, listed = Path.iterdir, [entry.name for entry in list_robots()]

    def iterdir(folder):
        if folder == closed:
            raise PermissionError(13, "Permission denied", str(folder))
        return whole(folder)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    assert [entry.name for entry in list_robots()] == listed


@pytest.mark.parametrize(
    "name", ["x" * 5000, "a\0b", "a\0b/c.urdf", "x" * 5000 + ".urdf", "~no_such_user_here/a.urdf"]
)
def test_names_that_nothing_can_have(name):
    with pytest.raises((UnknownRobot, RobotFileError)) as refused:
        load_robot(name)
    assert len(str(refused.value)) <= 4000
