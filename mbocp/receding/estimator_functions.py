r"""Functions of a stage of an estimator, for the kernel, and its loop there.

A state is x = (q, v, p), with the constants p of the robot. A stage moves it by noise w and then by a step of
second order of the mechanics, of length h:

.. math::

    q_1 &= q_0 \exp\bigl(\tfrac h2 (v_0 + v_1)\bigr), \\
    h\,\mathrm{RNEA}(q_m, v_m, \tfrac{v_1 - v_0}{h}; p_1) &= h\,f(q_m, v_m, u; p_1) + \sqrt h D w_v, \\
    p_1 &= p_0 + \sqrt h\,G w_p,

at the middle of the step. Samples at times t_i in it are compared with the motion of constant acceleration
that this step is, of which the cost needs the moments :math:`S_k = \sum t_i^k` and
:math:`\sum t_i^k \epsilon_i` alone, however many there are. Two stages before them last no time and have
the noise of what was known before, with the covariance L L': :math:`x_1 = x_0 \exp(L_1 w)`, and then that of
the other columns. Stages of a horizon that is not full yet do nothing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from mbocp._arrays import dataclass
from mbocp.formulation.signature import sources_digest
from mbocp.mechanics import JointMechanics
from mbocp.programme.compilation import CompiledFunctions, load_functions
from mbocp.programme.native_modules import kernel
from mbocp.receding import unknowns as own_unknowns
from mbocp.receding.unknowns import Constant, friction_in, payload_forces
from mbocp.robot import Robot

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelHorizon, KernelProgramme

NUM_MOMENTS = 5  # S_0 to S_4
_TOLERANCE = 1e-9  # of a Gauss-Newton step, in the units of states and noise


@dataclass(frozen=True)
class EstimatorLayout:
    """Sizes of the functions, and where their parameters are.

    Attributes
    ----------
    nq, nv, nu, num : int
        Sizes of configuration, velocity, control and constants.
    """

    nq: int
    nv: int
    nu: int
    num: int

    @property
    def nx(self) -> int:
        """Size of a state."""
        return self.nq + self.nv + self.num

    @property
    def ndx(self) -> int:
        """Size of its tangent."""
        return 2 * self.nv + self.num

    @property
    def nw(self) -> int:
        """Size of the noise: of the velocities, and of the constants."""
        return self.nv + self.num

    @cached_property
    def theta(self) -> dict[str, slice]:
        """What all stages share: inverse variances, intensities of noise, and L by columns."""
        n = self.ndx
        return _places(
            of_q=self.nv, of_v=self.nv, disturbance=self.nv, drift=self.num, arrival=n * (n + 1) // 2
        )

    @property
    def num_theta(self) -> int:
        """Size of theta."""
        return int(self.theta["arrival"].stop)

    @property
    def num_rho(self) -> int:
        """Size of a stage's rho."""
        return int(self.rho["u"].stop)

    @cached_property
    def rho(self) -> dict[str, slice]:
        """What is a stage's own: length and its inverse, whether it moves or is one of the first, samples."""
        return _places(
            h=1,
            rate=1,
            moves=1,
            arrives=2,
            moments=NUM_MOMENTS,
            of_q=3 * self.nv,
            of_v=2 * self.nv,
            squares=1,
            reference=self.nq,
            u=self.nu,
        )


def _places(**sizes: int) -> dict[str, slice]:
    found, at = dict[str, slice](), 0
    for name, size in sizes.items():
        found[name] = slice(at, at + size)
        at += size
    return found


def load_estimator_functions(robot: Robot, unknowns: Sequence[Constant], *, has_v: bool) -> CompiledFunctions:
    """Functions of a stage and of the end by name; see `load_functions`.

    Parameters
    ----------
    robot : Robot
    unknowns : sequence of Constant
    has_v : bool
        Whether velocities are measured.
    """
    digest = hashlib.sha256(sources_digest().encode())
    for source in (Path(__file__), Path(str(own_unknowns.__file__))):
        digest.update(source.read_bytes())
    key = f"estimator {digest.hexdigest()} {robot.fingerprint} {robot.payloads} {unknowns} {has_v}"
    return load_functions(key, lambda: _Stage(robot, unknowns, has_v=has_v).functions())


class _Stage:
    """Rows, cost and derivatives of a stage."""

    def __init__(self, robot: Robot, unknowns: Sequence[Constant], *, has_v: bool) -> None:
        self.layout = at = EstimatorLayout(robot.nq, robot.nv, robot.nu, len(unknowns))
        self._mechanics = JointMechanics(robot)
        self._space, self._unknowns, self._has_v = self._mechanics.space, unknowns, has_v
        self.x0, self.x1 = ca.SX.sym("x0", at.nx), ca.SX.sym("x1", at.nx)
        self.w, self.m = ca.SX.sym("w", at.nw), ca.SX.sym("m", at.ndx)
        self.theta = ca.SX.sym("theta", at.num_theta)
        self.rho = ca.SX.sym("rho", at.num_rho)
        self._of_all = {name: self.theta[where] for name, where in at.theta.items()}
        self._own = {name: self.rho[where] for name, where in at.rho.items()}
        self._d1, self._d0 = ca.SX.sym("d1", at.ndx), ca.SX.sym("d0", at.ndx)
        self._z = ca.vertcat(self._d1, self._d0, self.w)

    def functions(self) -> dict[str, ca.Function]:
        """All of them."""
        c, dc_dz, cost, gradient, hessian = self._derivatives()
        y, nothing, at = ca.SX.sym("y", 0), ca.SX.sym("nothing", 0), self.layout
        given, parameters = [self.x0, self.x1, y, self.w], [self.theta, self.rho]
        first = [c, cost, dc_dz, gradient.T]
        x, d, moved = ca.SX.sym("x", at.nx), ca.SX.sym("d", at.ndx), ca.SX.sym("moved", at.nx)
        none, flat = ca.SX.zeros(0, 1), ca.SX(1, at.ndx)
        end = [ca.SX(0), none, ca.SX(0, at.ndx), flat, ca.SX(at.ndx, at.ndx)]
        all_inputs = [*given, self.m, *parameters]
        linear = [ca.densify(value) for value in (c, dc_dz, gradient, hessian)]
        named = {
            "values": ([*given, *parameters], [c, cost]),
            "jacobian": ([*given, *parameters], first),
            "complete": (all_inputs, [*first, ca.triu(hessian)]),
            "linear": ([self.x0, self.x1, self.w, *parameters], linear),
            "retract": ([x, d], [ca.densify(self._retract(x, d))]),
            "difference": ([x, moved], [ca.densify(self._difference(x, moved))]),
            "terminal_values": ([x, nothing], end[:2]),
            "terminal_complete": ([x, ca.SX.sym("eta", 0), nothing], end),
        }
        return {name: ca.Function(name, *arguments) for name, arguments in named.items()}

    def _parts(self, x: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        nq, nv = self.layout.nq, self.layout.nv
        return x[:nq], x[nq : nq + nv], x[nq + nv :]

    def _retract(self, x: ca.SX, d: ca.SX) -> ca.SX:
        nq, nv = self.layout.nq, self.layout.nv
        return ca.vertcat(self._space.integrate(x[:nq], d[:nv]), x[nq:] + d[nv:])

    def _difference(self, x: ca.SX, moved: ca.SX) -> ca.SX:
        nq = self.layout.nq
        return ca.vertcat(self._space.difference(x[:nq], moved[:nq]), moved[nq:] - x[nq:])

    def _derivatives(self) -> list[ca.SX]:
        """Rows, their Jacobian, cost, its gradient and its Gauss-Newton Hessian, at zero tangents."""
        at, own, z, nv = self.layout, self._own, self._z, self.layout.nv
        h, moves, arrives = own["h"], own["moves"], own["arrives"]
        lower = ca.SX(ca.Sparsity.lower(at.ndx), self._of_all["arrival"])
        moved0 = self._retract(self.x0, self._d0)
        known = arrives[0] * lower[:, : at.nw] @ self.w + arrives[1] * lower[:, at.nw :] @ self.w[:nv]
        q0, v0, p0 = self._parts(self._retract(moved0, known))
        q1, v1, p1 = self._parts(self._retract(self.x1, self._d1))
        noise_v, noise_p = self.w[:nv], self.w[nv:]
        root = ca.sqrt(h)
        middle = ca.vertcat(
            self._space.integrate(q0, h / 4 * (v0 + v1)), (v0 + v1) / 2, (v1 - v0) * own["rate"], p1
        )
        base = ca.SX.sym("base", at.nq)
        of_middle = ca.vertcat(self._space.difference(base, middle[: at.nq]), middle[at.nq :])
        rest = ca.vertcat(
            self._space.difference(q1, self._space.integrate(q0, h / 2 * (v0 + v1))),
            (1 - moves) * (v0 - v1) - moves * root * self._of_all["disturbance"] * noise_v,
            p0 + root * self._of_all["drift"] * noise_p - p1,
        )
        coefficients, W, moments = self._motion(*self._parts(moved0)[:2], v1)
        J = ca.jacobian(coefficients, z)
        found = [rest, ca.jacobian(rest, z), coefficients, J, middle, ca.jacobian(of_middle, z)]
        rest, drest, coefficients, J, middle, dmiddle = self._at_zero(found, [base, middle[: at.nq]])
        balance, slopes = self._balance()(middle, own["u"])
        at_v = slice(nv, 2 * nv)
        scale = moves * h
        drest[at_v, :] += scale * (slopes @ dmiddle)
        rest[at_v] += scale * balance
        Wa = W @ coefficients
        cost = ca.dot(self.w, self.w) / 2 + ca.dot(coefficients, Wa / 2 - moments) + own["squares"]
        gradient = J.T @ (Wa - moments)
        noise = slice(2 * at.ndx, 2 * at.ndx + at.nw)
        gradient[noise] += self.w
        hessian = J.T @ W @ J
        hessian[noise, noise] += ca.SX.eye(at.nw)
        return [rest, drest, cost, gradient, hessian]

    def _balance(self) -> ca.Function:
        """(q, v, a, p), u -> the balance of forces, and its derivatives, those in q along its tangent."""
        at, mechanics = self.layout, self._mechanics
        q, v, a = ca.SX.sym("q", at.nq), ca.SX.sym("v", at.nv), ca.SX.sym("a", at.nv)
        p, u, turn = ca.SX.sym("p", at.num), ca.SX.sym("u", at.nu), ca.SX.sym("turn", at.nv)
        there = self._space.integrate(q, turn)
        rows = mechanics.inverse_dynamics(there, v, a) - mechanics.force(there, v, u)
        rows -= friction_in(self._unknowns, p, v)
        rows += payload_forces(mechanics, self._unknowns, p, there, v, a)
        rows = ca.cse(rows)  # payloads move with frames that the robot's own equations know, too
        rows, slopes = ca.cse([rows, ca.jacobian(rows, ca.vertcat(turn, v, a, p))])
        still = ca.SX.zeros(at.nv)
        rows, slopes = ca.Function("still", [q, turn, v, a, p, u], [rows, slopes])(q, still, v, a, p, u)
        return ca.Function("balance", [ca.vertcat(q, v, a, p), u], [rows, slopes])

    def _motion(self, q0: ca.SX, v0: ca.SX, v1: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Coefficients in time of the motion within the stage, weights of their squares and of themselves."""
        own, nv = self._own, self.layout.nv
        coefficients = ca.vertcat(self._space.difference(own["reference"], q0), v0, (v1 - v0) * own["rate"])
        S, of_q, of_v = own["moments"], self._of_all["of_q"], self._of_all["of_v"]
        hankel = ca.blockcat([[S[0], S[1], S[2] / 2], [S[1], S[2], S[3] / 2], [S[2] / 2, S[3] / 2, S[4] / 4]])
        W = ca.kron(hankel, ca.diag(of_q))
        moments = ca.repmat(of_q, 3) * own["of_q"]
        if self._has_v:
            rates = ca.blockcat([[0, 0, 0], [0, S[0], S[1]], [0, S[1], S[2]]])
            W += ca.kron(ca.sparsify(rates), ca.diag(of_v))
            moments[nv:] += ca.repmat(of_v, 2) * own["of_v"]
        return coefficients, W, moments

    def _at_zero(self, expressions: list[ca.SX], base: list[ca.SX]) -> list[ca.SX]:
        """Expressions at zero tangents, where a base is what is given for it there."""
        symbols = [self.x0, self.x1, self.w, self.theta, self.rho, self._d1, self._d0]
        zero = ca.SX.zeros(self.layout.ndx)
        there = [*symbols[:5], zero, zero]
        (at_base,) = ca.Function("base", symbols, base[1:]).call(there)
        function = ca.Function("at_zero", [*symbols, base[0]], expressions)
        return list(function.call([*there, at_base]))


def make_kernel(
    functions: CompiledFunctions, at: EstimatorLayout, num_stages: int
) -> tuple[KernelProgramme, KernelHorizon]:
    """Make a programme of so many stages, and the loop that moves it on; both are all zeros."""
    native, of = kernel(), functions.stage_function
    kind = native.Kind(
        nx=at.nx,
        ndx=at.ndx,
        ny=0,
        nu=at.nw,
        nr=at.num_rho,
        values=of("values"),
        jacobian=of("jacobian"),
        complete=of("complete"),
        scale_c=np.ones(at.ndx),
        scale_y=np.zeros(0),
        scale_m=np.ones(at.ndx),
        scale_ru=np.ones(at.nw),
    )
    end = native.Terminal(ng=0, values=of("terminal_values"), complete=of("terminal_complete"))
    programme = native.Programme(num_stages, kind, end, of("retract"), of("difference"))
    horizon = native.RecedingHorizon(
        programme, tolerance=_TOLERANCE, barrier=0.0, shift_unit=1.0, augmentation=0.0
    )
    return programme, horizon
