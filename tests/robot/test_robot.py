"""What a loaded robot computes: identities, on the manifold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mbocp._arrays import Array
from mbocp.exceptions import DimensionMismatch, InvalidValue, LoopNotClosed, UnknownFrame
from mbocp.robot import InitialPoseWarning, NormalisationWarning, Robot, load_robot
from tests.robot import urdfs

ROBOTS = ["kinova", "hector", "solo12", "cart_pendulum_rigid"]
TOML = """
[actuation]
joints = ["j1", "j2"]
[[constraint]]
type = "rod"
name = "brace"
frames = ["l3", "l1"]
[[spring]]
name = "cord"
frames = ["l3", "world"]
coefficient = 3.0
length = 0.4
[[spring_damper]]
name = "strut"
frames = ["base", "l2"]
stiffness = 20.0
damping = 2.0
length = 0.3
[[spring_damper]]
name = "pull"
frames = ["l3", "base"]
stiffness = 5.0
damping = 1.0
length = 0.0
[[actuator]]
type = "thruster"
name = "jet"
frame = "l3"
axis = [0, 3, 4]
torque_ratio = 0.1
[initial]
q = { j2 = 0.5 }
"""


@pytest.fixture(scope="module")
def braced(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """A free-floating chain with everything that a robot.toml can add."""
    folder = tmp_path_factory.mktemp("braced")
    return load_robot(urdfs.write(folder, urdfs.chain(*["revolute"] * 3), "free_flyer = true\n" + TOML))


def random_state(robot: Robot, seed: int) -> tuple[Array, Array]:
    generator = np.random.default_rng(seed)
    return robot.integrate(robot.q0, generator.normal(size=robot.nv)), generator.normal(size=robot.nv)


def tangent_derivative(robot: Robot, function: object, q: Array, h: float = 1e-6) -> Array:
    columns = [(function(robot.integrate(q, h * e)) - function(robot.integrate(q, -h * e))) / (2 * h)  # type: ignore[operator]
               for e in np.eye(robot.nv)]  # fmt: skip
    return np.array(columns).T


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=20)
@given(data=st.data())
def test_integrate_and_difference_are_inverse(name: str, data: st.DataObject) -> None:
    robot = load_robot(name)
    # Below half a turn, the logarithm is the inverse of the exponential.
    step = data.draw(arrays(np.float64, robot.nv, elements=st.floats(-1.0, 1.0)))
    q = robot.integrate(robot.q0, data.draw(arrays(np.float64, robot.nv, elements=st.floats(-3.0, 3.0))))
    moved = robot.integrate(q, step)
    np.testing.assert_allclose(robot.difference(q, moved), step, atol=1e-9)
    np.testing.assert_allclose(robot.normalise(moved), moved, atol=1e-12)


@settings(max_examples=50)
@given(scale=st.floats(1e-3, 1e3), numbers=arrays(np.float64, 4, elements=st.floats(-1, 1)))
def test_normalise_keeps_the_direction(scale: float, numbers: Array) -> None:
    robot = load_robot("hector")
    norm = float(np.linalg.norm(numbers))
    if norm < 1e-3:
        return
    unit = numbers / norm
    q = np.concatenate([[1.0, 2.0, 3.0], scale * unit])
    if abs(scale - 1) > 1e-9:
        with pytest.warns(
            NormalisationWarning, match=r"q\[3:7\], the quaternion of joint 'root_joint': norm"
        ):
            out = robot.normalise(q)
    else:
        out = robot.normalise(q)
    np.testing.assert_allclose(out, [1, 2, 3, *unit], atol=1e-12)
    assert not out.flags.writeable


def test_normalise_refuses_what_has_no_direction() -> None:
    drone, arm = load_robot("hector"), load_robot("kinova")
    with pytest.raises(
        InvalidValue, match=r"start.q.*quaternion of joint 'root_joint': got norm 0, expected a unit"
    ):
        drone.normalise(np.zeros(7), name="start.q")
    q = np.array(arm.q0)
    q[arm.configuration_indices("j2s6s200_joint_1")] = 0
    with pytest.raises(InvalidValue, match="cos/sin pair of joint 'j2s6s200_joint_1'"):
        arm.normalise(q)
    with pytest.raises(InvalidValue, match=r"robot 'hector': q: got .*nan.*expected finite numbers"):
        drone.normalise([np.nan] * 7)
    with pytest.raises(DimensionMismatch, match=r"robot 'hector': q: got shape \(6,\), expected \(7,\)"):
        drone.normalise(np.zeros(6))


@pytest.mark.parametrize("name", ROBOTS)
def test_momentum_and_velocity(name: str) -> None:
    robot = load_robot(name)
    q, v = random_state(robot, 1)
    p = robot.momentum(q, v)
    np.testing.assert_allclose(p, robot.mass_matrix(q) @ v, rtol=1e-12)
    np.testing.assert_allclose(robot.velocity_from_momentum(q, p), v, rtol=1e-8, atol=1e-10)
    np.testing.assert_array_equal(robot.mass_matrix(q), robot.mass_matrix(q).T)


def test_constraint_jacobian_against_differences(braced: Robot) -> None:
    np.testing.assert_allclose(braced.constraint_residual(braced.q0), [0.0], atol=1e-15)
    q, _ = random_state(braced, 2)
    expected = tangent_derivative(braced, braced.constraint_residual, q)
    np.testing.assert_allclose(braced.constraint_jacobian(q), expected, atol=1e-8)
    assert [str(label) for label in braced.constraint_labels] == ["brace [m^2]"]


def test_forces_against_the_potential(braced: Robot) -> None:
    weightless = load_robot(Path(str(braced.spec["name"])), gravity=(0, 0, 0))
    q, v = random_state(weightless, 3)
    expected = -tangent_derivative(weightless, lambda x: np.array([weightless.potential_energy(x)]), q)[0]
    np.testing.assert_allclose(weightless.force_elements(q, np.zeros(9)), expected, atol=1e-7)
    damping = weightless.force_elements(q, v) - weightless.force_elements(q, np.zeros(9))
    assert damping @ v < 0


def test_frame_actuators_do_the_work_of_their_wrench(braced: Robot) -> None:
    import pinocchio as pin

    assert [str(u) for u in braced.u_labels] == ["j1 [N m]", "j2 [N m]", "jet [N]"]
    assert not braced.actuation.is_constant
    q, v = random_state(braced, 4)
    tau = braced.actuation_matrix(q) @ [0.0, 0.0, 2.5]
    data = braced.model.createData()
    pin.forwardKinematics(braced.model, data, q, v)
    twist = pin.getFrameVelocity(braced.model, data, braced.frame_id("l3"), pin.LOCAL).vector
    axis = np.array([0, 0.6, 0.8])
    assert tau @ v == pytest.approx(2.5 * (axis @ twist[:3] + 0.1 * axis @ twist[3:]), rel=1e-12)


def test_an_initial_pose_off_the_constraints_is_told(tmp_path: Path) -> None:
    toml = TOML.replace('frames = ["l3", "l1"]', 'frames = ["l3", "l1"]\nlength = 0.6')
    path = urdfs.write(tmp_path, urdfs.chain(*["revolute"] * 3), toml)
    with pytest.warns(InitialPoseWarning, match="the initial pose violates 'brace' by .*the nearest"):
        robot = load_robot(path)
    assert abs(robot.constraint_residual(robot.q0)[0]) < 1e-14


def test_a_rod_that_is_too_long_is_refused_by_name(tmp_path: Path) -> None:
    toml = TOML.replace('frames = ["l3", "l1"]', 'frames = ["l3", "l1"]\nlength = 0.7')
    path = urdfs.write(tmp_path, urdfs.chain(*["revolute"] * 3), toml)
    with pytest.raises(LoopNotClosed, match=r"the nearest configuration violates 'brace' by -0\.\d+ m\^2"):
        load_robot(path)


def test_frames(braced: Robot) -> None:
    assert braced.frame_id("world") == braced.frame_id("universe") == 0
    with pytest.raises(UnknownFrame, match=r"robot 'braced.*' has no frame 'l33': did you mean 'l3'"):
        braced.frame_id("l33")


def test_what_is_no_array_of_numbers_is_told_by_name(braced: Robot) -> None:
    with pytest.raises(InvalidValue, match=r": q: got 'load', expected an array of numbers"):
        braced.frame_placement("load", "load")  # type: ignore[arg-type]


def test_fingerprint_tells_what_shapes_the_equations(tmp_path: Path) -> None:
    urdf = urdfs.chain(*["revolute"] * 3)
    base = load_robot(urdfs.write(tmp_path, urdf, TOML))
    assert base.fingerprint == load_robot(tmp_path).fingerprint
    changes = {
        "stiffness = 20.0": "stiffness = 20.5",
        "coefficient = 3.0": "coefficient = 3.1",
        "torque_ratio = 0.1": "torque_ratio = 0.2",
        'joints = ["j1", "j2"]': 'joints = ["j2", "j1"]',
        "[actuation]": "gravity = [0, 0, -9.8]\n[actuation]",
    }
    seen = {base.fingerprint}
    for old, new in changes.items():
        assert old in TOML
        seen.add(load_robot(urdfs.write(tmp_path, urdf, TOML.replace(old, new))).fingerprint)
    assert len(seen) == len(changes) + 1
    renamed = load_robot(urdfs.write(tmp_path, urdf, 'name = "other"\n' + TOML))
    assert renamed.fingerprint == base.fingerprint


def test_arrays_are_read_only() -> None:
    robot = load_robot("ur5")
    for array in (robot.q0, robot.limits.effort, robot.actuation.selection, robot.mass_matrix(robot.q0)):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    assert repr(robot) == "Robot('ur5', nq=6, nv=6, nu=6, nc=0)"
