"""Inertias that no body has are told once, by name; those that make kinetic energy negative are refused."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from mbocp.robot import ImpossibleInertiaWarning, NotModelledWarning, Robot, load_robot
from mbocp.robot.loading.mechanics_checks import IndefiniteMassMatrix
from tests.robot import urdfs
from tests.robot.urdfs import joint, link, robot


def inertial(mass: float, moments: tuple[float, ...], products: tuple[float, ...] = (0.0, 0.0, 0.0)) -> str:
    xx, yy, zz = moments
    xy, xz, yz = products
    return (
        f'<inertial><mass value="{mass}"/><inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" '
        f'izz="{zz}"/></inertial>'
    )


def arm(*bodies: str, axes: str = "zyx") -> str:
    """A chain of revolute joints j0, j1, ... about the axes, with links l0, l1, ... of these inertials."""
    vectors = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
    names = ["base", *(f"l{i}" for i in range(len(bodies)))]
    links = [link("base"), *(link(n, None, body) for n, body in zip(names[1:], bodies, strict=True))]
    joints = [
        joint(f"j{i}", "revolute", names[i], names[i + 1], axis=vectors[axes[i % 3]])
        for i in range(len(bodies))
    ]
    return robot(*links, *joints)


def told(folder: Path, urdf: str, category: type[Warning], **options: object) -> tuple[Robot, list[str]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        loaded = load_robot(urdfs.write(folder, urdf), **options)  # type: ignore[arg-type]
    return loaded, [str(w.message) for w in caught if issubclass(w.category, category)]


GOOD = inertial(1.0, (0.1, 0.1, 0.15))
TRIANGLE = inertial(1.0, (10.0, 0.1, 0.1))
INDEFINITE = inertial(1.0, (0.1, 0.1, 0.1), (10.0, 0.0, 0.0))


def test_a_broken_triangle_inequality_is_told_once(tmp_path: Path) -> None:
    found, words = told(tmp_path, arm(GOOD, TRIANGLE, TRIANGLE), ImpossibleInertiaWarning)
    (message,) = words
    assert "link 'l1': of its principal moments 0.1, 0.1, 10 kg m^2 the largest is above the sum" in message
    assert "link 'l2'" in message
    assert "link 'l0'" not in message
    np.testing.assert_array_equal(np.diag(found.model.inertias[2].inertia), [10.0, 0.1, 0.1])  # as it stands


def test_an_indefinite_inertia_is_told_with_its_product(tmp_path: Path) -> None:
    """About one axis only the moment about it counts: the motion is right, and the robot loads."""
    found, words = told(tmp_path, arm(INDEFINITE), ImpossibleInertiaWarning)
    (message,) = words
    assert "principal moment of inertia is -9.9 kg m^2" in message
    assert "(ixy = 10 is too large for ixx = 0.1 and iyy = 0.1)" in message
    assert found.mass_matrix(found.q0).item() == pytest.approx(0.1)


@pytest.mark.filterwarnings("ignore::mbocp.robot.ImpossibleInertiaWarning")
def test_an_indefinite_mass_matrix_is_refused(tmp_path: Path) -> None:
    """Three axes turn the body any way, and some turn has negative energy, though not at the initial pose."""
    with pytest.raises(
        IndefiniteMassMatrix, match=r"indefinite .* what j2 moves|indefinite .*'j2'"
    ) as refused:
        load_robot(urdfs.write(tmp_path, arm(GOOD, GOOD, INDEFINITE)))
    assert refused.value.joints == ("j2",)
    assert refused.value.eigenvalue < -0.1


@pytest.mark.parametrize(
    "body",
    [
        inertial(1.0, (0.0, 0.1, 0.1)),  # a thin rod
        inertial(1.0, (0.1, 0.1, 0.2)),  # a thin plate
        inertial(1.0, (0.1, 0.1, 0.201)),  # a thin plate, with few digits
        inertial(0.0, (0.1, 0.1, 0.15)),  # a rotor
        inertial(1.0, (2e-10, -1e-13, 1e-10)),  # round-off
    ],
)
def test_bodies_that_there_are_raise_no_doubt(tmp_path: Path, body: str) -> None:
    assert load_robot(urdfs.write(tmp_path, arm(GOOD, body, axes="zz"))).nv == 2


def test_small_parts_with_muddled_numbers_on_a_good_body_are_harmless(tmp_path: Path) -> None:
    parts = [link("base"), link("l", None, GOOD), link("camera", None, inertial(0.01, (0.01, 0.001, 0.001)))]
    urdf = robot(*parts, joint("j", "revolute", "base", "l"), joint("f", "fixed", "l", "camera"))
    assert load_robot(urdfs.write(tmp_path, urdf)).nv == 1


def test_what_stands_still_is_not_told_unless_it_floats(tmp_path: Path) -> None:
    urdf = robot(link("base", None, TRIANGLE), link("l", None, GOOD), joint("j", "revolute", "base", "l"))
    assert told(tmp_path, urdf, ImpossibleInertiaWarning)[1] == []
    (message,) = told(tmp_path, urdf, ImpossibleInertiaWarning, free_flyer=True)[1]
    assert "link 'base'" in message


def test_the_largest_numbers_give_a_finite_mass_matrix(tmp_path: Path) -> None:
    heavy = link("l", 1e15).replace('xyz="0.1 ', 'xyz="1e15 ')
    urdf = robot(link("base"), heavy, joint("j", "revolute", "base", "l"))
    found = load_robot(urdfs.write(tmp_path, urdf))
    assert np.isfinite(found.mass_matrix(found.q0)).all()


LEFT_OUT = {
    "the spring of joint 'j0' (<dynamics spring_stiffness>)": (
        '<dynamics spring_stiffness="3" damping="0"/></joint>',
        "</joint>",
    ),
    "the spring of <gazebo reference='j0'>": (
        '<gazebo reference="j0"><springStiffness>2.5</springStiffness></gazebo></robot>',
        "</robot>",
    ),
    "gravity turned off for the links 'l0' (<gazebo>)": (
        '<gazebo reference="l0"><turnGravityOff>true</turnGravityOff></gazebo></robot>',
        "</robot>",
    ),
    "the joint 'loop' in <gazebo reference=None> ([[constraint]] of a robot.toml closes loops)": (
        '<gazebo><joint name="loop" type="revolute"/></gazebo></robot>',
        "</robot>",
    ),
    "the loop that <loop_joint> 'loop' closes ([[constraint]] of a robot.toml closes loops)": (
        '<loop_joint name="loop"/></robot>',
        "</robot>",
    ),
    "the rotor's inertia in <transmission> 't'": (
        '<transmission name="t"><actuator name="m"><rotorInertia>1e-4</rotorInertia></actuator>'
        "</transmission></robot>",
        "</robot>",
    ),
    "<intertial> of link 'base' (did you mean <inertial>?)": ("intertial>", "inertial>"),
}


@pytest.mark.parametrize("words", LEFT_OUT)
def test_what_is_not_modelled_is_told_by_name(tmp_path: Path, words: str) -> None:
    new, old = LEFT_OUT[words]
    urdf = arm(GOOD)
    if new == "intertial>":
        urdf = urdf.replace(old, new, 2)
    else:
        urdf = urdf[: urdf.rindex(old)] + new + urdf[urdf.rindex(old) + len(old) :]
    (message,) = told(tmp_path, urdf, NotModelledWarning)[1]
    assert words in message


def test_what_changes_nothing_is_not_told(tmp_path: Path) -> None:
    extras = (
        '<gazebo reference="l0"><mu1>0.2</mu1><turnGravityOff>false</turnGravityOff></gazebo>'
        '<transmission name="t"><type>simple</type><joint name="j0"/></transmission><material name="m"/>'
    )
    urdf = arm(GOOD + '<collision><geometry><sphere radius="1"/></geometry></collision>')
    urdf = urdf.replace("</robot>", extras + "</robot>")
    assert told(tmp_path, urdf, NotModelledWarning)[1] == []
