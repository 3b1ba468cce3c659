"""Forward dynamics with drives: the free rows of Pinocchio's inverse dynamics vanish at the result."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mbocp._arrays import Array
from mbocp.exceptions import UnsupportedRobot
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.robot import Robot, load_robot
from tests.mechanics.models import robot as robot_of
from tests.mechanics.models import spherical_pendulum
from tests.robot.test_drives import BALL, FORWARD, TURN, load


@pytest.fixture(scope="module", params=["unicycle", "cart"])
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    if request.param == "unicycle":
        return load_robot("unicycle_pendulum")
    return load(tmp_path_factory.mktemp("cart"), BALL + FORWARD + TURN)


def velocity(robot: Robot, q: Array, s: Array, u: Array) -> Array:
    return np.asarray(robot.speed_map(q) @ s + robot.control_velocity_map(q) @ u)


@pytest.mark.parametrize("rotations", ["quaternion", "dcm"])
def test_free_components_feel_no_other_force(robot: Robot, rotations: str) -> None:
    mechanics = ForwardMechanics(robot, rotations)
    assert mechanics.ns == robot.num_speeds
    z, s, u = ca.SX.sym("z", mechanics.nq), ca.SX.sym("s", mechanics.ns), ca.SX.sym("u", mechanics.nu)
    rates = [mechanics.velocity(z, s, u), mechanics.speed_rate(z, s, u, ca.SX(0.0))]
    function = ca.Function("f", [z, s, u], rates)
    free = [i for i in range(robot.nv) if i not in robot.driven]
    rng = np.random.default_rng(2)
    for _ in range(5):
        q = robot.integrate(robot.q0, rng.uniform(-1, 1, robot.nv))
        speeds, controls = rng.uniform(-2, 2, robot.num_speeds), rng.uniform(-2, 2, robot.nu)
        got = function(mechanics.space.coordinates(q[None])[0], speeds, controls)
        v, rate = (np.asarray(out).ravel() for out in got)
        assert np.allclose(v, velocity(robot, q, speeds, controls), rtol=0, atol=1e-13)
        # dv/dt while controls stand still
        h = 1e-5
        ahead, behind = (
            velocity(robot, robot.integrate(q, t * v), speeds + t * rate, controls) for t in (h, -h)
        )
        a = (ahead - behind) / (2 * h)
        left = pin.rnea(robot.model, robot.model.createData(), q, v, a)
        left -= robot.actuation_matrix(q) @ controls
        assert np.abs(left[free]).max() < 1e-7
        names = [label.name for label in robot.u_labels]
        pushed = [names.index(d.name) for d in robot.drives if d.control == "acceleration"]
        assert np.array_equal(rate[-len(pushed) :], controls[pushed])


def test_without_drives_speeds_are_velocities() -> None:
    robot = spherical_pendulum(gravity=True)
    mechanics = ForwardMechanics(robot)
    q, s, u = (ca.SX.sym(name, 3) for name in "qsu")
    assert mechanics.velocity(q, s, u) is s
    assert mechanics.ns == robot.nv


def test_drives_and_constraints_are_refused(tmp_path: Path) -> None:
    robot = load(tmp_path, BALL + FORWARD)
    both = robot_of(robot.model, constraints=spherical_pendulum().constraints)
    object.__setattr__(both, "actuation", robot.actuation)
    with pytest.raises(UnsupportedRobot, match=r"drives \('forward', \.\.\.\).*constraints \('rod'"):
        ForwardMechanics(both)
