"""What symplectic partitioned methods keep over many steps without controls, by the kernel's simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from benchmarks.invariants import SYSTEMS, Free, drift_of, moved
from mbocp._arrays import Array
from mbocp.integrators import PAIRS
from mbocp.robot import Robot
from mbocp.robot.kinematics import momenta_of
from tests.mechanics.models import BODY, ORIGIN, chain
from tests.mechanics.models import robot as robot_of

ON_CONSTRAINTS = [name for name, pair in PAIRS.items() if pair.holds_constraints]
BODY_OF_ITS_OWN, FALLING, FOUR_BAR, ARM = SYSTEMS
FEW_STAGES = [name for name, pair in PAIRS.items() if pair.num_stages <= 2]
SYMPLECTIC = [name for name, pair in PAIRS.items() if pair.is_symplectic]
CHUNK = 10_000  # steps of one simulation: all of them would take gigabytes


def arm(gravity: float) -> Robot:
    """Two links, the axis of the first vertical, nothing that dissipates."""
    model = chain("RZ RX")[0]
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    return robot_of(model)


def top() -> Robot:
    """A body on a ball joint in gravity, with three different moments of inertia."""
    model = chain("Spherical")[0]
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    return robot_of(model)


def flyer(gravity: float) -> Robot:
    """A free-flyer with a second body on a hinge."""
    model = chain("FreeFlyer")[0]
    side = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.1]))
    hinge = model.addJoint(1, pin.JointModelRX(), side, "hinge")
    model.appendBodyToJoint(hinge, BODY, ORIGIN)
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    return robot_of(model)


def energies(robot: Robot, qs: Array, vs: Array) -> Array:
    model, data = robot.model, robot.model.createData()
    return np.array([pin.computeMechanicalEnergy(model, data, q, v) for q, v in zip(qs, vs, strict=True)])


def momenta(robot: Robot, qs: Array, vs: Array) -> Array:
    return momenta_of(robot.model, qs, vs)


@pytest.mark.parametrize("scheme", PAIRS)
def test_momentum_of_a_cyclic_joint_over_ten_thousand_steps(scheme: str) -> None:
    """Nothing pulls at a joint whose axis is vertical, though the other swings in gravity."""
    robot = arm(9.81)
    qs, vs = moved(robot, scheme, 0.02, np.array([0.3, -0.9]), np.array([1.0, -2.0]), CHUNK)
    kept, single = momenta(robot, qs, vs).T
    assert np.abs(kept / kept[0] - 1.0).max() < 1e-13
    assert np.ptp(single) > 0.1 * np.abs(single).max()  # that of the other joint varies


@pytest.mark.parametrize("scheme", ON_CONSTRAINTS)
def test_momentum_on_a_sphere_over_ten_thousand_steps(scheme: str) -> None:
    """Angular momentum of the rigid pendulum about the vertical; the rod and its speed stay, too."""
    robot = replace(mbocp.load_robot("rigid_pendulum"), resistances=())
    q = np.array([3.0, 0.0, -4.0])
    qs, vs = moved(robot, scheme, 0.02, q, np.array([0.0, 2.0, 0.0]), CHUNK)
    kept = qs[:, 0] * vs[:, 1] - qs[:, 1] * vs[:, 0]
    assert np.abs(kept / kept[0] - 1.0).max() < 1e-13
    assert np.abs(np.linalg.norm(qs, axis=1) / 5.0 - 1.0).max() < 1e-12
    assert np.abs(np.einsum("ij,ij->i", qs, vs)).max() < 1e-11


@pytest.mark.parametrize(
    "scheme", [pytest.param(name, marks=[] if name in FEW_STAGES else pytest.mark.slow) for name in PAIRS]
)
def test_momentum_of_a_top_over_ten_thousand_steps(scheme: str) -> None:
    """Angular momentum about the vertical through the pivot; the other two vary."""
    robot = top()
    turned = pin.exp3_quat(np.array([0.4, -0.8, 0.2]))
    qs, vs = moved(robot, scheme, 0.01, turned, np.array([0.5, -1.0, 6.0]), CHUNK)
    pairs = zip(qs, momenta(robot, qs, vs), strict=True)
    kept = np.array([pin.Quaternion(q).toRotationMatrix() @ p for q, p in pairs])
    scale = np.abs(kept).max()
    assert np.ptp(kept[:, 2]) < 1e-13 * scale
    assert np.ptp(kept[:, 0]) > 0.1 * scale
    assert np.abs(np.linalg.norm(qs, axis=1) - 1.0).max() < 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("scheme", PAIRS)
def test_momentum_of_a_free_flyer_over_ten_thousand_steps(scheme: str) -> None:
    """All six components, in the world and about its origin, while a hinge on it moves."""
    robot = flyer(0.0)
    q, v = np.array([0.0] * 6 + [1.0, 0.4]), np.array([0.1, -0.05, 0.02, 0.5, 1.2, -0.7, 0.9])
    qs, vs = moved(robot, scheme, 0.02, q, v, CHUNK)
    ps = momenta(robot, qs, vs)
    pairs = zip(qs, ps, strict=True)
    kept = np.array([pin.XYZQUATToSE3(q[:7]).act(pin.Force(p[:6])).vector for q, p in pairs])
    linear, angular = kept[:, :3], kept[:, 3:]
    reach = 1.0 + np.linalg.norm(qs[:, :3], axis=1).max()  # [m] by which round-off of forces turns
    scale = np.linalg.norm(kept[0])  # those of turning bodies are larger than their sum
    assert np.ptp(linear, axis=0).max() < 1e-13 * scale
    assert np.ptp(angular, axis=0).max() < 1e-13 * scale * reach
    assert np.ptp(ps[:, 6]) > 0.1  # that of the hinge varies


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SYMPLECTIC)
def test_energy_stays_within_bounds_over_a_hundred_thousand_steps(scheme: str) -> None:
    """Ten times as many steps have no larger errors, and no trend."""
    dt = 0.02 if PAIRS[scheme].order == 2 else 0.05
    check_energy(arm(9.81), scheme, dt, np.array([0.5, -0.3]), np.zeros(2))


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SYMPLECTIC)
def test_energy_of_a_top_stays_within_bounds_over_a_hundred_thousand_steps(scheme: str) -> None:
    turned = pin.exp3_quat(np.array([0.4, -0.8, 0.2]))
    dt = 0.01 if PAIRS[scheme].order == 2 else 0.02
    check_energy(top(), scheme, dt, turned, np.array([0.2, -0.4, 1.5]))


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SYMPLECTIC)
def test_energy_of_a_free_flyer_stays_within_bounds_over_a_hundred_thousand_steps(scheme: str) -> None:
    """Without gravity, so that it does not fall out of the numbers."""
    q, v = np.array([0.0] * 6 + [1.0, 0.4]), np.array([0.01, -0.005, 0.002, 0.5, 1.2, -0.7, 0.9])
    check_energy(flyer(0.0), scheme, 0.02, q, v)


def check_energy(robot: Robot, scheme: str, dt: float, q: Array, v: Array) -> None:
    """Over ten times 10,000 steps, of which each begins where the one before ended."""
    start = energies(robot, q[None], v[None])[0]
    largest, means = [], []
    for _ in range(10):
        qs, vs = moved(robot, scheme, dt, q, v, CHUNK)
        errors = energies(robot, qs, vs) - start
        largest.append(np.abs(errors).max())
        means.append(errors.mean())
        q, v = qs[-1], vs[-1]
    first = max(largest[:2])  # a tenth alone has not seen all of a motion that does not repeat itself
    assert max(largest) < 1.2 * first + 1e-10
    assert np.ptp(means) < 0.2 * first + 1e-11


LONG = [
    *((BODY_OF_ITS_OWN, scheme) for scheme in ("midpoint", *SYMPLECTIC)),
    *((FOUR_BAR, scheme) for scheme in ("midpoint", *ON_CONSTRAINTS)),
    # By gauss1 errors go with the speed of its wrist, which grows for a while.
    *((ARM, scheme) for scheme in ("midpoint", *SYMPLECTIC) if scheme != "gauss1"),
]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:start.q. outside the position limits")  # joints turn as they like
@pytest.mark.parametrize(("system", "scheme"), [pytest.param(*c, id=f"{c[0].name}, {c[1]}") for c in LONG])
def test_the_last_tenth_of_a_hundred_thousand_steps_is_like_the_first(system: Free, scheme: str) -> None:
    """Energies of rigid bodies, a linkage and an arm; momenta of symplectic schemes, over 10,000 steps.

    The midpoint rule keeps the energy of a free body to round-off, not its momenta.
    """
    found = drift_of(system, scheme)
    assert found.last < 1.5 * found.first + 1e-12
    if scheme in PAIRS:
        assert found.moved < 0.5 * found.first + 1e-12
        assert system.momenta is None or found.momentum < (2e-13 if scheme == "gauss1" else 1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["gauss1", "lobatto2", "gauss2"])
def test_momenta_of_a_body_that_falls(scheme: str) -> None:
    """Linear across gravity, and angular about it, as parts of what it comes to have along gravity."""
    assert drift_of(FALLING, scheme, parts=1).momentum < 1e-13


def test_compensated_steps_do_not_add_rounding_up() -> None:
    """A momentum that rounding moves by steps as they are stays where rounding of one step leaves it."""
    robot = arm(9.81)
    changes = []
    for compensated in (False, True):
        q, v = np.array([0.3, -0.9]), np.array([1.0, -2.0])
        qs, vs = moved(robot, "lobatto2", 0.02, q, v, CHUNK, compensated=compensated)
        kept = momenta(robot, qs, vs)[:, 0]
        changes.append(np.abs(kept / kept[0] - 1.0).max())
    assert changes[1] < 5e-15
    assert changes[1] < 0.3 * changes[0]
