"""The optimal control problem as one immutable value."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from mbocp._arrays import Array
from mbocp._linear import null_space
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.integrators import ControlKind
from mbocp.mechanisms.consistency import tangent_space
from mbocp.problem._checks import ProblemWarning, check_choice, check_integer
from mbocp.problem.completion import (
    PathObject,
    checked_terms,
    listed_path,
    ordered_via,
    phases_of_via,
    spread_phases,
    via_placed,
    with_contacts,
    with_places,
)
from mbocp.problem.contact_bounds import ContactBounds
from mbocp.problem.coordinate_checks import check_coordinates
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.cost import Cost
from mbocp.problem.default_scheme import AUTO_SCHEME, chosen_scheme
from mbocp.problem.file.changes import changed
from mbocp.problem.file.read import from_tables
from mbocp.problem.goals.consistency import check_end_conditions
from mbocp.problem.goals.ends import checked_acceleration, checked_start, completed_goal
from mbocp.problem.goals.frames import goal_branches
from mbocp.problem.goals.free_start import FreeStart, check_free_start, check_periodic
from mbocp.problem.goals.goal import Goal
from mbocp.problem.goals.goal_set import reachable_members
from mbocp.problem.goals.rest import at_rest
from mbocp.problem.guess import Guess
from mbocp.problem.integration import (
    Lie,
    Scheme,
    Stabilisation,
    check_control_terms,
    check_controls,
    check_integrator,
)
from mbocp.problem.limits import Bounds, check_limits
from mbocp.problem.obstacles.clear_goal import clear_configuration
from mbocp.problem.obstacles.clearance import Clearance, SelfCollision
from mbocp.problem.obstacles.clearance_pairs import clearance_of
from mbocp.problem.path import PathConstraint, check_path
from mbocp.problem.rates import RateLimit, check_rates, rate_limits
from mbocp.problem.solver import SolverOptions
from mbocp.problem.timeline.duration import check_duration
from mbocp.problem.timeline.hold import Hold, Release
from mbocp.problem.timeline.hold_checks import check_holds
from mbocp.problem.timeline.named_phase import Horizon, NamedPhase, are_alike, step_counts
from mbocp.problem.timeline.phase_cost import heaviest_cost, weight_shares
from mbocp.problem.timeline.phase_holds import Switches, checked_switches
from mbocp.problem.timeline.phase_limits import limits_along, limits_of_phases, widest_limits
from mbocp.problem.timeline.phases import Phase, free_phases
from mbocp.problem.timeline.seam import check_seam
from mbocp.problem.timeline.step_counts import first_count
from mbocp.problem.timeline.step_table import check_accuracy, check_lengths, check_takes_steps
from mbocp.problem.timeline.switches import SwitchTable, switch_table
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.timeline.via_constraint import ViaConstraint
from mbocp.problem.timeline.via_points import via_constraints
from mbocp.problem.together import (
    check_guess,
    check_has_actuators,
    check_leaps,
    check_method,
    check_weights,
)
from mbocp.problem.warn import warn_alternating
from mbocp.robot import InverseKinematics, Robot
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.terms import OwnTerm

__all__ = ["COORDINATES", "Problem", "ProblemWarning"]

Inequality: TypeAlias = PathObject | RateLimit


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    r"""Optimal control of a multibody system, Eqs. (6) to (9) of [Bijalwan2025]_.

    .. math::
        \min_{y,\, u} \quad & \mathcal{J} = \int_0^T \mathcal{L}(y, u)\, dt + \beta_T\, \psi(y(T)) & (7) \\
        & \mathcal{L} = \tfrac{\beta}{2} (y - y_d)^T Q (y - y_d) + \tfrac{\alpha}{2} u^T u          & (8) \\
        & \psi = \tfrac{1}{2} (y(T) - y_T)^T Q_T (y(T) - y_T)                                       & (9) \\
        \text{s.t.} \quad
        & \dot{y} = f(y, \lambda, u), \qquad \Phi(q) = 0                                            & (6) \\
        & \gamma\, g_T(y(T)) = 0                                                                      \\
        & \underline{u} \le u \le \overline{u}, \quad \underline{y} \le y \le \overline{y}, \quad
            \underline{h} \le h(q, v) \le \overline{h}                                                \\
        & y(0) = y_0

    with the state y = (q, p), the momentum p = M(q) v, and the time [0, T] in N steps of length dt. The
    fields follow the formula: what is minimised and over which time, which mechanics, which end, which
    limits, which start; then how to begin and how to solve. `Problem.create` takes the same words as a
    problem file.

    Limits of the robot are enforced only where `limits` has them. A start or goal outside position limits
    that are not is a `ProblemWarning`.

    Attributes
    ----------
    cost : Cost
        alpha, beta, Q, y_d, beta_T, Q_T and y_T of Eqs. (7) to (9).
    duration : float
        T [s]; a guess of it where `duration_range` says that it is free.
    duration_range : tuple of float, optional
        Least and greatest T [s]. T is found with the motion then, and `cost` may weigh it. None: T is given.
    phase : tuple of NamedPhase
        Phases one after the other, each with a duration of its own and with what differs in it: `num_steps`
        and `duration` are their sums. Empty where there are none with names.
    phases : tuple of Phase
        Runs of steps that are as long as each other, where lengths are found with the motion: one for a free
        duration, and more where times of via points are free, too, or durations of `phase`. Follows from the
        others.
    num_steps : int
        N, impacts included; with `accuracy` the number with which the search begins.
    lengths : ndarray, shape (N,), optional
        Lengths of the steps [s], where they differ and are given.
    accuracy : float, optional
        What errors of steps [rad, m], and that of the cost as a share of it, are to stay below: steps are
        found that do, see `mbocp.accuracy.refining`.
    controls : {"constant", "linear", "stages"}
        How controls vary within a step: not at all; linearly, and continuous; or with a value at each stage
        of the scheme. See `mbocp.integrators.controls`.
    holds : tuple of Hold
        Constraints that are taken on and let go along the horizon, see `mbocp.problem.timeline.hold`. Where
        phases hold or release something, this and the next two follow from them.
    releases : tuple of Release
        Steps in which constraints of the robot itself do not hold.
    impacts : tuple of int
        Steps of no duration, counted from 0, in which velocities leap: M (v+ - v-) = Phi_q^T Lambda. The
        others are as long as each other, or as long as `phases` says.
    robot : Robot
        The mechanics f, and the holonomic constraints Phi.
    coordinates : {"joint", "natural"}
        In which coordinates the mechanics are written: the joints' own, or positions and directors of all
        bodies, see `mbocp.mechanics.natural_coordinates`. Start, goal and results are in those of the joints
        in either case.
    scheme : {"auto", "se1", "se2", "midpoint", "semi_implicit_euler", "gauss1", "gauss2", "gauss3", \
            "lobatto2", "lobatto3", "euler", "heun", "rk4", "rkf5"}
        How time is discretised, see `mbocp.integrators`; the last four are explicit. Of a problem that is
        made, never "auto", which takes what suits it, see `mbocp.problem.default_scheme`.
    chooses_scheme : bool
        Whether the scheme was left open, and another may be taken where the problem changes.
    scheme_reason : str
        What of the problem decided then, as a phrase; empty where the scheme was named.
    lie : {"plain", "baumgarte", "munthe_kaas"}
        How explicit schemes keep rotations on their manifold: not at all, by stabilisation, or by
        construction.
    substeps : int
        Steps of an explicit scheme within each of the N.
    stabilisation : Stabilisation
        Rates for ``lie = "baumgarte"`` and for holonomic constraints.
    goal : Goal
        g_T and gamma; of several goals the first that is not out of reach.
    goals : tuple of Goal
        Several of which the best is taken; empty where there is one goal.
    limits : Bounds
        On controls, velocities and configurations; none by default.
    via : tuple of ViaPoint
        States, or poses of frames, that the motion goes through.
    obstacle : tuple of Obstacle
        Shapes that the links keep away from.
    self_collision : SelfCollision, optional
        Whether links keep away from each other; True: with the defaults.
    path : tuple of PathConstraint
        h: where frames may be, and how fast; path constraints among `terms`; tolerances of the goal's
            frames; `via`; `obstacle` and `self_collision` as one `Clearance`.
    terms : tuple of OwnTerm
        Costs, path constraints and end conditions of one's own, see `mbocp.terms.own`.
    q_start : ndarray, shape (nq,)
        Configuration of y_0 [m, rad, unit quaternion xyzw].
    v_start : ndarray, shape (nv,)
        Velocity of y_0 [m/s, rad/s].
    a_start : ndarray, shape (nv,), optional
        Acceleration before the start, the mean of a step that would end there: limits of jerk hold from it
        on. Zero by default [m/s^2, rad/s^2].
    start_free : FreeStart, optional
        Which entries of q_start and v_start are guesses, and found with the motion; None: all are given.
    guess : Guess
        Where the solver starts.
    solver : SolverOptions
        Which solver, and when it stops.
    source : Path, optional
        The problem file.
    name : str
        What the problem is called in output; the stem of the file.

    Raises
    ------
    DimensionMismatch, InvalidValue, ProblemError
        If a value does not fit the robot, or cannot be right.
    InconsistentStart
        If start or exact goal violate a holonomic constraint, at position or velocity level.
    UnreachableGoal
        If closed loops keep the robot from getting to an exact goal, or all of several are out of reach.
    UnreachablePose
        If nothing within the limits brings a frame to the pose of an exact goal.
    OverdeterminedGoal
        If there are more exact end conditions than the controls can meet.
    """

    cost: Cost
    duration: float
    duration_range: tuple[float, float] | None = None
    num_steps: int
    lengths: Array | None = None
    accuracy: float | None = None
    controls: ControlKind = "constant"
    holds: tuple[Hold, ...] = ()
    releases: tuple[Release, ...] = ()
    impacts: tuple[int, ...] = ()
    phase: tuple[NamedPhase, ...] = ()
    robot: Robot
    coordinates: Literal["joint", "natural"] = "joint"
    scheme: Scheme = "auto"
    lie: Lie = "munthe_kaas"
    substeps: int = 1
    stabilisation: Stabilisation = field(default_factory=Stabilisation)
    goal: Goal
    goals: tuple[Goal, ...] = ()
    phases: tuple[Phase, ...] = field(init=False, repr=False, default=())
    _bounds_of_sum: tuple[float, float] = field(init=False, repr=False, default=(0.0, math.inf))
    _members: tuple[tuple[int, Problem], ...] = field(init=False, repr=False, default=())
    chooses_scheme: bool = field(init=False, repr=False, default=False)
    scheme_reason: str = field(init=False, repr=False, default="")
    clearance: Clearance | None = field(init=False, repr=False, default=None)
    switches: SwitchTable | None = field(init=False, repr=False, default=None)
    limits: Bounds = field(default_factory=Bounds)
    via: tuple[ViaPoint, ...] = ()
    obstacle: tuple[Obstacle, ...] = ()
    self_collision: SelfCollision | bool | None = None
    path: tuple[PathObject, ...] = ()
    terms: tuple[OwnTerm, ...] = ()
    q_start: Array
    v_start: Array
    a_start: Array = field(default_factory=lambda: np.zeros(0))
    start_free: FreeStart | None = None
    guess: Guess = field(default_factory=Guess)
    solver: SolverOptions = field(default_factory=SolverOptions)
    source: Path | None = None
    name: str = "problem"

    def __post_init__(self) -> None:
        self._set(goals=tuple(self.goals))
        if self.goals:
            self._take_members()
            return
        self._take_time()
        check_choice("coordinates", self.coordinates, COORDINATES)
        self._take_scheme()
        options = (self.lie, self.substeps, self.stabilisation)
        check_integrator(self.robot, self.scheme, *options, suits=self.scheme_reason)
        check_controls(self.controls, self.scheme)
        check_has_actuators(self.robot)
        self._set(limits=self.limits.completed(self.robot))
        self._take_phases()
        self._check_coordinates()
        self._take_terms()
        q_start, v_start = checked_start(self.robot, self.limits_of_ends[0], self.q_start, self.v_start)
        self._set(q_start=q_start, v_start=v_start)
        self._set(a_start=checked_acceleration(self.robot, self.limits_of_ends[0], self.a_start))
        self._take_holds()
        nodes = self._take_via()
        self._take_goal()
        self._place_via(nodes)
        self._take_obstacles()
        self._check_free_start()
        check_takes_steps(self)
        self._check_cost()
        self._check_inequalities()
        check_guess(self.guess, self.robot, self.coordinates)

    @property
    def dt(self) -> float:
        """Length of a step [s]; the guess of it where the duration is free."""
        return self.duration / self.num_timed_steps

    @property
    def num_timed_steps(self) -> int:
        """Number of the steps that take time: all but impacts."""
        return self.num_steps - len(self.impacts)

    @property
    def has_free_duration(self) -> bool:
        """Whether the duration is found with the motion."""
        return self.duration_range is not None

    @property
    def has_free_lengths(self) -> bool:
        """Whether lengths of steps are found with the motion: the duration, or times on the way."""
        return bool(self.phases)

    @property
    def has_unequal_lengths(self) -> bool:
        """Whether lengths of steps are given, and differ."""
        return self.lengths is not None or (not self.phases and not are_alike(self.phase))

    @property
    def _num_lengths(self) -> int:
        """Number of lengths of steps that are found, or differ; 0 where all are given and the same."""
        return len(self.phase) if self.has_unequal_lengths else len(self.phases)

    @property
    def is_bounded(self) -> bool:
        """Whether there are inequalities: limits, path constraints or bounds of a free duration."""
        has_bounds = self.start_free is not None and self.start_free.is_bounded
        return self.widest_limits.any_finite or bool(self.path) or self.has_free_lengths or has_bounds

    @property
    def widest_limits(self) -> Bounds:
        """Bounds that are finite where those of any phase are, and as wide as the widest of them."""
        return widest_limits(self.limits, self.phase)

    @property
    def has_limits_of_phases(self) -> bool:
        """Whether limits differ from phase to phase."""
        return any(phase.limits.any_finite for phase in self.phase)

    def limits_along(self) -> Mapping[str, tuple[Array, Array]]:
        """Lower and upper bounds at the nodes 1..N, or in the N steps, by letters of `LIMITS`.

        Shapes are (N, n), or (1, n) where limits are the same in all phases.
        """
        return limits_along(self.limits, self.phase)

    @property
    def limits_of_ends(self) -> tuple[Bounds, Bounds]:
        """Limits at the start and at the end: those of the first and of the last phase."""
        each = limits_of_phases(self.limits, self.phase) or [self.limits]
        return each[0], each[-1]

    @property
    def heaviest_cost(self) -> Cost:
        """The cost with the largest weights of all phases."""
        return heaviest_cost(self.cost, self.phase, self.robot)

    @property
    def weight_shares(self) -> dict[str, Array]:
        """Which part of the heaviest weights counts in each step, shape (N, size), by the term's key."""
        counts = step_counts(self.phase)
        shares = weight_shares(self.cost, self.phase, self.robot)
        return {key: np.repeat(rows, counts, axis=0) for key, rows in shares.items()}

    @property
    def rate_limits(self) -> tuple[RateLimit, ...]:
        """Limits of accelerations, jerks, rates of controls and powers, one for each key that has some."""
        return rate_limits(self.robot, self.widest_limits)

    @property
    def inequalities(self) -> tuple[Inequality, ...]:
        """Path constraints and limits of rates: functions of a state that have bounds."""
        return (*self.path, *self.rate_limits)

    @property
    def waypoints(self) -> tuple[ViaConstraint, ...]:
        """The via points among the path constraints, in the order of their nodes."""
        return tuple(constraint for constraint in self.path if isinstance(constraint, ViaConstraint))

    @property
    def frame_constraints(self) -> tuple[PathConstraint, ...]:
        """The path constraints of `[[path]]`."""
        return tuple(constraint for constraint in self.path if isinstance(constraint, PathConstraint))

    @property
    def contacts(self) -> tuple[ContactBounds, ...]:
        """The bounds of contact forces among the path constraints."""
        return tuple(constraint for constraint in self.path if isinstance(constraint, ContactBounds))

    @property
    def p_start(self) -> Array:
        """Momentum at the start, shape (nv,) [kg m/s, N m s]."""
        return self.robot.momentum(self.q_start, self.v_start)

    def goal_branches(self) -> InverseKinematics:
        """Configurations at the poses that the goal asks of frames, the nearest to the start first.

        They are searched for now: a problem is made with a `goal.q` of a short search, the nearest to the
        start of the first few that it finds. ``replace(goal, q=...)`` takes another.

        Raises
        ------
        InvalidValue
            If the goal asks for no pose.
        """
        return goal_branches(self.robot, self.goal, self.q_start, self.limits)

    @property
    def members(self) -> tuple[tuple[int, Problem], ...]:
        """Place among `goals` and problem of each that is in reach; of one goal the problem itself."""
        return self._members or ((0, self),)

    def member(self, place: int | None) -> Problem:
        """The problem of one of several goals by its place among `goals`; None: of the first in reach."""
        return dict(self._members).get(place, self) if place is not None else self

    @property
    def num_end_conditions(self) -> int:
        """Number of independent exact end conditions, after the null-space projection."""
        return check_end_conditions(self.robot, self.goal, self.num_steps)

    @classmethod
    def create(
        cls,
        robot: Robot | str | Path | Mapping[str, Any],
        duration: float | Mapping[str, float] | None = None,
        steps: int | None = None,
        *,
        accuracy: float | None = None,
        controls: str | None = None,
        phase: Sequence[Mapping[str, Any]] | None = None,
        start: Mapping[str, Any] | None = None,
        goal: Mapping[str, Any] | None = None,
        cost: Mapping[str, Any] | None = None,
        limits: Mapping[str, Any] | None = None,
        via: Sequence[Mapping[str, Any]] | None = None,
        obstacle: Sequence[Mapping[str, Any]] | None = None,
        self_collision: bool | Mapping[str, Any] | None = None,
        path: Sequence[Mapping[str, Any]] | None = None,
        terms: Sequence[OwnTerm] = (),
        guess: Mapping[str, Any] | None = None,
        integrator: Mapping[str, Any] | None = None,
        solver: Mapping[str, Any] | None = None,
        coordinates: str = "joint",
        scheme: str = "",
        name: str = "problem",
    ) -> Problem:
        """Make a problem from the words of a problem file.

        Parameters
        ----------
        robot : Robot, str, Path or mapping
            A loaded robot, or what the key `robot` of a file takes.
        duration : float or mapping
            [s]; with `min`, `max` and, if you like, `guess`: free between the two. Left out with `phase`:
            what phases sum up to.
        steps : int
            Left out with `phase`, and with `accuracy`.
        accuracy : float, optional
            Of the motion, in place of the number of steps.
        controls : {"constant", "linear", "stages"}, optional
            How controls vary within a step; constant by default.
        phase : sequence of mapping, optional
            The tables `[[phase]]`.
        start, goal, cost, limits, guess, integrator, solver : mapping, optional
            The tables of a problem file; arrays may be NumPy's.
        via, obstacle, path : sequence of mapping, optional
            The tables `[[via]]`, `[[obstacle]]` and `[[path]]`.
        self_collision : bool or mapping, optional
            The key or table `self_collision`.
        terms : sequence of OwnTerm
            Terms of one's own, see `mbocp.terms.own`.
        scheme : str
            Short for the key `scheme` of `integrator`; what suits the problem where neither is given.

        Examples
        --------
        >>> goal = {"q": [0.5, -1, 1, 0, 0.5, 0], "v": [0] * 6}
        >>> problem = Problem.create("ur5", 1.0, 100, goal=goal)  # doctest: +SKIP
        """
        horizon = {"duration": duration, "steps": steps, "accuracy": accuracy, "controls": controls}
        tables = {
            "phase": phase,
            "start": start,
            "goal": goal,
            "cost": cost,
            "limits": limits,
            "via": via,
            "obstacle": obstacle,
            "self_collision": self_collision,
            "path": path,
            "guess": guess,
            "solver": solver,
        }
        document = {
            "horizon": {key: value for key, value in horizon.items() if value is not None},
            "coordinates": coordinates,
            "integrator": {**(integrator or {}), **({"scheme": scheme} if scheme else {})},
            **{key: table for key, table in tables.items() if table is not None},
        }
        return from_tables(cls, document, robot=robot, name=name, terms=terms)

    def with_(self, **changes: Any) -> Problem:
        """Return a copy with some fields changed, validated again.

        Parameters
        ----------
        **changes
            Fields of this class, or words of `create`: of a table only the keys that are given change
            (``cost={"velocity": 1.0}``), `guess`, `via` and `path` are replaced as a whole. A `frame` takes
            the place of a `q` of the goal that gives every joint.

        Raises
        ------
        ProblemError
            If there is no such field or word, or a value is of the wrong kind.
        """
        return changed(self, changes)

    def _set(self, **values: Any) -> None:
        """Set fields while the problem is made."""
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _take_members(self) -> None:
        """Problems of the goals that are not out of reach; all but the goals is as in the first of them."""
        members = reachable_members(self)
        first = members[0][1]
        kept = [name for name in self.__dataclass_fields__ if name not in ("goals", "_members")]
        self._set(_members=members, **{name: getattr(first, name) for name in kept})

    def _take_time(self) -> None:
        """Check duration and steps."""
        duration, duration_range = check_duration(self.duration, self.duration_range)
        steps = check_integer("horizon.steps", self.num_steps, minimum=1)
        self._set(accuracy=check_accuracy(self.accuracy))
        if self.accuracy is not None and self.lengths is None and not self.phase:
            steps = first_count(self)
        self._set(lengths=check_lengths(self.lengths, steps, duration))
        impacts = tuple(sorted({int(step) for step in self.impacts}))
        self._set(duration=duration, duration_range=duration_range, num_steps=steps, impacts=impacts)

    def _take_scheme(self) -> None:
        """Choose a scheme where the problem leaves it open."""
        if self.scheme == AUTO_SCHEME:
            chosen = chosen_scheme(self)
            self._set(scheme=chosen.scheme, chooses_scheme=True, scheme_reason=chosen.reason)

    def _take_phases(self) -> None:
        """Check phases against the horizon; find what they hold, and what durations sum up to."""
        given = Switches(tuple(self.holds), tuple(self.releases), self.impacts)
        self._set(**checked_switches(self.phase, given)._asdict())
        if self.phase:
            horizon = Horizon(self.num_steps, self.duration, self.duration_range)
            phases, bounds = spread_phases(self.robot, self.phase, self.limits, self.cost, horizon)
            self._set(phase=phases, _bounds_of_sum=bounds)

    def _take_terms(self) -> None:
        """Check terms of one's own; list path constraints."""
        terms = checked_terms(self.terms, self.robot)
        self._set(terms=terms, path=listed_path(self.path, terms, self.goal, self.robot))

    def _take_holds(self) -> None:
        """Find which rows of constraints act in which steps, and whose forces are bounded."""
        check_holds(self)
        if self.holds or self.releases or self.impacts:
            own = (self.robot, self.holds, self.releases, self.impacts, self.num_steps)
            table = switch_table(*own, (self.q_start, self.v_start))
            check_leaps(table, self.coordinates)
            self._set(switches=table)
        self._set(path=with_contacts(self.path, self.robot, self.scheme, self.switches))

    def _take_via(self) -> list[int | None]:
        """Via points in the order of the motion, with configurations; their nodes, as far as known."""
        horizon = Horizon(self.num_steps, self.duration, self.duration_range)
        start = self.q_start
        found, nodes = ordered_via(self.robot, self.via, self.phase, horizon, start, self.limits)
        self._set(via=found)
        return nodes

    def _take_goal(self) -> None:
        """Complete the goal with what its poses and loops leave open."""
        goal = completed_goal(
            self.robot,
            self.goal,
            self.limits_of_ends[1],
            self.q_start,
            self.via[-1].goal.q if self.via else self.q_start,
            num_steps=self.num_steps,
            scheme=self.scheme,
            suits=self.scheme_reason,
            closes_loops=self.switches is None or bool(self.switches.own[-1].all()),
        )
        self._set(goal=at_rest(self.robot, goal, self.limits_of_ends[1], self.free_at_end(goal.q)))
        check_end_conditions(self.robot, self.goal, self.num_steps)

    def free_at_end(self, q: Array) -> Array:
        """Directions of velocities that the constraints of the last step leave at q, shape (nv, any)."""
        if self.switches is None:
            return tangent_space(self.robot, q)
        return null_space(self.switches.at_end(q, of_rates=True), RANK_TOLERANCE)

    def _place_via(self, nodes: list[int | None]) -> None:
        """Find nodes and phases of via points; as path constraints they come last."""
        at = via_placed(self.robot, self.via, nodes, self.q_start, self.goal, self.num_steps)
        found = via_constraints(self.robot, self.via, at, self.num_steps)
        self._set(via=tuple(constraint.via for constraint in found))
        self._set(path=with_places(self.path, found, self.switches, self.phase))
        if self.phase:
            self._set(phases=free_phases(self.phase, self.duration, self._bounds_of_sum))
            return
        horizon = Horizon(self.num_steps, self.duration, self.duration_range)
        self._set(phases=phases_of_via(self.via, at, horizon, self.impacts))

    def _take_obstacles(self) -> None:
        """Pairs of spheres and what they keep away from, as the last path constraint."""
        said = self.self_collision
        own = said if isinstance(said, SelfCollision) else SelfCollision() if said else None
        self._set(obstacle=tuple(self.obstacle), self_collision=own)
        if self.obstacle or own is not None:
            found = clearance_of(self.robot, self.obstacle, own, self.limits)
            self._set(clearance=found, path=(*self.path, found) if found.rows else self.path)
            ends = (self.q_start, self.limits_of_ends[1])
            self._set(goal=clear_configuration(self.robot, self.goal, *ends, found))

    def _check_coordinates(self) -> None:
        """Refuse what these coordinates do not take."""
        check_coordinates(
            self.robot,
            self.coordinates,
            self.scheme,
            self.widest_limits,
            self.goal,
            via=self.via,
            is_free=self.has_free_duration or any(phase.is_free for phase in self.phase),
        )

    def _check_free_start(self) -> None:
        """Refuse a free start, and a periodic motion, where they do not fit the rest."""
        check_periodic(self.robot, self.goal, self.coordinates)
        table, free = self.switches, self.start_free
        if table is not None:
            check_seam(table, free, self.goal.periodic, (self.q_start, self.goal.q))
        if free is not None:
            state, limits = (self.q_start, self.v_start), self.limits_of_ends[0]
            check_free_start(self.robot, free, limits, state, coordinates=self.coordinates, switches=table)

    def _check_cost(self) -> None:
        """Refuse weights that do not fit the robot, or do not go with the goal."""
        cost = self.cost.on_controls(self.robot.nu)
        self._set(cost=cost)
        cost.check_controls(self.limits.finite("u"), [label.name for label in self.robot.u_labels])
        cost.check_dimensions(self.robot.nq, self.robot.nv, self.num_steps)
        more = bool(self.terms or self.via)
        is_free = self.has_free_duration or any("time" in phase.weights for phase in self.phase)
        check_weights(cost, self.goal, is_free=is_free, has_more=more)

    def _check_inequalities(self) -> None:
        """Refuse limits and path constraints that cannot hold, or that the method would not keep."""
        check_rates(self.robot, self.limits)
        check_control_terms(self.controls, self.heaviest_cost, self.widest_limits, self.limits_along()["u"])
        first, last = self.limits_of_ends
        check_limits(self.robot, first, self.q_start, self.v_start, self.goal, of_end=last)
        N, dt = self.num_steps, self.dt
        ends = (self.q_start, self.v_start, self.goal)
        check_path(self.robot, self.path, *ends, num_steps=N, dt=dt, num_phases=self._num_lengths)
        warn_alternating(self.frame_constraints, self.goal, self.scheme, num_steps=N, dt=dt)
        if self.is_bounded:
            table = "limits" if self.widest_limits.any_finite else "via" if self.via else "path"
            table = "obstacle" if self.clearance is not None else table
            has_times = len(self.phases) > 1
            check_method(self.solver, table, is_free=self.has_free_duration, has_free_times=has_times)
