r"""The flow of a robot under the controls of each step, to many more digits than steps of a problem have.

States are (q, s), configurations in Pinocchio's coordinates and speeds. The flow solves

.. math:: \dot q = q\,v(q, s, u), \qquad \dot s = a(q, s, u)

where u is constant in a step, or a polynomial in the share of it that has passed, by the method of order
eight of Dormand and Prince [Hairer1993]_ in these coordinates, in parts of a step that are as short as its
error asks for. Holonomic constraints act through projected accelerations, from velocities that satisfy
them. Where constraints begin and end along the way, there is a flow for each set of them, see
`mbocp.accuracy.course`.

The right-hand side is compiled once for a robot. Flows from all nodes are one call.

.. [Hairer1993] Hairer, Norsett, Wanner: Solving Ordinary Differential Equations I, section II.5.
"""

from __future__ import annotations

import hashlib
import math
from functools import lru_cache
from pathlib import Path

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp._dataclass import dataclass
from mbocp.accuracy.dop853 import NODES, SLOPES, WEIGHTS
from mbocp.formulation.signature import sources_digest
from mbocp.mechanics import symbols_of
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.mechanics.held_frames import Acting
from mbocp.programme.compilation import CompiledFunctions, load_functions
from mbocp.robot import Robot


@dataclass(frozen=True, eq=False)
class Flow:
    """Flow of a robot.

    Attributes
    ----------
    robot : Robot
    acting : Acting or None
        Rows of constraints that act; None: those of the robot.
    functions : CompiledFunctions
        "rate" (q, s, u) -> dq/dt, ds/dt; "energy" (q, v) -> E; "difference" (q, q) -> tangent;
        "consistent" (q, v) -> v on the constraints; each takes what varies of the robot as its last argument.
    """

    robot: Robot
    acting: Acting | None
    functions: CompiledFunctions

    @classmethod
    def of(cls, robot: Robot, acting: Acting | None = None, *, deadline: float = math.inf) -> Flow:
        """Compile the right-hand side, or take it from the cache.

        Raises
        ------
        UnsupportedRobot
            If the robot has both drives and holonomic constraints.
        CompilationError
            If it cannot be compiled, or not before the deadline.
        """
        ties = "" if acting is None else f"{acting.signature} "
        key = f"flow {robot.shape_fingerprint} {ties}{sources_digest()} {_own_digest()}"
        functions = load_functions(
            key, lambda: _functions(robot, acting), deadline=deadline, at_once=True
        )  # CasADi calls them
        return cls(robot, acting, functions)

    def ends(self, qs: Array, speeds: Array, us: Array, dts: Array, parts: int) -> tuple[Array, Array]:
        """States after flows over every step, each from its own node.

        Parameters
        ----------
        qs : ndarray, shape (N, nq)
        speeds : ndarray, shape (N, ns)
        us : ndarray, shape (N, k nu)
            Controls of the steps: coefficients of 1, s, s^2, ... in the share s of a step that has passed,
            one block after the other; k is 1 where they are constant.
        dts : ndarray, shape (N,)
            Lengths of the steps [s].
        parts : int
            Steps of the method in each.

        Returns
        -------
        qs : ndarray, shape (N, nq)
        speeds : ndarray, shape (N, ns)
        """
        step = _step(self._function("rate"), us.shape[1]).map(len(us))
        x, lengths = np.hstack([qs, speeds]).T, dts[None] / parts
        for part in range(parts):
            x = step(x, us.T, lengths, np.full(lengths.shape, part / parts), 1.0 / parts).full()
        return x[: qs.shape[1]].T, x[qs.shape[1] :].T

    def track(
        self, start: Array, planned: tuple[Array, Array], us: Array, dts: Array, parts: int, gains: Array
    ) -> Array:
        """End of one flow whose controls answer deviations from what is planned.

        At the begin of each step its control becomes u + K (x - x_planned), and stays so until its end.

        Parameters
        ----------
        start : ndarray, shape (nq + nv + nu,)
            Configuration and velocity, and what the control before is away from its plan.
        planned : tuple of ndarray, shapes (N, nq) and (N, nv)
            Configurations and velocities with which steps begin.
        us : ndarray, shape (N, k nu)
            As of `ends`.
        dts : ndarray, shape (N,)
        parts : int
        gains : ndarray, shape (N, k nu, 2 nv) or (N, k nu, 2 nv + nu)
            Of the coefficients. Those with more columns answer what the control at the end of the step before
            was away from its plan, too.

        Returns
        -------
        end : ndarray, shape (nq + nv + nu,)
        """
        rate, difference = self._function("rate"), self._function("difference")
        chain = _answering_step(rate, difference, parts, us.shape[1], gains.shape[2]).mapaccum(len(us))
        rows = np.transpose(gains, (0, 2, 1)).reshape(len(us), -1)  # CasADi's order of entries is by columns
        found = chain(start, np.hstack(planned).T, us.T, dts[None] / parts, rows.T).full().T
        end: Array = found[-1]
        return end

    def replay(self, q: Array, speeds: Array, us: Array, dts: Array, parts: int) -> tuple[Array, Array]:
        """States of the nodes of one flow from (q, speeds) under the controls of all steps.

        Returns
        -------
        qs : ndarray, shape (N + 1, nq)
        speeds : ndarray, shape (N + 1, ns)
        """
        chain = _step(self._function("rate"), us.shape[1]).mapaccum(parts * len(us))
        passed = np.tile(np.arange(parts) / parts, len(us))[None]
        lengths = np.repeat(dts, parts)[None] / parts
        shares = np.full(lengths.shape, 1.0 / parts)
        found = chain(np.append(q, speeds), np.repeat(us, parts, axis=0).T, lengths, passed, shares)
        xs = np.vstack([np.append(q, speeds), found.full().T[parts - 1 :: parts]])
        return xs[:, : q.size], xs[:, q.size :]

    def differences(self, befores: Array, afters: Array) -> Array:
        """Tangents that lead from configurations to others, shape (k, nv)."""
        found: Array = self._function("difference").map(len(befores))(befores.T, afters.T).full().T
        return found

    def energies(self, qs: Array, vs: Array) -> Array:
        """Kinetic and potential energy, springs included [J], shape (k,)."""
        found: Array = self._function("energy").map(len(qs))(qs.T, vs.T).full().ravel()
        return found

    def consistent(self, qs: Array, vs: Array) -> Array:
        """Velocities nearest in kinetic energy that keep the constraints, shape (k, nv)."""
        ties = self.robot.nc if self.acting is None else len(self.acting.own) + len(self.acting.rows)
        if not ties:
            return vs
        found: Array = self._function("consistent").map(len(qs))(qs.T, vs.T).full().T
        return found

    def _function(self, name: str) -> ca.Function:
        """One of the functions for the numbers of this robot; the same object each time."""
        function, numbers = self.functions.function(name), self.robot.varying_values
        return _with_numbers(function, tuple(numbers.tolist())) if numbers.size else function


@lru_cache(maxsize=64)
def _with_numbers(function: ca.Function, numbers: tuple[float, ...]) -> ca.Function:
    """A function without its last argument, the numbers of a robot, which it is given."""
    own = [ca.MX.sym(f"i{i}", function.numel_in(i)) for i in range(function.n_in() - 1)]
    return ca.Function(function.name(), own, function.call([*own, ca.DM(numbers)]))


def _functions(robot: Robot, acting: Acting | None) -> dict[str, ca.Function]:
    mechanics = ForwardMechanics(robot, acting=acting, numbers=symbols_of(robot))
    numbers = [mechanics.symbols] if robot.varying else []
    q, v = ca.SX.sym("q", mechanics.nq), ca.SX.sym("v", mechanics.nv)
    other = ca.SX.sym("other", mechanics.nq)
    s, u = ca.SX.sym("s", mechanics.ns), ca.SX.sym("u", mechanics.nu)
    along = mechanics.space.rate(q, mechanics.velocity(q, s, u))
    rates = [ca.densify(along), ca.densify(mechanics.speed_rate(q, s, u, ca.SX(0)))]
    energy = ca.dot(v, mechanics.momentum(q, v)) / 2 + mechanics.potential_energy(q)
    functions = {
        "rate": ca.Function("rate", [q, s, u, *numbers], ca.cse(rates)),
        "energy": ca.Function("energy", [q, v, *numbers], ca.cse([energy])),
        "difference": ca.Function(
            "difference", [q, other, *numbers], [ca.densify(mechanics.difference(q, other))]
        ),
    }
    if mechanics.num_tied:
        consistent = [ca.densify(mechanics.projected_velocity(q, v))]
        functions["consistent"] = ca.Function("consistent", [q, v, *numbers], ca.cse(consistent))
    return functions


@lru_cache(maxsize=64)
def _step(rate: ca.Function, size: int) -> ca.Function:
    """One step of the method, (x, u, h, s0, ds) -> x, from the share s0 of a problem's step over ds of it.

    `size`: number of the coefficients u of the controls.
    """
    nq, ns, nu = (rate.numel_in(i) for i in range(3))
    x, u, h = ca.MX.sym("x", nq + ns), ca.MX.sym("u", size), ca.MX.sym("h")
    s0, ds = ca.MX.sym("s0"), ca.MX.sym("ds")
    blocks = ca.vertsplit(u, nu) if nu else [u]
    slopes: list[ca.MX] = []
    for row, c in zip(SLOPES, NODES, strict=True):
        at = x + h * _sum(row, slopes) if slopes else x
        share, applied = s0 + float(c) * ds, blocks[-1]
        for block in reversed(blocks[:-1]):
            applied = block + share * applied
        slopes.append(ca.vertcat(*rate.call([at[:nq], at[nq:], applied])))
    return ca.Function("step", [x, u, h, s0, ds], [x + h * _sum(WEIGHTS, slopes)])


@lru_cache(maxsize=64)
def _answering_step(
    rate: ca.Function, difference: ca.Function, parts: int, size: int, width: int
) -> ca.Function:
    """A step of so many parts with feedback, ((x, du), x_planned, u, h, K) -> (x, du).

    The state carries du, what the control at the end of the step is away from its plan.
    """
    nq, nv, nu = (rate.numel_in(i) for i in range(3))
    carried = ca.MX.sym("carried", nu)
    x, planned = ca.MX.sym("x", nq + nv), ca.MX.sym("planned", nq + nv)
    u, h, K = ca.MX.sym("u", size), ca.MX.sym("h"), ca.MX.sym("K", size * width)
    away = ca.vertcat(difference(planned[:nq], x[:nq]), x[nq:] - planned[nq:])
    seen = away if width == 2 * nv else ca.vertcat(away, carried)
    moved = ca.reshape(K, size, width) @ seen
    answer, step, end = u + moved, _step(rate, size), x
    for part in range(parts):
        end = step(end, answer, h, part / parts, 1.0 / parts)
    left = sum(ca.vertsplit(moved, nu), start=ca.MX.zeros(nu)) if nu else carried
    return ca.Function("answered", [ca.vertcat(x, carried), planned, u, h, K], [ca.vertcat(end, left)])


def _sum(row: Array, slopes: list[ca.MX]) -> ca.MX:
    weighed = [(float(a), k) for a, k in zip(row, slopes, strict=False) if a]
    return ca.horzcat(*(k for _, k in weighed)) @ ca.DM([a for a, _ in weighed])


@lru_cache(maxsize=1)
def _own_digest() -> str:
    return hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
