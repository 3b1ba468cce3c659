"""Damping and friction of joints: the URDF's numbers, in every formulation, against Pinocchio's."""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue, RobotFileError
from mbocp.mechanics import JointMechanics, NaturalMechanics
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.mechanics.symmetries import find_symmetries
from mbocp.problem.problem import problem_from_tables
from mbocp.robot import JointResistance, NotModelledWarning, Robot, describe, load_robot, robot_from_spec
from tests.mechanics.models import POINT, chain
from tests.mechanics.models import robot as robot_of
from tests.mechanics.natural_coordinates.test_mechanics import check_accelerations
from tests.robot import urdfs
from tests.robot.urdfs import joint, link, losses, mimic

# Every joint that a URDF gives losses: a rail, a wheel, a hinge, and two that follow the hinge.
MIXED = urdfs.robot(
    link("base", None),
    link("a"),
    joint("rail", "prismatic", "base", "a", axis="1 0 0.2", extra=urdfs.LIMIT + losses(3.0, 0.5)),
    link("b"),
    joint("wheel", "continuous", "a", "b", axis="0 1 0", extra=losses(0.4)),
    link("c"),
    joint("hinge", "revolute", "b", "c", axis="0 1 0.3", extra=urdfs.LIMIT + losses(0.7, 0.2)),
    link("d", 0.3),
    joint("push", "prismatic", "c", "d", axis="0 0.2 1", extra=mimic("hinge", 0.2) + losses(5.0, 0.3)),
    link("e", 0.3),
    joint("turn", "revolute", "c", "e", axis="1 0 0", extra=mimic("hinge", -1.5) + losses(0.1)),
    link("f", 0.3),
    joint("ungreased", "revolute", "e", "f", axis="0 0 1", extra=urdfs.LIMIT + losses(0.0, 0.25)),
)
DAMPING = {"rail": 3.0, "wheel": 0.4, "hinge": 0.7 + 0.2**2 * 5.0 + 1.5**2 * 0.1, "ungreased": 0.0}


def expected_torque(robot: Robot, v: Array, *, damping: bool = True, speed: float | None = None) -> Array:
    """The losses of `MIXED`, joint by joint."""
    out = np.zeros(robot.nv)
    for name, coefficient in DAMPING.items():
        out[robot.velocity_indices(name)] -= damping * coefficient * v[robot.velocity_indices(name)]
    if speed is not None:
        for name, leader, ratio, friction in (
            ("rail", "rail", 1.0, 0.5),
            ("hinge", "hinge", 1.0, 0.2),
            ("push", "hinge", 0.2, 0.3),
            ("ungreased", "ungreased", 1.0, 0.25),
        ):
            assert name in robot.joint_names
            where = robot.velocity_indices(leader)
            out[where] -= ratio * friction * np.tanh(ratio * v[where] / speed)
    return out


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    return urdfs.write(tmp_path, MIXED)


def symbolic_force(mechanics: JointMechanics | NaturalMechanics, q: Array, v: Array, u: Array) -> Array:
    symbols = [ca.SX.sym(name, len(x)) for name, x in zip("qvu", (q, v, u), strict=True)]
    found: Array = ca.Function("f", symbols, [ca.densify(mechanics.force(*symbols))])(q, v, u).full().ravel()
    return found


@pytest.mark.parametrize("options", [{}, {"friction": "smooth", "friction_speed": 0.3}, {"damping": False}])
def test_forces_and_accelerations(mixed: Path, options: dict[str, object]) -> None:
    robot = load_robot(mixed, **{"friction": "none", **options})  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    q = robot.integrate(robot.q0, rng.uniform(-1, 1, robot.nv))
    v, u = rng.uniform(-1, 1, robot.nv), rng.uniform(-1, 1, robot.nu)
    speed = 0.3 if options.get("friction") == "smooth" else None
    lost = expected_torque(robot, v, damping=bool(options.get("damping", True)), speed=speed)
    np.testing.assert_allclose(robot.force_elements(q, v), lost, atol=1e-14)
    tau = robot.actuation_matrix(q) @ u + lost
    np.testing.assert_allclose(symbolic_force(JointMechanics(robot), q, v, u), tau, atol=1e-13)
    mechanics = ForwardMechanics(robot)
    symbols = [ca.SX.sym("q", robot.nq), ca.SX.sym("v", robot.nv), ca.SX.sym("u", robot.nu)]
    rate = ca.Function("f", symbols, [mechanics.speed_rate(*symbols, ca.SX(0.0))])(q, v, u).full().ravel()
    bias = pin.rnea(robot.model, robot.model.createData(), q, v, np.zeros(robot.nv))
    np.testing.assert_allclose(rate, np.linalg.solve(robot.mass_matrix(q), tau - bias), atol=1e-10)
    check_accelerations(robot)  # of natural coordinates


def test_the_power_that_is_lost(mixed: Path) -> None:
    """f . v = - sum d w^2 - sum F w tanh: never positive."""
    robot = load_robot(mixed, friction="smooth")
    for v in np.random.default_rng(1).standard_normal((20, robot.nv)):
        power = robot.force_elements(robot.q0, v) @ v
        damped = sum(d * float(v[robot.velocity_indices(name)][0]) ** 2 for name, d in DAMPING.items())
        assert power <= -damped
    still = dataclasses.replace(robot, resistances=())
    assert not still.has_forces
    assert still.fingerprint != robot.fingerprint


def test_damping_off_gives_the_equations_of_a_urdf_without(tmp_path: Path) -> None:
    text = urdfs.robot(link("base", None), link("a"), joint("j", "revolute", "base", "a"))
    lossy = text.replace(urdfs.LIMIT, urdfs.LIMIT + losses(2.0))
    plain, damped = (load_robot(urdfs.write(tmp_path / n, t)) for n, t in (("p", text), ("d", lossy)))
    off = load_robot(tmp_path / "d" / "robot.urdf", damping=False)
    assert damped.resistances == (JointResistance("j", 0, damping=2.0),)
    assert plain.resistances == off.resistances == ()
    q, v, u = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("u")
    graphs = [ca.Function("f", [q, v, u], [JointMechanics(r).force(q, v, u)]) for r in (plain, off, damped)]
    assert graphs[0].n_instructions() == graphs[1].n_instructions() < graphs[2].n_instructions()


def test_friction_is_told_once_by_name_unless_something_is_said(mixed: Path) -> None:
    with pytest.warns(
        NotModelledWarning, match=r"its file gives 'rail', 'hinge', 'ungreased', 'push' is left out"
    ):
        told = load_robot(mixed)
    assert not any(r.friction for r in told.resistances)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert load_robot(mixed, friction="none").resistances == told.resistances
        smooth = load_robot(mixed, friction="smooth", friction_speed=0.02)
    assert {r.name: r.friction for r in smooth.resistances if r.friction} == {
        "rail": 0.5,
        "hinge": 0.2,
        "ungreased": 0.25,
        "push": 0.3,
    }
    assert {r.speed for r in smooth.resistances} == {0.02}
    facts = {j["name"]: j for j in describe(smooth)["joints"]}
    assert (facts["rail"]["damping"], facts["rail"]["friction"]) == (3.0, 0.5)
    assert (facts["push"]["damping"], facts["wheel"]["friction"]) == (5.0, 0.0)


def test_losses_of_planar_and_floating_joints_are_told(tmp_path: Path) -> None:
    text = urdfs.robot(
        link("base", None),
        link("a"),
        joint("table", "planar", "base", "a", extra=losses(1.0)),
        link("b"),
        joint("free", "floating", "a", "b", extra=losses(0.0, 1.0)),
    )
    with pytest.warns(
        NotModelledWarning, match="damping and friction of the planar joint 'table' .*floating joint 'free'"
    ):
        assert load_robot(urdfs.write(tmp_path, text)).resistances == ()


def test_a_locked_joint_loses_nothing(mixed: Path) -> None:
    robot = load_robot(mixed, lock={"hinge": 0.3}, friction="smooth")
    assert [r.name for r in robot.resistances] == ["rail", "wheel", "ungreased"]
    v = np.arange(1.0, 1.0 + robot.nv)
    assert robot.force_elements(robot.q0, v)[0] == pytest.approx(-3.0 * v[0] - 0.5 * np.tanh(v[0] / 0.1))


def test_robot_toml_and_problem_files_say_it(tmp_path: Path) -> None:
    path = urdfs.write(tmp_path, MIXED, 'damping = false\nfriction = "smooth"\nfriction_speed = 0.5\n')
    robot = load_robot(path)
    assert {r.damping for r in robot.resistances} == {0.0}
    assert {r.speed for r in robot.resistances} == {0.5}
    other = robot_from_spec({"name": str(path), "damping": True, "friction": "none"})
    assert {r.friction for r in other.resistances} == {0.0}
    assert robot_from_spec(other.spec).fingerprint == other.fingerprint
    table = {"name": str(path), "friction": "none", "friction_speed": 0.2, "damping": True}
    problem = problem_from_tables(
        {"robot": table, "horizon": {"duration": 1.0, "steps": 5}, "goal": {"v": [0.0] * 4}}
    )
    assert (
        problem.robot.fingerprint
        == dataclasses.replace(other, resistances=problem.robot.resistances).fingerprint
    )
    assert {r.speed for r in problem.robot.resistances} == {0.2}


def test_what_makes_no_sense_is_refused(mixed: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidValue, match=r"friction: got 'rough', expected \"none\" \| \"smooth\""):
        load_robot(mixed, friction="rough")
    with pytest.raises(InvalidValue, match="friction_speed: got 0"):
        load_robot(mixed, friction="smooth", friction_speed=0.0)
    path = urdfs.write(tmp_path / "toml", MIXED, 'friction = "dry"\n')
    with pytest.raises(RobotFileError, match=r"friction: got 'dry', expected \"none\" \| \"smooth\""):
        load_robot(path)


def test_drives_feel_the_losses_of_what_they_move(tmp_path: Path) -> None:
    toml = 'friction = "none"\n[[drive]]\njoint = "rail"\ncontrol = "acceleration"\n'
    robot = load_robot(urdfs.write(tmp_path, MIXED, toml))
    off = dataclasses.replace(robot, resistances=())
    q, v, a = robot.q0, np.array([0.5, 0.0, 0.0, 0.0]), np.zeros(4)
    difference = robot.drive_forces(q, v, a) - off.drive_forces(q, v, a)
    np.testing.assert_allclose(difference, [3.0 * 0.5], atol=1e-12)


ROTATIONS = [f"rotation about {axis}" for axis in "xyz"]
TRANSLATIONS = [f"translation along {axis}" for axis in "xyz"]


@pytest.mark.parametrize(
    ("resistances", "names"),
    [
        ([(1.0, 0.0)] * 3, [*TRANSLATIONS, *ROTATIONS]),
        ([(1.0, 0.0), (1.0, 0.0), (2.0, 0.0)], [*TRANSLATIONS, "rotation about z"]),
        ([(0.0, 0.0), (0.0, 0.0), (0.0, 1.0)], [*TRANSLATIONS, "rotation about z"]),
        ([(1.0, 1.0)] * 3, TRANSLATIONS),
    ],
    ids=["alike", "one differs", "friction on one", "friction on all"],
)
def test_symmetries_of_a_point_mass(resistances: list[tuple[float, float]], names: list[str]) -> None:
    model = chain("PX PY PZ", POINT)[0]
    model.gravity.linear = np.zeros(3)
    found = tuple(
        JointResistance(f"{i}", i, damping=d, friction=f) for i, (d, f) in enumerate(resistances) if d or f
    )
    point = dataclasses.replace(robot_of(model), resistances=found)
    assert [s.name for s in find_symmetries(point)] == names
