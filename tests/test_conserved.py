"""Conserved quantities of optima, Noether's theorem: their values, and how they are reported.

Goals are chosen so that nothing vanishes: a drift is relative to a value, whose size the tests state.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp._arrays import Array
from mbocp.cli.app import app
from mbocp.mechanics.symmetries import find_symmetries, momentum_name
from mbocp.problem import Problem

from .mechanics import models

EXAMPLES = Path(__file__).parents[1] / "examples"
TOLERANCE = 1e-9  # of the relative drift
METHODS = ("monolithic", "fbsm_newton", "fbsm_bb+monolithic", "fbsm_bb+fbsm_newton")
ALL_METHODS = ("fbsm_bb", *METHODS)
SWITCH = ("solver.switch_residual=0", "solver.switch_cost=0", "solver.switch_iterations=10")

WEIGHTLESS = "robot.gravity=[0, 0, 0]"
ELASTIC = ("paper/elastic_pendulum", "horizon.steps=50")
RIGID = (
    "paper/rigid_pendulum", "horizon.steps=50",
    "start.q=[-3, 0, -4]", "start.p=[0.4, 2, -0.3]", "goal.q=[0, 3, -4]",
)  # fmt: skip
# Without an end condition on the cart the adjoints end at zero, and so does their sum all the way.
TO_A_PLACE = ('goal={q={cart_x=0.3}, enforce="exact"}', "cost.target={q=[0, 0, 2]}", "horizon.steps=100")
CARTS = (("paper/cart_pendulum_rigid", *TO_A_PLACE), ("paper/cart_pendulum_elastic", *TO_A_PLACE))
ARMS = (("arms/ur5_reach", "shoulder_pan_joint"), ("arms/panda_reach", "panda_joint1"))


def load(name: str, *settings: str) -> Problem:
    scheme = (
        ("integrator.scheme=se1", "horizon.steps=100")
        if name.startswith("arms")
        else ("integrator.scheme=se1",)
    )
    return mbocp.load_problem(EXAMPLES / f"{name}.toml", [*scheme, *settings])


@cache
def solve(name: str, *settings: str, method: str = "monolithic") -> mbocp.Solution:
    switch = SWITCH if "+" in method else ()  # so that hybrids do take gradient steps
    solution = mbocp.solve(load(name, *settings, *switch), solver=method)
    assert solution.converged, solution.advice
    return solution


def check_constant(values: Array, *, at_least: float) -> None:
    """Whether each column is constant, relative to a value that is not small."""
    assert np.abs(values[0]).min() > at_least
    assert (np.abs(values - values[0]).max(axis=0) <= TOLERANCE * np.abs(values[0])).all()


def check_reported(solution: mbocp.Solution, expected: dict[str, float], meaning: str = "") -> None:
    """Whether exactly the expected quantities are reported, as kept."""
    assert {quantity.name for quantity in solution.conserved} == set(expected)
    for quantity in solution.conserved:
        assert quantity.value == pytest.approx(expected[quantity.name], rel=1e-9)
        assert not quantity.vanishes
        assert quantity.relative_drift <= TOLERANCE
        assert meaning in quantity.meaning


def control_angular_momentum(s: mbocp.Solution) -> Array:
    """Eq. (15) for one particle."""
    out: Array = np.cross(s.qs, s.mus[:, :3]) + np.cross(s.ps, s.mus[:, 3:])
    return out


@pytest.mark.parametrize("method", ALL_METHODS)
@pytest.mark.parametrize("case", [ELASTIC, RIGID], ids=lambda c: c[0][6:])
def test_control_angular_momentum_about_gravity(case: tuple[str, ...], method: str) -> None:
    """About 14 for the spring, 61 for the rod; the other components change."""
    s = solve(*case, method=method)
    xi = control_angular_momentum(s)
    check_constant(xi[:, 2:], at_least=10.0)
    assert np.ptp(xi[:, :2], axis=0).min() > 1.0
    check_reported(s, {"rotation about z": xi[0, 2]}, "q x mu_q + p x mu_p along z")


@pytest.mark.parametrize("method", ALL_METHODS)
@pytest.mark.parametrize("case", [ELASTIC, RIGID], ids=lambda c: c[0][6:])
def test_control_angular_momentum_without_gravity(case: tuple[str, ...], method: str) -> None:
    """All three components: (-3.2, -2.8, 5.4) for the spring, (-108, 144, 108) for the rod."""
    s = solve(*case, WEIGHTLESS, method=method)
    xi = control_angular_momentum(s)
    check_constant(xi, at_least=2.0)
    check_reported(s, {f"rotation about {letter}": xi[0, i] for i, letter in enumerate("xyz")})


@pytest.mark.parametrize("method", ALL_METHODS)
@pytest.mark.parametrize("case", CARTS, ids=lambda c: c[0][6:])
def test_sum_of_the_horizontal_adjoints_of_a_cart_and_its_pendulum(
    case: tuple[str, ...], method: str
) -> None:
    """mu_q1 + mu_q3, as the paper counts: 0.059 for the rod, 0.030 for the spring; each alone changes."""
    s = solve(*case, method=method)
    total = s.mus[:, 0] + s.mus[:, 1]
    check_constant(total[:, None], at_least=0.02)
    assert np.ptp(s.mus[:, 0]) > 2.0 * abs(total[0])
    meaning = "adjoints mu_q of cart_x + mu_q of pendulum_x"
    check_reported(s, {"translation along x": total[0]}, meaning)


def test_a_quantity_of_the_paper_s_carts_vanishes_and_is_called_zero() -> None:
    s = solve("paper/cart_pendulum_rigid", "horizon.steps=40")
    (quantity,) = s.conserved
    assert quantity.vanishes
    assert abs(quantity.value) < 1e-12
    assert quantity.drift < 1e-12
    assert s.to_dict()["conserved"][0]["relative_drift"] is None


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("name", "joint"), ARMS)
def test_adjoint_of_the_base_joint_of_an_arm(name: str, joint: str, method: str) -> None:
    """The base turns about gravity, its angle is cyclic: mu_q is -127 for the UR5, -114 for the Panda."""
    s = solve(name, method=method)
    assert s.labels.v[0].name == joint
    check_constant(s.mus[:, :1], at_least=100.0)
    assert np.ptp(s.mus[:, 1 : s.nv], axis=0).min() > 0.5  # nothing else is
    check_reported(s, {"rotation about z": s.mus[0, 0]}, f"adjoint mu_q of {joint}, a cyclic coordinate")


@pytest.mark.parametrize("method", METHODS)
def test_spatial_adjoints_of_a_free_flyer(method: str) -> None:
    """(-8.3, -4.1, -13.2) for translations and 0.062 for the rotation about z; about x and y it changes.

    Uniform gravity does not depend on the height, so that the vertical translation is a symmetry, too.
    """
    s = solve("free_flyer/drone_flip", method=method)
    linear, angular = spatial_adjoints(s)
    check_constant(linear, at_least=1.0)
    check_constant(angular[:, 2:], at_least=1e-3)
    assert np.ptp(angular[:, :2], axis=0).min() > 1.0
    expected = {f"translation along {letter}": linear[0, i] for i, letter in enumerate("xyz")}
    check_reported(s, {**expected, "rotation about z": angular[0, 2]}, "spatial adjoint of root_joint's")


def spatial_adjoints(s: mbocp.Solution) -> tuple[Array, Array]:
    """Covectors of the free-flyer in the world's axes about its origin.

    The multipliers of a step of SE1 are written in the body's axes after the step.
    """
    places = [pin.XYZQUATToSE3(q) for q in [*s.qs[1:], s.qs[-1]]]
    linear = np.array([M.rotation @ mu[:3] for M, mu in zip(places, s.mus, strict=True)])
    turned = np.array([M.rotation @ mu[3:6] for M, mu in zip(places, s.mus, strict=True)])
    return linear, turned + np.cross([M.translation for M in places], linear)


def test_value_is_what_moving_the_start_costs() -> None:
    problem = load("arms/ur5_reach", "horizon.steps=50")
    best, h = mbocp.solve(problem), 1e-3  # [rad]

    def cost(angle: float) -> float:
        q = problem.q_start + np.array([angle, 0, 0, 0, 0, 0])
        s = mbocp.solve(problem.with_(q_start=q), warm_start=best)
        assert s.converged
        return s.cost

    slope = (8 * (cost(h) - cost(-h)) - (cost(2 * h) - cost(-2 * h))) / (12 * h)
    assert best.conserved[0].value == pytest.approx(slope, rel=1e-7)


@pytest.mark.parametrize(
    ("weight", "is_symmetric"),
    [("q=[1, 0, 1]", False), ("q=[0, 1, 1]", False), ("q=[0, 0, 3]", True)],
)
def test_a_cost_that_looks_at_the_place_is_not_claimed_to_be_invariant(
    weight: str, is_symmetric: bool
) -> None:
    name, *settings = CARTS[0]
    s = solve(name, *settings, f"cost.tracking_weights={{{weight}}}")
    total = s.mus[:, 0] + s.mus[:, 1]
    if is_symmetric:
        check_reported(s, {"translation along x": total[0]})
    else:
        assert s.conserved == ()
        assert np.ptp(total) > 0.1 * np.abs(total).max()  # it really is not


def test_a_rotation_is_broken_by_tracking_one_of_its_coordinates() -> None:
    tracked = ("cost.tracking=1.0", "cost.tracking_weights=[1, 0, 0, 0, 0, 0]", "cost.target={q=[4, 0, 0]}")
    s = solve(*ELASTIC, *tracked)
    assert s.conserved == ()
    assert np.ptp(control_angular_momentum(s)[:, 2]) > 1.0
    height = ("cost.tracking=1.0", "cost.tracking_weights=[0, 0, 1, 0, 0, 0]", "cost.target={q=[0, 0, -4]}")
    s = solve(*ELASTIC, *height)
    check_reported(s, {"rotation about z": control_angular_momentum(s)[0, 2]})


def test_weighed_changes_of_forces_that_turn_along_are_not_claimed_to_keep_a_rotation() -> None:
    """The control before has a part in the momentum then, which is not looked for."""
    s = solve(*ELASTIC, "cost.control_rate=0.1")
    assert s.conserved == ()
    assert np.ptp(control_angular_momentum(s)[:, 2]) > 1e-3
    name, *settings = CARTS[0]  # a force along the rail does not turn
    s = solve(name, *settings, "cost.control_rate=0.1")
    check_reported(s, {"translation along x": s.mus[0, 0] + s.mus[0, 1]})


def test_control_hamiltonian_of_an_arm_tends_to_its_constant() -> None:
    """To first order, once the first and the last instants are left out.

    There the light wrist moves faster than the steps resolve; in between H varies by 41, 21, 10 about -168.
    """
    name, solutions = "arms/ur5_reach", []
    for steps in (100, 200, 400):
        start = solutions[-1] if solutions else None
        solutions.append(mbocp.solve(load(name, f"horizon.steps={steps}"), warm_start=start))
    assert all(s.converged for s in solutions)
    inner = [s.control_hamiltonians[s.num_steps // 10 : -s.num_steps // 10] for s in solutions]
    varies = [np.ptp(values) for values in inner]
    assert varies[0] / varies[1] == pytest.approx(2.0, abs=0.1)
    assert varies[1] / varies[2] == pytest.approx(2.0, abs=0.1)
    assert varies[2] < 0.1 * abs(inner[2].mean())
    for s in solutions:
        h = s.control_hamiltonian
        assert h == {
            "min": s.control_hamiltonians.min(),
            "max": s.control_hamiltonians.max(),
            "mean": s.control_hamiltonians.mean(),
        }


def test_info_and_json_report_what_is_conserved(tmp_path: Path) -> None:
    s = solve("arms/ur5_reach")
    path = s.save(tmp_path / "reach.h5")
    loaded = mbocp.Solution.load(path)
    assert loaded.conserved == s.conserved
    run = CliRunner(env={"COLUMNS": "80", "TERM": "dumb"})
    lines = run.invoke(app, ["info", str(path)]).stdout.splitlines()
    row = next(i for i, line in enumerate(lines) if line.startswith("conserved"))
    assert "rotation about z: -127.08" in lines[row]
    assert lines[row + 1].strip() == "adjoint mu_q of shoulder_pan_joint, a cyclic coordinate"
    assert "Hamiltonian  mean -155.05" in "\n".join(lines)
    (entry,) = json.loads(run.invoke(app, ["info", str(path), "--json"]).stdout)["conserved"]
    assert entry["name"] == "rotation about z"
    assert entry["value"] == pytest.approx(s.mus[0, 0])
    assert 0.0 <= entry["relative_drift"] <= TOLERANCE


def test_info_says_when_nothing_is_conserved(tmp_path: Path) -> None:
    name, *settings = CARTS[0]
    path = solve(name, *settings, "cost.tracking_weights={q=[1, 0, 1]}").save(tmp_path / "cart.h5")
    told = CliRunner().invoke(app, ["info", str(path)]).stdout
    assert "none: no translation or rotation is known to be a symmetry" in told


@pytest.mark.parametrize(
    ("kinds", "words"),
    [
        ("RZ", {"rotation about z": "adjoint mu_q of 0_RZ, a cyclic coordinate"}),
        ("PX RY", {"translation along x": "adjoint mu_q of 0_PX, a cyclic coordinate"}),
        ("Planar", {"rotation about z": "spatial adjoint of 0_Planar's rotation along z"}),
        ("Spherical", {"rotation about z": "spatial adjoint of 0_Spherical's rotation along z"}),
        ("FreeFlyer RX", {"translation along y": "spatial adjoint of 0_FreeFlyer's position along y"}),
    ],
)
def test_words_for_every_kind_of_joint(kinds: str, words: dict[str, str]) -> None:
    robot = models.robot(models.chain(kinds)[0])
    found = {s.name: momentum_name(s, robot) for s in find_symmetries(robot)}
    for name, meaning in words.items():
        assert found[name] == meaning


def test_words_for_joints_that_turn_the_other_way_or_sit_askew() -> None:
    model = pin.Model()
    upside_down = pin.SE3(pin.utils.rotate("x", np.pi), np.array([0.2, 0.0, 1.0]))
    joint = model.addJoint(0, pin.JointModelRZ(), upside_down, "base")
    model.appendBodyToJoint(joint, models.BODY, pin.SE3.Identity())
    robot = models.robot(model)
    (symmetry,) = find_symmetries(robot)
    assert symmetry.name == "rotation about z through (0.2, 0, 0)"
    assert momentum_name(symmetry, robot) == "minus adjoint mu_q of base, a cyclic coordinate"
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), upside_down, "base")
    model.appendBodyToJoint(joint, models.BODY, pin.SE3.Identity())
    robot = models.robot(model)
    found = {s.name: momentum_name(s, robot) for s in find_symmetries(robot)}
    assert found["translation along z"] == (
        "spatial adjoint of base's position along -z, in the frame that the joint is fixed to"
    )
    assert found["rotation about z"] == ""  # about an axis beside the joint's origin
