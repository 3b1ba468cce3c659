"""Bodies of the log-Cholesky parametrisation are real ones."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from mbocp.identification.consistent import body_of, body_slopes, log_cholesky
from mbocp.identification.unknown_parameters import parameters_of, pseudo_inertia

BODY = pin.Inertia.FromBox(2.0, 0.1, 0.2, 0.4)


def test_it_goes_there_and_back():
    placed = pin.SE3(pin.utils.rpyToMatrix(0.3, -0.5, 1.0), np.array([0.1, -0.2, 0.3]))
    parameters = placed.act(BODY).toDynamicParameters()
    np.testing.assert_allclose(parameters_of(pseudo_inertia(parameters)), parameters, atol=1e-14)
    np.testing.assert_allclose(body_of(log_cholesky(pseudo_inertia(parameters))), parameters, atol=1e-13)


@pytest.mark.parametrize("seed", range(5))
def test_any_ten_numbers_are_a_body(seed):
    theta = np.random.default_rng(seed).standard_normal(10)
    parameters = body_of(theta)
    assert np.linalg.eigvalsh(pseudo_inertia(parameters)).min() > 0.0
    moments = np.linalg.eigvalsh(pin.Inertia.FromDynamicParameters(parameters).inertia)
    assert moments[0] > 0.0
    assert moments[2] < moments[0] + moments[1]


def test_slopes_are_those_of_differences():
    theta, h = np.random.default_rng(0).standard_normal(10), 1e-6
    columns = [(body_of(theta + h * e) - body_of(theta - h * e)) / (2 * h) for e in np.eye(10)]
    np.testing.assert_allclose(body_slopes(theta), np.array(columns).T, rtol=1e-8, atol=1e-8)
