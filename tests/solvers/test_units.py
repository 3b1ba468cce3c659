"""Units of force and cost: the same programme, and robots of any mass are solved alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.formulation import Formulation, formulate
from mbocp.guesses import make_guess
from mbocp.programme import Iterate
from mbocp.solvers import PureNewton
from mbocp.solvers.strategies.in_units import count_in, iterate_in
from tests.campaign.robots import arm_urdf
from tests.campaign.run import run_task

FORCE, COST = 2.0**7, 2.0**-9
ARRAYS = ("xs", "ys", "us", "ms", "eta")
PROBLEMS: dict[str, dict[str, Any]] = {
    "implicit": {"scheme": "midpoint"},
    "momenta at the end": {"goal": {"q": [1.0, -1.0], "p": [0.1, 0.2]}},
    "rates of controls": {"cost": {"effort": 0.1, "control_rate": 0.02, "velocity": 0.1, "potential": 0.1}},
    "explicit": {"scheme": "rk4", "cost": {"effort": 0.1, "control_rate": 0.02}},
    "loops": {"robot": "four_bar", "goal": {"v": [0.0] * 3}},
    "natural": {"robot": "four_bar", "goal": {"v": [0.0] * 3}, "coordinates": "natural"},
    "drives": {"robot": "unicycle_pendulum", "scheme": "heun"},
}


def formulation_of(name: str, factor: float = 1.0) -> Formulation:
    tables = {
        "robot": "double_pendulum",
        "duration": 0.3,
        "steps": 8,
        "goal": {"q": [1.0, -1.0], "v": [0.0, 0.0]},
        "cost": {"effort": 0.1},
        **PROBLEMS[name],
    }
    tables["cost"] = {key: factor * weight for key, weight in tables["cost"].items()}
    if name == "drives":
        tables["goal"] = {"q": mbocp.load_robot("unicycle_pendulum").q0}
    return formulate(mbocp.Problem.create(**{"integrator": {"scheme": "se1"}, **tables}))


def perturbed(formulation: Formulation) -> Iterate:
    """A guess with multipliers, at which no row holds."""
    iterate, _ = make_guess("control", formulation)
    rng = np.random.default_rng(1)
    values = {name: getattr(iterate, name) for name in ARRAYS}
    moved = {k: v + 0.1 * rng.standard_normal(v.shape) for k, v in values.items()}
    moved["xs"][0] = iterate.xs[0]
    if formulation.programme.kind.nx != formulation.programme.kind.ndx:  # on a group
        moved["xs"] = values["xs"]
    return replace(iterate, **moved)


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_newton_step_is_the_same_in_all_units(name: str) -> None:
    formulation = formulation_of(name)
    programme, iterate = formulation.programme, perturbed(formulation)
    units = replace(programme.units, force=FORCE, cost=COST)
    counted, begun = count_in(units, programme), iterate_in(units, iterate)
    solver = PureNewton()
    wanted = solver.step(solver.init(programme, iterate))
    got = solver.step(solver.init(counted, begun))
    assert got.evaluation.cost == pytest.approx(COST * wanted.evaluation.cost, rel=1e-8)
    expected = iterate_in(units, Iterate.read_from(wanted.native, programme))
    found = Iterate.read_from(got.native, counted)
    for key in ARRAYS:
        a, b = getattr(found, key), getattr(expected, key)
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-8 * np.abs(b).max(initial=1e-300), err_msg=key)


@pytest.mark.parametrize("name", PROBLEMS)
def test_there_and_back_is_exact(name: str) -> None:
    formulation = formulation_of(name)
    units = replace(formulation.programme.units, force=FORCE, cost=COST)
    iterate = perturbed(formulation)
    inverse = replace(units, force=1.0 / FORCE, cost=1.0 / COST)
    back = iterate_in(inverse, iterate_in(units, iterate))
    for key in ARRAYS:
        assert np.array_equal(getattr(back, key), getattr(iterate, key))
    again = count_in(inverse, count_in(units, formulation.programme))
    for key in ("theta", "rho_terminal", "x_start"):
        assert np.array_equal(getattr(again, key), getattr(formulation.programme, key))


@pytest.mark.parametrize("name", PROBLEMS)
def test_units_of_a_programme_in_units_are_relative_to_them(name: str) -> None:
    programme = formulation_of(name).programme
    both = count_in(replace(programme.units, force=FORCE, cost=COST), programme)
    first = count_in(replace(programme.units, force=FORCE), programme)
    then = count_in(replace(first.units, cost=COST), first)
    assert then.units.are_users
    assert then.control_weight == both.control_weight
    for key in ("theta", "rho_terminal", "x_start"):
        assert np.array_equal(getattr(then, key), getattr(both, key))


def arm(mass: float, folder: Path) -> mbocp.Robot:
    file = folder / f"{mass:g}.urdf"
    file.write_text(arm_urdf(1.0, mass))
    return mbocp.load_robot(file)


def swung(mass: float, folder: Path, **others: Any) -> mbocp.Solution:
    """The same motion of an arm of any mass, with weights and limits that suit it."""
    limits = {key: mass * value for key, value in others.pop("limits", {}).items()}
    problem = mbocp.Problem.create(
        robot=arm(mass, folder),
        duration=1.5,
        steps=30,
        goal={"q": [1.5, -1.0, 0.8], "v": [0.0] * 3},
        cost={"effort": mass**-2, "velocity": 0.1},
        limits=limits,
        **{"integrator": {"scheme": "se1"}, **others},
    )
    return mbocp.solve(problem, check=True)


@pytest.mark.parametrize(
    "others",
    [{}, {"limits": {"effort": 6.0}}, {"solver": {"method": "ipopt"}}, {"solver": {"method": "fbsm_newton"}}],
    ids=["auto", "limits", "ipopt", "sweeps"],
)
def test_an_arm_of_any_mass_moves_alike(others: dict[str, Any], tmp_path: Path) -> None:
    plain = swung(1.0, tmp_path, **others)
    assert "counted" not in plain.advice
    for mass in (2.0**-24, 2.0**24):
        s = swung(mass, tmp_path, **others)
        assert "counted" in s.advice
        np.testing.assert_allclose(s.qs, plain.qs, rtol=0, atol=1e-5)
        np.testing.assert_allclose(s.us / mass, plain.us, rtol=0, atol=1e-5 * np.abs(plain.us).max())
        assert s.cost == pytest.approx(plain.cost, rel=1e-8)
        for key, size in (("mus", 1.0), ("eta", 1.0), ("lam_us", mass)):
            whole, part = getattr(plain, key), size * getattr(s, key)
            if key == "mus":  # duals of q and of p, which has the unit of mass
                part = part * np.repeat([1.0, mass], 3)
            np.testing.assert_allclose(part, whole, rtol=0, atol=1e-4 * np.abs(whole).max(initial=1e-3))
        assert s.iterations <= 2 * plain.iterations + 5


def test_problems_of_ordinary_size_keep_their_units() -> None:
    for name in ("ur5", "panda", "double_pendulum", "four_bar"):
        robot = mbocp.load_robot(name)
        problem = mbocp.Problem.create(
            robot, 1.0, 20, goal={"v": np.zeros(robot.nv)}, cost={"effort": 1.0}, scheme="se1"
        )
        assert formulate(problem).programme.units.are_users, name


@pytest.mark.parametrize("weight", [1e7, 1e9])
def test_a_large_weight_on_what_hardly_moves_takes_few_iterations(weight: float) -> None:
    problem = mbocp.Problem.create(
        "double_pendulum",
        1.5,
        20,
        goal={"q": [1.0, 0.0], "v": 0},
        limits={"effort": 2.0},
        cost={"effort": 0.01, "tracking": weight, "tracking_weights": [0, 1, 0, 0], "target": {"q": [0, 0]}},
    )
    solution = mbocp.solve(problem, check=True)
    assert "cost weighed" in solution.advice
    assert solution.iterations <= 12  # 17 and 22 with costs of about one


def test_costs_are_multiplied_as_by_their_weights() -> None:
    programme = formulation_of("rates of controls").programme
    counted = count_in(replace(programme.units, cost=COST), programme)
    other = formulation_of("rates of controls", factor=COST).programme
    for key in ("theta", "rho_terminal"):
        assert np.array_equal(getattr(counted, key), getattr(other, key))


@pytest.mark.parametrize("task", ["huge_arm:2", "huge_arm:13", "tiny_arm:27", "light_arm:22"])
def test_arms_of_a_millimetre_and_of_a_kilometre(task: str, tmp_path: Path) -> None:
    name, seed = task.split(":")
    row = run_task(name, int(seed), tmp_path)
    assert row["status"] in ("converged", "under_resolved"), row["advice"]
    assert row["failures"] == []
    assert row["iterations"] < 350  # those of trials with few steps included, where effort alone costs
