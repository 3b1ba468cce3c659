r"""Motions within limits that hold for what is uncertain, too: tubes about a plan, and limits that shrink.

Deviations of the state and constant parameters p, with the feedback K of the optimum, go on as

.. math:: \delta x^+ = (A + B K)\, \delta x + D\, \delta p + G\, w, \qquad w \sim N(0, W),

with exact derivatives of the step. Their covariance P, with which limits shrink, see
`mbocp.formulation.state_bounds`, is a number to the next solve: the problem has no more unknowns, and a round
costs a warm start ([Zanelli2021]_, [Feng2020]_). Rounds end where the limits do not move any more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, dataclass, null_space
from mbocp._text import list_names
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.formulation import Formulation
from mbocp.formulation.gains import tangents
from mbocp.formulation.state_bounds import margins_of, words_of
from mbocp.job import Job, Strategy
from mbocp.mechanisms.consistent_states import tangent_space
from mbocp.problem import Problem
from mbocp.problem.between_nodes import can_hold_within
from mbocp.problem.found_parameter import Robust, Tube
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.programme.evaluation import call
from mbocp.sensitivity.lagrangian_slopes import load_stage_functions
from mbocp.sensitivity.of_robot import OfRobot
from mbocp.sensitivity.optimum import formulate_as_solved
from mbocp.sensitivity.parameters import PARAMETERS, parameters_of
from mbocp.solution import Solution
from mbocp.solution.later import retold
from mbocp.solvers import Phase, Status

_ROUNDS = 15
_SETTLED = 1e-3  # of the largest margin of a limit along the motion: margins of two rounds differ by less
_DAMPED_FROM = 5  # rounds with the mean of the last two tubes: they go back and forth


@dataclass(frozen=True)
class RoomForTubes:
    """Solve; then again within limits that leave room for what the motion strays, until these settle.

    Limits hold within steps, too, where they can; where that leads to no motion, at nodes alone.

    Attributes
    ----------
    once : Strategy
        For each.
    """

    once: Strategy

    def run(self, job: Job) -> Solution:
        """Solve up to sixteen times, twice more where limits move too far for a warm start, or all again."""
        if job.problem.goals:
            raise ProblemError("robust: a motion to one goal is made robust; choose one of goal.any")
        job, within = replace(job, has_gains=True), can_hold_within(job.problem)
        solution = self._settle(job.with_limits_within(within))
        if not within or solution.is_stationary or solution.status.is_stopped or job.is_late:
            return solution
        again = _count(solution, self._settle(job.anew()), "limits within steps")
        return retold(again, advice=f"{again.advice}; limits leave room at nodes, and not within steps")

    def _settle(self, job: Job) -> Solution:
        """Solve until limits do not move any more."""
        robust, known = job.problem.robust, None
        assert robust is not None
        solution = self.once.run(job)
        for number in range(_ROUNDS):
            if not solution.is_stationary:
                return solution if known is None else _tell_in_vain(solution, known)
            found = Tubes.of(solution, robust)
            if known is not None and found.is_near(known):
                return found.tell(solution)
            if job.is_late:
                break
            known = found if known is None or number < _DAMPED_FROM else found.between(known)
            solution = self._solve(job, known.tube, solution)
        words = f"the room that limits leave has not settled in {_ROUNDS} rounds, or in time"
        advice = f"{words}; {solution.advice}"
        return retold(solution, status=Status.UNDER_RESOLVED, advice=advice)

    def _solve(self, job: Job, tube: Tube, start: Solution) -> Solution:
        """Solve within tighter limits; where that fails, within such that are half as tight first."""
        for shares in ((1.0,), (0.5, 1.0)):
            solution = start
            for share in shares:
                problem = replace(job.problem, tube=replace(tube, sigmas=share * tube.sigmas))
                again = self.once.run(replace(job.anew(), problem=problem, start=solution))
                solution = _count(solution, again, "wider limits")
                if not again.is_stationary:
                    break
            if solution.is_stationary or job.is_late:
                break
        return solution


def _count(before: Solution, again: Solution, name: str) -> Solution:
    """A solution that was found after another, with what both took."""
    return retold(
        again,
        guess_used=before.guess_used,
        iterations=before.iterations + again.iterations,
        phases=(Phase(name, before.iterations, before.wall_time_s), *again.phases),
        history=(*before.history, *again.history),
        wall_time_s=before.wall_time_s + again.wall_time_s,
    )


def _tell_in_vain(solution: Solution, known: Tubes) -> Solution:
    """A solution that was not found, with what its limits had to leave."""
    return retold(
        solution,
        advice=f"within limits that leave room for {known.tube.sigmas:.3g} standard deviations "
        f"({known.words}): {solution.advice}",
    )


@dataclass(frozen=True, eq=False)
class Tubes:
    """A tube, and what it makes of the limits of its motion.

    Attributes
    ----------
    formulation : Formulation
        Of the problem with its limits as they are.
    tube : Tube
    margins : ndarray, shape (N, nx + nu + nh)
    """

    formulation: Formulation
    tube: Tube
    margins: Array

    @classmethod
    def of(cls, solution: Solution, robust: Robust) -> Tubes:
        """Tubes about a solution.

        Raises
        ------
        ProblemError
            If the optimum has no feedback, or a parameter is none of the robot.
        """
        formulation, iterate = formulate_as_solved(solution)
        feedback = _feedback(formulation, iterate, solution, robust)
        tube = _propagate(formulation, iterate, robust, feedback, solution)
        return cls(formulation, tube, margins_of(formulation.programme, tube))

    def is_near(self, other: Tubes) -> bool:
        """Whether limits shrink alike."""
        if self.margins.shape != other.margins.shape:
            return False
        largest = np.maximum(self.margins, other.margins).max(axis=0, initial=0.0)
        return bool((np.abs(self.margins - other.margins) <= _SETTLED * largest).all())

    def between(self, other: Tubes) -> Tubes:
        """Mean of two tubes."""
        tube = self.tube
        if tube.xs.shape != other.tube.xs.shape or tube.us.shape != other.tube.us.shape:
            return self
        mean = replace(
            tube,
            covariances=(tube.covariances + other.tube.covariances) / 2.0,
            spreads=(tube.spreads + other.tube.spreads) / 2.0,
        )
        return replace(self, tube=mean, margins=margins_of(self.formulation.programme, mean))

    @property
    def words(self) -> str:
        """Which limits give most: of ranges by the share of each, and of what has one side."""
        programme = self.formulation.programme
        width = programme.bounds.upper - programme.bounds.lower
        has_range = np.isfinite(width) & (width > 0.0)
        shares = np.where(has_range, self.margins / np.where(has_range, width, 1.0), 0.0)
        found = []
        for sizes in (shares, np.where(has_range, 0.0, self.margins)):
            if sizes.any():
                stage, entry = (int(i) for i in np.unravel_index(int(sizes.argmax()), sizes.shape))
                share = f", {100.0 * shares[stage, entry]:.2g} % of its range" if shares[stage, entry] else ""
                limit = words_of(programme, stage, entry)
                found.append(f"{limit} is tighter by {self.margins[stage, entry]:.3g}{share}")
        return "; ".join(found) or "no limit is tighter"

    def tell(self, solution: Solution) -> Solution:
        """The solution with the tube about it."""
        layout, tube = self.formulation.layout, self.tube
        count, nu = _values_of_controls(self.formulation)
        along = np.linalg.pinv(tangents(self.formulation, tube.xs))
        of_q = along @ tube.covariances[:, : layout.nw, : layout.nw] @ np.swapaxes(along, 1, 2)
        own = tube.spreads[:, : layout.num_own].reshape(len(tube.us), count, nu).max(axis=1)
        return retold(
            solution,
            sigma_qs=_roots(of_q),
            sigma_vs=_roots(tube.covariances[:, layout.ds, layout.ds]),
            sigma_us=own,
            sigmas=tube.sigmas,
            tightest=self.words,
        )


def _roots(covariances: Array) -> Array:
    """Standard deviations."""
    return np.sqrt(np.maximum(np.einsum("nii->ni", covariances), 0.0))


def _values_of_controls(formulation: Formulation) -> tuple[int, int]:
    """How many values the controls of a step have, and how many controls there are."""
    nu = formulation.problem.robot.nu
    return (formulation.layout.num_own // nu if nu else 1), nu


def _feedback(formulation: Formulation, iterate: Iterate, solution: Solution, robust: Robust) -> Array:
    """What the programme's controls answer to deviations of its states, shape (N, nu, ndx)."""
    layout, kind = formulation.layout, formulation.programme.kind
    found, gains = np.zeros((len(iterate.us), kind.nu, kind.ndx)), solution.gains
    if robust.feedback == "none":
        return found
    nv = formulation.problem.robot.nv
    if not gains.size:
        raise ProblemError(
            "robust.feedback: the optimum has no feedback gains: explicit steps leave the manifold of its "
            "rotations, or no weight of the end condition makes it a minimum; take another scheme, or "
            'feedback = "none"'
        )
    own = slice(0, layout.num_own)
    found[:, own, : layout.nw] = gains[:, :, :nv] @ np.linalg.pinv(tangents(formulation, iterate.xs[:-1]))
    found[:, own, layout.ds] = gains[:, :, nv : 2 * nv]
    return found


def _propagate(
    formulation: Formulation, iterate: Iterate, robust: Robust, feedback: Array, solution: Solution
) -> Tube:
    """Covariances of states and parameters from node to node."""
    programme, layout = formulation.programme, formulation.layout
    kind, N = programme.kind, programme.num_steps
    A, B, solved = _steps(programme, iterate)
    D, parameters = _of_parameters(formulation, iterate, robust, solved)
    k, values = len(parameters), _values_of_controls(formulation)
    noise = B[:, :, : layout.num_own].reshape(N, kind.ndx, *values).sum(axis=2)
    for block in layout.blocks:
        if block.counts_as_control:  # remembered as it was meant
            noise[:, layout.rows[block.name]] = 0.0
    dts = np.diff(solution.t)
    rates = np.divide(1.0, dts, out=np.zeros(N), where=dts > 0.0)  # impacts take no time
    added = np.einsum("niu,u,n,nju->nij", noise, robust.tau**2, rates, noise)
    whole = np.zeros((N + 1, kind.ndx + k, kind.ndx + k))
    whole[0, : kind.ndx, : kind.ndx] = _at_start(formulation, iterate, robust, solution)
    whole[0, kind.ndx :, kind.ndx :] = np.diag(parameters**2)
    step = np.zeros((kind.ndx + k, kind.ndx + k))
    step[kind.ndx :, kind.ndx :] = np.eye(k)
    for n in range(N):
        step[: kind.ndx] = np.hstack([A[n] + B[n] @ feedback[n], D[n]])
        whole[n + 1] = step @ whole[n] @ step.T
        whole[n + 1, : kind.ndx, : kind.ndx] += added[n]
    covariances = whole[:, : kind.ndx, : kind.ndx]
    spreads = _roots(feedback @ covariances[:-1] @ np.swapaxes(feedback, 1, 2))
    return Tube(robust.sigmas, iterate.xs, iterate.us, covariances, spreads)


def _steps(programme: StagewiseProgramme, iterate: Iterate) -> tuple[Array, Array, Array]:
    """Derivatives A, B of each step, and what right-hand sides of its equations move the state by."""
    kind, N = programme.kind, programme.num_steps
    points = [iterate.xs[:-1], iterate.xs[1:], iterate.ys, iterate.us]
    given = [*points, iterate.ms, programme.theta, programme.rho]
    found = call(programme.functions, "complete", N, given)[2]
    rows = kind.ndx + kind.ny
    jacobian = np.zeros((N, rows, rows + kind.ndx + kind.nu))
    jacobian[:, found.rows, found.columns] = found.values
    try:
        solved: Array = -np.asarray(np.linalg.inv(jacobian[:, :, :rows])[:, : kind.ndx], dtype=np.float64)
    except np.linalg.LinAlgError:
        raise ProblemError(
            "robust: the equations of a step do not determine the state after it: forces of redundant "
            "constraints are no functions of the state"
        ) from None
    moved = solved @ jacobian[:, :, rows:]
    return moved[:, :, : kind.ndx], moved[:, :, kind.ndx :], solved


def _of_parameters(
    formulation: Formulation, iterate: Iterate, robust: Robust, solved: Array
) -> tuple[Array, Array]:
    """Derivatives of each step in uncertain parameters, shape (N, ndx, k), and their deviations, (k,)."""
    programme = formulation.programme
    kind, N = programme.kind, programme.num_steps
    columns, sizes = [np.zeros((N, kind.ndx, 0))], [np.zeros(0)]
    if not robust.parameters:
        return columns[0], sizes[0]
    known = [w for kind in PARAMETERS if issubclass(kind, OfRobot) for w in kind.words(formulation)]
    functions = load_stage_functions(formulation)
    points = [iterate.xs[:-1], iterate.xs[1:], iterate.ys, iterate.us]
    given = [*points, iterate.ms, np.zeros(programme.bounds.nh), programme.theta, programme.rho]
    for word in robust.parameters:
        if word not in known:
            expected = f"one of {', '.join(known)}" if known else "none: the robot has no payload that varies"
            raise InvalidValue("robust.parameters", word, expected)
    for parameter in parameters_of(formulation, tuple(robust.parameters)):
        key = f"robust.parameters.{parameter.word}"
        count, written = len(parameter.names), robust.parameters[parameter.word]
        if written.size not in (1, count):
            raise ProblemError(f"{key}: got {written.size} numbers, expected 1 or {count}")
        sizes.append(np.broadcast_to(written, count))
        change = parameter.change()
        for theta, rho in zip(change.theta, change.rho, strict=True):
            _, c, h = call(functions, "push", N, [*given, theta, rho])
            if h.values.any():
                which = {programme.path_names[row] for row in h.rows[h.values.any(axis=0)]}
                raise ProblemError(
                    f"{key}: not by the motion alone, but by itself it moves {list_names(sorted(which), 3)}; "
                    "leave out one of the two"
                )
            columns.append(solved @ c.dense(kind.ndx + kind.ny)[:, :, None])
    return np.concatenate(columns, axis=2), np.concatenate(sizes)


def _at_start(formulation: Formulation, iterate: Iterate, robust: Robust, solution: Solution) -> Array:
    """Covariance of the first state: along what constraints leave free."""
    problem, layout, ndx = formulation.problem, formulation.layout, formulation.programme.kind.ndx
    along, found = tangents(formulation, iterate.xs[:1])[0], np.zeros((ndx, ndx))
    for place, sizes, of_rates, directions in (
        (slice(0, layout.nw), robust.q, False, along),
        (layout.ds, robust.v, True, np.eye(len(robust.v))),
    ):
        basis = _free_at_start(problem, solution.qs[0], of_rates=of_rates)
        moves = directions @ basis @ basis.T * sizes
        found[place, place] = moves @ moves.T
    return found


def _free_at_start(problem: Problem, q: Array, *, of_rates: bool) -> Array:
    """Directions that constraints which act at the start leave, shape (nv, any)."""
    switches = problem.timeline.switches
    if switches is None:
        return tangent_space(problem.robot, q)
    return null_space(switches.at_start(q, of_rates=of_rates), RANK_TOLERANCE)
