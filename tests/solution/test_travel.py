"""Results hold their robot: all that is done with one works where the robot is gone, or another by now."""

from __future__ import annotations

import dataclasses
import json
import pickle
import shutil
import warnings
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp.cli.app import app
from mbocp.exceptions import InvalidValue, ResultFileError, RobotError, RobotFileError
from mbocp.robot import (
    MissingMeshWarning,
    Payload,
    Robot,
    RobotChangedWarning,
    RobotFiles,
    RobotNotStoredWarning,
    gather,
    load_parts,
    load_robot,
    load_stored,
)
from mbocp.solution import Solution
from tests.view.pages import stl

from .damage import edit

LINK = """<link name="{name}"><inertial><origin xyz="0 0 -0.3"/><mass value="1"/>
<inertia ixx="0.03" iyy="0.03" izz="0.003" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><mesh filename="{mesh}"/></geometry></visual>
<collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>"""
URDF = """<robot name="arm"><link name="base"/>{links}
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="20" velocity="9"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -0.6"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="20" velocity="9"/></joint></robot>"""
QUADROTOR = Path(__file__).parents[2] / "examples/free_flyer/robots/quadrotor"  # whose URDF is a name
TABLE = 'urdf = "../models/urdf/arm.urdf"\nname = "my arm"\ngravity = [0, 0, -3.7]\n'
PROBLEM = """
robot = "robots/robot.toml"
[horizon]
duration = 1.0
steps = 10
[goal]
q = [0.4, -0.3]
v = [0, 0]
[limits]
effort = true
[integrator]
scheme = "se1"
"""


def write_robot(folder: Path) -> None:
    """A robot.toml, a URDF elsewhere, one mesh by two kinds of addresses, the same content twice."""
    for name in ("robots", "models/urdf", "models/srdf", "models/meshes"):
        (folder / name).mkdir(parents=True)
    for name in ("upper.stl", "lower.stl"):
        (folder / "models/meshes" / name).write_bytes(stl(2))
    (folder / "models/package.xml").write_text("<package/>")
    absolute = folder / "models/meshes/lower.stl"
    meshes = {"upper": "package://models/meshes/upper.stl", "lower": f"file://{absolute}"}
    links = "".join(LINK.format(name=name, mesh=mesh) for name, mesh in meshes.items())
    (folder / "models/urdf/arm.urdf").write_text(URDF.format(links=links))
    (folder / "models/srdf/arm.srdf").write_text(
        '<robot name="arm"><disable_collisions link1="upper" link2="lower"/></robot>'
    )
    (folder / "robots/robot.toml").write_text(TABLE)


@pytest.fixture
def place(tmp_path: Path) -> Path:
    write_robot(tmp_path / "here")
    (tmp_path / "here/arm.toml").write_text(PROBLEM)
    return tmp_path / "here"


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Solution, Path]:
    """A solution, its result, and nothing left of its robot."""
    folder = tmp_path_factory.mktemp("solved")
    write_robot(folder / "here")
    (folder / "here/arm.toml").write_text(PROBLEM)
    solution = mbocp.solve(mbocp.load_problem(folder / "here/arm.toml"), check=True)
    path = solution.save(folder / "arm.h5")
    shutil.rmtree(folder / "here")
    return solution, path


def run(*arguments: str | Path) -> Any:
    done = CliRunner().invoke(app, list(map(str, arguments)), env={"COLUMNS": "200", "TERM": "dumb"})
    assert done.exit_code == 0, done.stderr
    return done


def test_all_that_is_done_with_a_result_without_its_robot(
    solved: tuple[Solution, Path], tmp_path: Path
) -> None:
    solution, result = solved
    run("plot", result, "-o", tmp_path / "a.svg")
    run("replay", result, "-o", tmp_path / "a.html")
    assert "_meshfile_geometry" in (tmp_path / "a.html").read_text()
    run("export", result, "-o", tmp_path / "a.csv", "--rate", "50")
    words = " ".join(run("info", result).stdout.split())
    assert "holds its robot: 6 files" in words
    facts = json.loads(run("explain", result, "--no-search", "--json").stdout)
    assert facts["causes"] == []
    again = json.loads(run("solve", result, "-o", tmp_path / "b.h5", "--json").stdout)
    assert again["cost"] == pytest.approx(solution.cost, rel=1e-12)
    run("solve", tmp_path / "b.h5", "--set", "horizon.duration=1.5", "-q")  # its result holds it, too


def test_the_robot_is_the_same(solved: tuple[Solution, Path]) -> None:
    solution, result = solved
    loaded = Solution.load(result)
    assert loaded == solution
    robot, problem = loaded.load_robot(), loaded.load_problem()
    assert (robot.name, robot.model.gravity.linear[2]) == ("my arm", -3.7)
    assert dict(robot.spec) == dict(solution.robot_spec) == dict(problem.robot.spec)
    assert problem.name == "arm"
    assert len(robot.collision_model.geometryObjects) == 2
    assert mbocp.solve(problem).problem_text == solution.problem_text


def test_options_of_the_robot_can_still_change(solved: tuple[Solution, Path], tmp_path: Path) -> None:
    problem = Solution.load(solved[1]).load_problem(["robot.label='other'", "robot.damping=false"])
    assert problem.robot.name == "other"
    saved = Solution.load(mbocp.solve(problem).save(tmp_path / "other.h5"))
    assert saved.load_robot().name == "other"


def test_a_payload_that_was_added_in_python_travels(solved: tuple[Solution, Path], tmp_path: Path) -> None:
    problem = Solution.load(solved[1]).load_problem()
    heavy = problem.robot.with_payload(Payload(name="load", frame="lower", mass=0.7, com=(0.0, 0.0, -0.6)))
    solution = mbocp.solve(problem.with_(robot=heavy))
    loaded = Solution.load(solution.save(tmp_path / "heavy.h5"))
    assert [p.mass for p in loaded.load_robot().payloads] == [0.7]
    assert mbocp.solve(loaded.load_problem()).cost == pytest.approx(solution.cost, rel=1e-12)


def test_each_content_is_stored_once(solved: tuple[Solution, Path]) -> None:
    files = Solution.load(solved[1]).robot_files
    assert files is not None
    assert len(files.files) == 6
    assert len(files.contents) == 5  # two meshes are alike
    with h5py.File(solved[1]) as file:
        assert sorted(file["robot/contents"]) == sorted(files.contents)


def test_the_stored_robot_wins_and_that_is_said(place: Path, tmp_path: Path) -> None:
    robot = load_robot(place / "robots")
    files = gather(robot.spec)
    solution = dataclasses.replace(fabricated(robot), robot_files=files)
    path = solution.save(tmp_path / "a.h5")
    urdf = place / "models/urdf/arm.urdf"
    urdf.write_text(urdf.read_text().replace('mass value="1"', 'mass value="2"'))
    with pytest.warns(RobotChangedWarning, match=r"has changed since \(.*arm.urdf\); what the result holds"):
        stored = Solution.load(path).load_robot()
    assert stored.fingerprint == robot.fingerprint != load_robot(place / "robots").fingerprint
    done = run("replay", path)
    assert "the robot has changed since" in " ".join(done.stderr.split())


def fabricated(robot: Robot) -> Solution:
    n = robot.nv
    return Solution(
        status="converged", solver="none", iterations=0, cost=0.0, residual=0.0, unknowns=1,
        t=np.linspace(0.0, 1.0, 3), qs=np.zeros((3, robot.nq)), vs=np.zeros((3, n)), ps=np.zeros((3, n)),
        us=np.zeros((2, robot.nu)), mus=np.zeros((3, 2 * n)), robot_name=robot.name,
        robot_spec=dict(robot.spec),
    )  # fmt: skip


def test_without_meshes(place: Path, tmp_path: Path) -> None:
    solution = fabricated(load_robot(place / "robots"))
    small, large = (solution.save(tmp_path / f"{m}.h5", meshes=m) for m in (False, True))
    files = Solution.load(small).robot_files
    assert files is not None
    assert [Path(f.path).name for f in files.left_out] == ["upper.stl", "lower.stl"]
    assert small.stat().st_size < large.stat().st_size
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Solution.load(small).load_robot()  # the meshes are still where they were
    shutil.move(place, tmp_path / "away")
    with pytest.warns(MissingMeshWarning, match="was left out of the result"):
        assert Solution.load(small).load_robot().nv == 2
    assert "2 meshes left out" in " ".join(run("info", small).stdout.split())


def test_large_meshes_are_left_out_unasked_and_that_is_told(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbocp.solution.its_robot.MESH_LIMIT", 10)
    solution = fabricated(load_robot(place / "robots"))
    with pytest.warns(RobotNotStoredWarning, match="--meshes"):
        small = solution.save(tmp_path / "a.h5")
    files = Solution.load(small).robot_files
    assert files is not None
    assert len(files.left_out) == 2
    solution.save(tmp_path / "b.h5", meshes=True)


def test_a_robot_that_is_gone_before_the_result_is_written(place: Path, tmp_path: Path) -> None:
    solution = fabricated(load_robot(place / "robots"))
    shutil.rmtree(place)
    with pytest.warns(RobotNotStoredWarning, match="written without its robot"):
        path = solution.save(tmp_path / "a.h5")
    loaded = Solution.load(path)
    assert loaded == solution
    with pytest.raises(RobotError, match="no such file"):
        loaded.load_robot()
    assert "holds no robot" in " ".join(run("info", path).stdout.split())


def test_files_of_before_are_read_as_before(place: Path, tmp_path: Path) -> None:
    solution = fabricated(load_robot(place / "robots"))
    path = solution.save(tmp_path / "a.h5")

    def without_robot(file: h5py.File) -> None:
        del file["robot"]

    edit(path, without_robot)
    old = Solution.load(path)
    assert old == solution
    assert old.robot_files is None
    assert old.load_robot().nv == 2


def test_a_world_of_parts_and_a_robot_of_a_package(place: Path, tmp_path: Path) -> None:
    """Parts that are assembled by another file, a robot by name, a body of given shape, a chain."""
    (place / "pair").mkdir()
    (place / "pair/robot.toml").write_text(
        'gravity = [0, 0, -3.7]\n[[part]]\nrobot = "../robots"\nname = "a"\n'
        '[[part]]\nrobot = "chain_2"\nname = "b"\n'
    )
    parts = [
        {"robot": str(place / "pair"), "name": "pair"},
        {"robot": "double_pendulum", "name": "swing", "position": [1.0, 0, 0]},
        {"mass": 1.0, "box": [0.1, 0.1, 0.1], "name": "box"},
    ]
    world = load_parts(parts, gravity=[0, 0, -3.7])
    files = gather(world.spec)
    shutil.rmtree(place)
    again = load_stored(RobotFiles(json.loads(json.dumps(files.listed)), files.contents))
    assert again.fingerprint == world.fingerprint
    assert dict(again.spec) == dict(world.spec)
    meshes = [g.meshPath for g in again.visual_model.geometryObjects if g.meshPath]
    assert meshes
    assert all(Path(mesh).is_relative_to(again.stored.folder) for mesh in meshes)


@pytest.mark.parametrize("name", ["ur5", "solo12", "hector", "stewart", "chain_3", QUADROTOR])
def test_robots_by_name(name: str) -> None:
    """With the SRDF's initial pose and inertias of motors; no file of the package is asked again."""
    robot = load_robot(name)
    again = load_stored(gather(robot.spec))
    assert again.fingerprint == robot.fingerprint
    np.testing.assert_array_equal(again.q0, robot.q0)
    assert [g.name for g in again.visual_model.geometryObjects] == [
        g.name for g in robot.visual_model.geometryObjects
    ]


def test_a_robot_that_code_builds_is_not_stored(tmp_path: Path) -> None:
    robot = load_robot("talos_legs")
    with pytest.warns(RobotNotStoredWarning, match="built by code"):
        fabricated(robot).save(tmp_path / "a.h5")


def test_the_folder_lives_as_long_as_the_robot(place: Path) -> None:
    robot = load_stored(gather(load_robot(place / "robots").spec))
    folder = robot.stored.folder
    assert (folder / "files").is_dir()
    copied = pickle.loads(pickle.dumps(robot.stored))
    assert copied.folder != folder
    del robot
    assert not folder.exists()


@pytest.mark.parametrize("path", ["../out.stl", "/tmp/out.stl", "files/../../out", "", "a\\b", "\ud800"])
def test_nothing_is_written_outside_of_the_folder(place: Path, path: str) -> None:
    files = gather(load_robot(place / "robots").spec)
    listed = json.loads(json.dumps(files.listed))
    listed["files"][0]["path"] = path
    with pytest.raises(InvalidValue, match="path within the folder"):
        RobotFiles(listed, files.contents)


def test_a_source_of_no_kind_is_refused(place: Path) -> None:
    files = gather(load_robot(place / "robots").spec)
    listed = json.loads(json.dumps(files.listed))
    listed["sources"][0]["kind"] = "\ud800"
    with pytest.raises(InvalidValue, match="kind"):
        RobotFiles(listed, files.contents)


def test_what_was_not_stored_is_not_looked_for(place: Path, tmp_path: Path) -> None:
    """A stored URDF that names any file of this machine does not get it."""
    secret = tmp_path / "secret.stl"
    secret.write_bytes(stl(2))
    files = gather(load_robot(place / "robots").spec)
    listed = json.loads(json.dumps(files.listed))
    listed["addresses"] = [row for row in listed["addresses"] if "lower" not in row["asked"]]
    with pytest.warns(MissingMeshWarning, match="was missing where the result was written"):
        load_stored(RobotFiles(listed, files.contents))


def test_damage_is_named(place: Path, tmp_path: Path) -> None:
    solution = fabricated(load_robot(place / "robots"))
    path = solution.save(tmp_path / "a.h5")

    def other_list(file: h5py.File) -> None:
        text = json.dumps({"spec": 3}).encode()
        del file["robot/list"]
        file["robot"].create_dataset("list", data=np.frombuffer(text, np.uint8)).attrs["description"] = "JSON"

    files = gather(solution.robot_spec)
    broken = dict.fromkeys(files.contents, b"nothing")
    with pytest.raises(RobotFileError, match="is damaged in the result"):
        load_stored(RobotFiles(files.listed, broken))
    swapped = dict(zip(files.contents, [*list(files.contents.values())[1:], b""], strict=True))
    with pytest.raises(RobotFileError, match="is damaged in the result"):
        load_stored(RobotFiles(files.listed, swapped))
    edit(path, other_list)
    with pytest.raises(ResultFileError, match="its parts do not fit together"):
        Solution.load(path)


def test_a_private_file_is_no_mesh_of_a_robot(place: Path) -> None:
    """Meshes are files of known formats, and pictures come from the robot's own folders."""
    private = place.parent / "id_rsa"
    private.write_text("secret")
    urdf = place / "models/urdf/arm.urdf"
    urdf.write_text(urdf.read_text().replace("package://models/meshes/upper.stl", str(private)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        files = gather(load_robot(place / "robots").spec)
    assert not [f for f in files.files if "id_rsa" in f.path]


def test_pictures_and_material_files_travel(place: Path, tmp_path: Path) -> None:
    meshes = place / "models/meshes"
    (meshes / "upper.obj").write_text("mtllib upper.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    (meshes / "upper.mtl").write_text("newmtl a\nKd 1 0 0\nmap_Kd wood.png\n")
    png = b"\x89PNG\r\n\x1a\n" + b"a picture" * 9
    for picture in (meshes / "wood.png", tmp_path / "own.png"):
        picture.write_bytes(png)
    urdf = place / "models/urdf/arm.urdf"
    urdf.write_text(urdf.read_text().replace("upper.stl", "upper.obj"))
    names = {Path(file.path).name for file in gather(load_robot(place / "robots").spec).files}
    assert {"upper.obj", "upper.mtl", "wood.png"} <= names
    (meshes / "upper.mtl").write_text("newmtl a\nmap_Kd ../../../own.png\n")
    names = {Path(file.path).name for file in gather(load_robot(place / "robots").spec).files}
    assert "own.png" not in names


def test_a_solution_shows_itself(solved: tuple[Solution, Path], tmp_path: Path) -> None:
    solution = Solution.load(solved[1])
    assert solution.plot(tmp_path / "a.png").stat().st_size > 1000
    page = solution.replay(tmp_path / "a.html", trace=["lower"], speed=0.5)
    assert page is not None
    assert "my arm" in page.read_text()
    assert solution.export(tmp_path / "a.csv", rate=20.0).exists()


def test_with_takes_the_words_of_create(solved: tuple[Solution, Path]) -> None:
    problem = Solution.load(solved[1]).load_problem()
    changed = problem.with_(
        start={"q": {"elbow": 0.5}}, goal={"q": {"shoulder": -0.2}}, cost={"velocity": 2.0}, steps=12
    )
    np.testing.assert_allclose(changed.q_start, [0.0, 0.5])
    assert changed.goal.q[0] == -0.2
    assert changed.num_steps == 12
    assert mbocp.solve(changed).converged


def test_xarray(solved: tuple[Solution, Path]) -> None:
    pytest.importorskip("xarray")
    solution = solved[0]
    data = solution.to_xarray()
    np.testing.assert_array_equal(data.q.sel(q_name="elbow"), solution.qs[:, 1])
    np.testing.assert_array_equal(data.u.sel(u_name="shoulder"), solution.us[:, 0])
    assert data.u.dims == ("step", "u_name")
    assert str(data.v_unit.sel(v_name="elbow").values) == "rad/s"
    assert data.mu.shape == solution.mus.shape
    assert (data.attrs["robot"], data.attrs["cost"]) == ("my arm", solution.cost)
    assert float(data.v.interp(t=0.5 * data.t[-1]).sel(v_name="elbow")) == pytest.approx(solution.vs[5, 1])
