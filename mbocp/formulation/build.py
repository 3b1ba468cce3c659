"""Problem and integrator become one stagewise programme, all that a solver sees."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.base import Formulation
from mbocp.formulation.bounds import state_bounds
from mbocp.formulation.end import build_end_functions
from mbocp.formulation.goal import EndRows, end_condition_rows, guarded_parts
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.natural import EndTarget, natural_coordinates, natural_end
from mbocp.formulation.operations import check_operations
from mbocp.formulation.parameters import (
    HAS_BEFORE,
    ParameterLayout,
    Sizes,
    concatenated,
    parameter_layout,
    path_parameters,
)
from mbocp.formulation.rows import row_describer
from mbocp.formulation.shape import Shape
from mbocp.formulation.stage import build_functions, mechanics_for, state_layout
from mbocp.formulation.start import start_state
from mbocp.formulation.turning import turning_factors
from mbocp.integrators import EXPLICIT_SCHEMES
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import NaturalMechanics, NaturalSpace
from mbocp.problem import Problem
from mbocp.problem.horizon import check_horizon
from mbocp.programme import StageKind, StagewiseProgramme
from mbocp.programme.compilation import load_functions
from mbocp.terms import ExactGoal, TerminalCost, TermNumbers, running_terms

__all__ = ["formulate", "is_flat", "transcribe"]


def is_flat(problem: Problem) -> bool:
    """Whether a state's coordinates are the unknowns, and not its tangent: see `StateLayout`."""
    leaves_the_group = problem.scheme in EXPLICIT_SCHEMES and problem.lie != "munthe_kaas"
    return leaves_the_group or problem.is_bounded or problem.solver.is_interior_point


def transcribe(
    problem: Problem, without: Sequence[int] = (), *, deadline: float = math.inf
) -> StagewiseProgramme:
    """Stagewise programme of a problem, all that a solver asks for; see `formulate`."""
    return formulate(problem, without, deadline=deadline).programme


def formulate(problem: Problem, without: Sequence[int] = (), *, deadline: float = math.inf) -> Formulation:
    """Formulation of a problem with its stagewise programme, compiled or from the cache.

    Parameters
    ----------
    problem : Problem
    without : sequence of int
        Rows of the end condition to leave out.
    deadline : float
        Time of `time.perf_counter` at which compiling is given up.

    Raises
    ------
    TranscriptionError
        If the stage functions would be too large, cannot be compiled, or not before the deadline.
    MemoryLimitExceeded
        If the horizon has more steps than there is memory for.
    InconsistentStart
        If the scheme cannot begin with the start velocity in steps of this length.
    """
    robot = problem.robot
    natural = natural_coordinates(problem)
    joints = ConfigurationSpace(robot.model, _rotations(problem)) if natural is None else natural.joint_space
    space = joints if natural is None else NaturalSpace(natural, problem.q_start)
    guarded = guarded_parts(problem, joints)
    rows = end_condition_rows(robot, problem.goal, is_explicit=problem.scheme in EXPLICIT_SCHEMES)
    rows = rows.without(without)
    shape = _shape(problem, joints, rows, guarded, is_natural=natural is not None)
    check_operations(robot.name, space.nv, shape)
    at = state_layout(robot, space.nz, space.nv, shape)
    sizes = Sizes(space.nz, space.nv, robot.nu, joints.nz, robot.nv)
    layout = parameter_layout(shape, sizes)
    ny = 0 if shape.is_explicit else (robot.nc if natural is None else natural.nc)
    check_horizon(problem.num_steps, 2 * at.ndx + ny + robot.nu, by_others=problem.solver.is_interior_point)
    end = EndTarget(*rows, np.asarray(problem.goal.value))
    if natural is not None:
        end = natural_end(problem, natural, rows)
    theta, rho, rho_terminal = _parameters(problem, shape, layout, space, joints, end)
    programme = StagewiseProgramme(
        num_steps=problem.num_steps,
        kinds=(_kind(problem, space, at, ny, sum(layout.stage.values()), natural),),
        stage_kind=(0,) * problem.num_steps,
        ng=shape.goal.rows,
        num_guards=len(guarded),
        functions=load_functions(
            shape.stage_text,
            lambda: build_functions(mechanics_for(robot, shape), shape),
            deadline=deadline,
        ),
        end_functions=load_functions(
            "end " + shape.end_text,
            lambda: build_end_functions(mechanics_for(robot, shape), shape),
            of_end=True,
            deadline=deadline,
        ),
        theta=theta,
        rho=rho,
        rho_terminal=rho_terminal,
        theta_weights=layout.weighing(layout.theta),
        terminal_weights=layout.weighing(layout.terminal),
        x_start=start_state(problem, space, at),
        bounds=state_bounds(problem, space, at),
        is_explicit=shape.is_explicit,
        dt=problem.dt,
        control_weight=_control_weight(problem),
        describe_row=row_describer(problem, space, at, rows),
        path_names=tuple(label.name for constraint in problem.path for label in constraint.labels),
    )
    return Formulation(
        problem=problem,
        programme=programme,
        layout=at,
        space=space,
        end_rows=rows,
        constraint_labels=robot.constraint_labels if natural is None else natural.constraint_labels,
    )


def _rotations(problem: Problem) -> str:
    return problem.robot.rotations if problem.scheme in EXPLICIT_SCHEMES else "quaternion"


def _kind(
    problem: Problem,
    space: ConfigurationSpace | NaturalSpace,
    at: StateLayout,
    ny: int,
    nr: int,
    natural: NaturalMechanics | None,
) -> StageKind:
    nu, dt = problem.robot.nu, problem.dt
    has_groups = problem.scheme == "se1" and at.nr == 0
    return StageKind(
        nx=at.nx,
        ndx=at.ndx,
        ny=ny,
        nu=nu,
        nr=nr,
        scale_c=np.concatenate([np.ones(at.ndx), np.full(ny, dt)]),
        scale_y=np.full(ny, 1 / dt),
        scale_m=np.concatenate([np.ones(at.ndx), np.full(ny, 1 / dt)]),
        scale_ru=np.full(nu, 1 / dt),
        turning=turning_factors(problem.robot.model, space, at),
        groups=natural.groups if natural is not None and has_groups else (),
    )


def _control_weight(problem: Problem) -> float:
    """Where the effort costs nothing the rate of the controls does, or limits determine them."""
    cost = problem.cost
    weights = np.asarray(cost.effort) + np.asarray(cost.control_rate) / problem.dt**2
    positive = weights[weights > 0.0]
    return problem.dt * (float(positive.min()) if positive.size else 1.0)


def _shape(
    problem: Problem,
    joints: ConfigurationSpace,
    rows: EndRows,
    guarded: tuple[int, ...],
    *,
    is_natural: bool,
) -> Shape:
    goal, nv = problem.goal, problem.robot.nv
    is_explicit = problem.scheme in EXPLICIT_SCHEMES
    given = TermNumbers(problem.cost, problem.robot, joints, problem.num_steps)
    return Shape(
        robot=problem.robot.fingerprint,
        coordinates="natural" if is_natural else "joint",
        scheme=problem.scheme,
        goal=ExactGoal(goal.rate, len(rows.D_q), len(rows.D_rate)),
        cost=running_terms(given),
        terminal=TerminalCost.of(problem.cost, joints, nv, goal.rate, is_natural=is_natural),
        path=tuple(constraint.term for constraint in problem.path),
        rotations=_rotations(problem),
        lie=problem.lie if is_explicit else "",
        substeps=problem.substeps if is_explicit else 1,
        is_flat=is_flat(problem) or is_natural or problem.robot.is_vector_space,
        guarded=guarded,
    )


def _parameters(
    problem: Problem,
    shape: Shape,
    layout: ParameterLayout,
    space: ConfigurationSpace | NaturalSpace,
    joints: ConfigurationSpace,
    end: EndTarget,
) -> tuple[Array, Array, Array]:
    goal, robot, N, rates = problem.goal, problem.robot, problem.num_steps, problem.stabilisation
    given = TermNumbers(problem.cost, robot, joints, N)
    named: dict[str, Array] = {
        "dt": np.array([problem.dt]),
        "gains": np.array([rates.gamma_quaternion, rates.gamma_dcm, rates.gamma_constraint]),
    }
    rows: dict[str, Array] = {HAS_BEFORE: (np.arange(N) > 0).astype(float)[:, None]}
    for term in shape.cost:
        named |= term.numbers(given)
        rows |= term.stage_numbers(given)
    for k, constraint in enumerate(problem.path):
        named |= {path_parameters(k, name): value for name, value in constraint.numbers.items()}
    rho = np.hstack([rows[name] for name in layout.stage]).ravel() if layout.stage else np.zeros(0)
    at_end: dict[str, Array] = {
        "q": space.coordinates(np.asarray(goal.q)[None])[0],
        "rate": end.rate,
        "D_q": end.D_q.ravel(order="F"),  # CasADi reshapes by columns
        "D_rate": end.D_rate.ravel(order="F"),
        **TerminalCost.numbers(problem.cost, robot.nv),
        "joint_q": joints.coordinates(np.asarray(goal.q)[None])[0],
        "joint_rate": np.asarray(goal.value),
    }
    return concatenated(named, layout.theta), np.ascontiguousarray(rho), concatenated(at_end, layout.terminal)
