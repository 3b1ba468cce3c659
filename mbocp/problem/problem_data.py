"""What a problem is: plain data that follow from what was said of it, and what is read off them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Literal, TypeAlias

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.integrators import ControlKind
from mbocp.problem.contact_bounds import ContactBounds
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.excite import Excite
from mbocp.problem.found_parameter import Parameter, Robust, Tube
from mbocp.problem.goals.end_conditions import (
    accelerations_at_end,
    check_end_conditions,
    controls_at,
    free_at_end,
    holds_anywhere,
    says_whole,
    stops_whole,
)
from mbocp.problem.goals.end_control import EndControl
from mbocp.problem.goals.frames import goal_branches
from mbocp.problem.goals.free_start import FreeStart
from mbocp.problem.goals.goal import Goal
from mbocp.problem.goals.periodic import Periodic
from mbocp.problem.integration import Lie, Stabilisation
from mbocp.problem.limits import Bounds
from mbocp.problem.obstacles.clearance import Clearance, SelfCollision
from mbocp.problem.path import PathConstraint
from mbocp.problem.rate_limits import RateLimit, end_control_limit, end_jerk_limit, rate_limits
from mbocp.problem.solver import Guess, SolverOptions
from mbocp.problem.timeline.hold import Hold, Release
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.phase_values import (
    have_limits,
    heaviest_cost,
    limits_along,
    limits_of_phases,
    weight_shares,
    widest_limits,
)
from mbocp.problem.timeline.step_counts import AskedNodes
from mbocp.problem.timeline.timeline import Timeline
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.weights import Cost
from mbocp.robot import InverseKinematics, Robot
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.terms import OwnTerm
from mbocp.terms.bounded import BoundedTerm

Inequality: TypeAlias = BoundedTerm | RateLimit


@dataclass(frozen=True, kw_only=True, eq=False)
class ProblemData:
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
    timeline : Timeline
        The time [0, T] in phases and junctions: N steps and their lengths, via points, impacts, and which
        constraints act when. `duration`, `duration_range`, `num_steps`, `lengths`, `phase`, `via`, `holds`,
        `releases` and `impacts`, of which `with_` takes others, are read off it.
    accuracy : float, optional
        What errors of steps [rad, m], and that of the cost as a share of it, are to stay below: steps are
        found that do, see `mbocp.accuracy.refining`.
    controls : {"constant", "linear", "stages"}
        How controls vary within a step: not at all; linearly, and continuous; or with a value at each stage
        of the scheme. See `mbocp.integrators.controls`.
    robot : Robot
        The mechanics f, and the holonomic constraints Phi.
    coordinates : {"joint", "natural"}
        In which coordinates the mechanics are written: the joints' own, or positions and directors of all
        bodies, see `mbocp.mechanics.natural_coordinates`. Start, goal and results are in those of the joints
        in either case.
    scheme : str
        How time is discretised, one of `mbocp.integrators.SCHEMES`, or "auto". Of a problem that is
        made, never "auto", which takes what suits it, see `mbocp.problem.integration`.
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
    excite : Excite, optional
        The motion is to tell most about the robot, in the place of the cost.
    limits : Bounds
        On controls, velocities and configurations; none by default.
    robust : Robust, optional
        What is uncertain, for which limits leave room.
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
    u_start : EndControl
        Controls before the start: limits of their rates hold from these on.
    parameter : tuple of Parameter
        Numbers of the robot that are found with the motion.
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
    limits_within : str
        Letters of the limits that are to hold within steps, too, "v" for speeds, "a" for accelerations and
        "m" for what falls with a speed: solves ask for it where they would not.
    tube : Tube, optional
        By how much limits are tightened: solves find it, see `mbocp.robust`.

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
    timeline: Timeline
    accuracy: float | None
    controls: ControlKind
    robot: Robot
    coordinates: Literal["joint", "natural"]
    scheme: str
    lie: Lie
    substeps: int
    stabilisation: Stabilisation
    goal: Goal
    goals: tuple[Goal, ...]
    excite: Excite | None
    chooses_scheme: bool
    scheme_reason: str
    clearance: Clearance | None
    limits: Bounds
    robust: Robust | None
    obstacle: tuple[Obstacle, ...]
    self_collision: SelfCollision | bool | None
    path: tuple[BoundedTerm, ...]
    terms: tuple[OwnTerm, ...]
    q_start: Array
    v_start: Array
    a_start: Array
    u_start: EndControl
    parameter: tuple[Parameter, ...]
    start_free: FreeStart | None
    guess: Guess
    solver: SolverOptions
    source: Path | None
    name: str
    limits_within: str = ""
    tube: Tube | None = None

    @property
    def duration(self) -> float:
        """T [s]; a guess of it where `duration_range` says that it is free."""
        return self.timeline.duration

    @property
    def duration_range(self) -> tuple[float, float] | None:
        """Least and greatest T [s]: T is found with the motion then. None: T is given."""
        return self.timeline.duration_range

    @property
    def num_steps(self) -> int:
        """N, impacts included; with `accuracy` the number with which the search begins."""
        return self.timeline.num_steps

    @property
    def dt(self) -> float:
        """Length of a step [s]; the guess of it where the duration is free."""
        return self.timeline.dt

    @property
    def lengths(self) -> Array | None:
        """Lengths of the steps [s], shape (N,), where they differ and are given one by one."""
        return self.timeline.given_lengths

    @property
    def phase(self) -> tuple[Phase, ...]:
        """Phases with names, of which `num_steps` and `duration` are the sums; empty where there are none."""
        return self.timeline.named_phases

    @property
    def via(self) -> tuple[ViaPoint, ...]:
        """States, or poses of frames, that the motion goes through, in their order."""
        return tuple(point.via for point in self.timeline.waypoints)

    @property
    def holds(self) -> tuple[Hold, ...]:
        """Constraints that are taken on and let go along the horizon, see `mbocp.problem.timeline.hold`."""
        return self.timeline.schedule.holds

    @property
    def releases(self) -> tuple[Release, ...]:
        """Steps in which constraints of the robot itself do not hold."""
        return self.timeline.schedule.releases

    @property
    def impacts(self) -> tuple[int, ...]:
        """Steps of no duration, in which velocities leap: M (v+ - v-) = Phi_q^T Lambda."""
        return self.timeline.impacts

    @property
    def asked_nodes(self) -> AskedNodes:
        """What says where nodes are."""
        return AskedNodes.of(self.timeline, self.path, self.terms)

    @cached_property
    def is_bounded(self) -> bool:
        """Whether there are inequalities: limits, path constraints or bounds of a free duration."""
        has_bounds = self.start_free is not None and self.start_free.is_bounded
        is_limited = self.widest_limits.any_finite or bool(self.path or self.parameter)
        return is_limited or self.timeline.has_free_lengths or has_bounds

    @cached_property
    def widest_limits(self) -> Bounds:
        """Bounds that are finite where those of any phase are, and as wide as the widest of them."""
        return widest_limits(self.limits, self.timeline.phases)

    @property
    def has_limits_of_phases(self) -> bool:
        """Whether limits differ from phase to phase."""
        return have_limits(self.timeline.phases)

    def limits_along(self) -> Mapping[str, tuple[Array, Array]]:
        """Lower and upper bounds at the nodes 1..N, or in the N steps, by letters of `LIMITS`.

        Shapes are (N, n), or (1, n) where limits are the same in all phases.
        """
        return limits_along(self.limits, self.timeline.phases)

    @cached_property
    def limits_of_ends(self) -> tuple[Bounds, Bounds]:
        """Limits at the start and at the end: those of the first and of the last phase."""
        each = limits_of_phases(self.limits, self.timeline.phases)
        return each[0], each[-1]

    @cached_property
    def heaviest_cost(self) -> Cost:
        """The cost with the largest weights of all phases."""
        return heaviest_cost(self.cost, self.timeline.phases, self.robot)

    @property
    def weight_shares(self) -> dict[str, Array]:
        """Which part of the heaviest weights counts in each step, shape (N, size), by the term's key."""
        return weight_shares(self.cost, self.timeline.phases, self.robot)

    @cached_property
    def rate_limits(self) -> tuple[RateLimit, ...]:
        """Limits of accelerations, jerks, rates of controls and powers, one for each key that has some."""
        return rate_limits(self.robot, self.widest_limits)

    @cached_property
    def end_limits(self) -> tuple[RateLimit, ...]:
        """Limits of jerks and rates with which accelerations and controls become those at the end."""
        at_end, goal = self.limits_of_ends[1], self.goal
        timeline = self.timeline
        length = (
            timeline.dt if timeline.has_free_lengths else float(timeline.lengths()[~timeline.is_impact][-1])
        )
        limits = end_jerk_limit(
            self.robot, at_end, *accelerations_at_end(self.robot, goal, self.a_start), length
        )
        u = self.u_after
        if u is None:
            return limits
        goal_u = None if isinstance(u, str) else u
        is_linear = self.controls == "linear"
        return (*limits, *end_control_limit(self.robot, at_end, goal_u, length, is_linear=is_linear))

    @cached_property
    def u_before(self) -> Array | None:
        """Controls before the start, shape (nu,), from which limits of their rates lead; None: free."""
        if "du" not in self.widest_limits.letters:
            return None
        begins = not (self.v_start.any() or self.a_start.any()) and self.start_free is None and self._is_known
        return controls_at(self.robot, self.u_start, self.limits_of_ends[0], self.q_start, rests=begins)

    @cached_property
    def u_after(self) -> Array | Literal["held"] | None:
        """Controls after the end, shape (nu,), to which limits of their rates lead; None: free.

        Of open chains with a motor for each joint, wherever these end, what holds them.
        """
        said, robot, goal = self.goal.u, self.robot, self.goal
        if goal.periodic is not None and said.rule == "rest" and goal.periodic == Periodic():
            return self.u_before
        if "du" not in self.widest_limits.letters or not (said.rule == "given" or self._is_known):
            return None
        follows = COORDINATES[self.coordinates].has_joint_states and holds_anywhere(robot)
        rests = stops_whole(robot, goal) and (follows or says_whole(robot, goal))
        u = controls_at(robot, said, self.limits_of_ends[1], goal.q, rests=rests)
        return "held" if u is not None and follows and said.rule == "rest" else u

    @property
    def _is_known(self) -> bool:
        """Whether the robot, and what it stands on, are those of the problem all along."""
        return not self.parameter and self.timeline.switches is None

    @property
    def sets_acceleration(self) -> BoolArray:
        """Accelerations of the last step that the goal asks for, shape (nv,), but for limits of jerk."""
        return self.goal.a_active & ~self.limits_of_ends[1].finite("j")

    @cached_property
    def inequalities(self) -> tuple[Inequality, ...]:
        """Path constraints and limits of rates: functions of a state that have bounds."""
        return (*self.path, *self.limits_of_rates)

    @cached_property
    def limits_of_rates(self) -> tuple[RateLimit, ...]:
        """All of them, those at the end last: the rows after those of the path constraints."""
        return (*self.rate_limits, *self.end_limits)

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
    def num_end_conditions(self) -> int:
        """Number of independent exact end conditions, after the null-space projection."""
        return check_end_conditions(self.robot, self.goal, self.num_steps)

    def free_at_end(self, q: Array) -> Array:
        """Directions of velocities that the constraints of the last step leave at q, shape (nv, any)."""
        return free_at_end(self.robot, self.timeline.switches, q)
