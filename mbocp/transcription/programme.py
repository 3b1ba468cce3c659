"""Problem and integrator become one stagewise programme, all that a solver sees.

minimise    sum_n l_n(x_{n-1}, x_n, u_{n-1}) + psi(x_N)
subject to  c_n(x_{n-1}, x_n, y_n, u_{n-1}) = 0
            g_T(x_N) = 0,  x_0 given
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from mbocp._arrays import Array
from mbocp.mechanics import JointMechanics
from mbocp.problem import Problem
from mbocp.transcription.compilation import CompiledFunctions, load_functions
from mbocp.transcription.goal import end_condition_rows
from mbocp.transcription.shape import Shape
from mbocp.transcription.stage import ParameterLayout, build_functions, parameter_layout
from mbocp.transcription.start import start_state

__all__ = ["StageKind", "StagewiseProgramme", "transcribe"]


@dataclass(frozen=True)
class StageKind:
    """Dimensions of one kind of stage, and the factors from its rows and unknowns to the paper's.

    Attributes
    ----------
    nx, ndx, ny, nu, nr : int
        State, its tangent, algebraic unknowns, controls, stage parameters.
    scale_c : ndarray, shape (ndx + ny,)
        From the rows of c to those of eqs. (24), (25): constraints are kept as Phi / dt.
    scale_y : ndarray, shape (ny,)
        From impulses to the multipliers lambda [1/s].
    scale_m : ndarray, shape (ndx + ny,)
        From the rows' multipliers to (mu, dt zeta): zeta itself carries round-off of the size 1e-16 / dt^2,
        which no step can bring down.
    scale_ru : ndarray, shape (nu,)
        From the gradient in u to grad_u H of eq. (28) [1/s].
    """

    nx: int
    ndx: int
    ny: int
    nu: int
    nr: int
    scale_c: Array
    scale_y: Array
    scale_m: Array
    scale_ru: Array


@dataclass(frozen=True)
class StagewiseProgramme:
    """Functions, dimensions, structure and parameters of a discretised optimal control problem.

    Attributes
    ----------
    num_steps : int
        N.
    kinds : tuple of StageKind
        The different kinds of stages.
    stage_kind : tuple of int, length N
        Kind of each stage.
    ng : int
        Rows of the end condition.
    functions : CompiledFunctions
        Where the stage functions are.
    theta, rho, rho_terminal : ndarray
        Parameters: of the horizon, stage after stage, of the end.
    x_start : ndarray, shape (nx,)
        The given state x_0, as the scheme takes it.
    dt : float
        Step length [s].
    control_weight : float
        Smallest second derivative of the running cost in a control, the unit of regularisation.
    describe_row : callable
        (stage, row) -> words for messages; stage -1 is the end condition.
    """

    num_steps: int
    kinds: tuple[StageKind, ...]
    stage_kind: tuple[int, ...]
    ng: int
    functions: CompiledFunctions
    theta: Array
    rho: Array
    rho_terminal: Array
    x_start: Array
    dt: float
    control_weight: float
    describe_row: Callable[[int, int], str] = field(compare=False)

    @property
    def num_unknowns(self) -> int:
        """What Newton's method solves for: mu_0..mu_{N-1}, zeta, y_1..y_N (tangent), lambda, u, eta.

        The paper's DOF column also counts mu_N and a control u_N that nothing needs.
        """
        per_stage = [2 * (k.ndx + k.ny) + k.nu for k in self.kinds]
        return sum(per_stage[i] for i in self.stage_kind) + self.ng


def transcribe(problem: Problem) -> StagewiseProgramme:
    """Stagewise programme of a problem, compiled or from the cache.

    Raises
    ------
    TranscriptionError
        If the stage functions cannot be compiled.
    InconsistentStart
        If the scheme cannot begin with the start velocity in steps of this length.
    """
    robot = problem.robot
    D_q, D_rate = end_condition_rows(robot, problem.goal)
    shape = _shape(problem, D_q.shape[0], D_rate.shape[0])
    functions = load_functions(shape.text, lambda: build_functions(JointMechanics(robot), shape))
    layout = parameter_layout(shape, robot.nq, robot.nv, robot.nu)
    nv, nc, dt = robot.nv, robot.nc, problem.dt
    kind = StageKind(
        nx=robot.nq + nv,
        ndx=2 * nv,
        ny=nc,
        nu=robot.nu,
        nr=sum(layout.stage.values()),
        scale_c=np.concatenate([np.ones(2 * nv), np.full(nc, dt)]),
        scale_y=np.full(nc, 1 / dt),
        scale_m=np.concatenate([np.ones(2 * nv), np.full(nc, 1 / dt)]),
        scale_ru=np.full(robot.nu, 1 / dt),
    )
    theta, rho, rho_terminal = _parameters(problem, shape, layout, D_q, D_rate)
    return StagewiseProgramme(
        num_steps=problem.num_steps,
        kinds=(kind,),
        stage_kind=(0,) * problem.num_steps,
        ng=shape.ng_q + shape.ng_rate,
        functions=functions,
        theta=theta,
        rho=rho,
        rho_terminal=rho_terminal,
        x_start=start_state(problem),
        dt=dt,
        control_weight=dt * float(np.min(problem.cost.effort)),
        describe_row=_row_describer(problem),
    )


def _shape(problem: Problem, ng_q: int, ng_rate: int) -> Shape:
    cost, goal, nv = problem.cost, problem.goal, problem.robot.nv
    tracking = np.asarray(cost.tracking * cost.tracking_weights)
    penalised = goal.enforce in ("penalty", "both") and cost.terminal > 0
    return Shape(
        robot=problem.robot.fingerprint,
        coordinates=problem.coordinates,
        scheme=problem.scheme,
        track_q=bool(np.any(tracking[:nv])),
        track_p=bool(np.any(tracking[nv:])),
        weigh_velocity=bool(np.any(cost.velocity)),
        penalise_q=bool(penalised and np.any(cost.terminal_weights[:nv])),
        penalise_rate=bool(penalised and np.any(cost.terminal_weights[nv:])),
        rate=goal.rate,
        ng_q=ng_q,
        ng_rate=ng_rate,
    )


def _parameters(
    problem: Problem, shape: Shape, layout: ParameterLayout, D_q: Array, D_rate: Array
) -> tuple[Array, Array, Array]:
    cost, goal, robot, N = problem.cost, problem.goal, problem.robot, problem.num_steps
    weights = cost.tracking * np.asarray(cost.tracking_weights)
    named: dict[str, Array] = {
        "dt": np.array([problem.dt]),
        "effort": np.broadcast_to(np.asarray(cost.effort, dtype=float), (robot.nu,)),
        "velocity": np.asarray(cost.velocity),
        "weight_q": weights[: robot.nv],
        "weight_p": weights[robot.nv :],
    }
    theta = _concatenate(named, layout.theta)
    nv, terminal = robot.nv, cost.terminal * np.asarray(cost.terminal_weights)
    rows = {
        "target_q": np.broadcast_to(np.asarray(cost.target_q), (N, robot.nq)),
        "target_p": np.broadcast_to(np.asarray(cost.target_p), (N, robot.nv)),
    }
    rho = np.hstack([rows[name] for name in layout.stage]).ravel() if layout.stage else np.zeros(0)
    at_end: dict[str, Array] = {
        "q": np.asarray(goal.q),
        "rate": np.asarray(goal.value),
        "D_q": D_q.ravel(order="F"),  # CasADi reshapes by columns
        "D_rate": D_rate.ravel(order="F"),
        "weight_q": terminal[:nv],
        "weight_rate": terminal[nv:],
    }
    return theta, np.ascontiguousarray(rho), _concatenate(at_end, layout.terminal)


def _concatenate(named: Mapping[str, Array], sizes: Mapping[str, int]) -> Array:
    return np.concatenate([np.asarray(named[name], dtype=float).ravel() for name in sizes])


def _row_describer(problem: Problem) -> Callable[[int, int], str]:
    robot, nv, dt = problem.robot, problem.robot.nv, problem.dt

    def describe(stage: int, row: int) -> str:
        if stage < 0:
            return f"end condition {row + 1} at t = {problem.duration:g} s"
        when = f"in the step to t = {(stage + 1) * dt:g} s"
        if row < nv:
            return f"kinematics of {robot.v_labels[row].name} {when}"
        if row < 2 * nv:
            return f"momentum balance of {robot.v_labels[row - nv].name} {when}"
        return f"constraint {robot.constraint_labels[row - 2 * nv].name} {when}"

    return describe
