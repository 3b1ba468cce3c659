r"""Constraints that begin or end along the way, where the start is free or the motion periodic.

Two questions have answers here. *What acts at the start*: rows that the free start has to keep, of positions
where they say where something is, of velocities where the first step takes time. *What a cycle compares*:
the end less the image of the start can point along

.. math:: D = (T_N + A\,T_0) \cap K

where T are the directions that constraints leave at the end and of the free start, A is the symmetry, and K
are the directions that what is held from start to end where it is leaves. All others are zero by themselves,
or belong to what holds.

Where the cycle closes nothing leaps, as there is no step between the end and its image. What acts at the
start and not at the end is taken on softly there. What acts at the end and not at the start would be let go
with the scheme's errors in its velocities, and is refused: a cycle can be cut at any other place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbocp._arrays import Array, BoolArray, align, null_space
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import ProblemError
from mbocp.problem.goals.free_start import FreeStart
from mbocp.problem.goals.goal import Goal
from mbocp.problem.goals.periodic import Periodic
from mbocp.problem.timeline.switches import SwitchTable, rows_by_frame

_TOLERANCE = 1e-6  # of a unit vector, and [m, rad] of what a symmetry moves
_NUM_POSES = 3  # around the start, where a symmetry has to keep what is held
_SPREAD = 0.2  # [m, rad]


class CycleBases(NamedTuple):
    """Bases of the directions in which the end and the image of the start can differ, shapes (nv, any)."""

    positions: Array
    velocities: Array


def compare_ends(
    table: SwitchTable, free: FreeStart | None, periodic: Periodic, ends: tuple[Array, Array]
) -> CycleBases:
    """Return the directions that a cycle compares.

    Parameters
    ----------
    ends : tuple of ndarray, shape (nq,)
        Configurations about which: of the start, and its image.
    """
    robot, (q_start, q_end), nv = table.robot, ends, table.robot.nv
    A, nothing = periodic.image(robot).A, np.zeros(nv, dtype=np.bool_)
    masks = (nothing, nothing) if free is None else (free.q, free.v)
    starts = (
        _start_directions(table, q_start, masks[0], of_rates=False),
        _start_directions(table, q_start, masks[1], of_rates=True),
    )
    positions = _sum(_end_directions(table, q_end, of_rates=False), A @ starts[0])
    velocities = _sum(_end_directions(table, q_end, of_rates=True), A @ starts[1])
    kept = table.jacobians(q_end[None])[0][_always(table)]
    shared = _intersection(positions, null_space(kept, RANK_TOLERANCE))
    return CycleBases(align(shared), align(velocities))


def check_cycle(
    switches: SwitchTable | None, start_free: FreeStart | None, goal: Goal, q_start: Array
) -> None:
    """Refuse what holds and a free start, or a cycle, do not allow together.

    Raises
    ------
    ProblemError
    """
    if switches is None:
        return
    if start_free is not None and switches.is_impact[0]:
        raise ProblemError(
            "start.free: the first step is an impact, before which the motion has not begun; begin with a "
            "step that takes time, or give the start"
        )
    periodic, ends = goal.periodic, (q_start, goal.q)
    if periodic is None:
        return
    if periodic.impact:
        raise ProblemError(
            f"goal.periodic.impact: lets go all that is held, and takes on {periodic.impact!r} alone; let a "
            "phase hold that frame, which begins with an impact, and end the cycle after it"
        )
    _check_kept(switches, periodic, ends[0])
    _check_let_go(switches, periodic, ends)


def _check_kept(table: SwitchTable, periodic: Periodic, q: Array) -> None:
    """What is held from start to end has to be where it was in the image of any configuration."""
    always, robot, rng = _always(table), table.robot, np.random.default_rng(0)
    if not always.any():
        return
    image = periodic.image(robot)
    for _ in range(_NUM_POSES):
        there = robot.integrate(q, rng.normal(scale=_SPREAD, size=robot.nv))
        away = table.residuals(image.configuration(there)[None], there[None])[0]
        worst = int(np.argmax(np.abs(away) * always))
        if np.abs(away[worst]) * always[worst] > _TOLERANCE:
            raise ProblemError(
                f"goal.periodic: hold {table.labels[worst].name!r} acts from start to end, and the symmetry "
                "does not leave it where it is; let go on the way, or take another symmetry"
            )


def _check_let_go(table: SwitchTable, periodic: Periodic, ends: tuple[Array, Array]) -> None:
    """What acts at the end has to act at the start, unless a parting has set its velocities."""
    robot, (q_start, q_end), last = table.robot, ends, len(table.rows) - 1
    if table.is_impact[last]:
        return
    every = np.ones(robot.nv, dtype=np.bool_)
    starts = periodic.image(robot).A @ _start_directions(table, q_start, every, of_rates=True)
    rates = table.in_step(q_end, last) @ starts
    worst = int(np.argmax(np.abs(rates).max(axis=1, initial=0.0))) if rates.size else 0
    if rates.size and np.abs(rates[worst]).max() > _TOLERANCE:
        names = [*np.array([x.name for x in robot.constraint_labels], dtype=object)[table.own[last]]]
        names += [label.name for label, acts in zip(table.labels, table.rows[last], strict=True) if acts]
        raise ProblemError(
            f"goal.periodic: {names[worst]!r} acts at the end and nothing like it at the start: it would be "
            "let go where the cycle closes; cut the cycle elsewhere, so that a phase without it follows"
        )


def _start_directions(table: SwitchTable, q: Array, mask: BoolArray, *, of_rates: bool) -> Array:
    """Moves of what is free of the start that keep what acts there, shape (nv, any)."""
    E = np.eye(table.robot.nv)[:, mask]
    return E @ null_space(table.at_start(q, of_rates=of_rates) @ E, RANK_TOLERANCE) if mask.any() else E


def _end_directions(table: SwitchTable, q: Array, *, of_rates: bool) -> Array:
    """What acts at the end leaves these: of positions, what says where something is."""
    last = len(table.rows) - 1 if of_rates else int(np.flatnonzero(~table.is_impact)[-1])
    rows = table.rows[last] if of_rates else table.rows[last] & table.coincides
    return null_space(table.derivatives(q, table.own[last], rows), RANK_TOLERANCE)


def _always(table: SwitchTable) -> BoolArray:
    """Rows of the held frames that are where they are in all steps, under any name, shape (rows,)."""
    timed = table.rows[~table.is_impact]
    found = np.zeros(timed.shape[1], dtype=np.bool_)
    for same in rows_by_frame(table.held).values():
        for rows in same:
            found[rows[0]] = timed[:, rows].any(axis=1).all()
    return found & ~table.coincides


def _sum(one: Array, other: Array) -> Array:
    """Orthonormal basis of the sum of two spaces."""
    left, values, _ = np.linalg.svd(np.hstack([one, other]), full_matrices=False)
    return left[:, values > RANK_TOLERANCE]


def _intersection(one: Array, other: Array) -> Array:
    """Orthonormal basis of what two spaces with orthonormal bases share."""
    unit = np.eye(len(one))
    return null_space(np.vstack([unit - one @ one.T, unit - other @ other.T]), RANK_TOLERANCE)
