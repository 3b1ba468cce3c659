"""What explicit integrators need of the groups: rates, brackets, projections, guards, rotation matrices."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from mbocp._arrays import Array
from mbocp.lie import ConfigurationSpace
from mbocp.lie.groups import Circle, Plane, RotationMatrix
from tests.mechanics.models import ORIGIN

JOINTS = {
    "prismatic": "PY",
    "continuous": "RUBZ",
    "spherical": "Spherical",
    "planar": "Planar",
    "free_flyer": "FreeFlyer",
}
CASES = [(name, rotations) for name in (*JOINTS, "all") for rotations in ("quaternion", "dcm")]


class Space:
    """A configuration space with its maps as functions of numbers."""

    def __init__(self, name: str, rotations: str) -> None:
        self.model, parent = pin.Model(), 0
        for kind in JOINTS.values() if name == "all" else [JOINTS[name]]:
            joint = getattr(pin, f"JointModel{kind}")()
            parent = self.model.addJoint(parent, joint, ORIGIN, f"{kind}_{parent}")
        self.space = ConfigurationSpace(self.model, rotations)
        z, g = ca.SX.sym("z", self.space.nz), ca.SX.sym("g", self.space.nz)
        v, w = ca.SX.sym("v", self.space.nv), ca.SX.sym("w", self.space.nv)
        t = ca.SX.sym("t", 2)
        self.integrate = ca.Function("integrate", [z, v], [self.space.integrate(z, v)])
        self.difference = ca.Function("difference", [g, z], [self.space.difference(g, z)])
        self.projection = ca.Function("projection", [g, z], [self.space.projection(g, z)])
        self.rate = ca.Function("rate", [z, v], [self.space.rate(z, v)])
        self.dexp = ca.Function("dexp", [v, w], [self.space.dexp(v, w)])
        self.bracket = ca.Function("bracket", [v, w], [self.space.bracket(v, w)])
        self.attraction = ca.Function("attraction", [z], [self.space.attraction(z, ca.SX(2), ca.SX(1))])
        self.defects = ca.Function("defects", [z], [self.space.defects(z)])
        guards = [guard for _, guard in self.space.guards(g, z)]
        self.guards = ca.Function("guards", [g, z], [ca.vertcat(*guards) if guards else ca.SX(0, 1)])
        # How a commutator of motions differs from none, to second order.
        there = self.space.integrate(self.space.integrate(z, t[0] * v), t[1] * w)
        other = self.space.integrate(self.space.integrate(z, t[1] * w), t[0] * v)
        mixed = ca.jacobian(ca.jacobian(self.space.difference(other, there), t[0]), t[1])
        self.commutator = ca.Function("commutator", [z, v, w], [ca.substitute(mixed, t, ca.SX.zeros(2))])
        self.rng = np.random.default_rng(4)

    def random(self, size: float = 2.0) -> Array:
        """Coordinates of some configuration."""
        return self.moved(self.neutral, self.rng.uniform(-size, size, self.model.nv))

    @property
    def neutral(self) -> Array:
        return self.coordinates(pin.neutral(self.model))

    def coordinates(self, q: Array) -> Array:
        return np.asarray(self.space.coordinates(q[None])[0])

    def configuration(self, z: Array) -> Array:
        return np.asarray(self.space.configurations(z[None])[0])

    def moved(self, z: Array, v: Array) -> Array:
        return numbers(self.integrate(z, v))

    def tangent(self) -> Array:
        return self.rng.standard_normal(self.model.nv)


def numbers(value: ca.DM) -> Array:
    return np.asarray(value).ravel()


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def space(request: pytest.FixtureRequest) -> Space:
    return Space(*request.param)


# --- maps -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 0.1, 1.0, 2.9])
def test_maps_equal_pinocchio_s(space: Space, size: float) -> None:
    for _ in range(3):
        q = pin.integrate(space.model, pin.neutral(space.model), space.rng.uniform(-2, 2, space.model.nv))
        v = space.tangent()
        v *= size / max(1.0, np.linalg.norm(v))
        z, there = space.coordinates(q), pin.integrate(space.model, q, v)
        assert np.abs(numbers(space.defects(z))).max(initial=0.0) < 1e-15 * 4
        got = space.configuration(space.moved(z, v))
        assert np.abs(pin.difference(space.model, there, got)).max() < 2e-14
        back = numbers(space.difference(z, space.moved(z, v)))
        assert np.allclose(back, v, rtol=1e-11, atol=1e-13)


def test_matrices_equal_scipy_s() -> None:
    group = RotationMatrix()
    z, v, g = ca.SX.sym("z", 9), ca.SX.sym("v", 3), ca.SX.sym("g", 9)
    integrate = ca.Function("i", [z, v], [group.integrate(z, v)])
    difference = ca.Function("d", [g, z], [group.difference(g, z)])
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-12, 1e-7, 1e-3, 0.3, 0.99, 1.01, 2.0, 3.1):
        start, turn = Rotation.random(random_state=rng), rng.standard_normal(3)
        turn *= size / np.linalg.norm(turn)
        end = (start * Rotation.from_rotvec(turn)).as_matrix()
        got = numbers(integrate(start.as_matrix().ravel(order="F"), turn))
        assert np.allclose(got, end.ravel(order="F"), rtol=0, atol=3e-15)
        back = numbers(difference(start.as_matrix().ravel(order="F"), end.ravel(order="F")))
        assert np.allclose(back, turn, rtol=1e-12, atol=1e-15 if size < 1e-2 else 1e-13)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-7, 1e-3, 0.5])
def test_derivatives_at_no_motion_are_finite(space: Space, size: float) -> None:
    """The first argument of a step is always zero: neither branch of the scalar functions may spoil it."""
    z, v = ca.SX.sym("z", space.space.nz), ca.SX.sym("v", space.space.nv)
    moved = space.space.integrate(z, v)
    back = space.space.difference(z, moved)
    weights = space.rng.standard_normal(back.numel())
    hessian, slope = ca.hessian(ca.dot(weights, back), v)
    function = ca.Function("f", [z, v], [ca.jacobian(moved, v), slope, hessian])
    tangent = size * space.tangent()
    along, slope_at, curvature = (np.asarray(o) for o in function(space.random(), tangent))
    assert np.isfinite(along).all()
    assert np.allclose(slope_at.ravel(), weights, rtol=0, atol=1e-11)  # log exp is the identity
    assert np.abs(curvature).max() < 1e-8


# --- rates, brackets --------------------------------------------------------------------------------------


def test_rate_is_the_derivative_of_a_motion(space: Space) -> None:
    z, v = ca.SX.sym("z", space.space.nz), ca.SX.sym("v", space.space.nv)
    t = ca.SX.sym("t")
    slope = ca.substitute(ca.jacobian(space.space.integrate(z, t * v), t), t, 0)
    derivative = ca.Function("derivative", [z, v], [slope])
    for _ in range(3):
        at, along = space.random(), space.tangent()
        assert np.allclose(numbers(derivative(at, along)), numbers(space.rate(at, along)), atol=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-5, 0.7, 2.0])
def test_derivative_of_the_exponential(space: Space, size: float) -> None:
    """Against differences of fourth order; D ad = 1 - Ad of the inverse motion, too."""
    v, w = (space.rng.uniform(-1, 1, space.model.nv) for _ in range(2))
    v, h = size * v, 1e-3

    def from_there(t: float) -> Array:
        ends = (space.moved(space.neutral, v), space.moved(space.neutral, v + t * w))
        return numbers(space.difference(*ends))

    slope = (8 * (from_there(h) - from_there(-h)) - (from_there(2 * h) - from_there(-2 * h))) / (12 * h)
    assert np.abs(numbers(space.dexp(v, w)) - slope).max() < 1e-9
    pushed = space.moved(space.moved(space.moved(space.neutral, -v), h * w), v)
    carried = numbers(space.difference(space.neutral, pushed)) / h
    expected = w - numbers(space.dexp(v, numbers(space.bracket(v, w))))
    assert np.abs(carried - expected).max() < 1e-8


def test_brackets_are_those_of_a_lie_algebra(space: Space) -> None:
    a, b, c = space.tangent(), space.tangent(), space.tangent()

    def bracket(x: Array, y: Array) -> Array:
        return numbers(space.bracket(x, y))

    assert np.allclose(bracket(a, b), -bracket(b, a), atol=1e-15)
    jacobi = bracket(a, bracket(b, c)) + bracket(b, bracket(c, a)) + bracket(c, bracket(a, b))
    assert np.abs(jacobi).max() < 1e-14
    assert np.allclose(numbers(space.commutator(space.random(), a, b)), bracket(a, b), atol=1e-13)


def test_attraction_vanishes_on_the_group_and_leads_to_it(space: Space) -> None:
    z = space.random()
    assert np.abs(numbers(space.attraction(z))).max() < 1e-14
    before = np.abs(numbers(space.defects(1.01 * z)))
    after = np.abs(numbers(space.defects(1.01 * z + 0.1 * numbers(space.attraction(1.01 * z)))))
    assert np.all(after < 0.9 * before)


# --- end conditions ---------------------------------------------------------------------------------------


def test_projection_is_the_difference_to_first_order(space: Space) -> None:
    goal = space.random()
    v = ca.SX.sym("v", space.space.nv)
    errors = space.space.projection(ca.DM(goal), space.space.integrate(ca.DM(goal), v))
    at_goal = ca.Function("at_goal", [v], [errors, ca.jacobian(errors, v)])
    value, slope = (np.asarray(o) for o in at_goal(np.zeros(space.model.nv)))
    assert np.abs(value).max() < 1e-15 * 4
    assert np.allclose(slope, np.eye(space.model.nv), rtol=0, atol=1e-14)
    small = 1e-4 * space.tangent()
    there = space.moved(goal, small)
    assert np.allclose(numbers(space.projection(goal, there)), small, rtol=0, atol=1e-7)


def test_guards_say_where_the_projection_vanishes_besides() -> None:
    """Half-turns are roots for matrices and circles, not for quaternions; they are far beyond the guard."""
    rng = np.random.default_rng(6)
    for name, rotations, root_at_pi in (
        ("continuous", "quaternion", True),
        ("spherical", "dcm", True),
        ("spherical", "quaternion", False),
        ("free_flyer", "dcm", True),
        ("planar", "dcm", True),
    ):
        space = Space(name, rotations)
        goal = space.random()
        axes = 1 if name in ("continuous", "planar") else 3
        direction = np.zeros(space.model.nv)
        direction[-axes:] = rng.standard_normal(axes)
        direction /= np.linalg.norm(direction)
        for angle in np.linspace(0.05, np.pi, 60):
            there = space.moved(goal, angle * direction)
            size = np.linalg.norm(numbers(space.projection(goal, there)))
            allowed = np.all(numbers(space.guards(goal, there)) >= 0)
            if not root_at_pi:
                assert size == pytest.approx(2 * np.sin(angle / 2), rel=1e-12)
                assert allowed  # nothing to guard
            else:
                assert size == pytest.approx(np.sin(angle), abs=1e-12)
                assert allowed == (angle < np.pi / 2)  # where the sine is as good as the angle
        half_turn = space.moved(goal, np.pi * direction)
        assert (np.linalg.norm(numbers(space.projection(goal, half_turn))) < 1e-14) == root_at_pi


@pytest.mark.parametrize(("group", "at_goal", "at_half_turn"), [(Circle(), 1, -1), (RotationMatrix(), 2, -2)])
def test_values_of_the_guards(group: Circle | RotationMatrix, at_goal: float, at_half_turn: float) -> None:
    rng = np.random.default_rng(3)
    g, v = ca.SX.sym("g", group.nz), ca.SX.sym("v", group.nv)
    guard = ca.Function("guard", [g, v], [group.guards(g, group.integrate(g, v))[0]])
    goal = np.array([0.6, 0.8]) if group.nz == 2 else Rotation.random(random_state=rng).as_matrix().ravel()
    axis = rng.standard_normal(group.nv)
    axis /= np.linalg.norm(axis)
    assert float(guard(goal, 0 * axis)) == pytest.approx(at_goal, abs=1e-14)
    assert float(guard(goal, np.pi * axis)) == pytest.approx(at_half_turn, abs=1e-14)


# --- to and from Pinocchio's configurations ---------------------------------------------------------------


def test_coordinates_and_back(space: Space) -> None:
    qs = np.array(
        [
            pin.integrate(space.model, pin.neutral(space.model), space.rng.uniform(-3, 3, space.model.nv))
            for _ in range(20)
        ]
    )
    zs = space.space.coordinates(qs)
    assert zs.shape == (20, space.space.nz)
    back = space.space.configurations(zs)
    between = [pin.difference(space.model, a, b) for a, b in zip(qs, back, strict=True)]
    assert np.abs(between).max() < 2e-14
    assert np.allclose(space.space.coordinates(back), zs, rtol=0, atol=2e-15)
    for part in space.space.parts:
        if part.at_matrix < 0:
            assert np.allclose(back[:, part.at_q], qs[:, part.at_q], rtol=0, atol=1e-15)


def test_quaternions_of_a_motion_do_not_jump() -> None:
    """Three turns: a quaternion by itself changes its sign on the way."""
    space = Space("free_flyer", "dcm")
    angles = np.linspace(0.0, 6 * np.pi, 200)
    axis = np.array([1.0, -2.0, 0.5]) / np.linalg.norm([1.0, -2.0, 0.5])
    zs = np.array([space.moved(space.neutral, np.concatenate([np.zeros(3), a * axis])) for a in angles])
    quaternions = space.space.configurations(zs)[:, 3:]
    assert np.all(np.sum(quaternions[1:] * quaternions[:-1], axis=1) > 0.9)
    assert np.abs(np.linalg.norm(quaternions, axis=1) - 1).max() < 1e-15 * 3


def test_the_nearest_rotation_is_that_of_the_polar_decomposition() -> None:
    space, rng = Space("spherical", "dcm"), np.random.default_rng(8)
    for _ in range(10):
        R = Rotation.random(random_state=rng).as_matrix() @ (np.eye(3) + 0.2 * rng.standard_normal((3, 3)))
        nearest, _ = polar(R)
        got = space.configuration(R.ravel(order="F"))
        assert np.allclose(Rotation.from_quat(got).as_matrix(), nearest, rtol=0, atol=1e-14)


def test_coordinates_beside_the_group_are_normalised() -> None:
    space = Space("all", "quaternion")
    z = space.random()
    for scale in (0.9, 1.2):
        off = z.copy()
        for part in space.space.parts:
            if not part.group.is_vector:
                size = 2 if isinstance(part.group, (Circle, Plane)) else 4
                off[part.at_z.stop - size : part.at_z.stop] *= scale
        assert np.allclose(space.configuration(off), z, rtol=0, atol=1e-15)
