"""Constraints that begin and end along the way, impacts, and forces of constraints that states remember."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, BoolArray, IntArray, dataclass
from mbocp.formulation.features.feature import Feature, StepRequests
from mbocp.formulation.layout import Block, StateLayout
from mbocp.formulation.motion import Passage
from mbocp.formulation.steps import StepSymbols
from mbocp.integrators.switched import ActiveForces
from mbocp.mechanics.diagnostics import ConstraintViolation, worst_violation
from mbocp.mechanics.held_frames import HeldFrame, label_held
from mbocp.problem import Problem
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.robot import Label
from mbocp.robot.nodes import between
from mbocp.terms.contact import ContactTerm

_ACTIVE = "active"  # the stage parameters e
_IS_IMPACT = "is_impact"  # the stage parameter k
_SHARES = ("own_share", "share_before")  # of a step's force and of that before it in what is remembered


@dataclass(frozen=True)
class Switches(Feature):
    """What of the constraints can be switched, without the steps in which it is.

    Attributes
    ----------
    held : tuple of HeldFrame
    num_own : int
        Rows of the robot's own constraints where these can be released; else 0.
    has_impacts : bool
    """

    held: tuple[HeldFrame, ...] = ()
    num_own: int = 0
    has_impacts: bool = False

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> Switches | None:
        """Return them where there are some."""
        table = problem.timeline.switches
        if table is None:
            return None
        found = cls(table.held, problem.robot.nc if table.has_releases else 0, bool(problem.timeline.impacts))
        return found if found.held or found.num_own or found.has_impacts else None

    @property
    def num_held(self) -> int:
        """Rows of the held frames."""
        return len(label_held(self.held))

    @property
    def stage_parameters(self) -> Mapping[str, int]:
        """Which rows act, and whether a step is an impact."""
        rows = self.num_own + self.num_held
        return {**({_ACTIVE: rows} if rows else {}), **({_IS_IMPACT: 1} if self.has_impacts else {})}

    @property
    def unknowns_key(self) -> Mapping[str, Any]:
        """What is held, and whether there are releases and impacts."""
        held = [frame.signature for frame in self.held]
        return {"switches": {"held": held, "num_own": self.num_own, "has_impacts": self.has_impacts}}

    def enter(self, at: StepSymbols) -> StepSymbols:
        """Say what acts in the step."""
        always = ca.SX.ones(at.mechanics.nc - self.num_own)
        active = ca.vertcat(always, at.given.get(_ACTIVE, ca.SX.zeros(0, 1)))
        is_impact, nothing = at.given.get(_IS_IMPACT, ca.SX(0)), ca.SX.zeros(active.numel())
        return replace(at, switched=ActiveForces(self.held, active, is_impact, nothing))

    def idle_cost(self, at: StepSymbols) -> ca.SX:
        """Half the square of the controls of impacts, on which nothing depends."""
        return at.is_impact * ca.dot(at.u, at.u) / 2.0 if self.has_impacts else ca.SX(0)

    def stage_numbers(self, problem: Problem) -> Mapping[str, Array]:
        """What acts where."""
        table = problem.timeline.switches
        if table is None:
            return {}
        own = table.own if self.num_own else table.own[:, :0]
        return {
            _ACTIVE: np.hstack([own, table.rows]).astype(np.float64),
            _IS_IMPACT: table.is_impact.astype(np.float64)[:, None],
        }


def has_step_before(problem: Problem) -> Array:
    """1 in steps that follow one that takes time, shape (N,)."""
    timed = ~problem.timeline.is_impact
    return (np.arange(problem.num_steps) > int(np.argmax(timed))).astype(np.float64)


def fill_lengths(problem: Problem, dts: Array) -> Array:
    """Lengths of steps [s], with the mean one in the place of those of impacts."""
    return np.where(problem.timeline.is_impact, problem.dt, dts)


def fill_impulses(problem: Problem, dts: Array) -> Array:
    """What multipliers are multiplied by to be impulses, shape (N, 1): lengths [s], and 1 in impacts."""
    return np.where(problem.timeline.is_impact, 1.0, dts)[:, None]


def repeat_at_impacts(values: Array, is_impact: BoolArray) -> Array:
    """Values of the steps, (N,) or (N, any), where impacts, which have none, repeat those of a neighbour.

    It is the step before, or the first that takes time.
    """
    return values[repeat_steps(is_impact)]


def repeat_steps(is_impact: BoolArray) -> IntArray:
    """Whose values each step has, see `repeat_at_impacts`, shape (N,)."""
    steps = np.flatnonzero(~is_impact)
    places = np.searchsorted(steps, np.arange(len(is_impact)), side="right") - 1
    return steps[np.maximum(places, 0)]


def ties_at_end(problem: Problem, q: Array) -> tuple[Array, Array] | None:
    """Derivatives of the constraints on positions and on velocities at an end, where these are others."""
    table = problem.timeline.switches
    if table is None:
        return None
    return table.at_end(q, of_rates=False), table.at_end(q, of_rates=True)


def active_values(problem: Problem, values: Array) -> Array:
    """Values of the rows of all constraints (N, rows), zero where these do not act."""
    table = problem.timeline.switches
    return values if table is None else np.where(np.hstack([table.own, table.rows]), values, 0.0)


def breaks_symmetries(problem: Problem) -> bool:
    """Whether what is held tells places or directions of the world apart."""
    table = problem.timeline.switches
    return table is not None and any(frame.breaks_symmetries(problem.robot) for frame in table.held)


def worse_of(one: ConstraintViolation, other: ConstraintViolation) -> ConstraintViolation:
    """The larger violation of positions, and the larger one of velocities."""
    place, rate = (max((one, other), key=key) for key in (lambda x: x.position, lambda x: x.velocity))
    places = (place.position, place.position_name, place.position_node)
    return ConstraintViolation(*places, rate.velocity, rate.velocity_name, rate.velocity_node)


def labels_of(problem: Problem) -> tuple[Label, ...]:
    """Name and unit of the rows of a robot's constraints, and of what is held."""
    own = problem.robot.constraint_labels
    return own if problem.timeline.switches is None else (*own, *problem.timeline.switches.labels)


def add_held_columns(problem: Problem, lams: Array) -> Array:
    """Multipliers (N, nc) of the robot's constraints with zeros for what is held, where they have none."""
    missing = len(labels_of(problem)) - lams.shape[1]
    return np.hstack([lams, np.zeros((len(lams), missing))]) if missing else lams


def measure_switched_violation(table: SwitchTable, qs: Array, vs: Array) -> ConstraintViolation:
    """Largest violation of what acts, at the start and at the nodes after the steps in which it does.

    What is held where it is counts from where it was when its span began. Velocities count there, too, after
    an impact.
    """
    robot, count = table.robot, len(qs)
    kept = list(robot.kept_rows)
    own = np.zeros((count, 0)), np.zeros((count, 0))
    if robot.nc:
        residuals, jacobians = robot.closure_along(qs)
        own = residuals[:, kept], np.einsum("nij,nj->ni", jacobians[:, kept], vs)
    at_start = [np.hstack(table.rows_at_start(of_rates=of_rates))[None] for of_rates in (False, True)]
    acts = np.hstack([table.own, table.rows])
    names = [label.name for label in (*robot.constraint_labels, *table.labels)]
    rates = np.einsum("nij,nj->ni", table.jacobians(qs), vs)
    places = np.vstack([table.residuals(qs[:1], qs[:1]), _places(table, qs, qs[1:])])
    position = np.hstack([own[0], places]) * np.vstack([at_start[0], acts])
    velocity = np.hstack([own[1], rates]) * np.vstack([at_start[1], acts])
    return worst_violation(position, velocity, names)


def _places(table: SwitchTable, qs: Array, reached: Array) -> Array:
    """How far what is held is from where its span began, or from coinciding, shape (N, rows).

    Parameters
    ----------
    qs : ndarray, shape (N + 1, nq)
        At the nodes, among which spans begin.
    reached : ndarray, shape (N, nq)
        A configuration of each step.
    """
    anchors = table.anchors
    found = np.zeros(anchors.shape)
    for first in np.unique(anchors[anchors >= 0]):
        steps = np.flatnonzero((anchors == first).any(axis=1))
        residuals = table.residuals(reached[steps], np.tile(qs[first], (len(steps), 1)))
        found[steps] = np.where(anchors[steps] == first, residuals, found[steps])
    return found


def violation_within(problem: Problem, qs: Array) -> float:
    """Largest violation of positions in the middles of steps, on geodesics from node to node."""
    robot, table = problem.robot, problem.timeline.switches
    middles = between(robot, qs[:-1], qs[1:], np.full(len(qs) - 1, 0.5))
    found = robot.closure_along(middles)[0][:, list(robot.kept_rows)] if robot.nc else middles[:, :0]
    if table is not None:
        found = active_values(problem, np.hstack([found, _places(table, qs, middles)]))
    return float(np.abs(found).max(initial=0.0))


@dataclass(frozen=True)
class Reactions(Feature):
    """Forces of the robot's constraints that states remember; in a parting that of the step before with it.

    Attributes
    ----------
    rows : tuple of int
        Which ones, in rising order.
    has_partings : bool
    """

    rows: tuple[int, ...]
    has_partings: bool = False

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> Reactions | None:
        """Return those that path constraints look at."""
        rows = _rows_of(term for term in asked.path if isinstance(term, ContactTerm))
        table = problem.timeline.switches
        return cls(rows, table is not None and bool(table.is_parting.any())) if rows else None

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """A force for each; impacts have impulses in their place."""
        return (Block("reaction", len(self.rows), has_unit=True, has_impacts=True),)

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Which rows they are."""
        return {"reactions": self.rows} | ({"has_partings": True} if self.has_partings else {})

    @property
    def stage_parameters(self) -> Mapping[str, int]:
        """Which steps are partings."""
        return dict.fromkeys(_SHARES, 1) if self.has_partings else {}

    def stage_numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Of partings the force of the step before, and the impulse as a force over that step."""
        return dict(zip(_SHARES, _shares(problem), strict=True)) if self.has_partings else {}

    def next_value(self, name: str, step: Passage) -> Any:
        """Forces in the step."""
        forces = step.forces(self.rows) / step.units[name]
        if not self.has_partings:
            return forces
        own, before = (step.given[share] for share in _SHARES)
        return own * forces + before * step.before[name]

    def show(self, name: str, value: ca.SX) -> ca.SX:
        """Forces at their rows, and zeros at those that are not remembered."""
        found = ca.SX.zeros(self.rows[-1] + 1)
        found[list(self.rows)] = value
        return found

    def units(self, problem: Problem) -> Mapping[str, float]:
        """The largest scale of a contact [N, N m]."""
        return {"reaction": reaction_unit(problem)}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Of which constraint."""
        labels = labels_of(problem)
        return [f"force of {labels[row].name}" for row in self.rows]


def _shares(problem: Problem) -> tuple[Array, Array]:
    """Of a step's own force and of that before it, shapes (N, 1)."""
    table, dts = problem.timeline.switches, fill_lengths(problem, problem.timeline.lengths())
    assert table is not None
    # lengths that are found are those of the phase, in its parting, too
    as_force = 1.0 if problem.timeline.has_free_lengths else dts / np.append(1.0, dts[:-1])
    own = np.where(table.is_parting, as_force, 1.0)
    return own[:, None], table.is_parting.astype(np.float64)[:, None]


def join_partings(problem: Problem, forces: Array) -> Array:
    """Forces (N, any), in partings with those of the steps before."""
    if problem.timeline.switches is None:
        return forces
    own, before = _shares(problem)
    return own * forces + before * np.vstack([np.zeros_like(forces[:1]), forces[:-1]])


def _rows_of(terms: Iterable[ContactTerm]) -> tuple[int, ...]:
    return tuple(sorted({row for term in terms for row in term.of_rows}))


def reaction_unit(problem: Problem) -> float:
    """Unit of the forces that states remember [N]."""
    return max((contact.scale for contact in problem.contacts), default=1.0)


def reactions_along(problem: Problem, at: StateLayout, xs: Array) -> Array:
    """Return forces of the robot's constraints in the steps to the nodes 1..N, shape (N, rows).

    Zero where they are not remembered.

    Parameters
    ----------
    problem : Problem
    at : StateLayout
    xs : ndarray, shape (N + 1, nx)
        States that remember them.
    """
    rows = _rows_of(contact.term for contact in problem.contacts)
    found = np.zeros((len(xs) - 1, rows[-1] + 1 if rows else 0))
    if rows:
        found[:, list(rows)] = reaction_unit(problem) * xs[1:, at.states["reaction"]]
    return found
