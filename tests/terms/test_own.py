"""Terms of one's own: derivatives, what they do to a motion, what is kept of them, what is refused."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import MbocpError, ProblemError
from mbocp.formulation import Formulation, formulate
from mbocp.problem import Problem, ProblemWarning, parse_problem, problem_to_toml
from mbocp.robot import load_robot
from mbocp.terms import Kinematics, OwnTerm, end_condition, path_constraint, running_cost, terminal_cost
from mbocp.terms.own import _trace

GOAL = {"q": [0.7, -0.4], "v": [0.0, 0.0]}
COST = {"effort": 0.5, "velocity": 0.1}


def everything(frame: str) -> list[OwnTerm]:
    """Terms that look at all there is."""

    def running(at: Kinematics) -> ca.SX:
        swing = ca.sumsqr(at.velocity(frame)) + at["gain"] * ca.sumsqr(at.acceleration(frame))
        return swing + ca.sin(at.t) * ca.dot(at.u, at.u) + ca.dot(at["pull"], at.position(frame))

    def terminal(at: Kinematics) -> ca.SX:
        return ca.sumsqr(at.momentum(frame)) + at.kinetic_energy() + at.potential_energy()

    def path(at: Kinematics) -> ca.SX:
        return ca.vertcat(ca.sumsqr(at.u) + at.rotation(frame)[2, 2], ca.dot(at.a, at.v))

    def end(at: Kinematics) -> ca.SX:
        return ca.vertcat(at.position(frame)[0] * at["scale"], at.joint_momentum()[0] ** 2)

    return [
        running_cost(running, weight=0.7, gain=0.01, pull=[0.1, 0.2, 0.3]),
        terminal_cost(terminal, weight=0.2),
        path_constraint(path, lower=[-1e3, -1e3], upper=1e3),
        end_condition(end, scale=2.0),
    ]


CASES = {
    "implicit": ("double_pendulum", "link2", {}),
    "midpoint": ("double_pendulum", "link2", {"integrator": {"scheme": "midpoint"}}),
    "explicit": ("double_pendulum", "link2", {"integrator": {"scheme": "heun"}}),
    "loop": ("five_bar", "", {}),
    "group": ("hector", "base_link", {}),
    "natural": ("double_pendulum", "link2", {"coordinates": "natural"}),
    "matrices": ("hector", "base_link", {"integrator": {"scheme": "euler"}}),
}


@cache
def formulated(name: str) -> Formulation:
    robot, frame, others = CASES[name]
    spec: dict[str, Any] = {"actuated": ["root_joint"]} if robot == "hector" else {}
    loaded = load_robot(robot, **spec, rotations="dcm" if name == "matrices" else "quaternion")
    terms = everything(frame or loaded.frame_names[-1])
    if name == "group":  # a state on the group has no path
        terms = [term for term in terms if term.role != "path"]
    return formulate(
        Problem.create(loaded, 1.0, 5, terms=terms, **{"integrator": {"scheme": "se1"}, **others})
    )


def check(f: Callable[[float], float], slope: float, curvature: float) -> None:
    """Slope and curvature of f at 0 against central differences of fourth order."""
    h = 2e-3
    a, b, c, d = f(h), f(-h), f(2 * h), f(-2 * h)
    scale = 1.0 + max(abs(value) for value in (a, b, c, d)) + abs(slope) + abs(curvature)
    assert abs((8 * (a - b) - (c - d)) / (12 * h) - slope) < 5e-7 * scale
    assert abs((16 * (a + b) - (c + d) - 30 * f(0.0)) / (12 * h * h) - curvature) < 5e-6 * scale


def numbers(value: Any) -> Array:
    return np.asarray(ca.DM(value))


def symmetric(upper: Array) -> Array:
    return np.triu(upper) + np.triu(upper, 1).T


class Case:
    """Two close random states of a formulation, multipliers and parameters."""

    def __init__(self, name: str) -> None:
        self.formulation = formulated(name)
        self.programme, at = self.formulation.programme, self.formulation.layout
        robot, rng = self.formulation.problem.robot, np.random.default_rng(4)
        q = robot.integrate(self.formulation.problem.q_start, 0.2 * rng.standard_normal(robot.nv))
        zs = self.formulation.space.coordinates(np.array([q, robot.integrate(q, 0.1 * np.ones(robot.nv))]))
        rest = 0.5 * rng.standard_normal((2, at.nx - at.nz))
        self.x0, self.x1 = np.hstack([zs, rest])
        kind = self.programme.kind
        self.y, self.u = rng.standard_normal(kind.ny), rng.standard_normal(kind.nu)
        self.m = rng.standard_normal(kind.ndx + kind.ny)
        self.rho = self.programme.rho.reshape(5, -1)[2]
        self.rng, self.ndx = rng, kind.ndx

    def moved(self, x: Array, dx: Array) -> Array:
        return numbers(self.programme.functions.function("retract")(x, dx)).ravel()

    def direction(self, size: int) -> Array:
        found = self.rng.standard_normal(size)
        return found / np.linalg.norm(found)


@pytest.mark.parametrize("name", CASES)
def test_running_costs_are_exact_in_second_order(name: str) -> None:
    case = Case(name)
    theta, functions = case.programme.theta, case.programme.functions
    out = functions.function("complete")(case.x0, case.x1, case.y, case.u, case.m, theta, case.rho)
    _, _, dc_dz, dl_dz, hessian = (numbers(value) for value in out)
    for _ in range(3):
        d = case.direction(dc_dz.shape[1])
        d1, dy, d0, du = np.split(d, np.cumsum([case.ndx, case.y.size, case.ndx]))

        def lagrangian(t: float, d0=d0, d1=d1, dy=dy, du=du) -> float:
            x0, x1 = case.moved(case.x0, t * d0), case.moved(case.x1, t * d1)
            c, cost = functions.function("values")(x0, x1, case.y + t * dy, case.u + t * du, theta, case.rho)
            return float(cost) + float(case.m @ numbers(c).ravel())

        slope = dl_dz.ravel() @ d + case.m @ (dc_dz @ d)
        check(lagrangian, float(slope), float(d @ symmetric(hessian) @ d))


@pytest.mark.parametrize("name", CASES)
def test_terms_of_the_end_are_exact_in_second_order(name: str) -> None:
    case = Case(name)
    functions, rho = case.programme.end_functions, case.programme.rho_terminal
    eta = case.rng.standard_normal(case.programme.ng)
    assert eta.size == 2
    out = functions.function("terminal_complete")(case.x1, eta, rho)
    _, _, dg_dx, dpsi_dx, hessian = (numbers(value) for value in out)
    for _ in range(3):
        d = case.direction(case.ndx)

        def lagrangian(t: float, d=d) -> float:
            psi, g = functions.function("terminal_values")(case.moved(case.x1, t * d), rho)
            return float(psi) + float(eta @ numbers(g).ravel())

        slope = dpsi_dx.ravel() @ d + eta @ (dg_dx @ d)
        check(lagrangian, float(slope), float(d @ symmetric(hessian) @ d))


@pytest.mark.parametrize("name", ["implicit", "explicit", "loop", "natural", "matrices"])
def test_path_constraints_are_exact_in_second_order(name: str) -> None:
    case = Case(name)
    path, theta = case.programme.functions.function("path"), case.programme.theta
    m = case.rng.standard_normal(2)
    h, J, hessian = (numbers(value) for value in path(case.x1, m, 0, theta))
    assert h.shape == (2, 1)
    for _ in range(3):
        d = case.direction(case.x1.size)

        def weighed(t: float, d=d) -> float:
            return float(m @ numbers(path(case.x1 + t * d, m, 0, theta)[0]).ravel())

        check(weighed, float(m @ (J @ d)), float(d @ symmetric(hessian) @ d))


def pendulum(*terms: OwnTerm, **others: Any) -> Problem:
    words: dict[str, Any] = {"start": {"q": [0.1, 0.2]}, "goal": GOAL, "cost": COST}
    return Problem.create(
        "double_pendulum", 1.0, 20, terms=terms, **{"integrator": {"scheme": "se1"}, **words, **others}
    )


def energy(at: Kinematics) -> ca.SX:
    return at["gain"] * at.kinetic_energy() + at.t


@pytest.mark.parametrize("method", ["monolithic", "ipopt", "fatrop", "fbsm_newton"])
def test_all_solvers_weigh_it(method: str) -> None:
    words = {"goal": {"v": [0.0, 0.0]}} if method == "fbsm_newton" else {}
    reference = mbocp.solve(pendulum(running_cost(energy, weight=3.0, gain=2.0), **words), check=True)
    solver = {"method": method, "tolerance": 1e-7 if method == "fatrop" else 1e-9}
    given = pendulum(running_cost(energy, weight=3.0, gain=2.0), **words, solver=solver)
    solution = mbocp.solve(given, check=True)
    np.testing.assert_allclose(solution.us, reference.us, atol=1e-4)
    kinetic = 0.5 * np.einsum("ni,ni->n", solution.ps, solution.vs)[1:]
    plain = 0.5 * (0.5 * np.einsum("ni,ni->n", solution.us, solution.us))
    plain += 0.05 * np.einsum("ni,ni->n", solution.vs[1:], solution.vs[1:])
    cost = given.dt * (plain + 3.0 * (2.0 * kinetic + solution.t[1:]))
    assert solution.cost == pytest.approx(cost.sum(), rel=1e-6)
    assert solution.control_momentum_names == ()  # nobody knows its symmetries


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.7, 3.0])
def test_the_error_of_a_pose_is_the_logarithm(angle: float) -> None:
    robot, rng = load_robot("ur5"), np.random.default_rng(8)
    q, data = rng.standard_normal(6), robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    placed, away = data.oMf[robot.frame_id("tool0")], pin.exp3(angle * np.array([0.6, 0.0, 0.8]))
    pose = pin.SE3(placed.rotation @ away.T, rng.standard_normal(3))
    for P in (pose, pin.SE3(np.eye(3), pose.translation)):

        def error(at: Kinematics, P: pin.SE3 = P) -> ca.SX:
            return at.pose_error(
                "tool0", P.translation, None if (P.rotation == np.eye(3)).all() else P.rotation
            )

        function = _trace(error, "path", "error", (), robot, "quaternion").function
        symbols = ca.SX.sym("q", 6)
        value = function(symbols, 0, 0, 0, 0)
        again = ca.Function(
            "f", [symbols], [value, ca.jacobian(value, symbols), ca.hessian(value[0], symbols)[0]]
        )
        found, slope, curvature = (part.full() for part in again(q))
        inside = P.actInv(placed)
        assert np.abs(np.ravel(found) - pin.log6(inside).vector).max() < 1e-9
        J = pin.computeFrameJacobian(robot.model, data, q, robot.frame_id("tool0"), pin.LOCAL)
        assert np.abs(slope - pin.Jlog6(inside) @ J).max() < 1e-7
        assert np.isfinite(curvature).all()


def test_kinematics_are_those_of_the_robot() -> None:
    robot = load_robot("ur5")
    rng = np.random.default_rng(6)
    q, v, a = robot.integrate(robot.q0, rng.standard_normal(6)), *rng.standard_normal((2, 6))
    seen: list[ca.SX] = []

    def looked(at: Kinematics) -> ca.SX:
        seen[:] = [at.velocity("tool0"), at.acceleration("tool0"), at.momentum("wrist_3_link")]
        return ca.vertcat(*seen, at.centroidal_momentum(), at.centre_of_mass(), at.joint_momentum())

    found = _trace(looked, "running", "looked", (), robot, "quaternion").function(q, v, 0, a, 0)
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, q, v, a)
    pin.updateFramePlacements(model, data)
    pin.ccrba(model, data, q, v)
    aligned, tool = pin.LOCAL_WORLD_ALIGNED, robot.frame_id("tool0")
    link = model.frames[robot.frame_id("wrist_3_link")]
    joint = int(link.parentJoint)
    moment = (model.inertias[joint] * data.v[joint]).vector
    placed = data.oMi[joint].act(pin.Force(moment))
    origin = data.oMf[robot.frame_id("wrist_3_link")].translation
    expected = [
        pin.getFrameVelocity(model, data, tool, aligned).vector,
        np.hstack(
            [
                pin.getFrameClassicalAcceleration(model, data, tool, aligned).linear,
                pin.getFrameAcceleration(model, data, tool, aligned).angular,
            ]
        ),
        np.hstack([placed.linear, placed.angular - np.cross(origin, placed.linear)]),
        data.hg.vector,
        pin.centerOfMass(model, data, q),
        robot.momentum(q, v),
    ]
    np.testing.assert_allclose(numbers(found).ravel(), np.hstack(expected), atol=1e-10)


def power(at: Kinematics) -> ca.SX:
    return at.u * at.v


@pytest.mark.parametrize("method", ["monolithic", "ipopt"])
def test_a_path_constraint_may_look_at_controls(method: str) -> None:
    free = mbocp.solve(pendulum(), check=True)
    most = 0.6 * float((free.us * free.vs[1:]).max())
    term = path_constraint(power, upper=most, unit="W")
    solution = mbocp.solve(pendulum(term, solver=method), check=True)
    assert (solution.us * solution.vs[1:]).max() < most + 1e-6
    assert solution.limit_violation < 1e-6
    touched = [limit for limit in solution.active_limits if limit.kind == "path"]
    assert {limit.unit for limit in touched} == {"W"}
    assert all(limit.bound == most for limit in touched)
    assert solution.cost > free.cost


def together(at: Kinematics) -> ca.SX:
    return at.q[0] + at.q[1]


def test_equations_are_kept_by_every_method() -> None:
    goal = {"q": {"joint1": 0.7}, "v": {"joint1": 0.0}}  # the equation says the rest
    ends: dict[str, Any] = {"start": {"q": [0.1, -0.1]}, "goal": goal}
    term = path_constraint(together, equals=0.0)
    own, ipopt, fatrop = (
        mbocp.solve(pendulum(term, **ends, solver={"method": method, "tolerance": 1e-9}), check=True)
        for method in ("monolithic", "ipopt", "fatrop")
    )
    assert mbocp.solve(pendulum(term, **ends)).solver.startswith("auto: monolithic")
    assert np.abs(own.qs.sum(axis=1)).max() < 1e-12
    for other in (ipopt, fatrop):
        assert own.cost == pytest.approx(other.cost, rel=1e-9)
        for field in ("qs", "us", "lam_path"):
            a, b = getattr(own, field), getattr(other, field)
            np.testing.assert_allclose(a, b, atol=1e-8 * np.abs(b).max())


def test_conditions_and_costs_of_the_end() -> None:
    def sideways(at: Kinematics) -> ca.SX:
        return at.position("link2")[1] - at["where"]

    def folded(at: Kinematics) -> ca.SX:
        return ca.sumsqr(at.q)

    term = end_condition(sideways, where=-0.06)
    solution = mbocp.solve(pendulum(term, goal={"v": [0.0, 0.0]}), check=True)
    robot = load_robot("double_pendulum")
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, solution.q_final)
    assert data.oMf[robot.frame_id("link2")].translation[1] == pytest.approx(-0.06, abs=1e-9)
    assert solution.eta.size == 3
    cheap, dear = (
        mbocp.solve(pendulum(terminal_cost(folded, weight=w), goal={"v": [0.0, 0.0]}), check=True)
        for w in (0.1, 0.2)
    )
    assert np.linalg.norm(dear.q_final) < np.linalg.norm(cheap.q_final)


@pytest.mark.usefixtures("compiled")
def test_numbers_never_recompile() -> None:
    def library(term: OwnTerm) -> tuple[Path | None, ...]:
        programme = formulate(pendulum(term)).programme
        return programme.functions.library, programme.end_functions.library

    first = library(running_cost(energy, weight=1.0, gain=1.0))
    assert library(running_cost(energy, weight=2.0, gain=5.0, name="renamed")) == first
    assert library(running_cost(lambda at: energy(at) ** 2, name="energy", gain=1.0)) != first


SCRIPT = """
import casadi as ca, mbocp
from mbocp.terms import running_cost
term = running_cost(lambda at: ca.sumsqr(at.velocity("link2")) * at["gain"], name="term", gain=3.0)
print(term.digest(mbocp.load_robot("double_pendulum")))
"""


def test_the_digest_is_that_of_the_expression() -> None:
    def fast(at: Kinematics) -> ca.SX:
        return ca.sumsqr(at.velocity("link2")) * at["gain"]

    found = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    robot = load_robot("double_pendulum")
    assert running_cost(fast, gain=7.0).digest(robot) == found.stdout.strip()
    assert running_cost(lambda at: 2 * fast(at), gain=7.0).digest(robot) != found.stdout.strip()


def test_a_result_says_what_it_lacks(tmp_path: Path) -> None:
    terms = [running_cost(energy, weight=3.0, gain=2.0), path_constraint(together, upper=2.0)]
    saved = mbocp.Solution.load(mbocp.solve(pendulum(*terms), check=True).save(tmp_path / "motion.h5"))
    for term in terms:
        assert term.digest(load_robot("double_pendulum")) in saved.problem_text
    with pytest.raises(ProblemError, match=r"terms: 'energy' is missing, a running cost of one's own \(dige"):
        parse_problem(saved.problem_text)
    with pytest.raises(ProblemError, match="'together' is missing, a path constraint"):
        parse_problem(saved.problem_text, terms=terms[:1])
    others = [running_cost(energy, gain=0.0), path_constraint(together)]  # numbers are those of the text
    again = mbocp.solve(parse_problem(saved.problem_text, terms=others), check=True)
    np.testing.assert_array_equal(again.us, saved.us)
    with pytest.warns(ProblemWarning, match="'together' is not the one that the text was written with"):
        parse_problem(
            saved.problem_text, terms=[terms[0], path_constraint(lambda at: at.q[1], name="together")]
        )
    warm = mbocp.solve(pendulum(), warm_start=saved, check=True)
    assert warm.cost == pytest.approx(mbocp.solve(pendulum()).cost)


def test_changes_keep_terms() -> None:
    given = pendulum(running_cost(energy, gain=2.0), path_constraint(together, upper=2.0))
    for changed in (given.with_(cost={"effort": 2.0}), given.with_(steps=30), given.with_(path=[])):
        assert [term.name for term in changed.terms] == ["energy", "together"]
        assert [constraint.name for constraint in changed.path] == ["together"]
    assert given.with_(terms=()).path == ()
    assert problem_to_toml(given.with_(terms=())) == problem_to_toml(pendulum())


def robot_free(at: Kinematics) -> ca.SX:
    return ca.SX.sym("x") * at.v[0]


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (
            lambda: running_cost(lambda at: at.v, name="c"),
            "c: got 2 values, expected one",
        ),
        (
            lambda: running_cost(lambda at: "fast", name="c"),
            "c: the function returns 'fast', expected",
        ),
        (lambda: running_cost(robot_free), "robot_free: x is no parameter"),
        (
            lambda: running_cost(lambda at: at["gian"], name="c", gain=1.0),
            "no parameter 'gian': did",
        ),
        (lambda: terminal_cost(lambda at: at.u[0], name="c"), r"c: a terminal cost has no controls \(u\)"),
        (lambda: path_constraint(lambda at: at.t, name="c", upper=1), r"a path constraint has no time \(t\)"),
        (lambda: path_constraint(power, upper=[1, 2, 3]), r"power: got bounds of shape \(3,\) for 2 values"),
        (lambda: path_constraint(power), "power: got .* expected a finite bound"),
        (lambda: running_cost(lambda at: at.position("hand")[0], name="c"), "has no frame 'hand'"),
        (
            lambda: end_condition(lambda at: at.pose_error("link2", [1.0, 2.0]), name="c"),
            r"pose_error: position: got shape \(2, 1\), expected \(3, 1\)",
        ),
        (lambda: running_cost(energy, gain=np.nan), "energy: gain: got nan, expected a number"),
        (lambda: path_constraint(together, upper=0.2), "at the start together is 0.3 .* above its bound 0.2"),
    ],
)
def test_what_cannot_be_is_refused(make: Callable[[], OwnTerm], reason: str) -> None:
    with pytest.raises(MbocpError, match=reason):
        pendulum(make())


def test_names_are_told_apart() -> None:
    with pytest.raises(ProblemError, match="there are several of the name 'energy'"):
        pendulum(running_cost(energy, gain=1.0), terminal_cost(together, name="energy"))


def test_accelerations_at_nodes_are_kept_in_natural_coordinates() -> None:
    def hard(at: Kinematics) -> ca.SX:
        return at.a

    free = mbocp.solve(pendulum(), check=True)
    most = 0.8 * np.abs(np.diff(free.vs, axis=0)).max() * 20
    words: dict[str, Any] = {"coordinates": "natural", "solver": "ipopt"}
    bounded = pendulum(path_constraint(hard, lower=-most, upper=most), **words)
    solution = mbocp.solve(bounded, check=True)
    assert solution.limit_violation < 1e-6
    assert np.abs(np.diff(solution.vs, axis=0)).max() * 20 < 0.95 * most / 0.8
