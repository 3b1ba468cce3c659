"""Symmetries and their control momenta: what is found, what is not, and Noether's theorem."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from mbocp._arrays import Array
from mbocp.integrators import TAU, VELOCITY_TAU
from mbocp.mechanics.symmetries.finding import find_symmetries, momentum_map
from mbocp.mechanics.symmetries.spins import independent_parts
from mbocp.robot import FrameActuator, QuarticSpring, Robot, Rod, SpringDamper
from tests.mechanics.models import (
    BODY,
    POINT,
    cart_pendulum,
    chain,
    elastic_pendulum,
    point_mass,
    robot,
    spherical_pendulum,
    weightless,
)

TRANSLATIONS = ["translation along x", "translation along y", "translation along z"]
ROTATIONS = ["rotation about x", "rotation about y", "rotation about z"]


def names(subject: Robot) -> list[str]:
    return [s.name for s in find_symmetries(subject)]


def rotor_drone() -> Robot:
    model, _ = chain("FreeFlyer")
    arm = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0]))  # [m]
    rotor = model.addFrame(pin.Frame("rotor", 1, 0, arm, pin.FrameType.OP_FRAME))
    thrust = FrameActuator("thrust", rotor, np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.1]))
    return robot(model, B=np.zeros((6, 0)), actuators=(thrust,))


def satellite_on_a_spring() -> Robot:
    """Free body and a point mass, joined by a spring-damper off the centre."""
    model, body = chain("FreeFlyer")
    hook = model.addFrame(
        pin.Frame("hook", 1, body, pin.SE3(np.eye(3), np.array([0.2, 0, 0.1])), pin.FrameType.OP_FRAME)
    )
    model, bob = chain("PX PY PZ", POINT, model=model, prefix="bob_")
    return robot(weightless(model), forces=(SpringDamper("spring", hook, bob, 3.0, damping=0.4, length=0.5),))


def rover() -> Robot:
    """Planar base that carries a revolute joint."""
    model, _ = chain("Planar")
    joint = model.addJoint(1, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.3, 0.1, 0.0])), "arm")
    model.appendBodyToJoint(joint, BODY, pin.SE3.Identity())
    return robot(model, B=np.eye(4)[:, 3:])


CASES: list[tuple[str, Callable[[], Robot], list[str]]] = [
    ("free point mass", point_mass, [*TRANSLATIONS, "rotation about z"]),
    ("elastic pendulum", elastic_pendulum, ["rotation about z"]),
    ("rigid pendulum", spherical_pendulum, ["rotation about z"]),
    ("weightless pendulum", lambda: spherical_pendulum(gravity=False), ROTATIONS),
    (
        "pendulum at (1, 2, 3)",
        lambda: spherical_pendulum(pivot=(1.0, 2.0, 3.0)),
        ["rotation about z through (1, 2, 0)"],
    ),
    ("cart pendulum", cart_pendulum, ["translation along x"]),
    ("free body", lambda: robot(chain("FreeFlyer")[0]), [*TRANSLATIONS, "rotation about z"]),
    ("weightless body", lambda: robot(weightless(chain("FreeFlyer")[0])), [*TRANSLATIONS, *ROTATIONS]),
    ("drone with a rotor", rotor_drone, [*TRANSLATIONS, "rotation about z"]),
    ("ball joint", lambda: robot(chain("Spherical")[0]), ["rotation about z"]),
    (
        "sliders and ball joint",
        lambda: robot(chain("PX PY PZ Spherical")[0]),
        [*TRANSLATIONS, "rotation about z"],
    ),
    ("gantry with a wrist", lambda: robot(chain("PX PY PZ RZ")[0]), [*TRANSLATIONS, "rotation about z"]),
    ("unbounded base joint", lambda: robot(chain("RUBZ RY")[0]), ["rotation about z"]),
    ("planar base", rover, ["translation along x", "translation along y", "rotation about z"]),
    ("satellite on a spring", satellite_on_a_spring, [*TRANSLATIONS, *ROTATIONS]),
    ("hinges that are not vertical", lambda: robot(chain("RY RY")[0]), []),
    ("hinges without gravity", lambda: robot(weightless(chain("RY RX")[0])), ["rotation about y"]),
]


@pytest.mark.parametrize(("build", "expected"), [c[1:] for c in CASES], ids=[c[0] for c in CASES])
def test_what_is_found(build: Callable[[], Robot], expected: list[str]) -> None:
    assert names(build()) == expected


def two_bobs(*forces: Any) -> Robot:
    """Two hinges one upon the other, and one beside them on a branch of its own."""
    model, _ = chain("RZ RY", prefix="left_")
    aside = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([0.0, 2.0, 0.0])), "right_0")
    model.appendBodyToJoint(aside, BODY, pin.SE3.Identity())
    lever = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0]))
    a = model.addFrame(pin.Frame("a", 2, 0, lever, pin.FrameType.OP_FRAME))
    b = model.addFrame(pin.Frame("b", aside, 0, lever, pin.FrameType.OP_FRAME))
    return robot(model, B=np.eye(3), forces=tuple(force(a, b) for force in forces))


def test_robots_that_nothing_joins_have_symmetries_of_their_own() -> None:
    apart = two_bobs()
    assert [len(joints) for joints in independent_parts(apart)] == [2, 1]
    left, right = find_symmetries(apart)
    assert left.name.startswith("rotation about z of left_")
    assert right.name == "rotation about z through (0, 2, 0) of right_0"
    assert left.constant == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
    assert right.constant == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)
    tied = two_bobs(lambda a, b: QuarticSpring("band", a, b, 1.0, 1.0))
    assert len(independent_parts(tied)) == 1
    assert names(tied) == []


def test_what_joins_two_parts() -> None:
    apart = two_bobs()
    geared = np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.0]])  # one motor turns both
    assert len(independent_parts(robot(apart.model, B=geared))) == 1
    a, b = (apart.model.getFrameId(name) for name in "ab")
    assert len(independent_parts(robot(apart.model, B=np.eye(3), constraints=(Rod("rod", a, b, 2.0),)))) == 1


def test_a_second_pivot_breaks_the_symmetry() -> None:
    model, bob = chain("PX PY PZ", POINT)
    aside = model.addFrame(
        pin.Frame("aside", 0, 0, pin.SE3(np.eye(3), np.array([1.0, 0, 0])), pin.FrameType.OP_FRAME)
    )
    springs = tuple(QuarticSpring(f"to {f}", bob, f, 1.0, 1.0) for f in (0, aside))
    assert names(robot(model, forces=springs)) == []


def test_gravity_may_point_anywhere() -> None:
    model, bob = chain("PX PY PZ", POINT)
    model.gravity.linear = np.array([0.0, -6.0, -8.0])
    assert names(robot(model, constraints=(Rod("rod", bob, 0, 2.0),))) == ["rotation about (0, 0.6, 0.8)"]


@pytest.mark.parametrize(
    ("B", "found"),
    [
        (np.eye(3), True),
        (np.eye(3)[:, :2], True),  # horizontal forces turn among themselves
        (np.eye(3)[:, 2:], True),  # a vertical force stays
        (np.diag([1.0, 1.0, 3.0]), True),
        (np.eye(3)[:, :1], False),  # one horizontal force distinguishes a direction
        (np.diag([1.0, 2.0, 1.0]), False),  # the effort |u|^2 would change
    ],
)
def test_the_actuation_must_turn_along(B: Array, found: bool) -> None:
    assert (names(spherical_pendulum(B=B)) == ["rotation about z"]) == found


def test_a_rotor_of_its_own_for_each_slider_breaks_the_rotation() -> None:
    model, bob = chain("PX PY PZ", POINT)
    model.armature = np.array([0.5, 0.5, 0.1])
    rod = Rod("rod", bob, 0, 2.0)
    assert names(robot(model, constraints=(rod,))) == ["rotation about z"]
    model.armature = np.array([0.5, 0.2, 0.1])
    assert names(robot(model, constraints=(rod,))) == []


def test_three_hinges_are_a_ball_joint_but_their_angles_do_not_step_like_one() -> None:
    assert names(robot(weightless(chain("RX RY RZ")[0]))) == ["rotation about x"]


@pytest.mark.parametrize("case", CASES, ids=[c[0] for c in CASES])
def test_every_body_moves_by_the_twist(case: Any) -> None:
    subject = case[1]()
    model, data = subject.model, subject.model.createData()
    rng = np.random.default_rng(3)
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    pin.computeJointJacobians(model, data, q)
    for symmetry in find_symmetries(subject):
        field = symmetry.generator(q[None])[0]
        for joint in range(1, model.njoints):
            center = data.oMi[joint].act(model.inertias[joint].lever)
            velocity = pin.getJointJacobian(model, data, joint, pin.WORLD) @ field
            if model.inertias[joint].mass > 0:
                at_center = velocity[:3] + np.cross(velocity[3:], center)
                expected = symmetry.twist[:3] + np.cross(symmetry.twist[3:], center)
                np.testing.assert_allclose(at_center, expected, atol=1e-12)


class Step:
    """One step of a scheme with random states, controls and multipliers, that satisfies its equations."""

    def __init__(self, subject: Robot, scheme: str, seed: int) -> None:
        self.robot, self.tau, self.dt = subject, TAU[scheme], 0.1  # [s]
        self.share = VELOCITY_TAU[scheme]
        rng = np.random.default_rng(seed)
        nv = subject.nv
        self.q0 = pin.integrate(subject.model, pin.neutral(subject.model), rng.normal(size=nv))
        v_tau = rng.normal(size=nv)
        self.u, self.lam = rng.normal(size=subject.nu), rng.normal(size=subject.nc)
        self.mu = rng.normal(size=2 * nv)
        q_tau = pin.integrate(subject.model, self.q0, self.tau * self.dt * v_tau)
        missing = self.momentum_row(q_tau, v_tau, np.zeros(nv), self.u) / self.dt
        acceleration = np.linalg.solve(subject.mass_matrix(q_tau), missing)
        self.v0 = v_tau - self.tau * self.dt * acceleration
        self.v1 = v_tau + (1 - self.tau) * self.dt * acceleration
        self.q1 = pin.integrate(subject.model, self.q0, self.dt * self.rate(self.v0, self.v1))

    def rate(self, v0: Array, v1: Array) -> Array:
        """Velocity of the kinematics."""
        return (1 - self.share) * v0 + self.share * v1

    def momentum_row(self, q: Array, v: Array, a: Array, u: Array) -> Array:
        r = self.robot
        force = r.actuation_matrix(q) @ u + r.force_elements(q, v)
        if r.nc:
            force = force - r.constraint_jacobian(q).T @ self.lam
        inertial: Array = pin.rnea(r.model, r.model.createData(), q, v, a)
        return self.dt * (force - inertial)

    def lagrangian(self, q0: Array, v0: Array, q1: Array, v1: Array, u: Array) -> float:
        """mu . F, eq. (22) without the cost, with the rows of `mbocp.integrators`."""
        nv, model = self.robot.nv, self.robot.model
        v = (1 - self.tau) * v0 + self.tau * v1
        q = {0.0: q0, 1.0: q1}.get(self.tau, pin.integrate(model, q0, self.tau * self.dt * v))
        kinematic = pin.difference(model, q1, pin.integrate(model, q0, self.dt * self.rate(v0, v1)))
        row = self.momentum_row(q, v, (v1 - v0) / self.dt, u)
        return float(self.mu[:nv] @ kinematic + self.mu[nv:] @ row)

    def costate(self) -> Array:
        """Derivative of the Lagrangian in the state at the start."""
        nv, model = self.robot.nv, self.robot.model

        def moved(direction: Array) -> Callable[[float], float]:
            return lambda e: self.lagrangian(
                pin.integrate(model, self.q0, e * direction[:nv]),
                self.v0 + e * direction[nv:],
                self.q1,
                self.v1,
                self.u,
            )

        return np.array([derivative(moved(direction)) for direction in np.eye(2 * nv)])


def derivative(f: Callable[[float], float]) -> float:
    weights = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
    h = 0.02
    return sum(w / h * (f(k * h) - f(-k * h)) for k, w in weights.items())


@pytest.mark.parametrize("scheme", TAU)
@pytest.mark.parametrize("case", [c for c in CASES if c[2]], ids=[c[0] for c in CASES if c[2]])
def test_noether(case: Any, scheme: str) -> None:
    """The Lagrangian of a step does not change along a symmetry.

    So what it gains at the start of the step, the momentum, is what it loses at its end; with stationarity
    in x_n and u that is the momentum of the next step.
    """
    subject = case[1]()
    model = subject.model
    for symmetry in find_symmetries(subject):
        s = Step(subject, scheme, seed=7)
        assert abs(s.lagrangian(s.q0, s.v0, s.q1, s.v1, s.u)) < 1e-12

        def moved(q: Array, v: Array, epsilon: float, symmetry: Any = symmetry) -> tuple[Array, Array]:
            field = symmetry.generator(q[None])[0]
            return pin.integrate(model, q, epsilon * field), v + epsilon * symmetry.velocity_generator(
                v[None]
            )[0]

        def start(epsilon: float, s: Step = s) -> float:
            return s.lagrangian(*moved(s.q0, s.v0, epsilon), s.q1, s.v1, s.u)

        def end(epsilon: float, s: Step = s, symmetry: Any = symmetry) -> float:
            turned = s.u + epsilon * symmetry.control @ s.u
            return s.lagrangian(s.q0, s.v0, *moved(s.q1, s.v1, epsilon), turned)

        (momentum,) = momentum_map(symmetry, s.q0[None], s.v0[None], s.costate()[None])
        assert derivative(start) == pytest.approx(momentum, abs=1e-9), symmetry.name
        assert derivative(end) == pytest.approx(-momentum, abs=1e-9), symmetry.name


def test_the_papers_formula() -> None:
    """Eq. (15): xi = q x mu^q + p x mu^p for point masses in Cartesian coordinates."""
    rng = np.random.default_rng(5)
    qs, vs, mus = rng.normal(size=(9, 3)), rng.normal(size=(9, 3)), rng.normal(size=(9, 6))
    xi = np.cross(qs, mus[:, :3]) + np.cross(vs, mus[:, 3:])  # the mass is 1 kg
    free = spherical_pendulum(gravity=False)
    found = np.array([momentum_map(s, qs, vs, mus) for s in find_symmetries(free)]).T
    np.testing.assert_allclose(found, xi, atol=1e-12)
    (about_z,) = find_symmetries(elastic_pendulum())
    np.testing.assert_allclose(momentum_map(about_z, qs, vs, mus), xi[:, 2], atol=1e-12)


def test_the_cart_pendulums_translation() -> None:
    rng = np.random.default_rng(6)
    qs, vs, mus = rng.normal(size=(9, 3)), rng.normal(size=(9, 3)), rng.normal(size=(9, 6))
    (along_x,) = find_symmetries(cart_pendulum())
    expected = mus[:, 0] + mus[:, 1]
    np.testing.assert_allclose(momentum_map(along_x, qs, vs, mus), expected, atol=1e-12)


def test_what_a_symmetry_touches() -> None:
    (about_z,) = find_symmetries(spherical_pendulum())
    height, side, vertical_momentum, momentum = (np.eye(6, dtype=bool)[i] for i in (2, 0, 5, 3))
    assert not about_z.touches(np.zeros(6))
    assert not about_z.touches(height)
    assert not about_z.touches(vertical_momentum)
    assert about_z.touches(side)
    assert about_z.touches(momentum)
    free = {s.name: s for s in find_symmetries(robot(chain("FreeFlyer")[0]))}
    body_momentum = np.arange(12) >= 6
    assert not free["rotation about z"].touches(body_momentum)
    assert free["rotation about z"].touches(~body_momentum)
