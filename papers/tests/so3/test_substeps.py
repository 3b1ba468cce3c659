"""Stages made of calls are those written in one piece; simulation, stretch, figure 12's crosses."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from mbocp_papers.so3.accuracy import Curve, Point
from mbocp_papers.so3.accuracy_figure import draw_curves
from mbocp_papers.so3.data import formulation
from mbocp_papers.so3.experiment import task_problem
from mbocp_papers.so3.motions import representation_matrices, stretch_of
from mbocp_papers.so3.substeps import Method, SteppedProgramme, stepped_programme
from scipy.spatial.transform import Rotation

from mbocp._arrays import Array
from mbocp.problem import Problem


def problem(label: str = "Q RK") -> Problem:
    return task_problem(formulation(label), settings={"integrator.scheme": "euler", "horizon.steps": 25})


@pytest.fixture(scope="module")
def stepped() -> SteppedProgramme:
    return stepped_programme(problem(), Method("heun", "plain", 3))


def arguments(stepped: SteppedProgramme, *, with_m: bool) -> tuple[list[Array], Array]:
    rng = np.random.default_rng(3)
    programme = stepped.programme
    nx, nu = stepped.formulation.layout.nx, stepped.problem.robot.nu
    x0, x1, u, m = (rng.normal(size=n) for n in (nx, nx, nu, nx))
    rho = programme.rho.reshape(programme.num_steps, -1)[3]
    return [x0, x1, np.zeros(0), u, *([m] if with_m else []), programme.theta, rho], m


def called(stepped: SteppedProgramme, name: str, given: list[Array]) -> list[Array]:
    found = stepped.programme.functions.function(name)(*given)
    return [np.array(one.full()) for one in (found if isinstance(found, tuple) else (found,))]


def test_rows_are_three_steps(stepped: SteppedProgramme) -> None:
    given, _ = arguments(stepped, with_m=False)
    x0, x1, _, u = given[:4]
    at, h = stepped.formulation.layout, stepped.problem.dt / 3
    state = x0[: at.r.start]
    for _ in range(3):
        state = np.array(stepped.step(np.concatenate([state, u]), h, [2, 1, 0])).ravel()
    c = called(stepped, "values", given)[0].ravel()
    assert np.allclose(c, np.concatenate([state - x1[: at.r.start], u - x1[at.r]]), atol=1e-14)


def test_derivatives_are_those_of_the_values(stepped: SteppedProgramme) -> None:
    """Jacobian and Hessian against central differences of values and of gradients."""
    given, m = arguments(stepped, with_m=False)
    nx, nu = given[0].size, given[3].size
    z = np.concatenate([given[1], given[0], given[3]])

    def at(point: Array) -> list[Array]:
        return [point[nx : 2 * nx], point[:nx], np.zeros(0), point[2 * nx :], *given[4:]]

    def slope(point: Array) -> Array:
        _, _, dc_dz, dl_dz = called(stepped, "jacobian", at(point))
        return (dl_dz.ravel() + dc_dz.T @ m).ravel()

    c, cost, dc_dz, _, hessian = called(stepped, "complete", [*at(z)[:4], m, *given[4:]])
    full = hessian + np.triu(hessian, 1).T
    h = 1e-5
    for k in range(2 * nx + nu):
        e = np.zeros(z.size)
        e[k] = h
        above, below = called(stepped, "values", at(z + e)), called(stepped, "values", at(z - e))
        assert np.allclose(dc_dz[:, k], (above[0] - below[0]).ravel() / (2 * h), atol=1e-7)
        assert np.allclose(full[:, k], (slope(z + e) - slope(z - e)) / (2 * h), atol=1e-6)
    assert np.allclose(called(stepped, "values", given)[1], cost)
    assert np.allclose(called(stepped, "values", given)[0], c)


def test_more_steps_are_more_accurate(stepped: SteppedProgramme) -> None:
    us = 0.5 * np.sin(np.arange(50.0)).reshape(25, 2)
    ends = [
        stepped_programme(problem(), Method("heun", "plain", count)).simulate(us)[-1]
        for count in (4, 8, 16, 64)
    ]
    errors = [float(np.linalg.norm(end - ends[-1])) for end in ends[:-1]]
    assert 3.0 < errors[0] / errors[1] < 6.0
    assert 3.0 < errors[1] / errors[2] < 6.0


def test_the_stretch_of_a_quaternion_is_its_norm_squared() -> None:
    rng = np.random.default_rng(0)
    zs = rng.normal(size=(4, 7))
    turn = zs[:, 2:6]
    turn /= np.linalg.norm(turn, axis=1)[:, None]
    expected = Rotation.from_quat(turn).as_matrix()
    assert np.allclose(representation_matrices(problem(), zs), expected)
    zs[2, 2:6] *= 1.1
    assert np.allclose(representation_matrices(problem(), zs)[2], 1.21 * expected[2])
    assert math.isclose(stretch_of(problem(), zs), 0.21)
    zs[0, 3] = np.nan
    assert stretch_of(problem(), zs) == math.inf


def test_the_stretch_of_a_matrix_is_its_own() -> None:
    rotation = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    deformed = rotation @ np.diag([1.0, 1.04, 0.9])
    zs = np.array([[1.0, 2.0, *matrix.ravel(order="F"), 0.5] for matrix in (rotation, deformed)])
    assert np.allclose(representation_matrices(problem("DCM RK"), zs), [rotation, deformed])
    assert math.isclose(stretch_of(problem("DCM RK"), zs), 0.04)


def test_meaningless_points_are_crosses() -> None:
    good = Point(1, 2.0, 1e-3, 1e-4, -1.0, 10, "converged")
    stretched = Point(2, 3.0, 1e-3, 0.06, -1.0, 10, "converged")
    failed = Point(4, math.nan, 5.0, math.inf, -1.0, 0, "diverged")
    assert [p.is_meaningful for p in (good, stretched, failed)] == [True, False, False]
    assert failed.to_dict()["milliseconds"] is None
    curves = [Curve(kind, "rk4", "plain", (good, stretched, failed)) for kind in ("quaternion", "dcm")]
    assert curves[0].label == "RK4"
    figure = draw_curves(curves)
    for axes in figure.axes:
        markers = {line.get_marker(): line.get_ydata()[0] for line in axes.get_lines() if line.get_marker()}
        assert markers["o"] == 1e-3
        assert markers["x"] == 1e4


def test_serialised_functions_call_the_compiled_step(stepped: SteppedProgramme) -> None:
    assert stepped.programme.functions.library is None
    assert isinstance(stepped.programme.functions.function("values"), ca.Function)
