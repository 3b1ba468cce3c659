"""Exciting motions: derivatives of the measure, what the search gains, limits, what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import mbocp
from mbocp.exceptions import MbocpError
from mbocp.identification import information
from mbocp.identification.dynamics import InverseDynamics
from mbocp.identification.exciting import Information, _columns, _log_det, _Search
from mbocp.terms.own import path_constraint
from tests.identification.logs import log_of

SPEED, EFFORT = 3.0, 25.0


def arm(**changes: Any) -> mbocp.Problem:
    """A double pendulum that hangs, with motors."""
    given: dict[str, Any] = {
        "duration": 3.0,
        "steps": 60,
        "start": {"q": [0.0, 0.0]},
        "goal": {"q": [0.0, 0.0], "v": 0.0},
        "limits": {"velocity": SPEED, "effort": EFFORT, "acceleration": 15.0},
        "scheme": "gauss2",
    }
    return mbocp.Problem.create("double_pendulum", **(given | changes))


def test_the_slope_is_that_of_differences() -> None:
    search, rng = _Search(arm(), [0.05, 0.02], "both", 8), np.random.default_rng(1)
    c, along = search.begin(rng), rng.standard_normal(search.line.shape) * search.free[:, None]

    def value(x: float) -> float:
        return _log_det(search.matrix(search.motion(c + x * along)))

    expected = (value(1e-5) - value(-1e-5)) / 2e-5
    assert np.sum(search.slope(search.motion(c)) * along) == pytest.approx(expected, rel=1e-6)


def test_it_tells_more_than_random_motions_within_the_same_limits() -> None:
    problem = arm()
    solution = mbocp.excite(problem, starts=2, knots=10)
    assert solution.converged
    search, rng = _Search(problem, 0.05, "both", 10), np.random.default_rng(2)
    random = max(_log_det(search.matrix(search.motion(search.begin(rng)))) for _ in range(10))
    told = information(solution)
    assert told.log_det > random + 3.0
    assert told.log_det == pytest.approx(np.log(np.linalg.eigvalsh(told.matrix)).sum(), rel=1e-6)
    between = CubicHermiteSpline(solution.t, solution.qs, solution.vs)(np.linspace(0.0, 3.0, 1201), 1)
    assert np.abs(between).max() < 1.02 * SPEED
    assert np.abs(solution.us).max() <= EFFORT * (1.0 + 1e-6)
    np.testing.assert_allclose(solution.qs[-1], solution.qs[0], atol=1e-8)
    np.testing.assert_allclose(solution.vs[-1], 0.0, atol=1e-8)


def test_standard_deviations_are_those_of_regressions() -> None:
    search, rng = _Search(arm(), 0.05, "both", 8), np.random.default_rng(3)
    motion = search.motion(search.begin(rng))
    Y = _columns(search.dynamics, search.unknowns, search.base, motion).reshape(-1, search.base.rank)
    errors = 0.05 * rng.standard_normal((len(Y), 4000)) / np.sqrt(search.weight)
    found = np.linalg.lstsq(Y, errors, rcond=None)[0].std(axis=1)
    np.testing.assert_allclose(Information(search.base, search.matrix(motion)).sd, found, rtol=0.06)


def test_goals_elsewhere_are_reached() -> None:
    goal = {"q": [0.8, -0.4], "v": 0.0}
    solution = mbocp.excite(arm(goal=goal), starts=1, rounds=3, knots=6)
    assert solution.converged
    np.testing.assert_allclose(solution.qs[-1], goal["q"], atol=1e-8)


def test_path_constraints_of_ones_own_stay() -> None:
    below = path_constraint(lambda at: at.q[0], upper=0.3, name="below")
    solution = mbocp.excite(arm(terms=[below]), starts=1, rounds=10, knots=6)
    assert solution.converged
    assert solution.qs[:, 0].max() == pytest.approx(0.3, abs=1e-5)


@pytest.mark.parametrize(
    ("changes", "options", "says"),
    [
        ({"limits": {}}, {}, "nothing limits how fast"),
        ({"goal": {"v": 0.0}}, {}, "goal.q"),
        ({"start": {"q": [0.0, 0.0], "v": [1.0, 0.0]}}, {}, "rest"),
        ({"duration": {"min": 1.0, "max": 2.0}}, {}, "duration"),
        ({"duration": 0.05, "goal": {"q": [1.0, 0.0], "v": 0.0}}, {}, "longer horizon.duration"),
        ({}, {"torque_noise": 0.0}, "torque_noise"),
        ({}, {"starts": 0}, "starts"),
        ({}, {"friction": "dry"}, "friction"),
    ],
)
def test_what_it_refuses(changes: dict[str, Any], options: dict[str, Any], says: str) -> None:
    with pytest.raises(MbocpError, match=says):
        mbocp.excite(arm(**changes), **options)


def linkage(name: str, **changes: Any) -> mbocp.Problem:
    """A mechanism of the examples that leaves its pose and comes back."""
    start = mbocp.load_problem(f"examples/loops/{name}.toml").q_start.tolist()
    robot = mbocp.load_robot(name)
    motors = [label.name for label in robot.u_labels]
    given: dict[str, Any] = {
        "duration": 3.0,
        "steps": 30,
        "start": {"q": start},
        "goal": {"q": start, "v": 0.0},
        "limits": {"effort": True, "velocity": 8.0, "acceleration": dict.fromkeys(motors, 60.0)},
        "scheme": "midpoint",
    }
    return mbocp.Problem.create(robot, **(given | changes))


@pytest.mark.parametrize(("name", "knots"), [("four_bar", 5), ("delta", 3)])
def test_the_slope_along_loops_is_that_of_differences(name: str, knots: int) -> None:
    limits = {"effort": True, "velocity": 8.0 if name != "delta" else {f"arm_{k}": 8.0 for k in (1, 2, 3)}}
    search, rng = _Search(linkage(name, limits=limits), 0.05, "both", knots), np.random.default_rng(1)
    c, along = search.begin(rng), rng.standard_normal(search.line.shape) * search.free[:, None]

    def value(x: float) -> float:
        return _log_det(search.matrix(search.motion(c + x * along)))

    expected = (value(1e-5) - value(-1e-5)) / 2e-5
    motion = search.motion(c)
    assert np.sum(search.slope(motion) * along) == pytest.approx(expected, rel=2e-4)
    best, found = search.climb(c, 1)
    assert best > value(0.0)
    assert search.within(found) is not None
    assert np.abs(search.dynamics.robot.closure_along(motion.qs)[0]).max() < 1e-9


@pytest.mark.parametrize(
    ("name", "steps"), [("four_bar", 30), pytest.param("five_bar", 60, marks=pytest.mark.slow)]
)
def test_loops_tell_more_than_along_random_motions(name: str, steps: int) -> None:
    """Joints that follow keep their limits, too, and a log says more by what the information promises."""
    problem = linkage(name, steps=steps)
    search, rng = _Search(problem, 0.05, "both", 6), np.random.default_rng(2)
    random = [search.begin(rng) for _ in range(2)]
    values = [_log_det(search.matrix(search.motion(c))) for c in random]
    best = search.climb(random[int(np.argmax(values))], 3)[1]
    solution = mbocp.solve(search.problem_near(best), check=True)
    told = information(solution)
    assert told.log_det > max(values) + 3.0
    follow = search.dynamics.dependent
    assert 5.0 < np.abs(solution.vs[:, follow]).max() <= 8.0 * (1.0 + 1e-6)
    t = np.arange(150) / 50.0
    size = []
    for c in (random[int(np.argmax(values))], best):
        y, yd, ydd = (search.spline.derivative(k)(t) @ c for k in range(3))
        dynamics = search.dynamics
        log = log_of(dynamics, dynamics.motion(y, yd, ydd, dynamics.follow(y, problem.q_start)), t, 1)
        size.append(np.linalg.slogdet(mbocp.identify(problem.robot, log).base_covariance)[1])
    assert size[1] < size[0] - 3.0


def test_loops_that_would_jump_have_no_motion() -> None:
    """Between these poses of a five-bar lies one where both rods are in line."""
    dynamics = InverseDynamics(mbocp.load_robot("five_bar"))
    with pytest.raises(MbocpError, match="without a jump"):
        dynamics.follow(np.array([[1.14094617, -1.24580799]]))


def test_goals_that_leave_joints_free_are_refused() -> None:
    problem = linkage("five_bar", goal={"q": {"left_shoulder": -1.9}, "v": 0.0})
    with pytest.raises(MbocpError, match=r"goal\.q"):
        mbocp.excite(problem)


def test_joints_without_motors_are_refused() -> None:
    goal = {"q": [0.0, 0.5, 1.0], "v": 0.0}
    problem = mbocp.Problem.create("cart_pendulum_rigid", 3.0, 60, goal=goal, scheme="midpoint")
    with pytest.raises(MbocpError, match="one motor in each of"):
        mbocp.excite(problem)
