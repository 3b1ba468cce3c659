"""Bounds along the motion, and the question whether numbers beyond them are in degrees or millimetres."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import field
from functools import cached_property

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass, frozen_array
from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.exceptions import DimensionMismatch, InvalidValue, ProblemError
from mbocp.problem.goals.goal import Goal
from mbocp.robot import Label, Robot
from mbocp.terms.rates import RATE_TERMS

LIMITS = {  # keys of a problem file
    "u": "limits.effort",
    "rms": "limits.effort_rms",
    "v": "limits.velocity",
    "q": "limits.position",
    **{term.letter: f"limits.{key}" for key, term in RATE_TERMS.items()},
}
_SLACK = 1e-6  # relative, by which the values of a plan, from which a start is taken, may leave their limits
_STORED = ("u", "v", "q")  # by the side of trajectories; a problem's text has all
_TURN = 2.0 * math.pi  # [rad]; a smaller number may well be an angle in radians that is a little too large
_TURNS = 2.0 * _TURN  # [rad] beyond which a whole number is no likely angle of a joint without limits
_FAR = 3.0  # [m]: as many millimetres are within the base of most robots
_BEYOND = 0.9  # of the way to a position: the robot reaches less than a tenth of it


_NOTHING = frozen_array(np.zeros(0))


def _no_bounds() -> Array:
    return _NOTHING


@dataclass(frozen=True, kw_only=True, eq=False)
class Bounds:
    r"""Bounds that hold along the motion, infinite where there are none.

    .. math:: \underline{u} \le u_n \le \overline{u}, \qquad
        \underline{v} \le v_n \le \overline{v}, \qquad \underline{q} \le q_n \le \overline{q}

    at the nodes n = 1, ..., N, and in all N steps for u: eq. (32) of [Manara2017]_; and bounds on rates, see
    `mbocp.terms.rates.RateTerm`. What is left out is unbounded; a `Problem` fills it in.

    Attributes
    ----------
    u_lower, u_upper : ndarray, shape (nu,)
        Controls [N, N m, and the units of drives].
    rms_lower, rms_upper : ndarray, shape (nu,)
        Root mean squares of the controls over the whole motion, whose lower side says nothing.
    v_lower, v_upper : ndarray, shape (nv,)
        Velocities [m/s, rad/s].
    q_lower, q_upper : ndarray, shape (nq,)
        Configuration [m, rad]: plain numbers only, no quaternions and no cosines and sines.
    a_lower, a_upper : ndarray, shape (nv,)
        Mean accelerations of the steps [m/s^2, rad/s^2].
    j_lower, j_upper : ndarray, shape (nv,)
        Jerks [m/s^3, rad/s^3].
    du_lower, du_upper : ndarray, shape (nu,)
        Rates of the controls [N/s, N m/s].
    power_lower, power_upper : ndarray, shape (nu,)
        Powers of the controls [W].
    """

    u_lower: Array = field(default_factory=_no_bounds)
    u_upper: Array = field(default_factory=_no_bounds)
    rms_lower: Array = field(default_factory=_no_bounds)
    rms_upper: Array = field(default_factory=_no_bounds)
    v_lower: Array = field(default_factory=_no_bounds)
    v_upper: Array = field(default_factory=_no_bounds)
    q_lower: Array = field(default_factory=_no_bounds)
    q_upper: Array = field(default_factory=_no_bounds)
    a_lower: Array = field(default_factory=_no_bounds)
    a_upper: Array = field(default_factory=_no_bounds)
    j_lower: Array = field(default_factory=_no_bounds)
    j_upper: Array = field(default_factory=_no_bounds)
    du_lower: Array = field(default_factory=_no_bounds)
    du_upper: Array = field(default_factory=_no_bounds)
    power_lower: Array = field(default_factory=_no_bounds)
    power_upper: Array = field(default_factory=_no_bounds)

    def __post_init__(self) -> None:
        for letter, key in LIMITS.items():
            lower, upper = self.sides(letter)
            if lower is upper is _NOTHING:
                continue
            lower, upper = (frozen_array(side, shape=(None,), name=key) for side in (lower, upper))
            if lower.shape != upper.shape:
                raise DimensionMismatch(key, lower.shape, upper.shape, "as many lower as upper bounds")
            for i, (lo, hi) in enumerate(zip(lower, upper, strict=True)):
                if not (lo < hi and lo < np.inf and hi > -np.inf):  # NaN, too
                    raise InvalidValue(f"{key}[{i}]", [float(lo), float(hi)], "a lower below an upper bound")
            object.__setattr__(self, f"{letter}_lower", lower)
            object.__setattr__(self, f"{letter}_upper", upper)

    @classmethod
    def none(cls, robot: Robot) -> Bounds:
        """No bounds at all, in the dimensions of `robot`."""
        return cls().complete(robot)

    def complete(self, robot: Robot) -> Bounds:
        """Return the same with infinite bounds where none were given, checked against `robot`."""
        sides: dict[str, Array] = {}
        of_rates = ((term.letter, getattr(robot, f"n{term.over}")) for term in RATE_TERMS.values())
        sizes = (("u", robot.nu), ("rms", robot.nu), ("v", robot.nv), ("q", robot.nq))
        for letter, size in (*sizes, *of_rates):
            for side, infinity in (("lower", -np.inf), ("upper", np.inf)):
                name = f"{letter}_{side}"
                value = getattr(self, name)
                sides[name] = value if value.size else np.full(size, infinity)
                if sides[name].shape != (size,):
                    raise DimensionMismatch(LIMITS[letter], value.shape, (size,))
        bounds = Bounds(**sides)
        for i in np.flatnonzero(bounds.finite("q") & ~is_plain(robot)):
            raise _not_plain(robot.q_labels[i].name)
        return bounds

    @property
    def any_finite(self) -> bool:
        """Whether anything is bounded."""
        return bool(self.letters)

    @cached_property
    def letters(self) -> frozenset[str]:
        """Letters of `LIMITS` that have a bound."""
        return frozenset(letter for letter in LIMITS if self.finite(letter).any())

    @property
    def fields(self) -> dict[str, Array]:
        """Lower and upper bounds as a `Solution` keeps them: limits_u (2, nu), limits_v (2, nv), limits_q."""
        return {f"limits_{letter}": np.vstack(self.sides(letter)) for letter in _STORED}

    def sides(self, letter: str) -> tuple[Array, Array]:
        """Return the lower and the upper bounds of a letter of `LIMITS`."""
        return getattr(self, f"{letter}_lower"), getattr(self, f"{letter}_upper")

    def finite(self, letter: str) -> BoolArray:
        """Which entries of a letter of `LIMITS` have a bound on at least one side."""
        lower, upper = self.sides(letter)
        return np.isfinite(lower) | np.isfinite(upper)


def check_mean_squares(robot: Robot, limits: Bounds) -> None:
    """Refuse limits of root mean squares that are not above zero, and of controls that prescribe a motion.

    Raises
    ------
    InvalidValue, ProblemError
        If there is one.
    """
    key, first_drive = LIMITS["rms"], robot.nu - len(robot.drives)
    for i in np.flatnonzero(limits.finite("rms")):
        name, limit = robot.u_labels[i].name, float(limits.rms_upper[i])
        if not limit > 0.0:
            raise InvalidValue(f"{key}.{name}", limit, "a number above 0")
        if i >= first_drive:
            raise ProblemError(
                f"{key}: the control {name!r} prescribes a motion and heats no motor; leave it out"
            )


def is_plain(robot: Robot) -> BoolArray:
    """Which numbers of q are lengths or angles, not parts of a quaternion or of a (cos, sin), shape (nq,)."""
    plain = np.ones(robot.nq, dtype=np.bool_)
    for _, group in robot.unit_groups:
        plain[group] = False
    return plain


def _not_plain(name: str) -> ProblemError:
    return ProblemError(
        f"{LIMITS['q']}: {name} is a part of a unit quaternion or of a (cos, sin) pair, which has no limits; "
        "only lengths and the angles of revolute joints have"
    )


def check_limits(
    robot: Robot, bounds: Bounds, q_start: Array, v_start: Array, goal: Goal, *, of_end: Bounds | None = None
) -> None:
    """Refuse limits that exclude the start or an exact goal, where those of the end may be others."""
    _refuse_outside(bounds, "start", "q", q_start, np.ones(robot.nq, dtype=np.bool_), robot.q_labels)
    _refuse_outside(bounds, "start", "v", v_start, np.ones(robot.nv, dtype=np.bool_), robot.v_labels)
    check_end_limits(robot, of_end or bounds, goal)


def check_end_limits(robot: Robot, bounds: Bounds, goal: Goal) -> None:
    """Refuse limits that exclude an exact goal."""
    for where, letter, value, asked, labels in _ends(robot, goal):
        _refuse_outside(bounds, where, letter, value, asked, labels)


def _ends(robot: Robot, goal: Goal) -> Iterator[tuple[str, str, Array, BoolArray, Sequence[Label]]]:
    """Components of q and v that an exact goal fixes."""
    if not goal.is_exact:
        return
    yield "goal", "q", goal.q, _configuration_mask(robot, goal.q_active), robot.q_labels
    if goal.rate == "v":
        yield "goal", "v", goal.value, goal.rate_active, robot.v_labels
    elif goal.q_active.all() and goal.rate_active.all():
        v = robot.velocity_from_momentum(goal.q, goal.value)
        yield "goal", "v", v, goal.rate_active, robot.v_labels


def _configuration_mask(robot: Robot, active: BoolArray) -> BoolArray:
    """Which numbers of q belong to joints whose directions are all active, shape (nq,)."""
    mask = np.ones(robot.nq, dtype=np.bool_)
    if not active.all():
        for place in robot.joint_places:
            mask[place.q] = active[place.v].all()
    return mask


def check_within(bounds: Bounds, where: str, letter: str, value: Array, labels: Sequence[Label]) -> None:
    """Refuse values at an end that its limits exclude, by more than a plan may leave them."""
    lower, upper = bounds.sides(letter)
    slack = _SLACK * np.maximum(1.0, np.abs(value))
    outside = (value < lower - slack) | (value > upper + slack)
    _refuse_outside(bounds, where, letter, value, outside, labels)


def _refuse_outside(
    bounds: Bounds, where: str, letter: str, value: Array, asked: BoolArray, labels: Sequence[Label]
) -> None:
    lower, upper = bounds.sides(letter)
    outside = asked & ((value < lower - BOUND_TOLERANCE) | (value > upper + BOUND_TOLERANCE))
    if outside.any():
        i = int(np.flatnonzero(outside)[0])
        side, bound = ("above", upper[i]) if value[i] > upper[i] else ("below", lower[i])
        words = (
            f"{where}.{letter}: {labels[i].name} is {value[i]:.6g} {labels[i].unit}, {side} its limit "
            f"{bound:.6g} in {LIMITS[letter]}; no motion keeps it: move the {where}, or widen the limit"
        )
        question = ask_degrees(value[i], lower[i], upper[i], labels[i].unit)
        raise ProblemError(with_question(words, question))


def ask_degrees(value: float, lower: float, upper: float, unit: str) -> str:
    """Return the question whether an angle is in degrees; "" where nothing looks like it.

    Parameters
    ----------
    value, lower, upper : float
        Angle and its limits, or numbers of another unit.
    unit : str
    """
    if unit != "rad":
        return ""
    angle = math.radians(value)
    if math.isinf(lower) and math.isinf(upper):
        likely = abs(value) > _TURNS and value == round(value)
    else:
        likely = abs(value) > _TURN and not lower <= value <= upper and lower <= angle <= upper
    return f'is it in degrees? "{value:.6g} deg" is {angle:.4f} rad' if likely else ""


def with_question(message: str, question: str) -> str:
    """Return a message with a question behind it, if there is one."""
    return f"{message}; {question}" if question else message


def ask_millimetres(position: Iterable[float], left: float) -> str:
    """Return the question whether a position is in millimetres; "" where nothing looks like it.

    Parameters
    ----------
    position : iterable of float
        [m], some of which may be NaN.
    left : float
        How far from there the robot remains [m].
    """
    given = [x for x in position if math.isfinite(x)]
    worst, size = max(given, key=abs, default=0.0), math.hypot(*given)
    likely = size > _FAR and left > _BEYOND * size
    return f'is it in millimetres? "{worst:.6g} mm" is {worst / 1e3:.4g} m' if likely else ""
