"""Problems in natural coordinates: reference optima, agreement with joint coordinates, symmetries."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import ProblemError
from mbocp.formulation import formulate
from mbocp.problem import Guess, Problem
from mbocp.problem.problem import problem_from_tables
from mbocp.programme.kernel import kernel_programme
from mbocp.robot import robot_from_spec
from mbocp.solution import Solution
from mbocp.solvers import Status
from tests.robot import urdfs

UR5_START = [0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0]
UR5_GOAL = [0.5, 1.2, 0.5, -0.3, 0.4, 0.2]


def double_pendulum(steps: int, coordinates: str = "natural", **tables: Any) -> Problem:
    document = {
        "robot": {"name": "double_pendulum", "damping": False},  # the optima below are without
        "coordinates": coordinates,
        "horizon": {"duration": 1.5, "steps": steps},
        "integrator": {"scheme": "se1"},
        "start": {"q": [0.0, 0.0]},
        "goal": {"q": [0.8, -0.6], "p": [0.0, 0.0]},
        "cost": {},
    }
    return problem_from_tables({**document, **tables})


def floating(coordinates: str = "natural", gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Problem:
    """A drone's body pushed by a whole wrench, to an attitude and place that leave no momentum zero."""
    attitude = np.array([0.3, -0.2, 0.4, 0.85])
    attitude = attitude / np.linalg.norm(attitude)
    return problem_from_tables(
        {
            "robot": {"name": "hector", "gravity": list(gravity), "actuated": ["root_joint"]},
            "coordinates": coordinates,
            "horizon": {"duration": 1.0, "steps": 40},
            "integrator": {"scheme": "se1"},
            "start": {"q": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], "v": [0.1, -0.2, 0.3, 0.2, 0.1, -0.3]},
            "goal": {"q": [0.4, -0.3, 0.5, *attitude.tolist()], "v": [0.2, 0.1, -0.1, 0.3, 0.2, 0.1]},
            "cost": {},
        }
    )


def solved(problem: Problem, **options: Any) -> Solution:
    solution = mbocp.solve(problem, **options)
    assert solution.converged, solution.advice
    return solution


# Optima that others computed: J = sum dt/2 |u|^2, rest to rest, projected end conditions.
@pytest.mark.parametrize(
    ("steps", "joint", "natural"), [(50, 0.022733819, 0.022707921), (100, 0.021696500, 0.021686105)]
)
def test_double_pendulum_has_the_reference_costs(steps: int, joint: float, natural: float) -> None:
    assert solved(double_pendulum(steps, "joint")).cost == pytest.approx(joint, abs=1e-9)
    assert solved(double_pendulum(steps)).cost == pytest.approx(natural, abs=1e-9)


def test_ur5_has_the_reference_costs() -> None:
    document = {
        "robot": "ur5",
        "horizon": {"duration": 1.5, "steps": 100},
        "integrator": {"scheme": "se1"},
        "start": {"q": UR5_START},
        "goal": {"q": UR5_GOAL, "p": [0.0] * 6},
        "cost": {},
    }
    joint = solved(problem_from_tables(document))
    natural = solved(problem_from_tables({**document, "coordinates": "natural"}))
    assert joint.cost == pytest.approx(2.419557001, abs=1e-8)
    assert natural.cost == pytest.approx(2.641142369, abs=1e-8)
    assert natural.constraint_violation < 1e-10
    (pan,) = natural.conserved  # about the axis of gravity
    assert pan.name == "rotation about z"
    assert pan.relative_drift < 1e-9


def test_optimum_tends_to_that_of_joint_coordinates() -> None:
    gaps = []
    for steps in (50, 100, 200, 400):
        joint, natural = solved(double_pendulum(steps, "joint")), solved(double_pendulum(steps))
        gaps.append(np.abs(joint.qs - natural.qs).max())
    assert gaps == sorted(gaps, reverse=True)
    assert gaps[0] / gaps[-1] > 6.0, gaps  # of first order: eight, but not cleanly in coarse steps


@pytest.mark.parametrize(
    ("robot", "effort"),
    [
        ("double_pendulum", 0.005),
        ("four_bar", 0.05),
        ({"name": "hector", "actuated": ["root_joint"]}, 0.05),
    ],
    ids=["double_pendulum", "four_bar", "hector"],
)
def test_forward_simulations_converge_to_each_other(robot: Any, effort: float) -> None:
    nv = robot_from_spec(robot).nv if isinstance(robot, dict) else mbocp.load_robot(robot).nv
    gaps = []
    for steps in (100, 200, 400):
        ends = []
        for coordinates in ("joint", "natural"):
            problem = problem_from_tables(
                {
                    "robot": robot,
                    "coordinates": coordinates,
                    "horizon": {"duration": 0.5, "steps": steps},
                    "integrator": {"scheme": "se1"},
                    "goal": {"v": [0.0] * nv},  # nothing is solved
                }
            )
            formulation = formulate(problem)
            programme = formulation.programme
            native = kernel_programme(programme)
            native.u = np.full(native.u.shape, effort)
            xs = np.zeros((steps + 1, formulation.layout.nx))
            xs[0] = programme.x_start
            native.x = xs.ravel()
            sweep = native.simulate(1e-12, 50)
            assert sweep.ok
            zs = native.x.reshape(xs.shape)[:, formulation.layout.z]
            ends.append(formulation.space.configurations(zs)[-1])
        gaps.append(np.abs(problem.robot.difference(ends[0], ends[1])).max())
    assert 1.6 < gaps[0] / gaps[1] < 2.6, gaps
    assert 1.6 < gaps[1] / gaps[2] < 2.6, gaps


@pytest.mark.parametrize(
    "method", ["fbsm_newton", "fbsm_bb+monolithic", "fbsm_bb+fbsm_newton", "ipopt", "fatrop"]
)
def test_solvers_agree(method: str) -> None:
    problem = double_pendulum(50)
    expected = solved(problem, solver="monolithic")
    found = solved(problem, solver=method)
    assert found.cost == pytest.approx(expected.cost, abs=1e-10)
    assert np.abs(found.us - expected.us).max() < 1e-7


@pytest.mark.parametrize("kind", ["line", "hold"])
def test_any_guess_does_for_an_easy_problem(kind: str) -> None:
    problem = double_pendulum(50)
    direct = solved(problem.with_(guess=Guess(kind=kind)))  # type: ignore[arg-type]
    assert direct.cost == pytest.approx(solved(problem).cost, abs=1e-10)


def test_solutions_warm_start_in_either_coordinates() -> None:
    natural, joint = double_pendulum(50), double_pendulum(50, "joint")
    of_natural, of_joint = solved(natural), solved(joint)
    assert solved(natural, warm_start=of_joint).cost == pytest.approx(of_natural.cost, abs=1e-10)
    assert solved(natural, warm_start=of_natural).cost == pytest.approx(of_natural.cost, abs=1e-10)
    assert solved(joint, warm_start=of_natural).cost == pytest.approx(of_joint.cost, abs=1e-10)


def test_a_solution_is_that_of_joints_and_knows_its_coordinates(tmp_path) -> None:
    solution = solved(double_pendulum(50))
    assert solution.qs.shape == (51, 2)
    assert solution.lams.shape == (50, 22)
    assert solution.labels.lam[0].name == "joint1 d1.d1"
    assert np.allclose(solution.qs[-1], [0.8, -0.6], atol=1e-9)
    assert solution.manifold_drift < 1e-12
    assert Solution.load(solution.save(tmp_path / "result.h5")).equals(solution)
    assert solution.coordinates == "natural"


@pytest.mark.parametrize(
    "tables",
    [
        {"cost": {"velocity": 0.1}},
        {"cost": {"control_rate": 0.01}},
        {"cost": {"potential": 0.02}},
        {"cost": {"tracking": 1.0, "tracking_weights": {"q": 1.0}, "target": {"q": [0.4, -0.3]}}},
        {"cost": {"tracking": 1.0, "tracking_weights": {"p": 1.0}, "target": {"p": [0.01, 0.0]}}},
        {"cost": {"terminal": 10.0}, "goal": {"q": [0.8, -0.6], "p": [0.0, 0.0], "enforce": "penalty"}},
        {"cost": {"terminal": 10.0}, "goal": {"q": [0.8, -0.6], "v": [0.0, 0.1], "enforce": "both"}},
        {"goal": {"q": {"joint1": 0.8}, "v": [0.0, 0.0]}},
        {"integrator": {"scheme": "midpoint"}},
        {"integrator": {"scheme": "se2"}},
    ],
    ids=lambda tables: " ".join(f"{k}.{j}" for k, v in tables.items() for j in v),
)
def test_every_cost_and_goal_means_the_same(tables: dict[str, Any]) -> None:
    gaps = []
    for steps in (40, 100):
        joint, natural = (
            solved(double_pendulum(steps, "joint", **tables)),
            solved(double_pendulum(steps, **tables)),
        )
        gaps.append(abs(joint.cost - natural.cost) / abs(joint.cost))
    assert gaps[1] < max(0.5 * gaps[0], 5e-4), gaps


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 0.0), (0.0, 0.0, -9.81)])
@pytest.mark.parametrize("coordinates", ["joint", "natural"])
def test_control_momenta_of_a_free_body(coordinates: str, gravity: tuple[float, float, float]) -> None:
    solution = mbocp.solve(floating(coordinates, gravity))
    assert solution.status.is_stationary, solution.advice  # effort alone: the body may spin fast
    conserved = {c.name: c for c in solution.conserved}
    axes = "xyz" if not any(gravity) else "z"
    names = [f"translation along {a}" for a in "xyz"] + [f"rotation about {a}" for a in axes]
    assert set(names) <= set(conserved)
    for name in names:
        assert abs(conserved[name].value) > 1e-3, name  # the goal does not make it vanish
        assert conserved[name].relative_drift < 1e-9, name


def test_sliding_masses_have_the_same_equations_in_both() -> None:
    joint = solved(mbocp.load_problem("examples/paper/rigid_pendulum.toml"))
    natural = solved(mbocp.load_problem("examples/paper/rigid_pendulum.toml").with_(coordinates="natural"))
    for name in ("us", "lams"):  # the patterns of their blocks need not be the same, nor then the last digits
        wanted = getattr(joint, name)
        np.testing.assert_allclose(getattr(natural, name), wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


def test_what_has_no_meaning_is_refused() -> None:
    with pytest.raises(ProblemError, match=r"integrator\.scheme.*rk4.*natural coordinates"):
        double_pendulum(50, integrator={"scheme": "rk4"})
    with pytest.raises(ProblemError, match=r"limits\.velocity.*natural coordinates"):
        double_pendulum(50, limits={"velocity": 1.0})
    with pytest.raises(ProblemError, match=r'guess\.kind: "joint" is for'):
        double_pendulum(50, "joint", guess={"kind": "joint"})


def test_limits_on_controls_hold() -> None:
    free = solved(double_pendulum(50))
    bound = 0.8 * float(np.abs(free.us).max())
    limited = solved(double_pendulum(50, limits={"effort": bound}, solver={"method": "ipopt"}))
    assert np.abs(limited.us).max() <= bound + 1e-8
    assert limited.cost > free.cost


def test_rest_that_few_steps_do_not_resolve_asks_for_more(tmp_path: Path) -> None:
    """Velocities of bodies are at rest to the order of the scheme: that is no other root."""
    arm = str(urdfs.write(tmp_path, urdfs.chain("revolute", "revolute", "prismatic")))
    tables: dict[str, Any] = {"goal": {"q": [1.9, -0.9, 0.02], "v": 0}, "cost": {"velocity": 1.0}}
    few, more = (
        mbocp.solve(Problem.create(arm, 1.0, n, coordinates="natural", scheme="midpoint", **tables))
        for n in (6, 12)
    )
    assert few.status is Status.UNDER_RESOLVED, few.advice
    assert "take more steps" in few.advice
    assert more.converged, more.advice
