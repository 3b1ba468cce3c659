r"""The flow of a robot under the controls of each step, to many more digits than steps of a problem have.

States are (q, s), configurations in Pinocchio's coordinates and speeds. The flow solves

.. math:: \dot q = q\,v(q, s, u), \qquad \dot s = a(q, s, u)

where u is constant in a step, or a polynomial in the share of it that has passed, by the method of order
eight of Dormand and Prince [Hairer1993]_ in these coordinates, in parts of a step that are as short as its
error asks for. Holonomic constraints act through projected accelerations, from velocities that satisfy
them. Where constraints begin and end along the way, there is a flow for each set of them, see
`mbocp.accuracy.course`.

The kernel evaluates the right-hand side, for the flows from several nodes at a time.

.. [Hairer1993] Hairer, Norsett, Wanner: Solving Ordinary Differential Equations I, section II.5.
"""

from __future__ import annotations

import hashlib
import math
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.accuracy.dop853 import NODES, SLOPES, WEIGHTS
from mbocp.formulation.signature import sources_digest
from mbocp.mechanics import symbols_of
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.mechanics.held_frames import ActiveRows
from mbocp.programme.compilation import CompiledFunctions, load_functions
from mbocp.programme.native_modules import kernel
from mbocp.robot import Robot

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelFlow


@dataclass(frozen=True, eq=False)
class Flow:
    """Flow of a robot.

    Attributes
    ----------
    robot : Robot
    acting : ActiveRows or None
        Rows of constraints that act; None: those of the robot.
    functions : CompiledFunctions
        "rate" (q, s, u) -> dq/dt, ds/dt; "energy" (q, v) -> E; "difference" (q, q) -> tangent;
        "consistent" (q, v) -> v on the constraints; each takes what varies of the robot as its last argument.
    """

    robot: Robot
    acting: ActiveRows | None
    functions: CompiledFunctions

    @classmethod
    def of(cls, robot: Robot, acting: ActiveRows | None = None, *, deadline: float = math.inf) -> Flow:
        """Build the right-hand side, or take it from the cache.

        Raises
        ------
        UnsupportedRobot
            If the robot has both drives and holonomic constraints.
        CompilationError
            If it is not built before the deadline.
        """
        ties = "" if acting is None else f"{acting.signature} "
        key = f"flow {robot.shape_fingerprint} {ties}{sources_digest()} {_own_digest()}"
        return cls(robot, acting, load_functions(key, lambda: _functions(robot, acting), deadline=deadline))

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
        found = self._native.ends(np.hstack([qs, speeds]).ravel(), us.ravel(), dts, parts)
        rows = found.reshape(len(dts), -1)
        return rows[:, : qs.shape[1]], rows[:, qs.shape[1] :]

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
        size = planned[0].shape[1] + planned[1].shape[1]
        x, away = np.ascontiguousarray(start[:size]), np.ascontiguousarray(start[size:])
        difference, plan = self.functions.stage_function("difference"), np.hstack(planned).ravel()
        states, left = self._native.track(x, us.ravel(), dts, parts, difference, plan, gains.ravel(), away)
        return np.append(states[-size:], left)

    def replay(self, q: Array, speeds: Array, us: Array, dts: Array, parts: int) -> tuple[Array, Array]:
        """States of the nodes of one flow from (q, speeds) under the controls of all steps.

        Returns
        -------
        qs : ndarray, shape (N + 1, nq)
        speeds : ndarray, shape (N + 1, ns)
        """
        start = np.append(q, speeds)
        rows = np.append(start, self._native.chain(start, us.ravel(), dts, parts)).reshape(len(dts) + 1, -1)
        return rows[:, : q.size], rows[:, q.size :]

    def differences(self, befores: Array, afters: Array) -> Array:
        """Tangents that lead from configurations to others, shape (k, nv)."""
        return self._evaluate("difference", befores, afters)

    def energies(self, qs: Array, vs: Array) -> Array:
        """Kinetic and potential energy, springs included [J], shape (k,)."""
        return self._evaluate("energy", qs, vs).ravel()

    def consistent(self, qs: Array, vs: Array) -> Array:
        """Velocities nearest in kinetic energy that keep the constraints, shape (k, nv)."""
        ties = self.robot.nc if self.acting is None else len(self.acting.own) + len(self.acting.rows)
        return self._evaluate("consistent", qs, vs) if ties else vs

    @cached_property
    def _native(self) -> KernelFlow:
        return kernel().Flow(
            rate=self.functions.stage_function("rate"),
            numbers=self.robot.varying_values,
            slopes=SLOPES.tolist(),
            weights=WEIGHTS.tolist(),
            nodes=NODES.tolist(),
        )

    def _evaluate(self, name: str, *inputs: Array) -> Array:
        """Values of a function of two arguments for each pair of rows, and for the numbers of this robot."""
        count, numbers = len(inputs[0]), self.robot.varying_values
        given = [np.ascontiguousarray(rows).ravel() for rows in inputs]
        if numbers.size:
            given.append(np.tile(numbers, count))
        (found,) = self.functions.stage_function(name).evaluate(given, count, True)
        return found.reshape(count, -1)


def _functions(robot: Robot, acting: ActiveRows | None) -> dict[str, ca.Function]:
    mechanics = ForwardMechanics(robot, acting=acting, numbers=symbols_of(robot))
    numbers = [mechanics.symbols] if robot.varying else []
    q, v = ca.SX.sym("q", mechanics.nq), ca.SX.sym("v", mechanics.nv)
    other = ca.SX.sym("other", mechanics.nq)
    s, u = ca.SX.sym("s", mechanics.ns), ca.SX.sym("u", mechanics.nu)
    along = mechanics.space.rate(q, mechanics.velocity(q, s, u))
    rates = [ca.densify(along), ca.densify(mechanics.speed_rate(q, s, u, ca.SX(0)))]
    energy = ca.dot(v, mechanics.momentum(q, v)) / 2 + mechanics.potential_energy(q)
    functions = {
        "rate": ca.Function("rate", [q, s, u, *numbers], rates),
        "energy": ca.Function("energy", [q, v, *numbers], [energy]),
        "difference": ca.Function(
            "difference", [q, other, *numbers], [ca.densify(mechanics.difference(q, other))]
        ),
    }
    if mechanics.num_tied:
        consistent = [ca.densify(mechanics.project_velocity(q, v))]
        functions["consistent"] = ca.Function("consistent", [q, v, *numbers], consistent)
    return functions


@lru_cache(maxsize=1)
def _own_digest() -> str:
    return hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
