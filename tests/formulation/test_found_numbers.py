"""Numbers of the robot that are found with the motion: against plain solves, and a search over them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize, minimize_scalar

import mbocp
from mbocp.exceptions import InvalidValue, ProblemError, ProblemFileError, RobotError
from mbocp.formulation import formulate
from mbocp.problem import Problem, problem_to_toml
from mbocp.problem.file.load import parse_problem
from mbocp.problem.found_parameter import with_values
from mbocp.robot.named_numbers import number_of, open_numbers, with_numbers, with_numbers_of_model

EXAMPLES = Path(__file__).parents[2] / "examples" / "design"
LOAD = {"name": "load", "frame": "tool0", "mass": 2.0, "com": [0.0, 0.0, 0.05]}
ARM: dict[str, Any] = {
    "robot": {"name": "ur5", "payload": [LOAD], "lock": ["wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]},
    "duration": 1.0,
    "steps": 16,
    "start": {"q": [0, -1.57, 1.57]},
    "goal": {"q": [0.6, -1.2, 1.2], "v": 0},
    "cost": {"effort": 1.0, "velocity": 30.0},
}
OF_ARM = [
    {
        "of": "robot.payload.load.mass",
        "min": 0.5,
        "max": 4.0,
        "cost": {"square": 30.0, "reference": 3.0},
    },
    {
        "of": "robot.payload.load.com.x",
        "min": -0.2,
        "max": 0.2,
        "cost": {"square": 3e4, "reference": 0.1},
    },
    {
        "of": "robot.joint.elbow_joint.length",
        "min": 0.2,
        "max": 0.6,
        "cost": {"square": 3e3, "reference": 0.4},
    },
]
GEARED = {
    **ARM,
    "robot": {
        **ARM["robot"],
        "motor": [{"joint": "elbow_joint", "gear_ratio": 50.0, "inertia": 5e-4, "effort": 3.0}],
    },
    "cost": {"effort": [1.0, 1.0, 2e3], "velocity": 3.0},
}
OF_MOTOR = [
    {"of": "robot.motor.elbow_joint.gear_ratio", "min": 20.0, "max": 120.0},
    {
        "of": "robot.motor.elbow_joint.inertia",
        "min": 1e-4,
        "max": 1e-2,
        "cost": {"square": 1e8, "reference": 5e-3},
    },
    {
        "of": "robot.joint.shoulder_lift_joint.mass",
        "min": 4.0,
        "max": 12.0,
        "cost": {"square": 400.0, "reference": 9.0},
    },
]
LOCKED = [*(f"panda_joint{k}" for k in (1, 3, 5, 6, 7)), "panda_finger_joint1", "panda_finger_joint2"]
LOSSY: dict[str, Any] = {
    **ARM,
    "robot": {"name": "panda", "friction": "smooth", "lock": LOCKED},
    "start": {"q": [0, -1.5]},
    "goal": {"q": [0.5, -1.0], "v": 0},
}
OF_LOSSES = [
    {
        "of": ["robot.joint.panda_joint2.damping", "robot.joint.panda_joint4.damping"],
        "min": 0.0,
        "max": 2.0,
        "cost": {"square": 300.0, "reference": 1.0},
    },
    {
        "of": "robot.joint.panda_joint2.friction",
        "min": 0.0,
        "max": 2.0,
        "cost": {"square": 300.0, "reference": 1.0},
    },
]
SPRUNG: dict[str, Any] = {
    "robot": "elastic_pendulum",
    "duration": 2.0,
    "steps": 20,
    "goal": {"q": [2.0, -5.0, -5.0], "v": 0},
    "cost": {"effort": 1.0},
}


def plain_cost(problem: Problem, values: list[float], **changes: Any) -> float:
    """Cost of a plain solve with parameters as numbers, and what they cost."""
    robot = open_numbers(problem.document.robot, [word for one in problem.parameter for word in one.words])
    fixed = problem.with_(robot=with_values(robot, problem.parameter, values), parameter=[], **changes)
    solution = mbocp.solve(fixed)
    assert solution.converged
    costs = [one.cost for one in problem.parameter]
    more = [c.linear * p + c.square * (p - c.reference) ** 2 for c, p in zip(costs, values, strict=True)]
    return solution.cost + sum(more)


@pytest.mark.parametrize(
    ("keys", "parameter", "scheme"),
    [
        *((ARM, OF_ARM, scheme) for scheme in ("se1", "midpoint", "gauss2", "rk4")),
        *((GEARED, OF_MOTOR, scheme) for scheme in ("se1", "gauss2", "rk4")),
        (LOSSY, OF_LOSSES, "midpoint"),
    ],
)
def test_is_the_optimum_of_plain_solves(
    keys: dict[str, Any], parameter: list[dict[str, Any]], scheme: str
) -> None:
    problem = Problem.create(**keys, parameter=parameter, scheme=scheme)
    solution = mbocp.solve(problem)
    found = list(solution.parameters.values())
    assert solution.converged
    assert not solution.active_limits
    assert plain_cost(problem, found) == pytest.approx(solution.cost, rel=1e-9)
    for k, one in enumerate(problem.parameter):
        for side in (-1.0, 1.0):
            aside = [p + side * 0.02 * (one.upper - one.lower) * (i == k) for i, p in enumerate(found)]
            assert plain_cost(problem, aside) > solution.cost * (1.0 + 1e-6)
    own = solution.problem.robot
    assert [number_of(own, one.words[0]) for one in problem.parameter] == pytest.approx(found, rel=1e-12)


def test_a_mass_that_is_found_goes_with_obstacles() -> None:
    """With the mass that is found as a given one, the motion past the obstacle costs the same."""
    post = {"shape": "sphere", "radius": 0.08, "position": [0.39, 0.32, 0.21], "margin": 0.02}
    problem = Problem.create(**{**ARM, "steps": 8}, parameter=OF_ARM[:1], obstacle=[post], scheme="se1")
    solution = mbocp.solve(problem)
    assert solution.converged, solution.advice
    assert any("sphere" in limit.name for limit in solution.active_limits)
    assert plain_cost(problem, list(solution.parameters.values())) == pytest.approx(solution.cost, rel=1e-7)


@pytest.mark.parametrize("scheme", ["se1", "lobatto3", "rk4"])
def test_derivatives_are_exact(scheme: str) -> None:
    loops = {"robot": {"name": "five_bar"}, "goal": {"q": {"left_shoulder": -0.8, "right_shoulder": 1.0}}}
    words = ["robot.joint.left_elbow.length", "robot.base.z"]
    of = [{"of": word, "min": 0.1 * k, "max": 1.2} for word, k in zip(words, (1, 0), strict=True)]
    problem = Problem.create(**{**SPRUNG, **loops}, parameter=of, scheme=scheme)
    formulation = formulate(problem)
    programme, rng = formulation.programme, np.random.default_rng(0)
    kind, function = programme.kind, programme.functions.function("complete")
    x0 = programme.x_start + 0.1 * rng.normal(size=kind.nx)
    z = np.concatenate([x0 + 0.05 * rng.normal(size=kind.nx), rng.normal(size=kind.ny), x0])
    z = np.concatenate([z, rng.normal(size=kind.nu)])
    m, rho = rng.normal(size=kind.ndx + kind.ny), programme.rho.reshape(programme.num_steps, -1)[0]

    def at(z: np.ndarray) -> list[np.ndarray]:
        x1, y, x0, u = np.split(z, np.cumsum([kind.nx, kind.ny, kind.nx]))
        return [np.asarray(out) for out in function(x0, x1, y, u, m, programme.theta, rho)]

    h = 1e-5
    around = [(at(z - h * e), at(z + h * e)) for e in np.eye(len(z))]

    def slopes(of: Any) -> np.ndarray:
        return np.array([(of(after) - of(before)).ravel() / (2.0 * h) for before, after in around]).T

    _, _, dc, dl, upper = at(z)
    gradient = slopes(lambda out: out[3].ravel() + out[2].T @ m)
    hessian = upper + np.triu(upper, 1).T
    found = [row for name in ("found",) for row in range(*formulation.layout.states[name].indices(kind.nx))]
    assert np.abs(dc[:, [kind.nx + kind.ny + i for i in found]]).max() > 1e-3
    assert dc == pytest.approx(slopes(lambda out: out[0]), abs=1e-7)
    assert dl.ravel() == pytest.approx(slopes(lambda out: out[1]).ravel(), abs=1e-6)
    assert hessian == pytest.approx(gradient, abs=1e-5)


def search(problem: Problem) -> tuple[float, np.ndarray]:
    """Least cost of plain solves, and where: a search without derivatives from the start of the problem."""
    lower, upper, start = np.array([(one.lower, one.upper, one.start) for one in problem.parameter]).T

    def cost(shares: np.ndarray) -> float:
        return plain_cost(problem, list(lower + shares * (upper - lower)))

    bounds = [(0.0, 1.0)] * len(start)
    options = {"xatol": 1e-5, "fatol": 1e-9}
    begin = (start - lower) / (upper - lower)
    best = minimize(cost, begin, method="Nelder-Mead", bounds=bounds, options=options)
    return best.fun, lower + best.x * (upper - lower)


def test_a_motor_before_its_gear() -> None:
    plain, problem = Problem.create(**ARM), Problem.create(**GEARED)
    robot, bare, dof = problem.robot, plain.robot, 2
    q, v = problem.q_start, np.arange(3.0)
    rotor = robot.momentum(q, v) - bare.momentum(q, v)
    assert rotor == pytest.approx([0.0, 0.0, 50.0**2 * 5e-4 * v[2]], abs=1e-12)
    assert robot.actuation_matrix(q) == pytest.approx(np.diag([1.0, 1.0, 50.0]))
    assert robot.limits.effort[dof] == 3.0
    assert robot.limits.velocity == pytest.approx(bare.limits.velocity)
    larger = with_numbers(robot, {"motor.elbow_joint.gear_ratio": 100.0})
    assert larger.limits.velocity[dof] == pytest.approx(bare.limits.velocity[dof] / 2.0)
    assert larger.model.armature[dof] == pytest.approx(5.0)
    assert larger.limits.effort[dof] == 3.0


def test_numbers_of_all_kinds_are_put_where_they_belong() -> None:
    robot = Problem.create(**GEARED, parameter=OF_MOTOR).robot
    own = dict(zip(robot.varying, robot.varying_values.tolist(), strict=True))
    assert with_numbers_of_model(robot, own).fingerprint == robot.fingerprint
    doubled = with_numbers_of_model(robot, {n: 2.0 * x if n.of == "motor" else x for n, x in own.items()})
    assert doubled.motors[0].gear_ratio == 2.0 * robot.motors[0].gear_ratio
    assert doubled.shape_fingerprint == robot.shape_fingerprint


@pytest.mark.parametrize("of", ["robot.motor.elbow_joint.gear_ratio", "robot.motor.elbow_joint.inertia"])
def test_a_file_has_what_its_gears_keep(of: str) -> None:
    table = {"of": of, "min": 1e-5, "max": 60.0}
    problem = Problem.create(**GEARED, parameter=[table], limits={"velocity": True})
    again = parse_problem(problem_to_toml(problem))
    is_gear = of.endswith("ratio")
    for one in (problem, again):
        assert [path.kind for path in one.path] == ["motor_speed"] * is_gear
        assert np.isinf(one.limits.v_upper).tolist() == [False, False, is_gear]


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ({"joint": "elbow"}, "elbow.*did you mean"),
        ({"joint": "elbow_joint", "gear_ratio": 0.0}, "gear_ratio.*0"),
        ({"joint": "elbow_joint", "ratio": 2.0}, r"ratio.*unknown key"),
        ([{"joint": "elbow_joint"}] * 2, r"motor\[1\].joint: 'elbow_joint' is named twice"),
    ],
)
def test_motors_that_cannot_be_are_refused(row: Any, words: str) -> None:
    with pytest.raises(RobotError, match=words):
        mbocp.load_robot("ur5", motor=row if isinstance(row, list) else [row])
    with pytest.raises(RobotError, match=r"motor\[0\].joint: got 'hook'|'hook'"):
        mbocp.load_robot("ur5", motor=[{"joint": "hook"}])


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("counterweight", {"horizon.steps": 12}),
        pytest.param("base_placement", {}, marks=pytest.mark.slow),
        pytest.param("gear_ratio", {"horizon.steps": 12}, marks=pytest.mark.slow),
    ],
)
def test_agrees_with_a_search(name: str, changes: dict[str, Any]) -> None:
    problem = mbocp.load_problem(EXAMPLES / f"{name}.toml", changes)
    solution = mbocp.solve(problem)
    least, where = search(problem)
    assert solution.cost == pytest.approx(least, rel=1e-6)
    assert list(solution.parameters.values()) == pytest.approx(where, abs=1e-3)


def test_lengths_of_a_loop_agree_with_a_search() -> None:
    problem = mbocp.load_problem(EXAMPLES / "five_bar_lengths.toml")
    solution = mbocp.solve(problem)
    crank, rod = solution.parameters.values()
    assert solution.constraint_violation < 1e-12
    assert crank == pytest.approx(problem.parameter[0].lower, abs=1e-6)
    options = {"xatol": 1e-4}
    best = minimize_scalar(
        lambda p: plain_cost(problem, [crank, p]), bounds=(0.381, 0.4), method="bounded", options=options
    )
    assert solution.cost == pytest.approx(best.fun, rel=1e-6)
    assert rod == pytest.approx(best.x, abs=1e-3)
    pull = solution.facts.parameters[0].multiplier
    assert pull < 0.0
    assert -pull == pytest.approx((plain_cost(problem, [crank + 1e-5, rod]) - solution.cost) / 1e-5, rel=0.01)
    assert "parameter" in [limit.kind for limit in solution.active_limits]


def test_loops_begin_where_motors_say() -> None:
    """Under `midpoint` plain solves choose conditions on velocities at the end again, where it is reached."""
    problem = mbocp.load_problem(EXAMPLES / "five_bar_lengths.toml", {"integrator.scheme": "midpoint"})
    solution = mbocp.solve(problem)
    driven = [problem.robot.velocity_indices(name).start for name in ("left_shoulder", "right_shoulder")]
    assert solution.qs[0][driven] == pytest.approx(problem.q_start[driven], abs=1e-12)
    assert np.abs(solution.qs[0] - problem.q_start).max() > 0.1
    assert solution.constraint_violation < 1e-12
    assert plain_cost(problem, list(solution.parameters.values())) == pytest.approx(solution.cost, rel=1e-3)
    further = mbocp.solve(solution.load_problem(), warm_start=solution)  # has the end that was chosen
    assert further.iterations <= 1
    assert further.cost == pytest.approx(solution.cost, rel=1e-12)
    other = solution.load_problem().with_(
        goal={"frame": [{"name": "left_tip", "x": 0.28, "z": 0.58}], "v": 0}
    )
    assert mbocp.solve(other, warm_start=solution).converged


@pytest.mark.parametrize("key", ["coefficient", "length"])
def test_springs(key: str) -> None:
    problem = Problem.create(**SPRUNG)
    name = problem.robot.forces[0].name
    word = f"robot.spring.{name}.{key}"
    is_now = number_of(problem.robot, word.removeprefix("robot."))
    table = {"of": word, "min": 0.7 * is_now, "max": 1.3 * is_now}
    problem = problem.with_(parameter=[{**table, "cost": {"square": 20.0 / is_now**2, "reference": is_now}}])
    solution = mbocp.solve(problem)
    (found,) = solution.parameters.values()
    assert plain_cost(problem, [found]) == pytest.approx(solution.cost, rel=1e-9)
    best = minimize_scalar(
        lambda p: plain_cost(problem, [p]),
        bounds=(table["min"], table["max"]),
        method="bounded",
        options={"xatol": 1e-5 * is_now},
    )
    assert solution.cost == pytest.approx(best.fun, rel=1e-5)


def test_a_number_on_which_nothing_depends_is_told() -> None:
    """Where the base stands says nothing of a motion between given angles."""
    parameters = [
        {"of": "robot.base.x", "min": -1.0, "max": 3.0},
        {"of": "robot.joint.elbow_joint.mass", "min": 1.0, "max": 4.0},
    ]
    changes = {"horizon.steps": 12, "parameter": parameters}
    advice = mbocp.solve(
        mbocp.load_problem(EXAMPLES.parent / "arms/ur5_reach.toml", changes), check=True
    ).advice
    assert "the motion does not depend on robot.base.x: take [[parameter]] out" in advice
    assert "elbow" not in advice


def test_work_grows_with_the_steps_alone() -> None:
    sizes = [
        formulate(Problem.create(**{**ARM, "steps": n}, parameter=OF_ARM)).programme for n in (5, 10, 20)
    ]
    assert len({(p.kind.nx, p.kind.ny, p.kind.nu) for p in sizes}) == 1
    few, some, many = (p.num_unknowns for p in sizes)
    assert many - some == 2 * (some - few)


def test_a_result_keeps_them(tmp_path: Path) -> None:
    problem = mbocp.load_problem(EXAMPLES / "counterweight.toml")
    solution = mbocp.solve(problem)
    read = mbocp.Solution.load(solution.save(tmp_path / "result.mbocp"))
    assert read.parameters == solution.parameters
    assert read.facts.parameters == solution.facts.parameters
    mass = solution.parameters["robot.payload.counterweight.mass"]
    assert read.load_robot().payloads[0].mass == mass
    assert mbocp.solve(problem, warm_start=read).iterations <= 1
    again = read.load_problem()
    assert number_of(again.robot, "payload.counterweight.mass") == mass
    assert mbocp.solve(again).cost == pytest.approx(solution.cost, rel=1e-8)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"of": "robot.payload.load.weight"}, "payload.load.weight.*did you mean"),
        ({"of": "cost.effort"}, r"parameter.0.of.*robot.payload.NAME.mass"),
        ({"of": "robot.payload.load.mass", "max": -1.0}, r"parameter.0.max.*above parameter.0.min"),
        ({"of": "robot.payload.load.mass", "max": 1.0}, r"parameter.0.start, that of the robot.*0 to 1"),
        ({"of": "robot.payload.load.mass", "start": 9.0}, r"parameter.0.start: got 9.*0 to 3"),
        ({"of": "robot.payload.load.mass", "least": 1.0}, "least.*unknown key"),
        ({"of": "robot.payload.load.mass", "min": -40.0}, "payload 'load': mass: got -40"),
        (
            {"of": "robot.joint.shoulder_lift_joint.mass", "min": -40.0, "max": 40.0},
            "got -40.0, expected a mass",
        ),
        ({"of": "robot.joint.elbow_joint.length"}, "parameter.0.min: got 0, expected a length above 0"),
        (
            {"of": ["robot.base.x", "robot.base.yaw"]},
            "parameter.0.of.*numbers of one unit; these are in m, rad",
        ),
    ],
)
def test_what_cannot_be_is_refused(table: dict[str, Any], words: str) -> None:
    with pytest.raises((InvalidValue, ProblemError, ProblemFileError), match=words):
        Problem.create(**ARM, parameter=[{"min": 0.0, "max": 3.0, **table}])


def test_lengths_of_a_robot_are_positive() -> None:
    with pytest.raises(InvalidValue, match=r"elbow_joint\.length: got -0\.4, expected a length above 0"):
        mbocp.load_robot("ur5", numbers={"joint.elbow_joint.length": -0.4})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"coordinates": "natural"}, "parameter: numbers of the robot are constants"),
        ({"self_collision": True}, "parameter: robot.base.z moves frames"),
        ({"parameter": [{"of": "robot.base.z", "min": -1, "max": 1}] * 2}, "named twice"),
    ],
)
def test_what_does_not_go_with_them_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ProblemError, match=words):
        Problem.create(**{**ARM, "parameter": [{"of": "robot.base.z", "min": -1, "max": 1}], **changes})
