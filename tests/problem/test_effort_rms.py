"""Root mean squares of controls that have a limit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.cli.solution_summary import solution_rows
from mbocp.exceptions import MbocpError, ProblemError
from mbocp.formulation import Motion, formulate
from mbocp.formulation.inequalities import limit_violation
from mbocp.integrators import root_mean_squares
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.receding import RecedingHorizon
from mbocp.solution import loads_of
from tests.formulation.stages import check_derivatives

EXAMPLES = Path(__file__).parents[2] / "examples"
LIMIT, WAY, INERTIA = 1.5, 2.0, 0.5
LEAST = 12.0**0.25 * np.sqrt(INERTIA * WAY / LIMIT)  # of the control that falls linearly from J 6 WAY / T^2
ROTOR = f"""<robot name="rotor"><link name="base"/>
<link name="wheel"><inertial><mass value="1"/>
<inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="axle" type="revolute"><parent link="base"/><child link="wheel"/><axis xyz="0 0 1"/>
<limit lower="-100" upper="100" effort="0" velocity="50"/></joint></robot>"""
ARM_LIMIT = 0.24
LOADED = {"effort_rms": {"joint1": ARM_LIMIT}}


@pytest.fixture
def rotor(tmp_path: Path) -> mbocp.Robot:
    file = tmp_path / "rotor.urdf"
    file.write_text(ROTOR)
    return mbocp.load_robot(file)


def turn(rotor: mbocp.Robot, steps: int = 20, **words: Any) -> Problem:
    """To an angle, at rest, in the least time."""
    goal, cost = {"q": [WAY], "v": [0.0]}, {"time": 1.0, "effort": 1e-8}
    words = {"limits": {"effort_rms": LIMIT}, **words}
    return Problem.create(rotor, {"min": 0.05, "max": 9.0}, steps, goal=goal, cost=cost, **words)


def lift(**words: Any) -> Problem:
    goal, cost = {"q": [0.8, 0.4], "v": 0}, {"effort": 1.0}
    words = {"limits": LOADED, "scheme": "midpoint", **words}
    return Problem.create("double_pendulum", 1.0, 20, goal=goal, cost=cost, **words)


@pytest.mark.parametrize(
    ("scheme", "controls", "near"),
    [
        ("se1", "constant", 2.0 / 40**2),
        ("euler", "constant", 2.0 / 40**2),
        ("rk4", "constant", 2.0 / 40**2),
        ("midpoint", "constant", 2.0 / 40**2),
        ("gauss2", "linear", 1e-8),
        ("gauss2", "stages", 1e-8),
        ("lobatto2", "linear", 2.0 / 40**2),
        ("radau2", "stages", 1e-8),
    ],
)
def test_the_least_time_is_exact(rotor: mbocp.Robot, scheme: str, controls: str, near: float) -> None:
    solution = mbocp.solve(turn(rotor, 40, scheme=scheme, controls=controls), check=True)
    assert solution.duration == pytest.approx(LEAST, rel=near)
    (load,) = loads_of(solution, rotor)
    assert load.rms == pytest.approx(LIMIT, rel=1e-8)
    (limit,) = solution.active_limits
    assert (limit.kind, limit.name, limit.side, limit.bound) == ("effort_rms", "axle", "upper", LIMIT)
    rows = {name: str(words) for name, words in solution_rows(solution, "")}
    assert rows["rms effort"] == "axle 1.5 of 1.5 N m"
    assert rows["limits"].startswith("root mean square of axle at its limit 1.5 N m\n")


@pytest.mark.parametrize(
    ("words", "coordinates"),
    [
        ({"scheme": "midpoint"}, "joint"),
        ({"scheme": "midpoint"}, "natural"),
        ({"scheme": "gauss2", "controls": "stages"}, "joint"),
        ({"solver": {"method": "ipopt"}}, "joint"),
    ],
)
def test_a_given_duration_costs_more_within_it(words: dict[str, Any], coordinates: str) -> None:
    given = {**words, "coordinates": coordinates}
    free, limited = (mbocp.solve(lift(**given, limits=one), check=True) for one in ({}, LOADED))
    robot = limited.problem.robot
    before, after = ([load.rms for load in loads_of(one, robot)] for one in (free, limited))
    assert before[0] > 1.04 * ARM_LIMIT
    assert after[0] == pytest.approx(ARM_LIMIT, rel=1e-7)
    assert after[1] > before[1]
    assert limited.cost > free.cost
    assert limited.limit_violation == 0.0


@pytest.mark.parametrize("controls", ["constant", "linear", "stages"])
def test_a_motion_has_heat_and_a_violation(controls: str) -> None:
    """From the numbers of any motion, as `loads_of` would say them."""
    problem, rng = lift(scheme="gauss2", controls=controls), np.random.default_rng(0)
    formulation = formulate(problem)
    k, lengths = formulation.pieces.signature.control_values.shares, problem.timeline.lengths()
    values = rng.normal(size=(problem.num_steps, len(k), 2))
    if controls == "linear":
        values[1:, 0] = values[:-1, 1]
    us = values.mean(axis=1) if k else rng.normal(size=(problem.num_steps, 2))
    still = np.zeros((problem.num_steps + 1, 2))
    motion = Motion(still, still, us, lengths, *((values, k) if k else ()))
    iterate = formulation.iterate_of(motion, np.zeros((problem.num_steps, 0)))
    square = root_mean_squares(lengths, us, values, k)[0] ** 2
    heat = iterate.xs[-1, formulation.layout.states["heat"]]
    assert heat == pytest.approx([square / ARM_LIMIT**2 - 1.0], rel=1e-12)
    found = limit_violation(formulation, iterate, motion)
    assert found == pytest.approx(square**0.5 - ARM_LIMIT, rel=1e-12)


@pytest.mark.parametrize("scheme", ["se1", "midpoint", "gauss2", "rk4"])
@pytest.mark.parametrize("duration", [1.0, {"min": 0.2, "max": 3.0}])
def test_its_derivatives_are_exact(scheme: str, duration: Any) -> None:
    formulation = formulate(lift(scheme=scheme).with_(duration=duration))
    check_derivatives(formulation, 2, [formulation.layout.rows["heat"].start])


def test_the_mean_is_that_of_the_polynomial() -> None:
    """By a quadrature of its own; a step of no duration, an impact, does not count."""
    rng, shares = np.random.default_rng(0), (0.1, 0.5, 0.9)
    values, lengths = rng.normal(size=(4, 3, 2)), np.array([0.1, 0.2, 0.0, 0.3])
    places = (np.arange(100_000) + 0.5) / 100_000
    polynomials = [[np.polyval(np.polyfit(shares, v[:, k], 2), places) for k in range(2)] for v in values]
    squares = np.array([[np.mean(p**2) for p in step] for step in polynomials])
    wanted = np.sqrt(lengths @ squares / lengths.sum())
    found = root_mean_squares(lengths, values.mean(axis=1), values, shares)
    np.testing.assert_allclose(found, wanted, rtol=1e-8)


def test_another_limit_compiles_nothing_and_files_say_the_same(rotor: mbocp.Robot, tmp_path: Path) -> None:
    one, two = turn(rotor), turn(rotor, limits={"effort_rms": 2.0 * LIMIT})
    assert formulate(one).pieces.signature == formulate(two).pieces.signature
    assert parse_problem(problem_to_toml(two)).limits.rms_upper.tolist() == [2.0 * LIMIT]
    part = lift()
    assert parse_problem(problem_to_toml(part)).limits.rms_upper.tolist() == [ARM_LIMIT, np.inf]
    solution = mbocp.solve(part, check=True)
    solution.save(tmp_path / "a.h5")
    saved = mbocp.Solution.load(tmp_path / "a.h5")
    assert saved.facts.effort_rms == (ARM_LIMIT, np.inf)
    assert saved.active_limits == solution.active_limits
    assert mbocp.solve(saved.problem, warm_start=saved).iterations <= 1


def test_a_stop_is_no_motion_to_be_hot_by() -> None:
    problem = lift(limits={**LOADED, "effort": 40.0})
    stopped = mbocp.stop(problem, q=[0.3, 0.1], v=[1.0, 0.5])
    assert stopped.problem.limits.finite("u").all()
    assert not stopped.problem.limits.finite("rms").any()


@pytest.mark.parametrize(
    ("written", "says"),
    [
        (-1.0, r"effort_rms: got -1.0, expected a number above 0"),
        ({"joint1": 0}, r"effort_rms: got 0 for 'joint1', expected a number above 0"),
        ([[-1.0, 2.0], 1.0], r"effort_rms: got \[-1.0, 2.0\] at index 0, expected a number"),
        (True, r"effort_rms: got True, expected a number"),
        ([1.0], r"effort_rms: got shape \(1,\), expected \(2,\)"),
        ({"elbow": 1.0}, r"effort_rms: robot 'double_pendulum' has no control 'elbow'"),
    ],
)
def test_what_is_no_limit_is_refused(written: Any, says: str) -> None:
    with pytest.raises(MbocpError, match=says):
        lift(limits={"effort_rms": written})


def test_where_it_cannot_be_it_is_refused() -> None:
    phases = [
        {"name": "up", "steps": 10, "duration": 0.5, "limits": LOADED},
        {"name": "on", "steps": 10, "duration": 0.5},
    ]
    with pytest.raises(ProblemError, match=r"phase 'up': limits.effort_rms: it is of the whole motion"):
        lift().with_(phase=phases)
    with pytest.raises(ProblemError, match=r"receding horizon: limits.effort_rms: is of a whole motion"):
        RecedingHorizon(lift())
    driven = mbocp.load_problem(EXAMPLES / "so3" / "unicycle_pendulum.toml")
    drive = driven.robot.u_labels[-1].name
    with pytest.raises(ProblemError, match=r"prescribes a motion and heats no motor"):
        driven.with_(limits={"effort_rms": {drive: 1.0}}, solver={"method": "auto"})
