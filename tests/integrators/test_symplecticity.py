"""The maps from one state and adjoint to the next preserve the canonical two-form, Proposition 5.

First Appendix B as it is printed: residual (B2) of a control Hamiltonian with free (tau_y, tau_mu), algebraic
unknowns s eliminated by grad_s H = 0. Then that solutions of mbocp satisfy just these equations, and last the
stage functions of any robot.
"""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.formulation.parameter_layout import parameter_layout
from mbocp.formulation.schemes.implicit_steps import ImplicitSteps
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.stage import build_functions
from mbocp.integrators import EULER_SCHEMES, TAU, VELOCITY_TAU
from mbocp.mechanics import JointMechanics
from mbocp.robot import Robot, load_robot
from mbocp.terms.kinds import Effort, ExactGoal, Tracking, Velocity
from mbocp.terms.point import Sizes

TAU_SCHEMES = [scheme for scheme in EULER_SCHEMES if TAU[scheme] == VELOCITY_TAU[scheme]]  # Appendix B
EXAMPLES = Path(__file__).parents[2] / "examples"
SYMPLECTIC = [(1.0, 0.0), (0.0, 1.0), (0.5, 0.5)]
# Beyond the proposition: what matters is tau_y + tau_mu = 1.
ALSO_SYMPLECTIC = [(0.3, 0.7)]
NOT_SYMPLECTIC = [(0.3, 0.3), (1.0, 1.0), (0.0, 0.0)]


class ControlHamiltonian:
    """H(y, mu, s) of eq. (11) with y = (q, p), mu = (mu_q, mu_p) and s = (u, lambda, zeta), by hand."""

    def __init__(self, name: str) -> None:
        y, mu = (ca.SX.sym(letter, 2 * DIMENSION[name]) for letter in ("y", "mu"))
        n = DIMENSION[name]
        q, p, mu_q, mu_p = y[:n], y[n:], mu[:n], mu[n:]
        u, holonomic = ca.SX.sym("u", n), int(name == "rigid_pendulum")
        lam, zeta = ca.SX.sym("lambda", holonomic), ca.SX.sym("zeta", holonomic)
        v, force = getattr(self, name)(q, p)
        phi = (ca.dot(q, q) - 25.0) / 2 if holonomic else ca.SX.zeros(0, 1)
        push = ca.jacobian(phi, q).T @ lam if holonomic else 0
        target = ca.DM(np.linspace(0.5, 1.0, 2 * n))
        cost = 0.4 * ca.dot(u, u) + 0.1 * ca.sumsqr(y - target)
        self.y, self.mu, self.s = y, mu, ca.vertcat(u, lam, zeta)
        self.H = cost + ca.dot(mu_q, v) + ca.dot(mu_p, force - push + u) + ca.dot(zeta, phi)

    def elastic_pendulum(self, q: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX]:
        potential = 0.6 / (8 * 25.0) * (ca.dot(q, q) - 25.0) ** 2 + 9.8 * q[2]
        return p, -ca.gradient(potential, q)

    def rigid_pendulum(self, q: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX]:
        return p, ca.SX(ca.DM([0, 0, -9.81]))

    def double_pendulum(self, q: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX]:
        mechanics = JointMechanics(load_robot("double_pendulum"))
        mass = ca.horzcat(*(mechanics.momentum(q, ca.DM(e)) for e in np.eye(2)))
        v, still = ca.solve(mass, p), ca.SX.sym("v", 2)
        kinetic = (
            ca.dot(still, mass @ still) / 2
        )  # at constant v, for d/dq of p' M^-1 p / 2 is minus its d/dq
        gravity = mechanics.inverse_dynamics(q, ca.SX.zeros(2), ca.SX.zeros(2))
        return v, ca.substitute(ca.gradient(kinetic, q), still, v) - gravity

    def residual(self, taus: tuple[float, float], dt: float) -> ca.Function:
        """(B2) and grad_s H = 0 in (z_{n-1}, z_n, s)."""
        size = self.y.shape[0]
        z0, z1 = ca.SX.sym("z0", 2 * size), ca.SX.sym("z1", 2 * size)
        at = [(1 - tau) * z0 + tau * z1 for tau in taus]
        unknowns = [self.y, self.mu, self.s]
        gradients = [ca.gradient(self.H, x) for x in unknowns]
        f, g, h = ca.Function("gradients", unknowns, [gradients[1], gradients[0], gradients[2]])(
            at[0][:size], at[1][size:], self.s
        )
        step = ca.vertcat(z1[:size] - z0[:size] - dt * f, z1[size:] - z0[size:] + dt * g)  # (B2)
        return ca.Function("residual", [z0, z1, self.s], [ca.vertcat(step, h)])


DIMENSION = {"elastic_pendulum": 3, "double_pendulum": 2, "rigid_pendulum": 3}
START = {  # near a motion, so that Newton's method finds a step
    "elastic_pendulum": [-2.0, -5.0, -5.0, -3.0, 0.5, 0.2],
    "double_pendulum": [0.4, -0.7, 0.05, 0.02],
    "rigid_pendulum": [3.0, 0.0, -4.0, 0.0, 3.0, 0.0],
}


def canonical(size: int) -> Array:
    """J of eq. (13) on (y, mu)."""
    zero, one = np.zeros((size, size)), np.eye(size)
    return np.block([[zero, one], [-one, zero]])


def a_step(name: str, taus: tuple[float, float]) -> tuple[Array, Array]:
    """Derivatives of the equations in (z_{n-1}, z_n), s, at one of their solutions."""
    subject = ControlHamiltonian(name)
    residual = subject.residual(taus, dt=0.1)
    rng = np.random.default_rng(4)
    mu = 0.3 * rng.standard_normal(len(START[name]))
    z = np.concatenate([START[name], mu])
    w, split = np.concatenate([z, z, np.zeros(subject.s.shape[0])]), 2 * len(z)
    parts = [ca.SX.sym(letter, n) for letter, n in (("a", len(z)), ("b", len(z)), ("s", len(w) - split))]
    whole = residual(*parts)
    both = ca.Function("both", [ca.vertcat(*parts)], [whole, ca.jacobian(whole, ca.vertcat(*parts))])
    for _ in range(50):  # Gauss-Newton to the nearest solution: fewer equations than unknowns
        value, jacobian = (np.asarray(ca.DM(out)) for out in both(w))
        if np.abs(value).max() < 1e-12:
            break
        w = w - np.linalg.lstsq(jacobian, value.ravel(), rcond=None)[0]
    assert np.abs(value).max() < 1e-12
    return jacobian[:, :split], jacobian[:, split:]


def defect(name: str, taus: tuple[float, float]) -> float:
    """|F' J F - J| with F = dz_n/dz_{n-1}, eqs. (B4), (B5)."""
    by_z, by_s = a_step(name, taus)
    size = by_z.shape[1] // 2
    all_unknowns = np.hstack([by_z[:, size:], by_s])
    F = -np.linalg.solve(all_unknowns, by_z[:, :size])[:size]
    J = canonical(size // 2)
    return float(np.abs(F.T @ J @ F - J).max())


@pytest.mark.parametrize("name", ["elastic_pendulum", "double_pendulum"])
def test_symplectic_pairs(name: str) -> None:
    for taus in SYMPLECTIC + ALSO_SYMPLECTIC:
        assert defect(name, taus) < 1e-9, taus
    for taus in NOT_SYMPLECTIC:
        assert defect(name, taus) > 1e-4, taus


def isotropy(relation: Array, before: Array, after: Array) -> float:
    """Largest difference of the two-form before and after, over pairs of columns (dz_{n-1}, dz_n)."""
    half = len(relation) // 2
    start, end = relation[:half], relation[half:]
    return float(np.abs(end.T @ after @ end - start.T @ before @ start).max())


def null_space(matrix: Array) -> Array:
    _, singular, vt = np.linalg.svd(matrix)
    rank = int((singular > 1e-10 * singular[0]).sum())
    basis: Array = vt[rank:].T
    return basis


def test_symplectic_pairs_on_a_constraint() -> None:
    """The rigid pendulum has no map from z_{n-1}: lambda and zeta belong to later equations.

    What there is, is a relation between z_{n-1} and z_n on which the two-form before equals that after: the
    presymplectic form. Half of the dimension of the pair, none too few.
    """
    J = canonical(6)
    for taus in SYMPLECTIC + ALSO_SYMPLECTIC + NOT_SYMPLECTIC:
        by_z, by_s = a_step("rigid_pendulum", taus)
        tangents = null_space(np.hstack([by_z, by_s]))
        relation = np.linalg.qr(tangents[:24])[0]
        assert relation.shape == (24, 12)
        assert np.linalg.matrix_rank(tangents[:24], tol=1e-8) == 12
        if taus in NOT_SYMPLECTIC:
            assert isotropy(relation, J, J) > 1e-4, taus
        else:
            assert isotropy(relation, J, J) < 1e-9, taus


TRACKED = [
    "horizon.steps=40",
    "cost.effort=0.8",
    "cost.tracking=0.2",
    "cost.tracking_weights=[1, 1, 1, 1, 1, 1]",
    "cost.target={q=[0.5, 0.6, 0.7], p=[0.8, 0.9, 1.0]}",
]


def solved(name: str, scheme: str) -> tuple[mbocp.Solution, ca.Function]:
    """A solution with effort and tracking cost, and the equations (B2), grad_s H = 0 of its steps."""
    settings = [f'integrator.scheme="{scheme}"', *TRACKED]
    solution = mbocp.solve(mbocp.load_problem(EXAMPLES / f"paper/{name}.toml", settings))
    assert solution.converged, solution.advice
    tau, dt = TAU[scheme], solution.duration / solution.num_steps
    return solution, ControlHamiltonian(name).residual((tau, 1.0 - tau), dt)


@pytest.mark.parametrize("scheme", TAU_SCHEMES)
def test_solutions_are_steps_of_appendix_b(scheme: str) -> None:
    solution, residual = solved("elastic_pendulum", scheme)
    zs = np.hstack([solution.qs, solution.ps, solution.mus])
    for z0, z1, u in zip(zs[:-1], zs[1:], solution.us, strict=True):
        assert np.abs(np.asarray(residual(z0, z1, u))).max() < 1e-9


@pytest.mark.parametrize("scheme", TAU_SCHEMES)
def test_solutions_on_a_constraint(scheme: str) -> None:
    """The constraint kicks the adjoint where it is asked for, at the node; else (B2) as it stands.

    For SE1 that is Box 1 again.
    """
    solution, residual = solved("rigid_pendulum", scheme)
    dt = solution.duration / solution.num_steps
    q, p = solution.qs[1:], solution.ps[1:]
    at = q + dt * p if scheme == "se2" else q  # the bob's mass is 1 kg
    push = dt * solution.zetas * at
    kick = np.hstack([push, dt * push if scheme == "se2" else 0 * push])
    zs = np.hstack([solution.qs, solution.ps, solution.mus])
    ends = np.hstack([q, p, solution.mus[1:] + kick])
    s = np.hstack([solution.us, solution.lams, 0 * solution.zetas])
    for z0, z1, s_n in zip(zs[:-1], ends, s, strict=True):
        assert np.abs(np.asarray(residual(z0, z1, s_n))[:-1]).max() < 1e-9  # the last row is Phi(q_tau)
    assert np.abs(np.einsum("ni,ni->n", at, at) - 25.0).max() < 1e-11
    assert solution.constraint_violation < 1e-10


class StageMap:
    """Step and stationarity of a random problem's stage, as equations between two states and their duals."""

    def __init__(self, robot: Robot, scheme: str) -> None:
        nv, nq = robot.nv, robot.nq
        cost = (Effort(), Tracking(q=True, p=True), Velocity())
        signature = FunctionSignature("", ImplicitSteps(scheme), ExactGoal("p", 0, 0), cost)
        self.robot, self.functions = robot, build_functions(JointMechanics(robot), signature)
        layout, rng = parameter_layout(signature, Sizes(nq, nv, robot.nu, nq, nv)), np.random.default_rng(11)
        self.theta = rng.uniform(0.2, 1.0, sum(layout.theta.values()))
        self.theta[0] = self.dt = 0.05  # [s]
        q = robot.q0 if robot.nc else robot.integrate(robot.q0, 0.3 * rng.standard_normal(nv))
        self.rho = np.concatenate([q, rng.standard_normal(nv)])
        v = rng.standard_normal(nv)
        if robot.nc:
            v = null_space(robot.constraint_jacobian(q)) @ rng.standard_normal(nv - robot.nc)
        self.ndx, self.ny, self.nu = 2 * nv, robot.nc, robot.nu
        self.u = rng.standard_normal(robot.nu)
        self.x0 = np.concatenate([q, v])
        self.x1, self.y = self.step()
        self.m = self.multipliers(rng)

    def jacobian(self, x1: Array, y: Array) -> list[Array]:
        out = self.functions["jacobian"](self.x0, x1, y, self.u, self.theta, self.rho)
        return [np.asarray(ca.DM(o)) for o in out]

    def step(self) -> tuple[Array, Array]:
        """The end of the step by Newton's method."""
        x1, y = self.x0, np.zeros(self.ny)
        for _ in range(30):
            c, _, dc_dz, _ = self.jacobian(x1, y)
            if np.abs(c).max() < 1e-13:
                break
            step = -np.linalg.solve(dc_dz[:, : self.ndx + self.ny], c.ravel())
            x1 = np.asarray(self.functions["retract"](x1, step[: self.ndx])).ravel()
            y = y + step[self.ndx :]
        assert np.abs(c).max() < 1e-10
        return x1, y

    def multipliers(self, rng: np.random.Generator) -> Array:
        """Multipliers that make u and y stationary, otherwise at random."""
        _, _, dc_dz, dl_dz = self.jacobian(self.x1, self.y)
        rows = np.hstack([dc_dz[:, self.ndx : self.ndx + self.ny], dc_dz[:, 2 * self.ndx + self.ny :]]).T
        wanted = np.concatenate([np.zeros(self.ny), -dl_dz.ravel()[2 * self.ndx + self.ny :]])
        m = rng.standard_normal(rows.shape[1])
        out: Array = m + np.linalg.lstsq(rows, wanted - rows @ m, rcond=None)[0]
        return out

    def linearised(self) -> tuple[Array, Array, Array]:
        """Tangents (dx_{n-1}, dc_{n-1}, dx_n, dc_n) of the relation, and both duals.

        Derivatives of the functions c and gradient as they stand, not the Hessian, which is symmetric by
        construction. Both are in the moving frame of q, along the retraction.
        """
        size = 2 * self.ndx + self.ny + self.nu
        t, dm = ca.SX.sym("t", size), ca.SX.sym("dm", len(self.m))
        d1, y, d0, u = ca.vertsplit(t, [0, self.ndx, self.ndx + self.ny, 2 * self.ndx + self.ny, size])
        x0, x1 = (self.functions["retract"](x, d) for x, d in ((self.x0, d0), (self.x1, d1)))
        c, _, dc_dz, dl_dz = self.functions["jacobian"](x0, x1, self.y + y, self.u + u, self.theta, self.rho)
        gradient = dl_dz.T + dc_dz.T @ (self.m + dm)
        everything = ca.vertcat(c, gradient)
        unknowns = ca.vertcat(t, dm)
        function = ca.Function("all", [unknowns], [gradient, ca.jacobian(everything, unknowns)])
        value, derivative = (np.asarray(ca.DM(o)) for o in function(np.zeros(unknowns.shape[0])))
        rows = len(self.m)
        by_x1, by_y, by_x0, by_u = np.split(
            derivative[rows:], np.cumsum([self.ndx, self.ny, self.ndx]), axis=0
        )
        tangents = null_space(np.vstack([derivative[:rows], by_y, by_u]))
        dx1, dx0 = tangents[: self.ndx], tangents[self.ndx + self.ny : 2 * self.ndx + self.ny]
        relation = np.vstack([dx0, by_x0 @ tangents, dx1, -by_x1 @ tangents])
        duals = value.ravel()
        return relation, duals[self.ndx + self.ny : 2 * self.ndx + self.ny], -duals[: self.ndx]


def two_form(robot: Robot, dual: Array) -> Array:
    """Canonical two-form on (dx, dc) in body-fixed frames: dx . dc' - dx' . dc + c . [dx, dx']."""
    form = canonical(2 * robot.nv)
    for joint in list(robot.model.joints)[1:]:
        if joint.shortname() != "JointModelFreeFlyer":
            continue
        block = slice(joint.idx_v, joint.idx_v + 6)
        for i, j in np.ndindex(6, 6):
            bracket = pin.Motion(np.eye(6)[i]).cross(pin.Motion(np.eye(6)[j])).vector
            form[joint.idx_v + i, joint.idx_v + j] += dual[block] @ bracket
    return form


@pytest.mark.parametrize("scheme", EULER_SCHEMES)
@pytest.mark.parametrize("name", ["ur5", "hector", "rigid_pendulum", "cart_pendulum_rigid"])
def test_stages_of_any_robot(name: str, scheme: str) -> None:
    robot = load_robot(name)
    stage = StageMap(robot, scheme)
    relation, before, after = stage.linearised()
    half = 2 * stage.ndx
    assert np.linalg.matrix_rank(relation, tol=1e-9 * np.abs(relation).max()) == half
    relation = np.linalg.qr(relation)[0]
    scale = 1 + np.abs(before).max() + np.abs(after).max()
    assert isotropy(relation, two_form(robot, before), two_form(robot, after)) < 1e-9 * scale
    if not robot.nc:  # then it is a map
        F = relation[half:] @ np.linalg.inv(relation[:half])
        change = F.T @ two_form(robot, after) @ F - two_form(robot, before)
        assert np.abs(change).max() < 1e-9 * (1 + np.abs(F).max() ** 2 * scale)
