r"""Limits and path constraints of a problem as bounds of its programme, and with room for motions that stray.

A row :math:`\underline h \le h(x) \le \overline h` becomes, with the covariance P of the state there,

.. math:: \underline h + \beta \sqrt{h_x P h_x^T} \le h(x) \le \overline h - \beta \sqrt{h_x P h_x^T} ,

in which the root is a number, worked out along the motion before: the zero-order method of [Feng2020]_ and
[Zanelli2021]_.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.exceptions import ProblemError
from mbocp.formulation.features.feature import Feature, infinite_bounds, join
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.pieces import Pieces
from mbocp.integrators import SCHEMES
from mbocp.problem import PathConstraint, Problem
from mbocp.problem.found_parameter import Tube
from mbocp.programme import StagewiseProgramme, StateBounds

_AT_LIMIT = 1e-4  # [rad, m]: a goal that is nearer leaves an interior-point method no room
_BY_LAST_SPEED = ("se1", "semi_implicit_euler")  # whose steps go by their last velocity: at rest nowhere


def state_bounds(pieces: Pieces) -> StateBounds:
    """Limits and path constraints of a problem in terms of its programme."""
    problem, at, features = pieces.problem, pieces.layout, pieces.signature.features
    N, along = problem.num_steps, problem.limits_along()
    of_blocks = join(feature.state_bounds(problem) for feature in features)
    settled = _ends_at_limits(problem)
    has_rows = problem.has_limits_of_phases or of_blocks or settled.any()
    lower, upper = infinite_bounds(N if has_rows else 1, at.nx)
    for part in pieces.space.parts:
        plain = part.at_q.stop - part.at_q.start if part.group.is_vector else 0
        plain = 3 if part.group.nv == 6 else 2 if (part.group.nz, part.group.nv) == (4, 3) else plain
        source = slice(part.at_q.start, part.at_q.start + plain)
        target = slice(part.at_z.start, part.at_z.start + plain)
        lower[:, target], upper[:, target] = along["q"][0][:, source], along["q"][1][:, source]
        for back, row in enumerate(settled[: len(lower)], start=1):
            free = target.start + np.flatnonzero(row[source])
            lower[-back, free], upper[-back, free] = -np.inf, np.inf
    lower[:, at.s], upper[:, at.s] = pieces.speed_bounds
    for name, sides in of_blocks.items():
        lower[:, at.states[name]], upper[:, at.states[name]] = sides
    lower, upper = (np.array(np.broadcast_to(side, (N, at.nx))) for side in (lower, upper))
    repeats = _repeats(problem, at, lower, upper)
    lower[repeats], upper[repeats] = -np.inf, np.inf
    u_lower, u_upper = _control_bounds(problem, features)
    inner = [constraint.inner_bounds for constraint in problem.inequalities]
    path_lower, path_upper = _at_nodes(problem, inner, is_inner=True)
    return StateBounds(
        x_lower=lower,
        x_upper=upper,
        u_lower=u_lower,
        u_upper=u_upper,
        path_lower=path_lower,
        path_upper=path_upper,
    )


def _repeats(problem: Problem, at: StateLayout, lower: Array, upper: Array) -> BoolArray:
    """Bounds that those of the node before say already, shape (N, nx): both at once would be dependent.

    Impacts leave the configuration, and partings velocities that are projected.
    """
    found, table = np.zeros(lower.shape, dtype=np.bool_), problem.timeline.switches
    if table is None:
        return found
    is_same = np.zeros(lower.shape, dtype=np.bool_)
    is_same[table.is_impact, at.z] = True
    if SCHEMES[problem.scheme].projects:
        is_same[table.is_parting, at.s] = True
    found[1:] = is_same[1:] & (lower[1:] <= lower[:-1]) & (upper[1:] >= upper[:-1])
    return found


def _ends_at_limits(problem: Problem) -> BoolArray:
    """Coordinates that the end condition puts at a limit, at the last node and the one before it, (2, nq).

    There it says all that the limit does.
    """
    goal, robot = problem.goal, problem.robot
    found = np.zeros((2, robot.nq), dtype=np.bool_)
    if goal.enforce not in ("exact", "both") or goal.periodic is not None or robot.nc:
        return found
    lower, upper = (side[-1] for side in problem.limits_along()["q"])
    for joint in robot.model.joints:
        if joint.nq == joint.nv == 1 and goal.q_active[joint.idx_v]:
            k, i = joint.idx_q, joint.idx_v
            found[0, k] = min(goal.q[k] - lower[k], upper[k] - goal.q[k]) < _AT_LIMIT
            stops = goal.rate == "v" and goal.rate_active[i] and goal.value[i] == 0.0
            found[1, k] = found[0, k] and stops and problem.scheme in _BY_LAST_SPEED and problem.num_steps > 1
    return found


def _control_bounds(problem: Problem, features: Sequence[Feature]) -> tuple[Array, Array]:
    """Bounds of all controls, shapes (N, any)."""
    found = [sides for feature in features for sides in feature.control_bounds(problem).values()]
    rows = max(len(lower) for lower, _ in found)  # one where they are the same in all steps
    lower, upper = (
        np.hstack([np.broadcast_to(side, (rows, side.shape[1])) for side in sides])
        for sides in zip(*found, strict=True)
    )
    shape = problem.num_steps, lower.shape[1]
    return np.broadcast_to(lower, shape), np.broadcast_to(upper, shape)


def sides_of_path(problem: Problem) -> tuple[Array, Array]:
    """Bounds of the values that people speak of, as those of the path functions in `state_bounds`."""
    return _at_nodes(problem, [(c.lower, c.upper) for c in problem.inequalities], is_inner=False)


def _at_nodes(
    problem: Problem, sides: Sequence[tuple[Array, Array]], *, is_inner: bool
) -> tuple[Array, Array]:
    N, none = problem.num_steps, np.zeros(0)
    if not sides:
        nothing = StateBounds.everywhere(none, N)
        return nothing, nothing
    lower = StateBounds.everywhere(np.concatenate([none, *(lower for lower, _ in sides)]), N)
    upper = StateBounds.everywhere(np.concatenate([none, *(upper for _, upper in sides)]), N)
    holds = path_nodes(problem)
    if not holds.all():
        lower, upper = np.where(holds, lower, -np.inf), np.where(holds, upper, np.inf)
    lower, upper = np.array(lower), np.array(upper)
    dt, first = problem.dt, 0
    limits = problem.limits_along() if problem.has_limits_of_phases else None
    for constraint in problem.inequalities:
        columns = slice(first, first + constraint.rows)
        first += constraint.rows
        differing = constraint.sides_in_steps(N, dt, limits, is_inner=is_inner)
        if differing is not None:
            steps, low, high = differing
            lower[steps, columns], upper[steps, columns] = low, high
    return lower, upper


def path_nodes(problem: Problem) -> BoolArray:
    """At which of the nodes 1..N each row of the path constraints holds, shape (N, nh).

    At the last one equations do not that an exact goal says, too: they would depend on it.
    """
    columns = [constraint.nodes(problem.num_steps, problem.dt) for constraint in problem.inequalities]
    for column, constraint in zip(columns, problem.inequalities, strict=True):
        if isinstance(constraint, PathConstraint) and constraint.term.has_velocity:
            column[-1, _find_rows_of_goal(problem, constraint)] = False
    return np.hstack(columns) if columns else np.ones((problem.num_steps, 0), dtype=np.bool_)


def _find_rows_of_goal(problem: Problem, constraint: PathConstraint) -> BoolArray:
    """Which rows of a constraint are equations on velocities that the goal gives, shape (rows,)."""
    goal, equations = problem.goal, np.asarray(constraint.lower == constraint.upper)
    if not (equations.any() and constraint.is_known_before and goal.is_exact and goal.rate == "v"):
        return np.zeros(constraint.rows, dtype=np.bool_)
    function = constraint.function(problem.robot, {})
    of_v = np.asarray(function.jac_sparsity(0, 1), dtype=np.bool_)
    moves = (of_v & (goal.value != 0.0)).any(axis=1) & ~goal.q_active.all()  # at rest q does not matter
    return equations & ~moves & ~(of_v & ~goal.rate_active).any(axis=1)


def free_speed_bounds(problem: Problem) -> tuple[Array, Array]:
    """Bounds of the speeds where controls may prescribe some velocities, shapes (N, ns) or (1, ns).

    Raises
    ------
    ProblemError
        If a velocity is limited that is no unknown of the programme, because controls prescribe it.
    """
    robot = problem.robot
    lower, upper = problem.limits_along()["v"]
    if not robot.drives:
        return lower, upper
    for i in robot.driven:
        if np.isfinite(lower[:, i]).any() or np.isfinite(upper[:, i]).any():
            raise ProblemError(
                f"limits.velocity: {robot.v_labels[i].name!r} is prescribed by a control; limit the control "
                "(limits.effort), and not its velocity"
            )
    free = [i for i in range(robot.nv) if i not in set(robot.driven)]
    unbounded = np.full((len(lower), robot.num_speeds - len(free)), np.inf)
    return np.hstack([lower[:, free], -unbounded]), np.hstack([upper[:, free], unbounded])


_LEAST_ROOM = 1e-6  # of a range, or of its unit: less is no room for an interior-point method


def margins_of(programme: StagewiseProgramme, tube: Tube) -> Array:
    """How far bounds of states, controls and path functions move, shape (N, nx + nu + nh).

    Zero where there are none, and where both sides are the same.
    """
    bounds, kind, N = programme.bounds, programme.kind, programme.num_steps
    after = tube.covariances[1:]
    of_states = np.sqrt(np.maximum(np.einsum("nii->ni", after), 0.0))
    if kind.nx != kind.ndx:  # then states have no limits
        of_states = np.zeros((N, kind.nx))
    of_path = np.zeros((N, bounds.nh))
    if bounds.nh:
        slopes = _path_slopes(programme, tube)
        of_path = np.sqrt(np.maximum(np.einsum("nhi,nij,nhj->nh", slopes, after, slopes), 0.0))
    spreads = np.hstack([of_states, tube.spreads, of_path])
    return np.where(bounds.has_limit & ~bounds.are_equations, tube.sigmas * spreads, 0.0)


def tighten(programme: StagewiseProgramme, tube: Tube) -> StagewiseProgramme:
    """The programme with bounds that leave room.

    Raises
    ------
    ProblemError
        If a range is narrower than the room on both its sides.
    """
    bounds, margins = programme.bounds, margins_of(programme, tube)
    lower, upper = bounds.lower + margins, bounds.upper - margins
    least = _LEAST_ROOM * np.fmax(1.0, np.where(np.isfinite(bounds.upper), np.abs(bounds.upper), 0.0))
    crossed = (margins > 0.0) & ~(lower + least < upper)
    if crossed.any():
        stage, entry = (int(i) for i in np.argwhere(crossed)[0])
        sides = f"[{bounds.lower[stage, entry]:.4g}, {bounds.upper[stage, entry]:.4g}]"
        raise ProblemError(
            f"robust: {words_of(programme, stage, entry)} has no room: {tube.sigmas:.3g} standard deviations "
            f"are {margins[stage, entry]:.4g} on each side of {sides}; widen the limit, or lower "
            "robust.sigmas or what is uncertain"
        )
    return replace(programme, bounds=bounds.with_sides(lower, upper))


def words_of(programme: StagewiseProgramme, stage: int, entry: int) -> str:
    """Words for a limit by its place in `StateBounds.has_limit`."""
    kind, limited = programme.kind, programme.bounds.has_limit
    rows = kind.ndx + kind.ny
    return programme.describe_row(stage, rows + int(np.count_nonzero(limited[stage, :entry])))


def _path_slopes(programme: StagewiseProgramme, tube: Tube) -> Array:
    """Derivatives of the path functions in the state, shape (N, nh, ndx)."""
    N, kind, nh = programme.num_steps, programme.kind, programme.bounds.nh
    function = programme.functions.function("path")
    given = [
        tube.xs[1:],
        np.zeros((N, nh)),
        tube.us,
        np.broadcast_to(programme.theta, (N, programme.theta.size)),
    ]
    values = programme.functions.stage_function("path").evaluate([np.ravel(v) for v in given], N, True)[1]
    rows, columns = function.sparsity_out(1).get_triplet()
    slopes = np.zeros((N, nh, kind.ndx))
    slopes[:, rows, columns] = np.reshape(values, (N, -1))
    return slopes
