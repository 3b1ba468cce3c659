r"""A start that is free, as one more control of the first step.

The state x_0 of the programme is given, and no solver has to know of more. The first step begins at

.. math:: x_0 \oplus e_k E w_k, \qquad e_0 = 1, \quad e_k = 0 \text{ in all other steps},

with the move w along the free directions E of (q, v). Where e is 0 nothing depends on w, and half its square
is added to the cost, which is zero at the optimum. The multiplier of w's row is the adjoint of the free
entries of the start: zero, unless bounds or the end say something of them (transversality). A start as a
further unknown of the recursion would save these idle controls; a control needs no other inertia check, no
other bounds and no other line search, in any solver.

Where the motion is periodic, states remember the move, :math:`r_{k+1} = r_k + e_k w_k`, so that the end
condition is a function of the last state alone. On groups r is in the tangent space of the given start.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.formulation.end_rows import independent_rows
from mbocp.formulation.features.feature import Feature, StepRequests, infinite_bounds
from mbocp.formulation.layout import Block, StateLayout
from mbocp.formulation.motion import Motion, Passage
from mbocp.formulation.steps import HAS_BEFORE, StepSymbols
from mbocp.lie import ConfigurationSpace
from mbocp.mechanisms.consistent_states import tangent_space
from mbocp.problem import Problem
from mbocp.problem.goals.free_start import rows_kept_at_start, start_bounds
from mbocp.problem.goals.periodic import Periodic, impact_axes
from mbocp.problem.timeline.cycle import compare_ends
from mbocp.robot import Label
from mbocp.terms.periodic_end import KeptRows, PeriodicEnd, StartEnd, StartState
from mbocp.terms.point import Sizes


@dataclass(frozen=True)
class MovedStart(Feature):
    """A free start.

    Attributes
    ----------
    directions : tuple of int
        Free directions of (q, v).
    is_remembered : bool
        Whether the end looks at the start.
    """

    directions: tuple[int, ...]
    is_remembered: bool = False

    asks_for_first = True  # it moves the first step alone

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> MovedStart | None:
        """Return it where some directions are free."""
        directions = _free_directions(problem)
        return cls(directions, "start" in asked.remembers) if directions else None

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """The move, where the end looks at it."""
        return (Block("start", len(self.directions), adds_up=True),) if self.is_remembered else ()

    def controls(self, nu: int) -> Mapping[str, int]:
        """The move."""
        return {"moves": len(self.directions)}

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Which directions are free."""
        return {"moves": self.directions}

    def enter(self, at: StepSymbols) -> StepSymbols:
        """Let the first step begin elsewhere."""
        has_before, size = at.given[HAS_BEFORE], 2 * at.space.layout.nv

        def start_move(w: ca.SX) -> ca.SX:
            move = ca.SX.zeros(size)
            for k, i in enumerate(self.directions):
                move[i] = (1 - has_before) * w[k]
            return move

        along = ca.SX.zeros(at.space.layout.ndx) if at.space.layout.is_flat else at.d0
        at0 = at.space.move(at.x0, along, start_move(at.named_inputs["moves"]))
        return replace(at, at0=at0, start_move=start_move)

    def next_value(self, name: str, step: Passage) -> Any:
        """What was before, and e w."""
        return step.before[name] + (1.0 - step.has_before) * step.controls["moves"]

    def idle_cost(self, at: StepSymbols) -> ca.SX:
        """Half the square of moves after the first step."""
        return at.given[HAS_BEFORE] * ca.sumsqr(at.named_inputs["moves"]) / 2.0

    def control_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Those of the start in the first step, and none after it."""
        lower, upper = infinite_bounds(problem.num_steps, len(self.directions))
        lower[0], upper[0] = _sides(problem)
        return {"moves": (lower, upper)}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Of which entry of the start."""
        return [f"memory of the {name}" for name in self._names(problem)] if self.is_remembered else ()

    def control_words(self, problem: Problem) -> Sequence[str]:
        """Of which entry of the start."""
        return [f"bound of the {name}" for name in self._names(problem)]

    def _names(self, problem: Problem) -> list[str]:
        robot = problem.robot
        names = [f"{part} of {label.name}" for part in ("position", "velocity") for label in robot.v_labels]
        return [f"start {names[i]}" for i in self.directions]

    def controls_of(self, problem: Problem, motion: Motion) -> Mapping[str, Array]:
        """The move from the given start to that of the motion."""
        robot = problem.robot
        away = [robot.difference(problem.q_start, motion.qs[0]), motion.vs[0] - problem.v_start]
        moves = np.zeros((problem.num_steps, len(self.directions)))
        moves[0] = np.clip(np.concatenate(away)[list(self.directions)], *_sides(problem))
        return {"moves": moves}

    def read(self, problem: Problem, at: StateLayout, xs: Array, us: Array, motion: Motion) -> Motion:
        """Where the motion starts."""
        robot, move = problem.robot, np.zeros(2 * problem.robot.nv)
        move[list(self.directions)] = us[0, at.controls["moves"]]
        qs, vs = np.array(motion.qs), np.array(motion.vs)
        qs[0] = robot.integrate(problem.q_start, move[: robot.nv])
        vs[0] = problem.v_start + move[robot.nv :]
        return replace(motion, qs=qs, vs=vs)

    def slopes(self, problem: Problem, at: StateLayout, us: Array) -> tuple[Array, Array]:
        """Derivatives of the start's configuration and velocity.

        Returns
        -------
        in_given : ndarray, shape (2 nv, 2 nv)
            In those of the given start.
        in_us : ndarray, shape (2 nv, nu)
            In the first controls.
        """
        robot, where = problem.robot, at.controls["moves"]
        move, in_given, along = np.zeros(2 * robot.nv), np.eye(2 * robot.nv), np.eye(2 * robot.nv)
        move[list(self.directions)] = us[0, where]
        for found, argument in ((in_given, pin.ArgumentPosition.ARG0), (along, pin.ArgumentPosition.ARG1)):
            turned = pin.dIntegrate(robot.model, problem.q_start, move[: robot.nv], argument)
            found[: robot.nv, : robot.nv] = turned
        in_us = np.zeros((2 * robot.nv, us.shape[1]))
        in_us[:, where] = along[:, list(self.directions)]
        return in_given, in_us


def _free_directions(problem: Problem) -> tuple[int, ...]:
    return problem.start_free.directions if problem.start_free is not None else ()


def _sides(problem: Problem) -> tuple[Array, Array]:
    free = problem.start_free
    if free is None:
        return np.zeros(0), np.zeros(0)
    return start_bounds(problem.robot, problem.limits_of_ends[0], free, problem.q_start, problem.v_start)


def start_ends(problem: Problem, space: ConfigurationSpace) -> tuple[PeriodicEnd | StartEnd, ...]:
    """Return conditions on the start: that the end is its image, that it keeps the robot's constraints."""
    robot = problem.robot
    start = StartState(
        sizes=Sizes(space.nz, robot.nv, robot.nu, space.nz, robot.nv),
        free=_free_directions(problem),
        z=space.coordinates(np.asarray(problem.q_start)[None])[0],
        v=np.asarray(problem.v_start),
    )
    found: list[PeriodicEnd | StartEnd] = []
    periodic = problem.goal.periodic
    if periodic is not None:
        found.append(_periodic_end(problem, periodic, space, start))
    kept = _rows_to_keep(problem)
    if kept is not None:
        held = problem.timeline.switches.held if problem.timeline.switches is not None else ()
        found.append(StartEnd(start, *kept, held))
    return tuple(found)


def _rows_to_keep(problem: Problem) -> tuple[KeptRows, KeptRows] | None:
    """Rows of the configuration and of the velocity that a free start has to keep."""
    free, periodic = problem.start_free, problem.goal.periodic
    if free is None:
        return None
    given = (problem.robot, free, problem.q_start, problem.v_start, problem.timeline.switches)
    places, rates = (_numbers(rows_kept_at_start(*given, of_rates=of_rates)) for of_rates in (False, True))
    if periodic is not None and periodic.impact:  # then the image keeps the constraints' rates
        rates = KeptRows()
    return (places, rates) if places.count + rates.count else None


def _numbers(masks: tuple[BoolArray, BoolArray]) -> KeptRows:
    own, held = (tuple(int(i) for i in np.flatnonzero(mask)) for mask in masks)
    return KeptRows(own, held)


def _periodic_end(
    problem: Problem, periodic: Periodic, space: ConfigurationSpace, start: StartState
) -> PeriodicEnd:
    """The condition of a periodic motion.

    What constraints say of the end is no condition where the symmetry keeps them. An impact lets go what was
    held, so that constraints hold at both sides of it for other reasons, and all is compared.
    """
    robot, image = problem.robot, periodic.image(problem.robot)
    positions, velocities = _compare(problem, periodic)
    D_q = independent_rows(image.compared, positions, positions)
    D_v = independent_rows(np.ones(robot.nv, dtype=np.bool_), velocities, velocities)
    A_z, moved = space.affine(image.C, image.moved)
    axes = impact_axes(robot, periodic.impact) if periodic.impact else ()
    frame_id = robot.frame_names.index(periodic.impact) if periodic.impact else -1
    return PeriodicEnd(start, len(D_q), len(D_v), frame_id, axes, D_q, D_v, A_z, image.A, moved)


def _compare(problem: Problem, periodic: Periodic) -> tuple[Array, Array]:
    """Bases of the directions in which positions and velocities are compared, shapes (nv, any)."""
    robot, table = problem.robot, problem.timeline.switches
    if table is not None:
        ends = problem.q_start, problem.goal.q
        return compare_ends(table, problem.start_free, periodic, ends)
    basis = np.eye(robot.nv) if periodic.impact else tangent_space(robot, problem.q_start)
    return basis, basis
