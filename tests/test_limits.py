"""Limits and path constraints, solved: kept, active where multipliers are, and priced by them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbocp

EXAMPLES = Path(__file__).parents[1] / "examples"
UR5 = EXAMPLES / "arms" / "ur5_limits.toml"
UNICYCLE = EXAMPLES / "so3" / "unicycle_pendulum.toml"


def solved(path: Path, *settings: str) -> mbocp.Solution:
    solution = mbocp.solve(mbocp.load_problem(path, settings))
    assert solution.converged, solution.advice
    assert solution.limit_violation < 1e-6
    return solution


def check_complementarity(s: mbocp.Solution) -> None:
    """Multipliers pull inwards, and only at their limits."""
    for letter, values in (("u", s.us), ("v", s.vs), ("q", s.qs)):
        lam, (lower, upper) = getattr(s, f"lam_{letter}s"), getattr(s, f"limits_{letter}")
        active = np.abs(lam) > 1e-5 * max(1.0, np.abs(lam).max())
        at = np.where(lam > 0.0, upper, lower)
        assert np.abs(values - at)[active].max(initial=0.0) < 1e-5


def test_an_arm_stopped_by_its_limits() -> None:
    s = solved(UR5)
    touched = {(a.kind, a.name, a.side) for a in s.active_limits}
    assert ("velocity", "shoulder_pan_joint", "upper") in touched
    check_complementarity(s)
    free = mbocp.solve(mbocp.load_problem(UR5, ["limits={}", "solver=monolithic"]))
    assert free.cost < s.cost
    assert np.abs(free.vs).max() > 4.0 > np.abs(s.vs).max()


def test_a_limit_that_nothing_touches_changes_nothing() -> None:
    wide = solved(UR5, "limits={velocity=30.0}", "horizon.steps=40")
    free = mbocp.solve(mbocp.load_problem(UR5, ["limits={}", "solver=monolithic", "horizon.steps=40"]))
    assert wide.active_limits == ()
    assert wide.cost == pytest.approx(free.cost, rel=1e-8)
    np.testing.assert_allclose(wide.us, free.us, atol=1e-4)


def test_a_warm_start_knows_what_the_limits_weigh() -> None:
    cold = solved(UR5, "horizon.steps=40", "integrator.scheme=se1")
    steps = {"horizon.steps": 50, "integrator.scheme": "se1"}
    near = mbocp.load_problem(UR5, {**steps, "goal.q": [2.21, -0.7, 1.5, -2.3, -1.57, 0.8]})
    again, warm = mbocp.solve(near, check=True), mbocp.solve(near, warm_start=cold, check=True)
    assert warm.cost == pytest.approx(again.cost, rel=1e-9)
    assert warm.iterations <= 0.8 * again.iterations


@pytest.mark.parametrize(
    ("key", "value", "field"),
    [
        ("limits={{velocity={{shoulder_pan_joint={}}}}}", 3.15, "lam_vs"),
        ("limits={{effort={{shoulder_lift_joint={}}}}}", 100.0, "lam_us"),
        ("limits={{position={{elbow_joint=[-9, {}]}}}}", 1.55, "lam_qs"),
    ],
)
def test_multipliers_are_the_price_of_a_limit(key: str, value: float, field: str) -> None:
    """The cost changes by minus the multipliers as limits are widened."""
    step = 1e-3 * value
    less, more = (solved(UR5, "horizon.steps=40", key.format(value + sign * step)) for sign in (-1, 1))
    s = solved(UR5, "horizon.steps=40", key.format(value))
    assert s.active_limits
    check_complementarity(s)
    price = -np.abs(getattr(s, field)).sum()
    assert (more.cost - less.cost) / (2 * step) == pytest.approx(price, rel=2e-2)


@pytest.mark.parametrize(
    ("constraint", "value"),
    [
        ('kind="position", y=[-9, {}]', 0.55),
        ('kind="distance", point=[0, 0, 0], min={}', 0.68),
        ('kind="distance", frame_b="base_link", min={}', 0.68),
        ('kind="speed", max={}', 2.5),
    ],
)
def test_multipliers_are_the_price_of_a_path_constraint(constraint: str, value: float) -> None:
    def at(bound: float) -> mbocp.Solution:
        table = f'path=[{{frame="tool0", {constraint.format(bound)}}}]'
        return solved(UR5, "horizon.steps=40", "limits={}", table)

    step = 1e-3 * value
    s = at(value)
    assert [a.kind for a in s.active_limits] == ["path"]
    assert s.path_names[0].split(" ")[0] in constraint
    slope = (at(value + step).cost - at(value - step).cost) / (2 * step)
    assert slope == pytest.approx(-s.lam_path.sum(), rel=2e-2)


def test_the_unicycle_keeps_its_limits_and_stands_upright() -> None:
    s = solved(UNICYCLE)
    assert np.abs(s.us[:, 0]).max() <= 2 * np.pi + 1e-6
    assert np.abs(s.us[:, 1]).max() <= 6.0 + 1e-6
    assert s.active_limits
    check_complementarity(s)
    assert s.manifold_drift_resimulated < 1e-12
    problem = mbocp.load_problem(UNICYCLE)
    assert np.abs(problem.robot.difference(problem.goal.q, s.q_final)).max() < 1e-6


def test_an_arm_in_minimum_time_within_all_limits() -> None:
    """Jerks of the slowest joints are at a bound, or their accelerations are."""
    s = solved(EXAMPLES / "arms" / "minimum_time.toml")
    dt = s.duration / s.num_steps
    a = np.diff(s.vs, axis=0) / dt
    jerk = np.diff(a, axis=0, prepend=np.zeros((1, 6)), append=np.zeros((1, 6))) / dt
    jerk[[0, -1]] *= 2.0  # from rest, and to rest, in half a step
    assert np.abs(a).max() == pytest.approx(10.0, rel=1e-6)
    assert np.abs(jerk).max() == pytest.approx(100.0, rel=1e-6)
    at_bound = (np.abs(a) > 9.999) | (np.abs(jerk[:-1]) > 99.99)
    assert at_bound[:, 1:3].mean() > 0.9
    # One radian from rest to rest takes no less by the textbook profile of seven pieces, ramps of 0.1 s.
    assert 0.65 < s.duration < 0.75


@pytest.mark.parametrize("scheme", ["midpoint", "gauss2", "se1", "semi_implicit_euler"])
def test_a_goal_may_be_at_a_limit(scheme: str) -> None:
    """The end condition says all that the limit says there, and a barrier has no room."""
    q_goal, most = [0.8, 0.8], [0.8, 1.0]
    problem = mbocp.problem.Problem.create(
        "double_pendulum",
        1.0,
        20,
        start={"q": [0.0, 0.0]},
        goal={"q": q_goal, "v": 0},
        cost={"effort": 1.0},
        limits={"position": {"joint1": [-1.0, most[0]], "joint2": [-1.0, most[1]]}},
        scheme=scheme,
        solver={"method": "monolithic"},
    )
    s = mbocp.solve(problem)
    assert s.converged, s.advice
    assert (s.qs <= np.array(most) + 1e-9).all()
    np.testing.assert_allclose(s.qs[-1], q_goal, atol=1e-8)
    bounds = mbocp.formulation.formulate(problem).programme.bounds
    at_last = np.isfinite(bounds.x_upper[-2:, :2])
    assert at_last.tolist() == [[scheme in ("midpoint", "gauss2"), True], [False, True]]
