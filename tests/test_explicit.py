"""The second paper's task in all six formulations, from the problem file to the solution and back."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import mbocp
from mbocp._arrays import Array
from mbocp.problem import Problem
from mbocp.solution import Solution
from tests.robot.test_unicycle import closed_form, driven_acceleration

FILE = Path(__file__).parents[1] / "examples" / "so3" / "unicycle_pendulum.toml"
ROTATIONS, LIE = ("quaternion", "dcm"), ("plain", "baumgarte", "munthe_kaas")


def load(rotations: str, lie: str, *settings: str) -> Problem:
    return mbocp.load_problem(FILE, [f"robot.rotations={rotations}", f"integrator.lie={lie}", *settings])


@cache
def solved(rotations: str, lie: str) -> Solution:
    return mbocp.solve(load(rotations, lie))


def tilt(s: Solution) -> Array:
    """Height of the pendulum's axis: -1 hanging, 1 upright, at all nodes."""
    return np.array([pin.Quaternion(*q[[5, 2, 3, 4]]).matrix()[2, 2] for q in s.qs])


@pytest.mark.parametrize("rotations", ROTATIONS)
@pytest.mark.parametrize("lie", LIE)
def test_all_formulations_swing_up(rotations: str, lie: str) -> None:
    problem, s = load(rotations, lie), solved(rotations, lie)
    assert s.converged, s.advice
    assert (s.scheme, s.lie, s.rotations, s.substeps) == ("rk4", lie, rotations, 1)
    assert np.abs(problem.robot.difference(problem.goal.q, s.q_final)).max() < 1e-6
    assert tilt(s)[0] == -1.0
    assert tilt(s)[-1] == pytest.approx(1.0, abs=1e-12)
    assert np.abs(s.vs[-1, :5]).max() < 1e-8  # at rest; the yaw rate is a control
    assert np.abs(s.vs[:, 4]).max() < 1e-12  # nothing makes the pendulum spin
    assert np.all(np.abs(s.us) <= np.array([2 * np.pi, 6.0]) + 1e-8)
    assert s.limit_violation <= 1e-8
    assert "left out, since the dynamics imply it" in s.advice
    assert np.allclose(np.linalg.norm(s.qs[:, 2:6], axis=1), 1.0, rtol=0, atol=1e-14)  # Pinocchio's
    assert np.all(np.sum(s.qs[1:, 2:6] * s.qs[:-1, 2:6], axis=1) > 0.5)  # and without jumps


@pytest.mark.parametrize("rotations", ROTATIONS)
def test_drift_is_that_of_the_formulation(rotations: str) -> None:
    """Of the solution, and of the motion that its controls make."""
    for lie in LIE:
        s = solved(rotations, lie)
        assert s.manifold_drifts.shape == (101,)
        assert s.manifold_drifts[0] < 1e-15
        assert s.manifold_drift == s.manifold_drifts.max()
        if lie == "munthe_kaas":
            assert s.manifold_drift < 1e-8  # the solver's tolerance
            assert s.manifold_drift_resimulated < 1e-13
        else:
            assert 1e-9 < s.manifold_drift < 1e-2
            assert s.manifold_drift_resimulated == pytest.approx(s.manifold_drift, rel=1e-2)


def test_on_the_group_coordinates_do_not_matter() -> None:
    quaternion = solved("quaternion", "munthe_kaas")
    dcm = mbocp.solve(load("dcm", "munthe_kaas"), warm_start=quaternion)  # there are several minima
    assert dcm.converged
    assert dcm.cost == pytest.approx(quaternion.cost, rel=1e-9)
    assert np.allclose(dcm.us, quaternion.us, rtol=0, atol=1e-5)
    assert np.allclose(dcm.vs, quaternion.vs, rtol=0, atol=1e-5)


def steps_in_truth(s: Solution) -> float:
    """Largest error of a step, by an adaptive method on eqs. (4), (5), (27) with nothing of mbocp's."""
    dt, worst = s.duration / s.num_steps, 0.0
    forward = s.vs[:, 0] * np.cos(s.qs[:, 6]) + s.vs[:, 1] * np.sin(s.qs[:, 6])
    states = np.hstack([s.qs, s.vs[:, 2:5], forward[:, None]])

    def rhs(_: float, x: Array, u: Array) -> Array:
        q, speeds = x[:7], x[7:]
        (x_, y_, z_, w_), (a, b, c) = q[2:6], speeds[:3]
        turning = (pin.Quaternion(w_, x_, y_, z_) * pin.Quaternion(0.0, a, b, c)).coeffs() / 2
        along = speeds[3] * np.array([np.cos(q[6]), np.sin(q[6])])
        spin = closed_form(q, speeds, driven_acceleration(speeds, u, q[6], 0.0))
        return np.concatenate([along, turning, u[:1], spin, u[1:]])

    for n in range(s.num_steps):
        out = solve_ivp(rhs, (0.0, dt), states[n], args=(s.us[n],), method="DOP853", rtol=1e-11, atol=1e-11)
        worst = max(worst, float(np.abs(out.y[:, -1] - states[n + 1]).max()))
    return worst


@pytest.mark.parametrize("rotations", ROTATIONS)
@pytest.mark.parametrize("lie", LIE)
def test_controls_do_in_truth_what_the_solution_says(rotations: str, lie: str) -> None:
    """Steps of 30 ms while the pendulum swings."""
    assert steps_in_truth(solved(rotations, lie)) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("rotations", ROTATIONS)
def test_halves_of_steps_have_a_thirty_second_of_the_error(rotations: str) -> None:
    finer = mbocp.solve(load(rotations, "munthe_kaas", "integrator.substeps=2"))
    assert finer.converged
    assert steps_in_truth(finer) < steps_in_truth(solved(rotations, "munthe_kaas")) / 12  # two to a step


def test_cost_is_eq_33() -> None:
    """Tracking, potential energy and the rate of the controls, summed by hand."""
    s, problem = solved("quaternion", "munthe_kaas"), load("quaternion", "munthe_kaas")
    dt, q = s.duration / s.num_steps, s.qs[:-1]
    away = np.stack([q[:, 0] - 0.5, q[:, 1] - 0.5, q[:, 6] - np.pi])
    tracking = 0.5 * (2 * away[0] ** 2 + 2 * away[1] ** 2 + 0.2 * away[2] ** 2)
    potential = np.array([problem.robot.potential_energy(x) for x in q])
    rates = np.diff(s.us, axis=0) / dt
    total = dt * np.sum(tracking - potential) + dt * np.sum(0.5 * 2e-3 * rates**2)
    assert s.cost == pytest.approx(total, rel=1e-7)


def test_a_guard_keeps_the_pendulum_from_hanging() -> None:
    """The projected condition for matrices also holds where it hangs, half a turn away, and at no cost."""
    stay = ("goal.q.base_x=0", "goal.q.base_y=0", "goal.q.yaw=0", "guess.kind=hold", "horizon.steps=30")
    free = mbocp.solve(load("dcm", "munthe_kaas", *stay, "goal.guard=false"))
    assert free.converged
    assert tilt(free)[-1] == pytest.approx(-1.0, abs=1e-9)
    assert "another root" in free.advice
    guarded = mbocp.solve(load("dcm", "munthe_kaas", *stay, "solver.max_iterations=300"))
    assert not guarded.converged or tilt(guarded)[-1] == pytest.approx(1.0, abs=1e-9)


def test_a_solution_reads_back(tmp_path: Path) -> None:
    s = solved("dcm", "munthe_kaas")
    again = Solution.load(s.save(tmp_path / "swing.h5") or tmp_path / "swing.h5")
    assert (again.scheme, again.lie, again.rotations) == (s.scheme, s.lie, s.rotations)
    assert np.array_equal(again.manifold_drifts, s.manifold_drifts)
    other = mbocp.solve(load("quaternion", "plain"), warm_start=again)
    assert other.converged
    assert other.iterations < 30
