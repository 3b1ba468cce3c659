"""Steps whose length is part of the state: the same as those of given length, with exact derivatives."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbocp import Problem, load_problem
from mbocp.formulation import Motion, formulate
from mbocp.formulation.features.step_lengths import begins_phase
from mbocp.problem import ProblemWarning
from tests.formulation.stages import check_derivatives, near

EXAMPLES = Path(__file__).parents[2] / "examples"
N = 6
CASES = [
    ("loops/four_bar", {"scheme": "se1"}),
    ("loops/four_bar", {"scheme": "midpoint"}),
    ("loops/four_bar", {"scheme": "se2"}),
    ("loops/four_bar", {"scheme": "heun"}),
    ("free_flyer/drone_flip", {"scheme": "se1"}),
    ("free_flyer/drone_flip", {"scheme": "midpoint"}),
    ("free_flyer/drone_flip", {"scheme": "rk4", "lie": "munthe_kaas"}),
    ("free_flyer/drone_flip", {"scheme": "heun", "lie": "baumgarte", "substeps": 2}),
    ("free_flyer/drone_flip", {"scheme": "euler", "lie": "plain", "substeps": 3}),
    ("so3/unicycle_pendulum", {}),
]


def free(name: str, integrator: dict[str, Any]) -> Problem:
    problem = load_problem(EXAMPLES / f"{name}.toml")
    T = problem.duration
    return problem.with_(
        steps=N,
        integrator=integrator,
        duration={"min": T / 3, "max": 3 * T, "guess": T},
        cost={"time": 0.7, "control_rate": 0.1, "velocity": 0.3, "fuel": 0.2},
        solver={"method": "auto"},
    )


@pytest.fixture(params=CASES, ids=lambda case: "-".join(map(str, (case[0], *case[1].values()))))
def problem(request: pytest.FixtureRequest) -> Problem:
    return free(*request.param)


@pytest.mark.parametrize("stage", [0, 3])
def test_a_step_is_the_one_of_given_length(problem: Problem, stage: int) -> None:
    formulation = formulate(problem)
    programme, at, nu = formulation.programme, formulation.layout, problem.robot.nu
    point, _ = near(formulation)
    e, (w,), (h0,), (h1,) = (
        begins_phase(N)[stage],
        point.u[nu:],
        point.x0[at.states["h"]],
        point.x1[at.states["h"]],
    )
    limits = {"effort": 1e6}  # a reason for states to be plain vectors
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)  # cost.time adds a constant, which is meant
        same_length = problem.with_(duration=problem.duration * (h0 + e * w), limits=limits)
    given = formulate(same_length).programme
    rho, rho_given = (p.rho.reshape(N, -1)[stage] for p in (programme, given))
    c, cost = programme.functions.function("values")(*point, programme.theta, rho)
    same = (point.x0[:-1], point.x1[:-1], point.y, point.u[:nu])
    c_given, cost_given = given.functions.function("values")(*same, given.theta, rho_given)
    c, c_given = np.asarray(c).ravel(), np.asarray(c_given).ravel()
    row = at.rows["h"].start
    assert np.allclose(np.delete(c, row), c_given, rtol=1e-12, atol=1e-12 * np.abs(c_given).max())
    assert c[row] == pytest.approx(h0 + e * w - h1, abs=1e-15)
    assert float(cost) == pytest.approx(float(cost_given) + (1 - e) * w**2 / 2, rel=1e-12)


@pytest.mark.parametrize("stage", [0, 3])
def test_derivatives(problem: Problem, stage: int) -> None:
    """The step length is among the unknowns that are looked at alone."""
    formulation = formulate(problem)
    check_derivatives(formulation, stage, [formulation.layout.rows["h"].start])


def test_phases_begin_where_their_first_steps_are() -> None:
    assert begins_phase(5).tolist() == [1, 0, 0, 0, 0]
    assert begins_phase(5, (0, 3)).tolist() == [1, 0, 0, 1, 0]


def test_motions_keep_the_lengths_of_their_steps() -> None:
    problem = free("loops/four_bar", {"scheme": "se1"})
    formulation = formulate(problem)
    kind = formulation.programme.kind
    rng = np.random.default_rng(0)
    robot = problem.robot
    motion = Motion(
        np.tile(problem.q_start, (N + 1, 1)),
        np.vstack([problem.v_start, rng.standard_normal((N, robot.nv))]),
        rng.standard_normal((N, robot.nu)),
        np.full(N, 1.7 * problem.dt),
    )
    iterate = formulation.iterate_of(motion, np.zeros((N, robot.nc)))
    iterate.check(formulation.programme)
    assert iterate.us.shape[1] == kind.nu == robot.nu + 1
    found = formulation.motion_of(iterate)
    for name in ("qs", "vs", "us", "dts"):
        assert np.allclose(getattr(found, name), getattr(motion, name), atol=1e-15)
    too_long = Motion(motion.qs, motion.vs, motion.us, np.full(N, 9.0 * problem.dt))
    shortened = formulation.motion_of(formulation.iterate_of(too_long, np.zeros((N, robot.nc))))
    assert np.allclose(shortened.dts, 3.0 * problem.dt, rtol=1e-14)
