"""From the pieces that a formulation chooses to the stagewise programme, compiled or from the cache."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp._memory import check_horizon
from mbocp.formulation.end_rows import EndRows, acceleration_rows, frame_ends
from mbocp.formulation.features.all_features import features_of
from mbocp.formulation.features.changing_constraints import has_step_before
from mbocp.formulation.features.easing import choose_easing_weights, ease_terms
from mbocp.formulation.features.feature import StepRequests
from mbocp.formulation.features.memory import memory_units
from mbocp.formulation.features.moved_start import start_ends
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.ordinary_units import units_of
from mbocp.formulation.parameter_layout import NUMBERS, ParameterLayout, concatenate, mask, path_parameters
from mbocp.formulation.pieces import Pieces
from mbocp.formulation.row_words import RowDescriber
from mbocp.formulation.signature import FunctionSignature, check_operations
from mbocp.formulation.stage import LATER, build_end_functions, build_first_functions, build_functions
from mbocp.formulation.state_bounds import state_bounds, tighten
from mbocp.formulation.steps import HAS_BEFORE, Steps, unit_of
from mbocp.formulation.term_numbers import term_numbers
from mbocp.lie import ConfigurationSpace
from mbocp.problem import Problem
from mbocp.programme import StageKind, StagewiseProgramme
from mbocp.programme.compilation import CompiledFunctions, LateFunctions, load_functions
from mbocp.robot import Robot
from mbocp.terms.kinds import AccelerationEnd, ExactGoal, Follow, TerminalCost
from mbocp.terms.own_parts import collect_running_terms, own_ends


def needs_plain_states(problem: Problem) -> bool:
    """Whether a state's coordinates are the unknowns, and not its tangent: see `StateLayout`."""
    return problem.is_bounded or problem.solver.is_interior_point


def check_size(
    problem: Problem, signature: FunctionSignature, layout: StateLayout, num_algebraic: int
) -> None:
    """Refuse what would be too large, before anything is built.

    Raises
    ------
    TooManyOperations
        If the stage functions would be.
    MemoryLimitExceeded
        If the horizon has more steps than there is memory for.
    """
    check_operations(problem.robot.name, layout.nv, signature)
    per_step = 2 * layout.ndx + num_algebraic + layout.num_controls
    check_horizon(problem.num_steps, per_step, by_others=problem.solver.is_interior_point)


def build_programme(pieces: Pieces, *, deadline: float = math.inf) -> StagewiseProgramme:
    """Stagewise programme of what a formulation has chosen.

    Parameters
    ----------
    pieces : Pieces
    deadline : float
        Time of `time.perf_counter` at which compiling is given up.

    Raises
    ------
    TranscriptionError
        If the stage functions cannot be compiled, or not before the deadline.
    ProblemError
        If a velocity is limited that is no unknown of the programme.
    """
    problem, signature, layout = pieces.problem, pieces.signature, pieces.parameters
    robot = problem.robot
    theta, rho, rho_terminal = parameter_values(pieces)
    bounds = state_bounds(pieces)
    at_once = problem.solver.is_interior_point  # CasADi's solvers call functions stage by stage
    programme = StagewiseProgramme(
        num_steps=problem.num_steps,
        kind=_kind(pieces, sum(layout.stage.values())),
        ng=signature.end_rows,
        num_guards=len(signature.guarded),
        functions=load_functions(
            signature.stage_text,
            lambda: build_first_functions(signature.steps.mechanics(robot), signature),
            deadline=deadline,
            at_once=at_once,
        ).with_later(_later(signature, robot, deadline, at_once=at_once)),
        end_functions=load_end_functions(signature, robot, deadline, at_once=at_once),
        theta=theta,
        rho=rho,
        rho_terminal=rho_terminal,
        theta_weights=layout.weight_entries(layout.theta),
        terminal_weights=layout.weight_entries(layout.terminal),
        x_start=pieces.x_start,
        bounds=bounds,
        rows_are_gaps=signature.steps.rows_are_gaps,
        dt=problem.dt,
        control_weight=control_weight_of(problem),
        describe_row=RowDescriber(pieces, bounds),
        units=units_of(pieces),
        path_names=tuple(label.name for constraint in problem.inequalities for label in constraint.labels),
        has_free_lengths=problem.timeline.has_free_lengths,
        easing=_find_easing_values(problem, signature, layout),
    )
    return programme if problem.tube is None else tighten(programme, problem.tube)


def load_end_functions(
    signature: FunctionSignature, robot: Robot, deadline: float, *, at_once: bool
) -> CompiledFunctions:
    """Functions of the end; see `load_functions`."""
    return load_functions(
        "end " + signature.end_text,
        lambda: build_end_functions(signature.steps.mechanics(robot), signature),
        deadline=deadline,
        at_once=at_once,
    )


def _later(signature: FunctionSignature, robot: Robot, deadline: float, *, at_once: bool) -> LateFunctions:
    """Functions that are loaded when they are asked for: in a solve before its deadline, or after it."""

    def load() -> CompiledFunctions:
        return load_functions(
            "later " + signature.stage_text,
            lambda: build_functions(signature.steps.mechanics(robot), signature, LATER),
            deadline=deadline if time.perf_counter() < deadline else math.inf,
            at_once=at_once,
        )

    return LateFunctions(LATER, load)


def _kind(pieces: Pieces, nr: int) -> StageKind:
    at, own = pieces.layout, pieces.algebraic
    dt, T = pieces.problem.dt, pieces.problem.duration
    return StageKind(
        nx=at.nx,
        ndx=at.ndx,
        ny=own.size,
        nu=at.num_controls,
        nr=nr,
        scale_c=np.concatenate([np.ones(at.ndx), own.scale_c]),
        scale_y=own.scale_y,
        scale_m=np.concatenate([np.ones(at.ndx), own.scale_m]),
        scale_ru=np.concatenate([np.full(at.num_own, 1 / dt), np.full(at.num_more_controls, 1 / T)]),
        turning=pieces.turning,
        groups=pieces.groups,
    )


def _find_easing_values(
    problem: Problem, signature: FunctionSignature, layout: ParameterLayout
) -> Array | None:
    weights = choose_easing_weights(problem, signature.cost)
    if weights is None:
        return None
    easing = np.zeros(sum(layout.theta.values()))
    easing[mask(layout.theta, ("velocity",))] = weights
    return easing


def control_weight_of(problem: Problem) -> float:
    """The least weight of a control over one step, the unit of what a solver adds to the Hessian.

    Where the effort costs nothing the rate of the controls does, or limits determine them.
    """
    cost = problem.heaviest_cost
    weights = cost.on_squares + np.asarray(cost.control_rate) / problem.dt**2
    positive = weights[weights > 0.0]
    return problem.dt * (float(positive.min()) if positive.size else 1.0)


def signature_of(
    problem: Problem,
    joints: ConfigurationSpace,
    rows: EndRows,
    steps: Steps,
    *,
    is_flat: bool,
    guarded: tuple[int, ...] = (),
    has_joint_goal: bool = False,
) -> FunctionSignature:
    """FunctionSignature of a problem: what it says itself, and what its formulation has chosen.

    Parameters
    ----------
    problem : Problem
    joints : ConfigurationSpace
        Of the joints, which costs and goals speak of.
    rows : EndRows
    steps : Steps
    is_flat : bool
        See `StateLayout`.
    guarded : tuple of int
        See `FunctionSignature`.
    has_joint_goal : bool
        See `TerminalCost`.
    """
    goal, nv = problem.goal, problem.robot.nv
    cost, robot = problem.heaviest_cost, problem.robot
    given = term_numbers(problem, cost, joints)
    terms = ease_terms(problem, collect_running_terms(given))
    path = _structures(problem, _of_joints(joints))
    ends = (
        *frame_ends(problem, rows),
        *own_ends(given),
        *_acceleration_end(problem),
        *start_ends(problem, joints),
    )
    return FunctionSignature(
        robot=robot.shape_fingerprint if steps.takes_numbers else robot.fingerprint,
        steps=steps,
        goal=ExactGoal(goal.rate, len(rows.D_q), len(rows.D_rate)),
        cost=terms,
        terminal=TerminalCost.of(problem.cost, joints, nv, goal.rate, has_joint_goal=has_joint_goal),
        path=path,
        ends=ends,
        is_flat=is_flat,
        guarded=guarded,
        features=features_of(problem, StepRequests(terms, path, ends, steps.tau)),
        num_numbers=len(robot.varying) if steps.takes_numbers else 0,
    )


def _acceleration_end(problem: Problem) -> tuple[AccelerationEnd, ...]:
    """Accelerations that the goal asks for, where it does."""
    goal = problem.goal
    if not problem.sets_acceleration.any():
        return ()
    D = acceleration_rows(problem)
    return (AccelerationEnd(len(D), D, goal.a / memory_units(problem)["acceleration"]),)


def _structures(problem: Problem, rotations: str) -> tuple[Any, ...]:
    """Terms of the path constraints; those that follow paths know which of the paths is theirs."""
    terms = (constraint.structure(rotations) for constraint in problem.inequalities)
    numbers = count()
    return tuple(replace(term, index=next(numbers)) if isinstance(term, Follow) else term for term in terms)


def _of_joints(joints: ConfigurationSpace) -> str:
    """Coordinates of attitudes in the configurations of the joints."""
    return "dcm" if any(part.at_matrix >= 0 for part in joints.parts) else "quaternion"


def parameter_values(pieces: Pieces) -> tuple[Array, Array, Array]:
    """Numbers that functions take: theta of all steps, rho of each, and those of the end."""
    layout = pieces.parameters
    problem, space, joints, end = pieces.problem, pieces.space, pieces.joints, pieces.end
    goal, robot, rates = problem.goal, problem.robot, problem.stabilisation
    given = term_numbers(problem, problem.heaviest_cost, joints)
    named: dict[str, Array] = {
        "dt": np.array([problem.dt]),
        "force": np.ones(1),
        NUMBERS: robot.varying_values,
        "gains": np.array([rates.gamma_quaternion, rates.gamma_dcm, rates.gamma_constraint]),
    }
    rows: dict[str, Array] = {}
    if HAS_BEFORE in layout.stage:
        rows[HAS_BEFORE] = has_step_before(problem)[:, None]
    for term in pieces.signature.cost:
        named |= term.numbers(given)
        rows |= term.stage_numbers(given)
    for feature in pieces.signature.features:
        named |= feature.numbers(problem)
        named |= {unit_of(name): np.array([unit]) for name, unit in feature.units(problem).items()}
        rows |= feature.stage_numbers(problem)
    for k, constraint in enumerate(problem.inequalities):
        values = constraint.numbers_in(_of_joints(joints))
        named |= {path_parameters(k, name): value for name, value in values.items()}
    rho = np.hstack([rows[name] for name in layout.stage]).ravel() if layout.stage else np.zeros(0)
    at_end: dict[str, Array] = {
        "q": space.coordinates(np.asarray(goal.q)[None])[0],
        "rate": end.rate,
        "D_q": end.D_q.ravel(order="F"),  # CasADi reshapes by columns
        "D_rate": end.D_rate.ravel(order="F"),
        **TerminalCost.numbers(problem.cost, robot.nv),
        "joint_q": joints.coordinates(np.asarray(goal.q)[None])[0],
        "joint_rate": np.asarray(goal.value),
        NUMBERS: robot.varying_values,
    }
    for feature in pieces.signature.features:
        at_end |= feature.numbers(problem)
    for end_term in pieces.signature.ends:
        at_end |= end_term.numbers()
    return concatenate(named, layout.theta), np.ascontiguousarray(rho), concatenate(at_end, layout.terminal)
