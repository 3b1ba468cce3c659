"""An iteration of Crocoddyl's FDDP: `python -m benchmarks.peers.tools.crocoddyl_iteration ROBOT N`."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import crocoddyl
import example_robot_data
import numpy as np
import pinocchio as pin

_DURATION, _MOVE = 0.5, 0.1  # [s], [rad, m]: as benchmarks.joints
_ROUNDS = 15


def main() -> None:
    """Print least processor times [s] of derivatives, direction and a trial, on one line of JSON."""
    model, N = example_robot_data.load(sys.argv[1]).model, int(sys.argv[2])
    problem = _problem(model, N)
    solver = crocoddyl.SolverFDDP(problem)
    solver.solve([problem.x0] * (N + 1), [np.zeros(problem.runningModels[0].nu)] * N, 3, False)

    def derivatives() -> None:
        problem.calc(solver.xs, solver.us)
        problem.calcDiff(solver.xs, solver.us)

    times = {
        "derivatives": _least(derivatives),
        "direction": _least(lambda: solver.computeDirection(False)),
        "trial": _least(lambda: solver.tryStep(0.0)),
    }
    print(json.dumps({**times, "version": crocoddyl.__version__}))


def _problem(model: Any, N: int) -> Any:
    """From rest to a small move of all motors, least effort."""
    state, nv = crocoddyl.StateMultibody(model), model.nv
    has_base = model.nq != nv
    actuation = (crocoddyl.ActuationModelFloatingBase if has_base else crocoddyl.ActuationModelFull)(state)
    move = np.full(nv, _MOVE)
    move[: nv - actuation.nu] = 0.0
    q, rest = pin.neutral(model), np.zeros(nv)
    running, end = crocoddyl.CostModelSum(state, actuation.nu), crocoddyl.CostModelSum(state, actuation.nu)
    effort = crocoddyl.ResidualModelControl(state, actuation.nu)
    running.addCost("effort", crocoddyl.CostModelResidual(state, effort), 1.0)
    goal = np.concatenate([pin.integrate(model, q, move), rest])
    there = crocoddyl.ResidualModelState(state, goal, actuation.nu)
    end.addCost("goal", crocoddyl.CostModelResidual(state, there), 1e6)
    forward = crocoddyl.DifferentialActionModelFreeFwdDynamics
    step = crocoddyl.IntegratedActionModelEuler(forward(state, actuation, running), _DURATION / N)
    last = crocoddyl.IntegratedActionModelEuler(forward(state, actuation, end), 0.0)
    return crocoddyl.ShootingProblem(np.concatenate([q, rest]), [step] * N, last)


def _least(work: Callable[[], Any]) -> float:
    def once() -> float:
        begun = time.process_time()
        work()
        return time.process_time() - begun

    return min(once() for _ in range(_ROUNDS))


if __name__ == "__main__":
    main()
