"""Mimic joints: every algorithm against numeric Pinocchio on all joints, tied by a matrix of the tests."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mbocp._arrays import Array
from mbocp.exceptions import UnsupportedRobot
from mbocp.mechanics import JointMechanics, NaturalMechanics, dual_of_momentum, dual_of_velocity
from mbocp.mechanics.duals import momentum_derivative
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.robot import load_robot
from tests.mechanics.mimics import ROBOTS, Tied, tied
from tests.mechanics.natural_coordinates.test_mechanics import acceleration, check_accelerations
from tests.robot import urdfs
from tests.robot.urdfs import joint, link, mimic


@pytest.fixture(scope="module", params=[*ROBOTS, "hand, floating"])
def pair(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Tied:
    name, floating, _ = request.param.partition(", floating")
    return tied(name, tmp_path_factory.mktemp("mimic"), free_flyer=bool(floating))


def state(pair: Tied, seed: int = 0) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    q = pair.robot.integrate(pair.robot.neutral(), rng.uniform(-1.0, 1.0, pair.robot.nv))
    return np.array(q), rng.standard_normal(pair.robot.nv), rng.standard_normal(pair.robot.nv)


def numbers(function: Callable[..., ca.SX], *at: Array) -> Array:
    """An expression at numbers."""
    symbols = [ca.SX.sym(f"x{i}", len(x)) for i, x in enumerate(at)]
    found: Array = ca.Function("f", symbols, [ca.densify(function(*symbols))])(*at).full()
    return found[:, 0] if found.shape[1] == 1 and found.shape[0] > 1 else found


def close(found: Array, expected: Array) -> None:
    expected = np.asarray(expected)
    np.testing.assert_allclose(
        np.asarray(found).reshape(expected.shape), expected, rtol=0, atol=1e-11 * (1 + np.abs(expected).max())
    )


def test_followers_have_no_coordinates(pair: Tied) -> None:
    assert pair.full.nv == pair.robot.nv + len(pair.ties)
    assert set(pair.full.joint_names) == set(pair.robot.joint_names)


def test_symbolic_dynamics(pair: Tied) -> None:
    mechanics, (q, v, a) = JointMechanics(pair.robot), state(pair)
    tau = pair.inverse_dynamics(q, v, a)
    mass = pair.mass_matrix(q)
    close(numbers(mechanics.inverse_dynamics, q, v, a), tau)
    close(numbers(mechanics.forward_dynamics, q, v, tau), a)
    close(numbers(mechanics.forward_dynamics, q, v, tau), pair.acceleration(q, v, tau))
    close(numbers(mechanics.mass_matrix, q), mass)
    close(numbers(mechanics.inverse_mass_matrix, q), np.linalg.inv(mass))
    close(numbers(mechanics.momentum, q, v), mass @ v)
    close(numbers(mechanics.potential_energy, q), [[pair.full.potential_energy(pair.configuration(q))]])


def test_numeric_dynamics(pair: Tied) -> None:
    robot, (q, v, _) = pair.robot, state(pair, 1)
    at, mass = pair.configuration(q), pair.mass_matrix(q)
    close(robot.mass_matrix(q), mass)
    close(robot.momentum(q, v), mass @ v)
    close(robot.velocity_from_momentum(q, mass @ v), v)
    assert robot.potential_energy(q) == pytest.approx(pair.full.potential_energy(at), rel=1e-12)


@pytest.mark.parametrize("rotations", ["quaternion", "dcm"])
def test_forward_dynamics_of_explicit_schemes(pair: Tied, rotations: str) -> None:
    mechanics, (q, v, _) = ForwardMechanics(pair.robot, rotations), state(pair, 2)
    u = np.linspace(-1.0, 1.0, pair.robot.nu)
    z = mechanics.space.coordinates(q[None])[0]
    rate = numbers(lambda z, s, u: mechanics.speed_rate(z, s, u, ca.SX(0.0)), z, v, u)
    close(rate, pair.acceleration(q, v, pair.robot.actuation_matrix(q) @ u))


def test_natural_coordinates(pair: Tied) -> None:
    """The bodies' accelerations are those of the joints, which are those of all joints tied together."""
    check_accelerations(pair.robot)
    q, v, tau = state(pair, 3)
    close(acceleration(pair.robot, q, v, tau), pair.acceleration(q, v, tau))


def test_momentum_derivative_and_duals(pair: Tied) -> None:
    q, v, _ = state(pair, 4)
    full, G, at = pair.full.model, pair.G, pair.configuration(q)
    rest, data = np.zeros(full.nv), full.createData()
    derivative = pin.computeRNEADerivatives(full, data, at, rest, G @ v)[0].copy()
    derivative -= pin.computeGeneralizedGravityDerivatives(full, data, at)
    close(momentum_derivative(pair.robot, q, v), G.T @ derivative @ G)
    mu = np.random.default_rng(5).standard_normal(2 * pair.robot.nv)
    close(dual_of_momentum(pair.robot, q, v, dual_of_velocity(pair.robot, q, v, mu)), mu)


def test_frames_are_where_those_of_all_joints_are(pair: Tied) -> None:
    mechanics, (q, _, _) = JointMechanics(pair.robot), state(pair, 6)
    full, at = pair.full.model, pair.configuration(q)
    data = full.createData()
    pin.computeJointJacobians(full, data, at)
    pin.updateFramePlacements(full, data)
    for name in ("t2", "f2", "r", "last", "b"):
        if name in pair.robot.frame_names:
            frame, other = pair.robot.frame_id(name), pair.full.frame_id(name)
            jacobian = pin.getFrameJacobian(full, data, other, pin.LOCAL_WORLD_ALIGNED).reshape(6, full.nv)
            close(
                numbers(lambda q, frame=frame: mechanics.frame_position(frame, q), q),
                data.oMf[other].translation,
            )
            close(
                numbers(lambda q, frame=frame: mechanics.frame_rotation(frame, q), q),
                data.oMf[other].rotation,
            )
            moved = numbers(lambda q, frame=frame: mechanics.frame_translation_jacobian(frame, q), q)
            close(moved, (jacobian @ pair.G)[:3])


@pytest.mark.parametrize("angle", [0.3, 2.4, -2.4])
def test_followers_that_turn_further_than_half_a_turn(angle: float, tmp_path_factory) -> None:
    """-1.5 times 2.4 rad is more than half a turn: the row that ties the bodies must not notice."""
    pair = tied("pair", tmp_path_factory.mktemp("far"))
    mechanics = NaturalMechanics(pair.robot)
    z = mechanics.tree.coordinates(np.array([[angle]]))[0]
    assert np.abs(numbers(mechanics.constraints, z)).max() < 1e-12
    moved = mechanics.tree.coordinates(np.array([[angle + 1e-3]]))[0]
    z[mechanics.tree.body(1).at :][:12] = moved[mechanics.tree.body(1).at :][:12]  # the leader alone
    row = [label.name for label in mechanics.constraint_labels].index("jb follows")
    assert abs(numbers(mechanics.constraints, z)[row]) == pytest.approx(1.5e-3, rel=1e-9)


@pytest.mark.parametrize(("kind", "ratio"), [("prismatic", 0.3), ("revolute", 1.5)])
def test_natural_coordinates_refuse_followers_of_unknown_turns(kind: str, ratio: float, tmp_path) -> None:
    far = '<limit lower="-9" upper="9" effort="3" velocity="4"/>'
    path = urdfs.write(
        tmp_path,
        urdfs.robot(
            link("base", None),
            link("a"),
            joint("ja", "revolute", "base", "a", extra=far),
            link("b"),
            joint("jb", kind, "base", "b", extra=mimic("ja", ratio).replace(urdfs.LIMIT, far)),
        ),
    )
    with pytest.raises(UnsupportedRobot, match=r"joint 'jb' follows 'ja' at the ratio .*take coordinates"):
        NaturalMechanics(load_robot(path))
