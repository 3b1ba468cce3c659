"""Schemes, their options, and the robots that they suit."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from mbocp.exceptions import InvalidValue, MbocpError, ProblemError
from mbocp.integrators import EULER_SCHEMES, PAIRS, TABLEAUX
from mbocp.problem import Problem, Stabilisation, parse_problem, problem_to_toml
from mbocp.problem.integration import has_rotations
from mbocp.robot import Robot, load_robot

Loader = Callable[..., Problem]

RK4 = "integrator.scheme=rk4"


def test_what_a_file_says_nothing_of(load: Loader) -> None:
    problem = load()
    assert (problem.scheme, problem.lie, problem.substeps) == ("gauss2", "munthe_kaas", 1)
    assert problem.stabilisation == Stabilisation()
    rates = (
        problem.stabilisation.gamma_quaternion,
        problem.stabilisation.gamma_dcm,
        problem.stabilisation.gamma_constraint,
    )
    assert rates == (2.0, 1.0, 0.0)  # [1/s]
    assert (problem.goal.guard, problem.goal.redundant) == (True, "drop")
    assert (problem.cost.potential, problem.cost.control_rate.any()) == (0.0, False)
    assert problem.solver.time_limit is None
    assert problem.solver.linear_solver == "auto"


@pytest.mark.parametrize("scheme", tuple(TABLEAUX))
@pytest.mark.parametrize("lie", ["plain", "baumgarte", "munthe_kaas"])
def test_explicit_schemes_read_back(load: Loader, scheme: str, lie: str) -> None:
    problem = load(
        f"integrator={{scheme='{scheme}', lie='{lie}', substeps=3, gamma_quaternion=1.5, gamma_dcm=0.5, "
        "gamma_constraint=4}",
        "goal.guard=false",
        "goal.redundant=keep",
        "solver.time_limit=30",
        "solver.linear_solver=mumps",
    )
    assert (problem.scheme, problem.lie, problem.substeps) == (scheme, lie, 3)
    assert problem.stabilisation == Stabilisation(gamma_quaternion=1.5, gamma_dcm=0.5, gamma_constraint=4.0)
    again = parse_problem(problem_to_toml(problem))
    for key in ("scheme", "lie", "substeps", "stabilisation", "solver"):
        assert getattr(again, key) == getattr(problem, key)
    assert (again.goal.guard, again.goal.redundant) == (False, "keep")


@pytest.mark.parametrize("scheme", EULER_SCHEMES)
@pytest.mark.parametrize(
    ("setting", "key", "got"),
    [
        ("integrator.lie=plain", "integrator.lie", '"plain"'),
        ("integrator.substeps=2", "integrator.substeps", "2"),
        ("integrator.gamma_quaternion=1", "integrator.gamma_quaternion", r"1\.0"),
        ("integrator.gamma_dcm=2", "integrator.gamma_dcm", r"2\.0"),
        ("integrator.gamma_constraint=5", "integrator.gamma_constraint", r"5\.0"),
        ("goal.guard=false", "goal.guard", "false"),
        ("goal.redundant=keep", "goal.redundant", '"keep"'),
    ],
)
def test_other_schemes_do_not_use_them(load: Loader, scheme: str, setting: str, key: str, got: str) -> None:
    reason = rf'{key}: got {got}, which scheme "{scheme}" does not use; leave it out, or choose an explicit'
    with pytest.raises(ProblemError, match=reason):
        load(f"integrator.scheme={scheme}", setting)
    load(RK4, setting)


@pytest.mark.parametrize(
    ("setting", "key", "reason"),
    [
        (
            "integrator.lie=cayley",
            "integrator.lie",
            """got 'cayley', expected "plain" | "baumgarte" | "munthe""",
        ),
        ("integrator.substeps=0", "integrator.substeps", "got 0, expected a whole number of at least 1"),
        ("integrator.substeps=1.5", "integrator.substeps", "got 1.5, expected a whole number"),
        ("integrator.gamma_dcm=-1", "integrator.gamma_dcm", "got -1.0, expected a rate >= 0 [1/s]"),
        ("integrator.gamma_dcm=inf", "integrator.gamma_dcm", "got inf, expected a finite number"),
        ("integrator.gamma=1", "integrator.gamma", "unknown key"),
        ("goal.redundant=maybe", "goal.redundant", """got 'maybe', expected "drop" | "keep\""""),
        ("goal.guard=1", "goal.guard", "got 1, expected true or false"),
        ("solver.time_limit=0", "solver.time_limit", "got 0.0, expected a positive number [s]"),
        (
            "solver.linear_solver=lu",
            "solver.linear_solver",
            """got 'lu', expected "auto" | "mumps" | "ma27\"""",
        ),
    ],
)
def test_wrong_values_name_key_got_and_allowed(load: Loader, setting: str, key: str, reason: str) -> None:
    with pytest.raises(MbocpError) as caught:
        load(RK4, setting)
    assert f"arm.toml: {key}: {reason}" in str(caught.value)


def test_the_scheme_is_a_word_of_its_own_in_python(ur5: Robot) -> None:
    goal = {"q": [0.1] * 6}
    short = Problem.create(ur5, 1.0, 10, goal=goal, scheme="heun", integrator={"lie": "plain"})
    long = Problem.create(ur5, 1.0, 10, goal=goal, integrator={"scheme": "heun", "lie": "plain"})
    assert (short.scheme, short.lie) == (long.scheme, long.lie) == ("heun", "plain")
    with pytest.raises(InvalidValue, match=r"integrator\.substeps: got 0"):
        long.with_(substeps=0)
    with pytest.raises(InvalidValue, match=r"integrator\.gamma_dcm: got -2\.0"):
        Stabilisation(gamma_dcm=-2.0)


def test_rotation_matrices_need_an_explicit_scheme(ur5: Robot) -> None:
    hector = load_robot("hector", actuated=["root_joint"], rotations="dcm")
    assert has_rotations(hector)
    words = {"goal": {"v": [0] * 6}}
    with pytest.raises(
        ProblemError, match=r'robot\.rotations: got "dcm", but scheme "se1" keeps rotations as'
    ):
        Problem.create(hector, 1.0, 10, **words, scheme="se1")
    problem = Problem.create(hector, 1.0, 10, **words)
    assert problem.scheme == "rk4"  # what suits
    assert parse_problem(problem_to_toml(problem)).robot.rotations == "dcm"
    assert not has_rotations(ur5)  # nothing that would be a matrix
    Problem.create(load_robot("ur5", rotations="dcm"), 1.0, 10, **words)


def test_rotations_are_a_key_of_the_problem_file(load: Loader) -> None:
    assert load().robot.rotations == "quaternion"
    assert load("robot.rotations=dcm").robot.rotations == "dcm"
    with pytest.raises(MbocpError, match=r"rotations: got 'euler', expected .*quaternion.*dcm"):
        load("robot.rotations=euler")


def test_constraints_go_with_explicit_schemes() -> None:
    goal = {"q": [0, 0, -5], "p": [0, 0, 0]}
    problem = Problem.create("rigid_pendulum", 1.0, 10, start={"q": [5, 0, 0]}, goal=goal, scheme="rk4")
    assert problem.robot.nc == 1
    assert problem.num_end_conditions == 4


@pytest.mark.parametrize("scheme", PAIRS)
def test_partitioned_schemes_read_back(load: Loader, scheme: str) -> None:
    robot = load_robot("double_pendulum")
    problem = Problem.create(robot, 1.0, 10, goal={"v": [0.0, 0.0]}, scheme=scheme, cost={})
    assert parse_problem(problem_to_toml(problem)).scheme == scheme
    with pytest.raises(ProblemError, match=r"integrator\.substeps: got 2, which scheme"):
        problem.with_(substeps=2)


def test_partitioned_schemes_refuse_what_they_do_not_take() -> None:
    loop, arm = load_robot("four_bar"), load_robot("double_pendulum")
    for scheme, pair in PAIRS.items():
        if not pair.holds_constraints:
            with pytest.raises(ProblemError, match=rf'"{scheme}".*\'four_bar\' has holonomic.*"lobatto2"'):
                Problem.create(loop, 1.0, 10, goal={"v": [0.0] * loop.nv}, scheme=scheme, cost={})
        with pytest.raises(ProblemError, match=rf'"{scheme}", but natural coordinates.*"midpoint".* alone'):
            Problem.create(
                arm, 1.0, 10, goal={"v": [0.0, 0.0]}, scheme=scheme, coordinates="natural", cost={}
            )


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("integrator.lie=plain", "integrator.lie"),
        ("integrator.substeps=2", "integrator.substeps"),
        ("goal.guard=false", "goal.guard"),
        ("goal.redundant=keep", "goal.redundant"),
    ],
)
def test_a_refusal_says_that_auto_chose_the_scheme(load: Loader, setting: str, key: str) -> None:
    """And which ones to name in its place: one of these is taken."""
    with pytest.raises(ProblemError) as refused:
        load(setting)
    words = str(refused.value)
    assert f"{key}: got " in words
    assert 'scheme "gauss2" does not use ("auto" chose it for an open chain of joints)' in words
    assert '"rk4"' in words
    assert words.endswith("as integrator.scheme")
    assert load(setting, RK4).scheme == "rk4"
    with pytest.raises(ProblemError) as named:
        load(setting, "integrator.scheme=gauss2")
    assert '"auto"' not in str(named.value)
