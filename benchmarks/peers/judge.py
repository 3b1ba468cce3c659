"""What a trajectory is worth, by Pinocchio and NumPy alone: no solver is asked about itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from benchmarks.peers.task import Array, Task

__all__ = ["Verdict", "judge"]


@dataclass(frozen=True)
class Verdict:
    """What was found.

    Attributes
    ----------
    cost : float
        sum_k h/2 (|u_k|^2 + w |v_k|^2) of the trajectory.
    defect : float
        Largest difference of a state from that to which a step by ABA leads from the one before.
    end : float
        Largest difference of the roll-out's last state from the goal: of joints [rad], positions [m] and
        velocities.
    rolled_cost : float
        Cost of the roll-out of the controls alone.
    excess : float
        By which a control is beyond its limit at most [N, N m].
    """

    cost: float
    defect: float
    end: float
    rolled_cost: float
    excess: float

    @property
    def error(self) -> float:
        """Largest of defect, error of the end and excess."""
        return max(self.defect, self.end, self.excess)


def judge(task: Task, qs: Array, vs: Array, us: Array) -> Verdict:
    """Evaluate a trajectory: states (N + 1, nq), (N + 1, nv), controls (N, nu)."""
    model, data, dt = task.model, task.model.createData(), task.dt
    if not (np.isfinite(qs).all() and np.isfinite(vs).all() and np.isfinite(us).all()):
        return Verdict(np.nan, np.inf, np.inf, np.nan, np.inf)

    def after(q: Array, v: Array, u: Array) -> tuple[Array, Array]:
        v = v + dt * pin.aba(model, data, q, v, task.torque_map @ u)
        return pin.integrate(model, q, dt * v), v

    def away(q: Array, v: Array, to_q: Array, to_v: Array) -> float:
        apart = np.abs(pin.difference(model, to_q, q)).max()
        return float(max(apart, np.abs(v - to_v).max()))

    still = np.zeros(model.nv)
    defect = away(qs[0], vs[0], task.q0, still)
    q, v, rolled = qs[0], vs[0], [vs[0]]
    for k, u in enumerate(us):
        defect = max(defect, away(*after(qs[k], vs[k], u), qs[k + 1], vs[k + 1]))
        q, v = after(q, v, u)
        rolled.append(v)

    def cost(speeds: Array) -> float:
        return float(dt / 2.0 * (np.sum(us**2) + task.weight * np.sum(speeds[:-1] ** 2)))

    return Verdict(
        cost=cost(vs),
        defect=defect,
        end=max(away(q, v, task.goal, still), away(qs[-1], vs[-1], task.goal, still)),
        rolled_cost=cost(np.array(rolled)),
        excess=float(np.maximum(np.abs(us) - task.limits, 0.0).max()),
    )
