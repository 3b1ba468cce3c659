"""Crocoddyl's published examples, and what a motion of mbocp is worth in them.

`python -m benchmarks.peers.tools.crocoddyl_examples NAME GUESS REPEATS MOTION.npz`

Robots, costs, numbers of steps and solvers are those of the files of these names in `examples/` of
https://github.com/loco-3d/crocoddyl (BSD-3-Clause), version 3.2.1; gaits are built by Crocoddyl itself.
Motions of both are judged by Crocoddyl's own functions.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import crocoddyl
import example_robot_data
import numpy as np
import pinocchio as pin
from crocoddyl.utils.biped import SimpleBipedGaitProblem
from crocoddyl.utils.quadruped import SimpleQuadrupedalGaitProblem

from benchmarks.peers.task import Array
from benchmarks.peers.tools.runs import timed

_MOST = 100  # iterations, Crocoddyl's default


@dataclass(frozen=True, eq=False)
class Example:
    """A shooting problem, its solver, and whether accelerations are its controls."""

    problem: Any
    solver: Any
    is_inverse: bool = False


def arm(*, inverse: bool = False) -> Example:
    """`arm_manipulation_fwddyn.py`, `arm_manipulation_invdyn.py`: a Kinova reaches for a pose."""
    model = example_robot_data.load("kinova").model
    state = crocoddyl.StateMultibody(model)
    actuation = crocoddyl.ActuationModelFull(state)
    x0 = np.concatenate([model.referenceConfigurations["arm_up"], np.zeros(model.nv)])
    nu = state.nv
    frame, there = model.getFrameId("j2s6s200_end_effector"), pin.SE3(np.eye(3), np.array([0.6, 0.2, 0.5]))
    pose = _cost(state, crocoddyl.ResidualModelFramePlacement(state, frame, there, nu))
    effort = crocoddyl.ResidualModelControl(state, nu)
    if inverse:
        effort = crocoddyl.ResidualModelJointEffort(state, actuation, nu)
    running, end = crocoddyl.CostModelSum(state, nu), crocoddyl.CostModelSum(state, nu)
    running.addCost("gripperPose", pose, 1.0)
    running.addCost("xReg", _cost(state, crocoddyl.ResidualModelState(state, x0, nu)), 1e-1)
    running.addCost("uReg", _cost(state, effort), 1e-1)
    end.addCost("gripperPose", pose, 1e3)
    return Example(
        _free(state, actuation, x0, running, end, (1e-2, 0.0), 100, inverse=inverse),
        crocoddyl.SolverIntro if inverse else crocoddyl.SolverFDDP,
        is_inverse=inverse,
    )


def quadrotor(*, inverse: bool = False) -> Example:
    """`quadrotor_fwddyn.py`, `quadrotor_invdyn.py`: Hector flies to a pose."""
    hector = example_robot_data.load("hector")
    model = hector.model
    state = crocoddyl.StateMultibody(model)
    arm_length, ratio, types = 0.1525, 1e-6 / 6.6e-5, crocoddyl.ThrusterType
    places = [(arm_length, 0.0), (0.0, arm_length), (-arm_length, 0.0), (0.0, -arm_length)]
    rotors = [
        crocoddyl.Thruster(pin.SE3(np.eye(3), np.array([x, y, 0.0])), ratio, types.CW if y else types.CCW)
        for x, y in places
    ]
    actuation = crocoddyl.ActuationModelFloatingBaseThrusters(state, rotors)
    nu = state.nv if inverse else actuation.nu
    weights = np.array([0.1] * 3 + [1000.0] * 3 + [1000.0] * model.nv)
    rest = crocoddyl.ResidualModelState(state, state.zero(), nu)
    effort = crocoddyl.ResidualModelControl(state, nu)
    if inverse:
        effort = crocoddyl.ResidualModelJointEffort(state, actuation, nu)
    there = pin.SE3(np.eye(3), np.array([1.0, 0.0, 1.0]))
    frame = model.getFrameId("base_link")
    pose = _cost(state, crocoddyl.ResidualModelFramePlacement(state, frame, there, nu))
    running, end = crocoddyl.CostModelSum(state, nu), crocoddyl.CostModelSum(state, nu)
    running.addCost("xReg", _cost(state, rest, weights), 1e-6)
    running.addCost("uReg", _cost(state, effort), 1e-6)
    running.addCost("trackPose", pose, 1e-2)
    end.addCost("goalPose", pose, 3.0)
    x0 = np.concatenate([hector.q0, np.zeros(state.nv)])
    return Example(
        _free(state, actuation, x0, running, end, (3e-2, 3e-2), 33, inverse=inverse),
        crocoddyl.SolverIntro if inverse else crocoddyl.SolverFDDP,
        is_inverse=inverse,
    )


def quadruped(gait: str, *numbers: Any) -> Example:
    """A motion of `quadrupedal_gaits_fwddyn.py`, from standing: of createWalkingProblem and the like."""
    feet = ("LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT")
    model, x0 = _standing("anymal", "standing")
    problems = SimpleQuadrupedalGaitProblem(model, *feet)
    return Example(getattr(problems, f"create{gait}Problem")(x0, *numbers), crocoddyl.SolverFDDP)


def biped() -> Example:
    """First motion of `bipedal_gaits_fwddyn.py`, a walk from standing."""
    model, x0 = _standing("talos_legs", "half_sitting")
    problems = SimpleBipedGaitProblem(model, "right_sole_link", "left_sole_link")
    return Example(problems.createWalkingProblem(x0, 0.6, 0.1, 0.03, 15, 4), crocoddyl.SolverFDDP)


def _standing(robot: str, name: str) -> tuple[pin.Model, Array]:
    model = example_robot_data.load(robot).model
    return model, np.concatenate([model.referenceConfigurations[name], np.zeros(model.nv)])


def _cost(state: Any, residual: Any, weights: Array | None = None) -> Any:
    if weights is None:
        return crocoddyl.CostModelResidual(state, residual)
    return crocoddyl.CostModelResidual(state, crocoddyl.ActivationModelWeightedQuad(weights), residual)


def _free(
    state: Any,
    actuation: Any,
    x0: Array,
    running: Any,
    end: Any,
    dts: tuple[float, float],
    N: int,
    *,
    inverse: bool,
) -> Any:
    forward = crocoddyl.DifferentialActionModelFreeFwdDynamics
    kind = crocoddyl.DifferentialActionModelFreeInvDynamics if inverse else forward
    step, last = (
        crocoddyl.IntegratedActionModelEuler(kind(state, actuation, costs), dt)
        for costs, dt in zip((running, end), dts, strict=True)
    )
    return crocoddyl.ShootingProblem(x0, [step] * N, last)


EXAMPLES: dict[str, Callable[[], Example]] = {
    "arm_manipulation_fwddyn": arm,
    "arm_manipulation_invdyn": lambda: arm(inverse=True),
    "quadrotor_fwddyn": quadrotor,
    "quadrotor_invdyn": lambda: quadrotor(inverse=True),
    "quadrupedal_gaits_fwddyn walk": lambda: quadruped("Walking", 0.25, 0.15, 1e-2, 25, 2),
    "quadrupedal_gaits_fwddyn trot": lambda: quadruped("Trotting", 0.15, 0.1, 1e-2, 25, 2),
    "quadrupedal_gaits_fwddyn pace": lambda: quadruped("Pacing", 0.15, 0.1, 1e-2, 25, 5),
    "quadrupedal_gaits_fwddyn bound": lambda: quadruped("Bounding", 0.15, 0.1, 1e-2, 25, 5),
    "quadrupedal_gaits_fwddyn jump": lambda: quadruped("Jumping", 0.15, [0.0, 0.3, 0.0], 1e-2, 10, 20),
    "bipedal_gaits_fwddyn": biped,
}


def judge(problem: Any, xs: Array, us: list[Array]) -> dict[str, float]:
    """Cost, largest defect of a step, and the gradient of the cost in the controls by that of the effort.

    The gradient is that of the cost of the roll-out, where defects vanish; both are the largest of all steps.
    Where accelerations have to satisfy equations, motors being fewer than joints, it says nothing: NaN.
    """
    cost = problem.calc(list(xs), us)
    problem.calcDiff(list(xs), us)
    state = problem.terminalModel.state
    defect = float(np.abs(state.diff(problem.x0, xs[0])).max())
    costate, gradient, scale = problem.terminalData.Lx.copy(), 0.0, 0.0
    for k in reversed(range(problem.T)):
        data = problem.runningDatas[k]
        defect = max(defect, float(np.abs(state.diff(data.xnext, xs[k + 1])).max()))
        if us[k].size:
            gradient = max(gradient, float(np.abs(data.Lu + data.Fu.T @ costate).max()))
            scale = max(scale, float(np.abs(data.Lu).max()))
        costate = data.Lx + data.Fx.T @ costate
    if any(model.nh for model in problem.runningModels):
        gradient = np.nan
    return {"cost": float(cost), "defect": defect, "gradient": gradient / scale}


def guessed(example: Example, kind: str) -> tuple[list[Array], list[Array]]:
    """The first motion: "hold", or "zero": that of `solve()` without arguments."""
    problem = example.problem
    if kind == "zero":
        return [], []
    xs = [problem.x0] * (problem.T + 1)
    if example.is_inverse:
        return xs, [np.zeros(model.nu) for model in problem.runningModels]
    return xs, list(problem.quasiStatic(xs[:-1]))


def solved(example: Example, start: tuple[list[Array], list[Array]], repeats: int) -> tuple[Any, list[float]]:
    """Solver at its end, and processor times [s]."""

    def solve() -> Any:
        solver = example.solver(example.problem)
        solver.solve(*start, _MOST, False)
        return solver

    return timed(solve, repeats, time.process_time)


def controls_of(example: Example, xs: Array, us: Array) -> list[Array]:
    """Controls of Crocoddyl's models that make the steps of a motion: accelerations for inverse dynamics."""
    nq = example.problem.terminalModel.state.nq
    if example.is_inverse:
        dt = example.problem.runningModels[0].dt
        return list(np.diff(xs[:, nq:], axis=0) / dt)
    return [u[: model.nu].copy() for model, u in zip(example.problem.runningModels, us, strict=True)]


def through_impacts(example: Example, xs: Array, us: Array) -> tuple[Array, Array]:
    """A motion with the impact at its end, if Crocoddyl has one there."""
    if len(us) == example.problem.T:
        return xs, us
    model = example.problem.runningModels[-1]
    data = model.createData()
    model.calc(data, xs[-1])
    return np.vstack([xs, data.xnext]), np.vstack([us, np.zeros(us.shape[1])])


def main() -> None:
    """Print on one line of JSON what both came to."""
    name, kind, repeats, ours = sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4]
    example = EXAMPLES[name]()
    example.problem.nthreads = 1
    solver, seconds = solved(example, guessed(example, kind), repeats)
    found: dict[str, Any] = {
        "version": crocoddyl.__version__,
        "iterations": solver.iter,
        "seconds": seconds,
        "theirs": judge(example.problem, np.array(solver.xs), list(solver.us)),
    }
    with np.load(ours) as kept:
        xs, us = through_impacts(example, np.hstack([kept["qs"], kept["vs"]]), kept["us"])
    us = controls_of(example, xs, us)
    found["ours"] = judge(example.problem, xs, us)
    again, _ = solved(example, (list(xs), us), 0)
    found["from ours"] = judge(example.problem, np.array(again.xs), list(again.us))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
