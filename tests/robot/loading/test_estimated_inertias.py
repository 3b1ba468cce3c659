"""Masses and inertias of the shapes of links: of URDFs that give none, or impossible ones."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp.cli.app import app
from mbocp.exceptions import RobotError
from mbocp.meshes.mesh_parts import MeshPart
from mbocp.meshes.triangles import binary_stl
from mbocp.problem import parse_problem, problem_to_toml
from mbocp.robot import EstimatedInertiaWarning, Robot, describe, gather, load_parts, load_robot, load_stored
from mbocp.robot.collision.hull import hull_of
from mbocp.robot.loading.mechanics_checks import SingularMassMatrix
from mbocp.robot.loading.readers.example_robots import example_facts
from mbocp.robot.robot_facts import find_oddities
from tests.robot.urdfs import joint, link, robot

RHO = 2700.0
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
AT = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.4, 0.8), np.array([0.2, 0.1, -0.3]))
ORIGIN = '<origin xyz="0.2 0.1 -0.3" rpy="0.1 -0.4 0.8"/>'


def shape(geometry: str, kind: str = "collision", origin: str = ORIGIN) -> str:
    return f"<{kind}>{origin}<geometry>{geometry}</geometry></{kind}>"


def mesh(path: Path, kind: str = "collision", scale: str = "0.001 0.001 0.001") -> str:
    return shape(f'<mesh filename="{path}" scale="{scale}"/>', kind)


def inertial(mass: float, moment: float, last: float | None = None) -> str:
    zz = moment if last is None else last
    return (
        f'<inertial><mass value="{mass}"/><inertia ixx="{moment}" ixy="0" ixz="0" iyy="{moment}" iyz="0" '
        f'izz="{zz}"/></inertial>'
    )


def arm(folder: Path, *insides: str) -> Path:
    """A URDF of a chain of links l1, l2, ... with these elements in them."""
    names = [f"l{i + 1}" for i in range(len(insides))]
    parts = [link(name, None, inside) for name, inside in zip(names, insides, strict=True)]
    parents = ["base", *names[:-1]]
    hinges = [
        joint(n.replace("l", "j"), "revolute", p, n, axis="0 1 0")
        for p, n in zip(parents, names, strict=True)
    ]
    path = folder / "arm.urdf"
    path.write_text(robot(link("base", None), *parts, *hinges))
    return path


def load(path: Path, says: str, **inertias: Any) -> Robot:
    """Load, and expect to be told so."""
    with pytest.warns(EstimatedInertiaWarning, match=says):
        return load_robot(path, inertias=inertias)


def assert_same(body: pin.Inertia, other: pin.Inertia) -> None:
    np.testing.assert_allclose(body.mass, other.mass, rtol=1e-6)
    np.testing.assert_allclose(body.lever, other.lever, atol=1e-6)
    np.testing.assert_allclose(body.inertia, other.inertia, atol=1e-6 * np.trace(other.inertia))


@pytest.fixture
def box_stl(tmp_path: Path) -> Path:
    """A box of 300 x 200 x 700, in millimetres."""
    hull = hull_of((CUBE - 0.5) * (300, 200, 700))
    path = tmp_path / "box.stl"
    path.write_bytes(binary_stl(MeshPart(np.array(hull.vertices), hull.faces, None, None, None)))
    return path


@pytest.fixture
def open_stl(tmp_path: Path) -> Path:
    """The same without a corner of one side."""
    hull = hull_of((CUBE - 0.5) * (300, 200, 700))
    path = tmp_path / "open.stl"
    path.write_bytes(binary_stl(MeshPart(np.array(hull.vertices), hull.faces[1:], None, None, None)))
    return path


BOX = pin.Inertia.FromBox(RHO * 0.3 * 0.2 * 0.7, 0.3, 0.2, 0.7)


@pytest.mark.parametrize(
    ("geometry", "body"),
    [
        ('<box size="0.3 0.2 0.7"/>', BOX),
        ('<sphere radius="0.2"/>', pin.Inertia.FromSphere(RHO * 4 / 3 * np.pi * 0.2**3, 0.2)),
        (
            '<cylinder radius="0.1" length="0.6"/>',
            pin.Inertia.FromCylinder(RHO * np.pi * 0.1**2 * 0.6, 0.1, 0.6),
        ),
        (
            '<capsule radius="0.1" length="0.6"/>',
            pin.Inertia.FromCapsule(RHO * np.pi * (0.1**2 * 0.6 + 4 / 3 * 0.1**3), 0.1, 0.6),
        ),
    ],
)
def test_shapes_are_filled_evenly(tmp_path: Path, geometry: str, body: pin.Inertia) -> None:
    found = load(arm(tmp_path, shape(geometry)), r"2700 kg/m\^3: link 'l1' .* \(collision", density=RHO)
    assert_same(found.model.inertias[1], AT.act(body))


@pytest.mark.parametrize("scale", ["0.001 0.001 0.001", "0.001 -0.001 0.001"])
def test_a_mesh_of_a_box_is_the_box(tmp_path: Path, box_stl: Path, scale: str) -> None:
    """A mirrored one, too, though its triangles face inwards."""
    found = load(arm(tmp_path, mesh(box_stl, scale=scale)), "collision", density=RHO)
    assert_same(found.model.inertias[1], AT.act(BOX))


def test_an_open_mesh_counts_as_its_hull(tmp_path: Path, open_stl: Path) -> None:
    file = arm(tmp_path, mesh(open_stl, "visual"))
    found = load(file, r"'l1' 113 kg \(visual shapes, 1 open mesh by the convex hull\)", density=RHO)
    assert_same(found.model.inertias[1], AT.act(BOX))


@pytest.mark.parametrize("turned", [False, True])
def test_a_mesh_whose_faces_are_there_twice_counts_as_its_hull(tmp_path: Path, turned: bool) -> None:
    """Its surface is closed, and encloses twice the volume, or none where the second faces are turned."""
    hull = hull_of((CUBE - 0.5) * (300, 200, 700))
    faces = np.vstack([hull.faces, hull.faces[:, ::-1] if turned else hull.faces])
    path = tmp_path / "twice.stl"
    path.write_bytes(binary_stl(MeshPart(np.array(hull.vertices), faces, None, None, None)))
    found = load(arm(tmp_path, mesh(path)), "by the convex hull", density=RHO)
    assert_same(found.model.inertias[1], AT.act(BOX))


def test_several_shapes_and_links_that_are_fixed_to_each_other_add_up(tmp_path: Path, box_stl: Path) -> None:
    both = shape('<sphere radius="0.2"/>', origin="") + mesh(box_stl) + shape("<box size='9 9 9'/>", "visual")
    found = load(arm(tmp_path, both), "collision", density=RHO)
    ball = pin.Inertia.FromSphere(RHO * 4 / 3 * np.pi * 0.2**3, 0.2)
    assert_same(found.model.inertias[1], ball + AT.act(BOX))


def test_a_total_mass_gives_the_density(tmp_path: Path) -> None:
    small, large = shape('<box size="0.1 0.1 0.1"/>'), shape('<box size="0.2 0.1 0.1"/>')
    file = arm(tmp_path, small, inertial(2.0, 0.1), large)
    found = load(file, r"at 1000 kg/m\^3: link 'l1' 1 kg .*, link 'l3' 2 kg", mass=5.0)
    assert [body.mass for body in found.model.inertias] == pytest.approx([0, 1.0, 2.0, 2.0])
    with pytest.raises(RobotError, match=r"inertias\.mass: got 1\.5 kg for the whole robot, .* weigh 2 kg"):
        load_robot(file, inertias={"mass": 1.5})


def test_what_the_file_says_is_kept_unless_no_body_has_it(tmp_path: Path) -> None:
    box = shape('<box size="0.3 0.2 0.7"/>')
    bad = (inertial(3.0, 0.0), inertial(3.0, 0.1, 0.5), inertial(0.0, 0.0))
    file = arm(tmp_path, *(body + box for body in (inertial(2.0, 0.1), inertial(0.0, 0.1), *bad)))
    kept = (
        "'l3' 3 kg .3 kg without inertia: its mass is kept; .*'l4' 3 kg .of its principal moments .*'l5' 113"
    )
    found = load(file, kept, density=RHO)  # and no ImpossibleInertiaWarning, which would be an error
    bodies = list(found.model.inertias)[1:]
    assert_same(bodies[0], pin.Inertia(2.0, np.zeros(3), 0.1 * np.eye(3)))
    assert_same(bodies[1], pin.Inertia(0.0, np.zeros(3), 0.1 * np.eye(3)))  # a rotor
    three = AT.act(pin.Inertia.FromBox(3.0, 0.3, 0.2, 0.7))
    for body, expected in zip(bodies[2:], (three, three, AT.act(BOX)), strict=True):
        assert_same(body, expected)
    assert [one.link for one in found.link_inertias] == ["l3", "l4", "l5"]
    with pytest.warns(match="impossible"):
        plain = load_robot(arm(tmp_path, *(inertial(2.0, 0.1), inertial(3.0, 0.1, 0.5))))
    assert any("l2" in line for line in find_oddities(plain))
    assert not any("'l3'" in line or "'l4'" in line for line in find_oddities(found))


def test_numbers_by_link_take_the_place_of_all(tmp_path: Path) -> None:
    box = shape('<box size="0.3 0.2 0.7"/>')
    file = arm(tmp_path, box, inertial(2.0, 0.1) + box)
    links: dict[str, Any] = {
        "l1": {"mass": 3.0},
        "l2": {"mass": 1.0, "com": [0, 0, 1], "inertia": [1, 2, 2.5]},
    }
    found = load(file, r"'l1' 3 kg \(given mass; collision", links=links)
    assert_same(found.model.inertias[1], AT.act(pin.Inertia.FromBox(3.0, 0.3, 0.2, 0.7)))
    at = np.array([0.0, 0.0, 1.0])
    assert_same(found.model.inertias[2], pin.Inertia(1.0, at, np.diag([1.0, 2.0, 2.5])))
    assert (
        load_robot(file, inertias={"links": {"l1": links["l2"]}}).nv == 2
    )  # nothing estimated, nothing told


def test_links_without_shapes_are_refused_as_ever(tmp_path: Path) -> None:
    flat = shape('<box size="0.3 0.2 0"/>')
    file = arm(tmp_path, shape('<box size="0.3 0.2 0.7"/>'), flat, "")
    with (
        pytest.warns(EstimatedInertiaWarning, match="no volume in the shapes of 'l2'"),
        pytest.raises(SingularMassMatrix, match="moves with 'j2', 'j3'"),
    ):
        load_robot(file, inertias={"density": RHO})
    with pytest.raises(SingularMassMatrix, match="inertias = "):
        load_robot(file)


def test_a_robot_with_inertias_is_told_that_nothing_is_estimated(tmp_path: Path) -> None:
    file = arm(tmp_path, inertial(2.0, 0.1))
    assert load(file, "nothing is estimated", density=RHO).fingerprint == load_robot(file).fingerprint


def test_results_have_the_numbers_and_need_no_meshes(tmp_path: Path, box_stl: Path) -> None:
    file = arm(tmp_path, mesh(box_stl), mesh(box_stl))
    found = load(file, "l2", density=RHO)
    spec = json.loads(json.dumps(found.spec))
    assert spec["inertias"]["links"]["l1"]["mass"] == found.link_inertias[0].mass
    text = f'robot = {{ name = "{file}", inertias = {{ density = {RHO} }} }}\n'
    with pytest.warns(EstimatedInertiaWarning):
        problem = parse_problem(text + "[horizon]\nduration = 1\nsteps = 5\n[goal]\nv = 0\n")
    files = gather(found.spec).without_meshes()
    box_stl.unlink()
    assert load_stored(files).fingerprint == found.fingerprint
    assert parse_problem(problem_to_toml(problem)).robot.fingerprint == found.fingerprint
    with pytest.raises(RobotError, match="collision 0 of link 'l1': its mesh is missing"):
        load_robot(file, inertias={"density": RHO})


def test_files_and_parts_say_it(tmp_path: Path, box_stl: Path) -> None:
    file = arm(tmp_path, mesh(box_stl))
    single = tmp_path / "single" / "robot.toml"
    single.parent.mkdir()
    single.write_text(f'urdf = "{file}"\n[inertias]\ndensity = {RHO}\n')
    with pytest.warns(EstimatedInertiaWarning):
        one = load_robot(single)
    with pytest.warns(EstimatedInertiaWarning):
        both = load_parts([{"robot": str(single), "name": "a"}, {"robot": str(single), "name": "b"}])
    assert [body["link"] for body in describe(both)["inertias"]] == ["a/l1", "b/l1"]
    cell = tmp_path / "cell" / "robot.toml"
    cell.parent.mkdir()
    cell.write_text(
        f'[[part]]\nname = "a"\nrobot = "{single}"\n[[part]]\nname = "b"\nmass = 1\nsphere = 0.1\n'
    )
    with pytest.warns(EstimatedInertiaWarning):
        whole = load_robot(cell)
    box_stl.unlink()
    for robot_ in (one, both, whole):
        assert mbocp.robot.robot_from_spec(robot_.spec).fingerprint == robot_.fingerprint
    with pytest.raises(RobotError, match=r"inertias: .* is assembled of parts"):
        load_robot(cell, inertias={"density": RHO})
    with pytest.raises(RobotError, match="expected PART/LINK, with a part 'a', 'b'; got c/l1"):
        load_robot(cell, inertias={"links": {"c/l1": one.link_inertias[0].table}})


def test_real_arms_come_near_their_own_inertias(tmp_path: Path) -> None:
    """As docs/robots.md says: a check of the order of magnitude, with real meshes and numbers."""
    ratios = []
    for name in ("ur5", "panda", "kinova", "z1"):
        facts = example_facts(name)
        root = ElementTree.parse(facts.path).getroot()
        for body in root.iterfind("link"):
            for element in body.findall("inertial"):
                body.remove(element)
        bare = tmp_path / f"{name}.urdf"
        bare.write_text(ElementTree.tostring(root, encoding="unicode"))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            true = load_robot(facts.path)
            mass = float(sum(body.mass for body in true.model.inertias))
            found = load_robot(bare, inertias={"mass": mass}, package_dirs=facts.packages)
        assert sum(body.mass for body in found.model.inertias) == pytest.approx(mass)
        ratios += list(np.diag(found.mass_matrix(found.q0)) / np.diag(true.mass_matrix(true.q0)))
    assert np.mean(np.abs(np.array(ratios) - 1.0) < 0.3) >= 0.5
    assert np.mean(np.abs(np.log2(ratios)) < 1.0) >= 0.75


def test_commands_show_it(tmp_path: Path) -> None:
    file = arm(tmp_path, shape('<box size="0.3 0.2 0.7"/>'))
    table = tmp_path / "robot.toml"
    table.write_text(f'urdf = "{file}"\ninertias = {{ density = {RHO} }}\n')
    task = tmp_path / "task.toml"
    task.write_text(f'robot = "{table}"\n[horizon]\nduration = 1\nsteps = 5\n[goal]\nq = [0.3]\nv = 0\n')
    for words in (["check", str(task)], ["robots", str(table)], ["explain", str(task)]):
        said = CliRunner().invoke(app, words)
        assert said.exit_code == 0, said.output
        assert "'l1' 113 kg (collision shapes)" in " ".join(said.output.split())


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"density": -1.0}, r"inertias\.density: got -1"),
        ({"density": "heavy"}, r"inertias\.density: got 'heavy'"),
        ({"dens": 3}, r"inertias\.dens: unknown key; did you mean 'density'"),
        ({"density": 1.0, "mass": 1.0}, r"inertias: give either density .* or mass"),
        ({}, "inertias: give density"),
        (5, "inertias: got 5, expected a table"),
        ({"links": {"l": {"mass": 1.0}}}, r"inertias\.links: the robot has no link 'l'; did you mean 'l1'"),
        ({"links": {"l1": {"com": [0, 0, 0]}}}, r"inertias\.links: l1\.mass: this key is required"),
        (
            {"links": {"l1": {"mass": 1.0, "co": [0, 0, 0]}}},
            r"inertias\.links: l1\.co: unknown key; did you mean 'com'",
        ),
        ({"links": {"l1": {"mass": 1.0}}}, r"links: l1: the link has no shape .* give com and inertia, too"),
        ({"links": {"l1": {"mass": 1.0, "inertia": [1, 1, 3]}}}, "principal moments"),
    ],
)
def test_wrong_tables_are_refused_by_key(tmp_path: Path, given: Any, says: str) -> None:
    file = arm(tmp_path, "")
    with pytest.raises(RobotError, match=says):
        load_robot(file, inertias=given)
    with pytest.raises(RobotError, match=says):
        mbocp.robot.robot_from_spec({"name": str(file), "inertias": given})


def test_it_has_no_meaning_without_dynamics(tmp_path: Path) -> None:
    file = arm(tmp_path, shape('<box size="0.3 0.2 0.7"/>'))
    with pytest.raises(RobotError, match="leave one of the two out"):
        load_robot(file, dynamics=False, inertias={"density": RHO})
    table = tmp_path / "robot.toml"
    table.write_text(f'urdf = "{file}"\ninertias = {{ density = {RHO} }}\n')
    assert load_robot(table, dynamics=False).link_inertias == ()
    table.write_text(f'urdf = "{file}"\ndynamics = false\n')
    with pytest.raises(RobotError, match="leave one of the two out"):
        load_robot(table, inertias={"density": RHO})
    with pytest.raises(RobotError, match="has its own"):
        load_robot("chain_2", inertias={"density": RHO})
