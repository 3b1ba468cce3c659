"""A task as a shooting problem of Crocoddyl, for its own solvers and those of mim_solvers.

Its Euler step is the semi-implicit one. Wheels of Crocoddyl that meet another Pinocchio than the one they
were built with leave gravity out, without a word: so nothing is solved before its accelerations agree with
those of `pin`.
"""

from __future__ import annotations

from typing import Any

import crocoddyl
import numpy as np
import pinocchio as pin

from benchmarks.peers.task import Array, Task
from benchmarks.peers.tools.runs import NotSolved, Run

__all__ = ["check_dynamics", "shooting_problem", "start_of", "trajectory"]

_END = 1e6  # weight of the end's error, halved: there are no hard end conditions
_SAME = 1e-9


def shooting_problem(task: Task, *, inverse: bool = False, hard_end: bool = False) -> Any:
    """Running models with forward dynamics, or inverse dynamics and accelerations as controls."""
    state = crocoddyl.StateMultibody(task.model)
    actuation = _actuation(task, state)
    nu = task.model.nv if inverse else actuation.nu
    running, end = crocoddyl.CostModelSum(state, nu), crocoddyl.CostModelSum(state, nu)
    effort: Any = crocoddyl.ResidualModelControl(state, nu)
    if inverse:
        effort = crocoddyl.ResidualModelJointEffort(state, actuation, np.zeros(actuation.nu), nu)
    running.addCost("effort", crocoddyl.CostModelResidual(state, effort), 1.0)
    nv = task.model.nv
    if task.weight:
        speeds = crocoddyl.ActivationModelWeightedQuad(np.repeat([0.0, task.weight], nv))
        rest = crocoddyl.ResidualModelState(state, np.concatenate([task.q0, np.zeros(nv)]), nu)
        running.addCost("speed", crocoddyl.CostModelResidual(state, speeds, rest), 1.0)
    goal = crocoddyl.ResidualModelState(state, np.concatenate([task.goal, np.zeros(nv)]), nu)
    conditions = crocoddyl.ConstraintModelManager(state, nu)
    if hard_end:
        none = np.zeros(2 * nv)  # CSQP takes equations as bounds
        conditions.addConstraint("goal", crocoddyl.ConstraintModelResidual(state, goal, none, none))
    else:
        end.addCost("goal", crocoddyl.CostModelResidual(state, goal), _END)
    limits = crocoddyl.ConstraintModelManager(state, nu)
    if hard_end and task.is_limited:
        within = crocoddyl.ConstraintModelResidual(state, effort, -task.limits, task.limits)
        limits.addConstraint("limits", within)
    kind = (
        crocoddyl.DifferentialActionModelFreeInvDynamics
        if inverse
        else crocoddyl.DifferentialActionModelFreeFwdDynamics
    )
    step = crocoddyl.IntegratedActionModelEuler(kind(state, actuation, running, limits), task.dt)
    last = crocoddyl.IntegratedActionModelEuler(kind(state, actuation, end, conditions), 0.0)
    if task.is_limited and not inverse:
        step.u_lb, step.u_ub = -task.limits, task.limits
    x0 = np.concatenate([task.q0, np.zeros(nv)])
    return crocoddyl.ShootingProblem(x0, [step] * task.num_steps, last)


def _actuation(task: Task, state: Any) -> Any:
    if task.is_arm:
        return crocoddyl.ActuationModelFull(state)
    rotors = []
    for column in task.torque_map.T:
        place = np.array([-column[4], column[3], 0.0])  # p x e_z = (p_y, -p_x, 0)
        ratio = column[5]
        kind = crocoddyl.ThrusterType.CW if ratio > 0 else crocoddyl.ThrusterType.CCW
        rotors.append(crocoddyl.Thruster(pin.SE3(np.eye(3), place), abs(ratio), kind, -np.inf, np.inf))
    return crocoddyl.ActuationModelFloatingBaseThrusters(state, rotors)


def check_dynamics(task: Task) -> None:
    """Refuse to go on where a step of Crocoddyl is not one by Pinocchio.

    Raises
    ------
    SystemExit
        If a step is another one: versions of the packages do not fit.
    """
    problem = shooting_problem(task)
    model, data, rng = task.model, task.model.createData(), np.random.default_rng(1)
    q, v = pin.integrate(model, task.q0, rng.standard_normal(model.nv)), rng.standard_normal(model.nv)
    u = rng.standard_normal(task.torque_map.shape[1])
    step = problem.runningModels[0]
    found = step.createData()
    step.calc(found, np.concatenate([q, v]), u)
    v1 = v + task.dt * pin.aba(model, data, q, v, task.torque_map @ u)
    q1 = pin.integrate(model, q, task.dt * v1)
    cost = task.dt / 2.0 * (u @ u + task.weight * v @ v)
    wrong = max(
        np.abs(pin.difference(model, q1, found.xnext[: model.nq])).max(),
        np.abs(found.xnext[model.nq :] - v1).max(),
        abs(found.cost - cost) / (1.0 + cost),
    )
    if not wrong < _SAME:
        raise SystemExit(
            f"{task.name}: a step of Crocoddyl {crocoddyl.__version__} differs by {wrong:.1e} from one by "
            f"Pinocchio {pin.__version__}: the wheels do not fit each other; install pin==4.0.0 and "
            "libpinocchio==4.0.0"
        )


def start_of(task: Task, problem: Any, *, inverse: bool = False) -> tuple[list[Array], list[Array]]:
    """States at the start, and controls that hold it."""
    xs = [problem.x0.copy() for _ in range(task.num_steps + 1)]
    u = np.zeros(task.model.nv) if inverse else task.holding()
    return xs, [u.copy() for _ in range(task.num_steps)]


def trajectory(task: Task, solver: Any, seconds: list[float], *, inverse: bool = False) -> Run:
    """States and controls of a solver, torques from accelerations where these were its controls."""
    xs, controls = np.array(solver.xs), np.array(solver.us)
    if not (np.isfinite(xs).all() and np.isfinite(controls).all()):
        raise NotSolved("not finite")
    nq, model = task.model.nq, task.model
    qs, vs = xs[:, :nq], xs[:, nq:]
    if inverse:
        data = model.createData()
        controls = np.array(
            [pin.rnea(model, data, q, v, a).copy() for q, v, a in zip(qs, vs, controls, strict=False)]
        )
    return Run(qs, vs, controls, int(solver.iter), seconds)
