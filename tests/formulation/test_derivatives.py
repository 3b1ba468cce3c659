"""Derivatives of the stage functions against finite differences on the manifold, first and second order."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mbocp.formulation.parameter_layout import parameter_layout
from mbocp.formulation.schemes.implicit_steps import ImplicitSteps
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.stage import build_end_functions, build_functions
from mbocp.mechanics import JointMechanics
from mbocp.robot import Robot, Rod, SpringDamper, load_robot
from mbocp.terms.kinds import Effort, ExactGoal, TerminalCost, Tracking, Velocity
from mbocp.terms.point import Sizes
from tests.mechanics.models import POINT, chain
from tests.mechanics.models import robot as robot_of

ROBOTS = (
    "ur5",
    "kinova",
    "double_pendulum",
    "hector",
    "rigid_pendulum",
    "elastic_pendulum",
    "cart_pendulum_rigid",
    "cart_pendulum_elastic",
)
# What a scheme does with forces, constraints and groups shows on the small ones.
CASES = [(name, "se1") for name in (*ROBOTS, "towed body")] + [
    (name, scheme)
    for scheme in ("se2", "midpoint", "semi_implicit_euler")
    for name in ("double_pendulum", "hector", "rigid_pendulum", "cart_pendulum_elastic", "towed body")
]


def towed_body() -> Robot:
    """Free body on a spring, and a point mass on a rod to it: force and constraint on a Lie group."""
    model, body = chain("FreeFlyer")
    hook = model.addFrame(
        pin.Frame("hook", 1, body, pin.SE3(np.eye(3), np.array([0.2, 0, 0.1])), pin.FrameType.OP_FRAME)
    )
    model, bob = chain("PX PY PZ", POINT, model=model, prefix="bob_")
    spring = SpringDamper("spring", hook, 0, 3.0, damping=0.4, length=0.5)
    return robot_of(model, constraints=(Rod("rod", hook, bob, 1.5),), forces=(spring,))


class Stage:
    """Stage and terminal functions of a robot at a random point, in the programme's order of unknowns."""

    def __init__(self, name: str, scheme: str) -> None:
        robot = towed_body() if name == "towed body" else load_robot(name)
        self.robot, nv, nq = robot, robot.nv, robot.nq
        signature = FunctionSignature(
            robot.fingerprint,
            ImplicitSteps(scheme),
            ExactGoal("p", nv, nv),
            (Effort(), Tracking(q=True, p=True), Velocity()),
            TerminalCost(q=True, p=True, rate="p", parts=None, has_joint_goal=False),
        )
        mechanics = JointMechanics(robot)
        self.functions = build_functions(mechanics, signature) | build_end_functions(mechanics, signature)
        layout = parameter_layout(signature, Sizes(nq, nv, robot.nu, nq, nv))
        rng = np.random.default_rng(7)
        self.x0, self.x1 = self.random_state(rng), self.random_state(rng)
        # Close states: the logarithm of a far rotation is nowhere smooth enough for a finite difference.
        self.x1[:nq] = robot.integrate(self.x0[:nq], 0.3 * rng.standard_normal(nv))
        self.y, self.u = rng.standard_normal(robot.nc), rng.standard_normal(robot.nu)
        self.m, self.eta = rng.standard_normal(2 * nv + robot.nc), rng.standard_normal(2 * nv)
        self.theta = rng.uniform(0.1, 1.0, sum(layout.theta.values()))
        self.rho = np.concatenate([self.random_state(rng)[:nq], rng.standard_normal(nv)])
        goal = robot.integrate(self.x1[:nq], 0.3 * rng.standard_normal(nv))
        size = sum(layout.terminal.values()) - nq
        self.rho_terminal = np.concatenate([goal, rng.uniform(0.1, 1.0, size)])
        self.ndx, self.ny, self.nu = 2 * nv, robot.nc, robot.nu

    def random_state(self, rng: np.random.Generator) -> np.ndarray:
        q = self.robot.integrate(self.robot.q0, rng.standard_normal(self.robot.nv))
        return np.concatenate([q, rng.standard_normal(self.robot.nv)])

    def retract(self, x: np.ndarray, d: np.ndarray) -> np.ndarray:
        nq, nv = self.robot.nq, self.robot.nv
        return np.concatenate([self.robot.integrate(x[:nq], d[:nv]), x[nq:] + d[nv:]])

    def values(self, z: np.ndarray) -> tuple[np.ndarray, float]:
        d1, y, d0, u = np.split(z, np.cumsum([self.ndx, self.ny, self.ndx]))
        x0, x1 = self.retract(self.x0, d0), self.retract(self.x1, d1)
        c, cost = self.functions["values"](x0, x1, self.y + y, self.u + u, self.theta, self.rho)
        return np.asarray(c).ravel(), float(cost)

    def complete(self) -> list[np.ndarray]:
        out = self.functions["complete"](self.x0, self.x1, self.y, self.u, self.m, self.theta, self.rho)
        return [np.asarray(ca.DM(o)) for o in out]

    def terminal_values(self, d: np.ndarray) -> tuple[float, np.ndarray]:
        psi, g = self.functions["terminal_values"](self.retract(self.x1, d), self.rho_terminal)
        return float(psi), np.asarray(g).ravel()


@pytest.fixture(scope="module", params=CASES, ids=lambda case: "-".join(case))
def stage(request: pytest.FixtureRequest) -> Stage:
    return Stage(*request.param)


def symmetric(upper: np.ndarray) -> np.ndarray:
    return np.triu(upper) + np.triu(upper, 1).T


def check_curve(f, first: float, second: float) -> None:
    """Value, slope and curvature of f(t) at 0 against central differences of fourth order."""
    h = 2e-3
    a, b, c, d = f(h), f(-h), f(2 * h), f(-2 * h)
    slope = (8 * (a - b) - (c - d)) / (12 * h)
    curvature = (16 * (a + b) - (c + d) - 30 * f(0.0)) / (12 * h * h)
    scale = 1.0 + max(abs(v) for v in (a, b, c, d)) + abs(first) + abs(second)
    assert abs(slope - first) < 2e-7 * scale
    assert abs(curvature - second) < 2e-6 * scale


def test_stage_derivatives_match_differences_on_the_manifold(stage: Stage) -> None:
    c, _, dc_dz, dl_dz, hessian = stage.complete()
    hessian, rng = symmetric(hessian), np.random.default_rng(1)
    assert np.allclose(c.ravel(), stage.values(np.zeros(dc_dz.shape[1]))[0], atol=1e-12)
    for _ in range(6):
        direction = rng.standard_normal(dc_dz.shape[1])
        direction /= np.linalg.norm(direction)

        def lagrangian(t: float, direction: np.ndarray = direction) -> float:
            rows, running = stage.values(t * direction)
            return running + float(stage.m @ rows)

        slope = dl_dz.ravel() @ direction + stage.m @ (dc_dz @ direction)
        check_curve(lagrangian, float(slope), float(direction @ hessian @ direction))


def test_each_row_of_the_jacobian(stage: Stage) -> None:
    dc_dz = stage.complete()[2]
    direction, h = np.random.default_rng(2).standard_normal(dc_dz.shape[1]), 1e-5
    difference = (stage.values(h * direction)[0] - stage.values(-h * direction)[0]) / (2 * h)
    assert np.allclose(dc_dz @ direction, difference, atol=1e-7 * (1 + np.abs(difference).max()))


def test_first_order_functions_agree(stage: Stage) -> None:
    """The function jacobian is complete without the Hessian, values that without derivatives."""
    out = stage.functions["jacobian"](stage.x0, stage.x1, stage.y, stage.u, stage.theta, stage.rho)
    whole = stage.complete()
    for first, second in zip(out, whole[:4], strict=True):
        assert np.allclose(np.asarray(ca.DM(first)), second, rtol=1e-13, atol=1e-13)
    c, cost = stage.values(np.zeros(whole[2].shape[1]))
    assert np.allclose(c, whole[0].ravel(), rtol=1e-13, atol=1e-13)
    assert cost == pytest.approx(float(whole[1].item()), rel=1e-13)


def test_terminal_derivatives_match_differences_on_the_manifold(stage: Stage) -> None:
    out = stage.functions["terminal_complete"](stage.x1, stage.eta, stage.rho_terminal)
    _, _, dg_dx, dpsi_dx, hessian = [np.asarray(ca.DM(o)) for o in out]
    rng = np.random.default_rng(3)
    for _ in range(4):
        direction = rng.standard_normal(stage.ndx)
        direction /= np.linalg.norm(direction)

        def lagrangian(t: float, direction: np.ndarray = direction) -> float:
            psi, g = stage.terminal_values(t * direction)
            return psi + float(stage.eta @ g)

        slope = dpsi_dx.ravel() @ direction + stage.eta @ (dg_dx @ direction)
        check_curve(lagrangian, float(slope), float(direction @ symmetric(hessian) @ direction))


def test_constraint_jacobian_matches_differences_on_the_manifold(stage: Stage) -> None:
    mechanics, robot = JointMechanics(stage.robot), stage.robot
    q, dv = ca.SX.sym("q", robot.nq), np.random.default_rng(4).standard_normal(robot.nv)
    function = ca.Function("phi", [q], [mechanics.constraints(q), mechanics.constraint_jacobian(q)])
    at, h = stage.x0[: robot.nq], 1e-5
    jacobian = np.asarray(ca.DM(function(at)[1])).reshape(robot.nc, robot.nv)
    ahead, back = function(robot.integrate(at, h * dv))[0], function(robot.integrate(at, -h * dv))[0]
    difference = np.asarray(ca.DM(ahead - back)).ravel() / (2 * h)
    assert np.allclose(jacobian @ dv, difference, atol=1e-8)
    assert np.allclose(jacobian, robot.constraint_jacobian(at), atol=1e-12)
