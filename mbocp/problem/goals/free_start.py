r"""A start that is found with the motion: which entries of q(0) and v(0) are free, and between which bounds.

The given start is the guess of what is free. With w the move from it,

.. math:: x_0 = (\bar q \exp(E_q w), \; \bar v + E_v w),

where the columns of E are unit vectors of the free directions. See `mbocp.formulation.features.moved_start`
for how w becomes a control of the first step.
"""

from __future__ import annotations

from dataclasses import field

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass, frozen_array, frozen_mask
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import DimensionMismatch, ProblemError
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.goals.goal import Goal
from mbocp.problem.goals.periodic import numbers_of
from mbocp.problem.limits import Bounds
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.robot import Robot

_KEY = "start.free"
_NUM_POSES = 2  # beside the start, at which a row that nothing free moves has no derivative either
_SPREAD = 0.2  # [m, rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeStart:
    """Which entries of the start are free.

    Attributes
    ----------
    q, v : ndarray of bool, shape (nv,)
        Directions of the configuration, and components of the velocity.
    lower, upper : ndarray, shape (2 nv,), optional
        Bounds of q and v at the start [m, rad, m/s, rad/s]; infinite where there are none, which is the
        default. Of q only where a joint has one number.
    """

    q: BoolArray
    v: BoolArray
    lower: Array = field(default_factory=lambda: frozen_array(np.zeros(0)))
    upper: Array = field(default_factory=lambda: frozen_array(np.zeros(0)))

    def __post_init__(self) -> None:
        nv = np.asarray(self.v).size
        for key in ("q", "v"):
            object.__setattr__(self, key, frozen_mask(getattr(self, key), size=nv, name=f"{_KEY}.{key}"))
        for key, none in (("lower", -np.inf), ("upper", np.inf)):
            given = np.asarray(getattr(self, key))
            array = given if given.size else np.full(2 * nv, none)
            object.__setattr__(self, key, frozen_array(array, shape=(2 * nv,), name=f"{_KEY}.{key}"))
        if not (self.q.any() or self.v.any()):
            raise ProblemError(f"{_KEY}: nothing is free; name joints, or leave it out")

    @property
    def mask(self) -> BoolArray:
        """Which directions of (q, v) are free, shape (2 nv,)."""
        return np.concatenate([self.q, self.v])

    @property
    def directions(self) -> tuple[int, ...]:
        """Indices of the free directions of (q, v)."""
        return tuple(int(i) for i in np.flatnonzero(self.mask))

    @property
    def is_bounded(self) -> bool:
        """Whether it has bounds of its own."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())


def start_bounds(robot: Robot, limits: Bounds, free: FreeStart, q: Array, v: Array) -> tuple[Array, Array]:
    """Lower and upper bounds of the moves w from the guess (q, v), shapes (number of directions,).

    Those of the start and, where they are finite, the limits of positions and velocities.
    """
    lower, upper = np.array(free.lower), np.array(free.upper)
    at, nv = numbers_of(robot), robot.nv
    plain = at >= 0
    guess = np.concatenate([np.where(plain, q[at], 0.0), v])
    lower[:nv][plain] = np.maximum(lower[:nv][plain], limits.q_lower[at[plain]])
    upper[:nv][plain] = np.minimum(upper[:nv][plain], limits.q_upper[at[plain]])
    lower[nv:], upper[nv:] = np.maximum(lower[nv:], limits.v_lower), np.minimum(upper[nv:], limits.v_upper)
    return (lower - guess)[free.mask], (upper - guess)[free.mask]


def check_free_start(
    robot: Robot,
    start_free: FreeStart | None,
    limits_at_start: Bounds,
    q_start: Array,
    v_start: Array,
    coordinates: str,
    switches: SwitchTable | None,
) -> None:
    """Refuse a free start that does not fit robot, limits or coordinates.

    Parameters
    ----------
    q_start, v_start : ndarray, shapes (nq,), (nv,)
        The guess of what is free.
    switches : SwitchTable, optional
        What acts when, where that changes.

    Raises
    ------
    DimensionMismatch, ProblemError
    """
    free = start_free
    if free is None:
        return
    if free.v.size != robot.nv:
        raise DimensionMismatch(_KEY, free.v.size, robot.nv)
    if not COORDINATES[coordinates].has_joint_states:
        raise ProblemError(f'{_KEY}: is for coordinates = "joint", where states are q and v; take them')
    if robot.drives:
        raise ProblemError(
            f"{_KEY}: controls of robot {robot.name!r} prescribe velocities, and its start has to be given; "
            "leave the key out"
        )
    _check_constraints(robot, free, q_start, v_start, switches)
    _check_bounds(robot, free, limits_at_start, q_start, v_start)


def check_periodic(robot: Robot, goal: Goal, coordinates: str) -> None:
    """Refuse a periodic motion in coordinates, or of robots, whose states are not q and v.

    Raises
    ------
    ProblemError
    """
    if goal.periodic is None:
        return
    if not COORDINATES[coordinates].has_joint_states:
        raise ProblemError('goal.periodic: is for coordinates = "joint", where states are q and v; take them')
    if robot.drives:
        raise ProblemError(
            f"goal.periodic: controls of robot {robot.name!r} prescribe velocities, which have no start to "
            "come back to; give goal.q"
        )


def rows_kept_at_start(
    robot: Robot, free: FreeStart, q: Array, v: Array, switches: SwitchTable | None, *, of_rates: bool
) -> tuple[BoolArray, BoolArray]:
    """Which rows of constraints a free start has to keep, and does not keep by itself.

    Parameters
    ----------
    q, v : ndarray
        The given start, the guess of what is free.
    switches : SwitchTable, optional
        What acts when, where that changes.
    of_rates : bool
        Whether of velocities.

    Returns
    -------
    own : ndarray of bool, shape (nc,)
        Of the robot's constraints.
    held : ndarray of bool, shape (rows,)
        Of the held frames.
    """
    every = np.ones(robot.nc, dtype=np.bool_), np.zeros(0, dtype=np.bool_)
    own, held = every if switches is None else switches.rows_at_start(of_rates=of_rates)
    mask = free.v if of_rates else free.q
    if of_rates and np.any(v) and free.q.any():
        return own, held
    touched = np.zeros(len(own) + len(held), dtype=np.bool_)
    for at in (q, *_beside(robot, q)):
        G = _all_rows(robot, at, switches)
        touched |= np.abs(G[:, mask]).max(axis=1, initial=0.0) > RANK_TOLERANCE
    return own & touched[: len(own)], held & touched[len(own) :]


def _all_rows(robot: Robot, q: Array, switches: SwitchTable | None) -> Array:
    """Derivatives of the robot's constraints and of what is ever held, shape (any, nv)."""
    own = robot.constraint_jacobian(q) if robot.nc else np.zeros((0, robot.nv))
    return own if switches is None else np.vstack([own, switches.jacobians(q[None])[0]])


def _beside(robot: Robot, q: Array) -> list[Array]:
    """Configurations at which nothing is special."""
    rng = np.random.default_rng(0)
    return [robot.integrate(q, rng.normal(scale=_SPREAD, size=robot.nv)) for _ in range(_NUM_POSES)]


def _check_constraints(
    robot: Robot, free: FreeStart, q: Array, v: Array, switches: SwitchTable | None
) -> None:
    """What is free has to be able to keep the constraints."""
    for part, mask in (("q", free.q), ("v", free.v)):
        rows = np.concatenate(rows_kept_at_start(robot, free, q, v, switches, of_rates=part == "v"))
        G = _all_rows(robot, q, switches)[rows][:, mask]
        if np.linalg.matrix_rank(G, tol=RANK_TOLERANCE) < len(G):
            is_held = switches is not None and bool(switches.held)
            what = "what is held from the start" if is_held else "the constraints"
            raise ProblemError(
                f"{_KEY}.{part}: what is free of {part} cannot keep {what} of robot {robot.name!r}; "
                f'say true for all of {part}, or "v" for a given configuration'
            )


def _check_bounds(robot: Robot, free: FreeStart, limits: Bounds, q: Array, v: Array) -> None:
    at, nv = numbers_of(robot), robot.nv
    bounded = np.isfinite(free.lower) | np.isfinite(free.upper)
    circles = bounded[:nv] & (at < 0)
    if circles.any():
        name = robot.v_labels[int(np.flatnonzero(circles)[0])].name
        raise ProblemError(f"{_KEY}.q: {name!r} is no single number that could have bounds; say true")
    lower, upper = start_bounds(robot, limits, free, q, v)
    outside = (lower > 0.0) | (upper < 0.0)
    if outside.any():
        i = free.directions[int(np.flatnonzero(outside)[0])]
        part, label = ("q", robot.v_labels[i]) if i < nv else ("v", robot.v_labels[i - nv])
        raise ProblemError(
            f"start.{part}: {label.name} is the guess of what {_KEY} sets free, and not within its bounds; "
            "move the guess, or widen the bounds"
        )
