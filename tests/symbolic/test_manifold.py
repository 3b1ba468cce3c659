"""Derivatives of `integrate` and `difference` stay finite and right at zero, where exp and log have 0/0.

Of the planar joint Pinocchio's SE(2) maps have the right first derivatives only: near zero they switch to a
truncated series, whose second derivatives are finite but wrong (docs/symbolic.md).
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mbocp.symbolic import model_functions
from tests.symbolic.test_joints import continuous_unaligned

JOINTS = {
    "free-flyer": pin.JointModelFreeFlyer(),
    "spherical": pin.JointModelSpherical(),
    "continuous": pin.JointModelRUBZ(),
    "continuous unaligned": continuous_unaligned(),
    "planar": pin.JointModelPlanar(),
}


@pytest.fixture(params=JOINTS)
def single(request):
    """Return a model of one joint, its functions, and a configuration away from neutral."""
    model = pin.Model()
    joint = model.addJoint(0, JOINTS[request.param], pin.SE3.Identity(), "joint")
    model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    q = pin.integrate(model, pin.neutral(model), np.random.default_rng(1).uniform(-1.0, 1.0, model.nv))
    return model, model_functions(model), q


def first_and_second(expression: ca.SX, x: ca.SX, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Jacobian (m, n), and its own Jacobian with respect to x (m n, n)."""
    J = ca.jacobian(expression, x)
    both = ca.Function("both", [x], [J, ca.jacobian(ca.vec(J), x)])
    return tuple(np.array(ca.densify(d)) for d in both(value))


def test_integrate_has_finite_derivatives_at_zero(single):
    model, functions, q = single
    v = ca.SX.sym("v", model.nv)
    J, H = first_and_second(functions.integrate(q, v), v, np.zeros(model.nv))
    assert np.isfinite(J).all()
    assert np.isfinite(H).all()
    step = 1e-3  # third derivatives are of order one: the truncation error is 1e-7

    def q1(dv):
        return pin.integrate(model, q, dv)

    E = step * np.eye(model.nv)
    first = np.stack([(q1(e) - q1(-e)) / (2 * step) for e in E], axis=1)
    np.testing.assert_allclose(J, first, atol=1e-6)
    if is_planar(model):
        return
    second = np.stack([np.stack([mixed_difference(q1, e, d, step) for e in E], axis=1) for d in E], axis=2)
    np.testing.assert_allclose(H, second.reshape(-1, model.nv, order="F").reshape(H.shape), atol=1e-5)


def is_planar(model: pin.Model) -> bool:
    return model.joints[1].shortname() == "JointModelPlanar"


def mixed_difference(f, e: np.ndarray, d: np.ndarray, step: float) -> np.ndarray:
    return (f(e + d) - f(e - d) - f(d - e) + f(-e - d)) / (4 * step**2)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-9, 1e-8, 1e-7, 1e-5, 1e-3, 0.1, 1.0, 2.0])
def test_difference_undoes_integrate_with_its_derivatives(single, size):
    model, functions, q = single
    v = ca.SX.sym("v", model.nv)
    value = size * np.full(model.nv, 1.0 / np.sqrt(model.nv))
    identity = functions.difference(q, functions.integrate(q, v))
    got = np.array(ca.Function("f", [v], [identity])(value)).ravel()
    J, H = first_and_second(identity, v, value)
    assert np.isfinite(H).all()
    if is_planar(model):
        np.testing.assert_allclose(got, value, rtol=0, atol=1e-14 + 1e-9 * size)
        np.testing.assert_allclose(J, np.eye(model.nv), atol=1e-4)
    else:
        np.testing.assert_allclose(got, value, rtol=0, atol=1e-14 + 1e-12 * size)
        np.testing.assert_allclose(J, np.eye(model.nv), atol=1e-6)
        np.testing.assert_allclose(H, 0.0, atol=1e-4)


def test_difference_has_finite_derivatives_in_both_arguments(single):
    model, functions, q = single
    w = ca.SX.sym("w", 2 * model.nv)
    q0, q1 = functions.integrate(q, w[: model.nv]), functions.integrate(q, w[model.nv :])
    J, H = first_and_second(functions.difference(q0, q1), w, np.zeros(2 * model.nv))
    np.testing.assert_allclose(J, np.hstack([-np.eye(model.nv), np.eye(model.nv)]), atol=1e-9)
    assert np.isfinite(H).all()


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 1.0])
def test_dintegrate_is_the_derivative_of_integrate(single, size):
    model, functions, q = single
    v = size * np.linspace(-1.0, 1.0, model.nv + 1)[1:]
    w = ca.SX.sym("w", 2 * model.nv)
    moved = functions.integrate(functions.integrate(q, w[: model.nv]), v + w[model.nv :])
    J, _ = first_and_second(functions.difference(functions.integrate(q, v), moved), w, np.zeros(2 * model.nv))
    np.testing.assert_allclose(J, np.hstack([np.array(d) for d in functions.dintegrate(q, v)]), atol=1e-7)
    for got, expected in zip(functions.dintegrate(q, v), pin.dIntegrate(model, q, v), strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-9)
