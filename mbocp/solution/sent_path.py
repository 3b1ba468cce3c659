"""Path constraints and obstacles along a motion as it is sent: they hold at nodes alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.problem import Problem
from mbocp.problem.obstacles.approach import nearest_approach
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.robot.nodes import between
from mbocp.solution.sent import Excess, find_excesses
from mbocp.solution.sent_states import Follower
from mbocp.terms.bounded import BoundedTerm

_PARTS = 8  # of a polynomial at whose ends they are looked at
_SAME = 1e-6  # of a step: times closer to a node than this are the node's
# Excesses that count: what arms are exact by on a path [m, rad], or a part of a limit of another unit.
TOLERANCES = {"m": 5e-4, "rad": 5e-3}
_PART = 0.01


def path_excesses(follower: Follower, problem: Problem) -> tuple[tuple[Excess, ...], tuple[str, ...]]:
    """What a motion is beyond its path constraints, and nearer to obstacles than it may be, as it is sent.

    Parameters
    ----------
    follower : Follower
    problem : Problem
        What the motion is a solution of.

    Returns
    -------
    excesses : tuple of Excess
        The worst of each row that is left by more than 0.5 mm, 5 mrad, or a hundredth of its limit.
    unseen : tuple of str
        Constraints with rows that were not looked at: they ask for forces, or for joints that are not sent.
    """
    if not problem.path:
        return (), ()
    motion, excesses, unseen = _Motion.of(follower, problem), list[Excess](), list[str]()
    for constraint in problem.path:
        if isinstance(constraint, Clearance):  # floating things are where the solution has them
            excesses += _nearer(constraint, motion)
            continue
        rows = _rows_seen(constraint, follower, problem)
        if rows.any():
            excesses += _beyond(constraint, motion, problem, rows)
        if not rows.all():
            unseen.append(constraint.name)
    return tuple(excesses), tuple(unseen)


@dataclass(frozen=True, eq=False)
class _Motion:
    """A motion as it is sent, at its nodes and between them.

    Attributes
    ----------
    t : ndarray, shape (n,)
        From its start [s].
    qs, vs, us : ndarray, shapes (n, nq), (n, nv) and (n, nu)
    nodes : ndarray, shape (n,)
        Where this is along the nodes 0..N of the solution: 1.5 is amid the second step.
    """

    t: Array
    qs: Array
    vs: Array
    us: Array
    nodes: Array

    @classmethod
    def of(cls, follower: Follower, problem: Problem) -> _Motion:
        sent = follower.sent
        curves, solution = sent.curves, sent.solution
        at_nodes = np.clip(sent.times_of(solution.t), 0.0, curves.nodes[-1])
        t = np.union1d(curves.places(_PARTS)[0], at_nodes)
        nodes = np.interp(t, at_nodes, np.arange(len(at_nodes)))
        nodes[[0, -1]] = 0.0, len(at_nodes) - 1.0
        positions, velocities, accelerations, _ = curves.at(t)
        step = np.minimum(nodes.astype(int), solution.num_steps - 1)
        others = between(problem.robot, solution.qs[step], solution.qs[step + 1], nodes - step)
        qs, vs = follower.states(t, positions, velocities, others)
        us = follower.controls(qs, vs, accelerations) if follower.has_controls else sent.controls(t)
        return cls(t, qs, vs, us, nodes)

    def within(self, held: BoolArray) -> BoolArray:
        """Where rows that hold at some of the nodes 0..N, shape (N + 1, rows), hold, shape (n, rows)."""
        first, last = (
            round_(self.nodes + sign * _SAME).astype(int) for round_, sign in ((np.floor, 1), (np.ceil, -1))
        )
        return np.asarray(np.logical_and(held[first], held[last]))


def _rows_seen(constraint: BoundedTerm, follower: Follower, problem: Problem) -> BoolArray:
    """Which rows of a constraint follow from joints that are sent, and controls."""
    symbols = {"progress": ca.SX.sym("s"), "control": ca.SX.sym("u", problem.robot.nu)}
    if not set(constraint.structure("quaternion").remembers) <= set(symbols):
        return np.zeros(constraint.rows, dtype=bool)
    function = constraint.function(problem.robot, symbols, *symbols.values())
    unknown = [~of for of in follower.known]
    asked = [np.asarray(function.jac_sparsity(0, k), dtype=bool)[:, of] for k, of in enumerate(unknown)]
    return np.asarray(~np.hstack(asked).any(axis=1))


def _beyond(constraint: BoundedTerm, motion: _Motion, problem: Problem, rows: BoolArray) -> Iterator[Excess]:
    at_nodes = np.logical_and(constraint.nodes(problem.num_steps, problem.dt), rows)
    at_start = np.logical_and(at_nodes[:1], constraint.span.has_start)
    held = motion.within(np.vstack([at_start, at_nodes]))
    values = constraint.values_along(problem.robot, motion.qs, motion.vs, motion.us)
    for k, label in enumerate(constraint.labels):
        row, bounds = held[:, k], np.array([constraint.lower[k], constraint.upper[k]])
        tolerance, size = TOLERANCES.get(label.unit, _PART), 1.0 if label.unit in TOLERANCES else None
        yield from find_excesses(
            "path", label.name, values[row, k], bounds, motion.t[row], label.unit, tolerance, size
        )


def _nearer(clearance: Clearance, motion: _Motion) -> Iterator[Excess]:
    found = nearest_approach(clearance, motion.t, motion.qs)
    if found is not None:
        short = found.margin - found.distance
        if short > TOLERANCES["m"] or found.distance < -BOUND_TOLERANCE:
            name = f"distance of {found.between}"
            yield Excess("path", name, found.distance, found.margin, found.time, short, "m")
