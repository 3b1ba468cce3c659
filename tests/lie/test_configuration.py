"""The symbolic group maps against Pinocchio's, and their derivatives where Newton's method takes them."""

from __future__ import annotations

import casadi as ca
import mpmath
import numpy as np
import pinocchio as pin
import pytest

from mbocp.exceptions import UnsupportedRobot
from mbocp.lie import ConfigurationSpace
from mbocp.lie import angles as scalar

JOINTS = {
    "revolute": pin.JointModelRX,
    "prismatic": pin.JointModelPY,
    "continuous": pin.JointModelRUBZ,
    "spherical": pin.JointModelSpherical,
    "spherical_zyx": pin.JointModelSphericalZYX,
    "translation": pin.JointModelTranslation,
    "planar": pin.JointModelPlanar,
    "free_flyer": pin.JointModelFreeFlyer,
}


def model_of(*kinds: str) -> pin.Model:
    model, parent = pin.Model(), 0
    for i, kind in enumerate(kinds):
        parent = model.addJoint(parent, JOINTS[kind](), pin.SE3.Random(), f"{kind}_{i}")
        model.appendBodyToJoint(parent, pin.Inertia.Random(), pin.SE3.Identity())
    return model


MODELS = {**{name: (name,) for name in JOINTS}, "all": tuple(JOINTS)}


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> pin.Model:
    return model_of(*MODELS[request.param])


def functions(model: pin.Model) -> tuple[ca.Function, ca.Function]:
    space = ConfigurationSpace(model)
    q, p, v = ca.SX.sym("q", model.nq), ca.SX.sym("p", model.nq), ca.SX.sym("v", model.nv)
    return ca.Function("i", [q, v], [space.integrate(q, v)]), ca.Function(
        "d", [q, p], [space.difference(q, p)]
    )


def random_q(model: pin.Model, rng: np.random.Generator) -> np.ndarray:
    return pin.integrate(model, pin.neutral(model), rng.uniform(-1.5, 1.5, model.nv))


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-8, 1e-5, 1e-3, 0.1, 0.14142, 0.9999, 1.0001, 2.0, 3.0])
def test_equal_pinocchio_s_numbers(model: pin.Model, size: float) -> None:
    integrate, difference = functions(model)
    rng = np.random.default_rng(0)
    for _ in range(5):
        q = random_q(model, rng)
        v = rng.standard_normal(model.nv)
        v *= size / max(1.0, np.linalg.norm(v))
        there = np.asarray(integrate(q, v)).ravel()
        assert np.allclose(there, pin.integrate(model, q, v), rtol=0, atol=3e-15 * 10)
        back = np.asarray(difference(q, there)).ravel()
        assert np.allclose(back, v, rtol=1e-11, atol=1e-13)
        assert np.allclose(back, pin.difference(model, q, there), rtol=0, atol=1e-7)


@pytest.mark.parametrize("rotations", ["quaternion", "dcm"])
def test_slopes_of_configurations_hold_off_the_groups(model: pin.Model, rotations: str) -> None:
    space, rng, step = ConfigurationSpace(model, rotations), np.random.default_rng(0), 1e-5
    zs = space.coordinates(random_q(model, rng)[None])
    zs += 0.1 * rng.standard_normal(zs.shape)
    found, dz = space.slopes_of_configurations(zs)[0], rng.standard_normal(space.nz)
    before, after = (space.configurations(zs + at * dz)[0] for at in (-step, step))
    assert np.allclose(found @ dz, pin.difference(model, before, after) / (2 * step), atol=1e-8)


def test_opposite_quaternions_are_the_same_attitude() -> None:
    model = model_of("free_flyer")
    _, difference = functions(model)
    rng = np.random.default_rng(1)
    q0, q1 = random_q(model, rng), random_q(model, rng)
    mirrored = np.concatenate([q1[:3], -q1[3:]])
    assert np.allclose(np.asarray(difference(q0, q1)), np.asarray(difference(q0, mirrored)), atol=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-16, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2, 0.5])
def test_derivatives_of_a_step_are_finite_and_right(model: pin.Model, size: float) -> None:
    """d/de difference(q1, q0 exp(v)) at and near the solution of the step, where the difference vanishes."""
    space = ConfigurationSpace(model)
    nq, nv = model.nq, model.nv
    q0, q1, v, d = ca.SX.sym("q0", nq), ca.SX.sym("q1", nq), ca.SX.sym("v", nv), ca.SX.sym("d", nv)
    row = space.difference(space.integrate(q1, d), space.integrate(q0, v))
    jacobian = ca.jacobian(row, d)
    weights = np.random.default_rng(3).standard_normal(nv)
    hessian, _ = ca.hessian(ca.dot(weights, row), d)
    f = ca.Function("f", [q0, q1, v, d], [row, jacobian, hessian])
    rng = np.random.default_rng(4)
    for _ in range(3):
        start = random_q(model, rng)
        step = rng.standard_normal(nv)
        end = pin.integrate(model, start, step / max(1.0, np.linalg.norm(step)))
        away = rng.standard_normal(nv)
        at = np.asarray(space_integrate(model, end, -size * away / max(1.0, np.linalg.norm(away))))
        values = f(start, at, step / max(1.0, np.linalg.norm(step)), np.zeros(nv))
        row_value, J, H = (np.asarray(ca.DM(x)) for x in values)
        assert np.isfinite(J).all()
        assert np.isfinite(H).all()
        assert np.abs(J + np.eye(nv)).max() < 3 * size + 1e-12  # -I where the step is met
        direction, h = rng.standard_normal(nv), 1e-3
        ahead = np.asarray(f(start, at, step / max(1.0, np.linalg.norm(step)), h * direction)[0]).ravel()
        back = np.asarray(f(start, at, step / max(1.0, np.linalg.norm(step)), -h * direction)[0]).ravel()
        assert np.allclose(J @ direction, (ahead - back) / (2 * h), atol=2e-5)
        curvature = weights @ (ahead + back - 2 * row_value.ravel()) / h**2
        assert np.isclose(
            direction @ H @ direction, curvature, atol=1e-4 * (1 + np.abs(direction).max() ** 4)
        )


def space_integrate(model: pin.Model, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.asarray(functions(model)[0](q, v)).ravel()


EXACT = {
    "sinc": lambda t: mpmath.sin(t) / t,
    "half_angle_sinc": lambda t: mpmath.sin(t / 2) / t,
    "one_minus_cos": lambda t: (1 - mpmath.cos(t)) / t**2,
    "theta_minus_sin": lambda t: (t - mpmath.sin(t)) / t**3,
    "v_inverse": lambda t: (1 - t / 2 * mpmath.cot(t / 2)) / t**2,
}


@pytest.mark.parametrize("name", EXACT)
def test_scalar_functions_against_mpmath(name: str) -> None:
    x = ca.SX.sym("x")
    value = getattr(scalar, name)(x)
    slope = ca.jacobian(value, x)
    f = ca.Function("f", [x], [value, slope, ca.jacobian(slope, x)])
    with mpmath.workdps(60):

        def exact(square: mpmath.mpf) -> mpmath.mpf:
            return EXACT[name](mpmath.sqrt(square))

        for theta in (1e-8, 1e-4, 1e-2, 0.3, 0.7071, 0.70711, 0.9999, 1.0001, 1.9999, 2.0001, 3.0, 3.1):
            square = mpmath.mpf(theta) ** 2
            got = [float(g) for g in f(float(square))]
            expected = [exact(square), mpmath.diff(exact, square), mpmath.diff(exact, square, 2)]
            for order, (g, e) in enumerate(zip(got, expected, strict=True)):
                tolerance = (1e-15, 1e-13, 1e-10)[order]
                assert abs(g - float(e)) <= tolerance * (1 + abs(float(e))), (theta, order)


def test_log_factor_is_continuous_across_its_threshold() -> None:
    x, w = ca.SX.sym("x"), ca.SX.sym("w")
    f = ca.Function("f", [x, w], [scalar.log_factor(x, w)])
    for square in (0.019999999, 0.020000001, 0.3, 1e-30):
        expected = 2 * mpmath.asin(mpmath.sqrt(square)) / mpmath.sqrt(square)
        assert float(f(square, np.sqrt(1 - square))) == pytest.approx(float(expected), rel=1e-15)


def test_composite_joint_is_refused_by_name() -> None:
    joint = pin.JointModelComposite(2)
    joint.addJoint(pin.JointModelRX())
    joint.addJoint(pin.JointModelRY())
    model = pin.Model()
    model.addJoint(0, joint, pin.SE3.Identity(), "wrist")
    with pytest.raises(UnsupportedRobot, match=r"joint 'wrist' is of type JointModelComposite"):
        ConfigurationSpace(model)
