r"""What a motion does to limits between its nodes, where nothing keeps them.

Positions, speeds and accelerations are those of the cubics through the nodes, see `StepCubics`; for open
chains and schemes of order two accelerations at the nodes take part. Limits of
accelerations hold for the mean of a step, those of controls that vary within steps where these have values,
and those of powers at the end of a step: what a step does elsewhere is looked at, too. So are path
constraints that fall with a speed, and hold with that at the end of a step. Jerks and rates of
controls are differences of steps by their definition, and have no value between nodes.

Where cubics leave a limit of speed by more than they are exact, or are kept within it, steps are followed
along the flow of the robot itself, as far as it is an open chain: those that may come nearest to a limit by
their cubics, and by what these are wrong by, a fourth of the step times their accelerations' errors at most.
Damping may stop a light joint within a small part of a step: the flow takes its decay exactly. Accelerations
at the nodes say nothing then of the step between: where they made the cubic, the flow alone counts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import chain

import numpy as np

from mbocp._arrays import Array, BoolArray, IntArray, dataclass
from mbocp.integrators import PAIRS, SCHEMES, control_basis
from mbocp.mechanics.motion_rates import accelerations, powers
from mbocp.problem.path import PathConstraint
from mbocp.problem.paths_between_nodes import (
    LEAST_SIZE,
    can_hold_paths_within,
    paths_within,
    rows_within,
    tolerances_within,
)
from mbocp.problem.problem import Problem
from mbocp.problem.speed_lines import find_steps_held, kind_of, over_speed, speed_lines
from mbocp.problem.step_cubics import StepCubics, move_along
from mbocp.problem.step_flow import StepFlow
from mbocp.robot import Label
from mbocp.terms.rates import RATE_TERMS

PATH = "path constraint"
GROSS_EXCESS = (
    0.05  # of a limit: what drives put up with for a moment; beyond, steps do not resolve the motion
)
# Of accelerations whose limit holds for the mean of a step: beyond, they vary within the step by as much.
_GROSS_MEAN = 0.5
_NONE = 1e-6  # part of a limit by which solvers may leave it
_PLACES = 33  # in a step, at which polynomials of controls are looked at
_PARTS_OF_PATHS = 8  # of a step, between which path constraints are
_COARSE = 0.01  # of a limit: speeds that leave it by more are those of steps that cubics do not follow well
_FOLLOWED = 8  # steps
_PARTS = 16  # that a step is followed in

Sides = tuple[Array, Array]


@dataclass(frozen=True)
class LimitExcess:
    """The largest excess of a limit between nodes.

    Attributes
    ----------
    kind : {"speed", "position", "acceleration", "effort", "power", "torque", "value", "path constraint"}
    name : str
        Of the joint's direction, the control, or the row of what falls with a speed.
    value, bound : float
        There, and the limit that is left [unit].
    time : float
        [s].
    ratio : float
        Of the excess to the size of the limit: the range of a position, the larger side of all others.
    unit : str
    most : float
        Of the ratio that is put up with.
    """

    kind: str
    name: str
    value: float
    bound: float
    time: float
    ratio: float
    unit: str
    most: float = GROSS_EXCESS

    @property
    def is_gross(self) -> bool:
        """Whether it is more than drives put up with for a moment."""
        return self.ratio > self.most

    @property
    def of(self) -> str:
        """Which limit."""
        return f"{self.kind} {self.name if self.kind == PATH else f'of {self.name}'}"

    @property
    def words(self) -> str:
        """In a sentence; where steps do not resolve the motion, the cubics follow it to some digits alone."""
        return (
            f"between nodes the {self.of} is {self.value:.4g} {self.unit} at t = {self.time:.4g} s, "
            f"{100.0 * self.ratio:.3g} % {'or more ' if self.is_gross else ''}beyond {self.bound:.4g}"
        )


def is_followed(problem: Problem) -> bool:
    """Whether the robot follows the cubics through the nodes, as far as steps resolve its motion."""
    return SCHEMES[problem.scheme].order > 1


def can_hold_within(problem: Problem) -> str:
    """Letters of the limits that can be had within steps, too, where the motion is that of cubics.

    Of schemes of order two what speeds leave between nodes is as large as what the steps are wrong by.
    Jerks of controls that leap at nodes are no limits of cubics. Limits that fall with a speed, "m", hold at
    the begins of steps, too, whatever the scheme, and path constraints, "p", within them.
    """
    letters = "ajv" if problem.controls == "linear" and _resolves_jerks(problem) else "av"
    has_limits = [letter for letter in letters if letter in problem.widest_limits.letters]
    found = [*(has_limits if has_cubics(problem) else ()), *("m" if speed_lines(problem) else "")]
    found += "p" if can_hold_paths_within(problem) else ""
    return "".join(sorted(found))


def limits_accelerations(problem: Problem) -> bool:
    """Whether limits of accelerations, all along or by the speed, or of jerks can hold within steps."""
    return bool({"a", "j"} & set(can_hold_within(problem))) or any(
        one.control is None for one in speed_lines(problem)
    )


def has_cubics(problem: Problem) -> bool:
    """Whether what speeds do within steps is that of cubics, to a higher order than steps are wrong by."""
    is_precise = problem.scheme in PAIRS and SCHEMES[problem.scheme].order > 2
    return is_precise and not problem.robot.drives


def _resolves_jerks(problem: Problem) -> bool:
    """Whether limits of jerks lead to the largest accelerations in steps, and not within one alone."""
    limits = problem.widest_limits
    most = np.maximum(-limits.a_lower, limits.a_upper)
    return bool((np.maximum(-limits.j_lower, limits.j_upper) * problem.dt < most).any())


def letter_of(excess: str) -> str:
    """Letter of the limit that is left, by `LimitExcess.of`; "" where it cannot be had within steps."""
    letters = {"speed": "v", "acceleration": "a", "torque": "m", "value": "m", "path": "p"}
    return letters.get(excess.partition(" ")[0], "")


def largest_excess(
    problem: Problem, t: Array, qs: Array, vs: Array, us: Array, shares: tuple[float, ...] = ()
) -> LimitExcess | None:
    """The largest excess of the limits between nodes, a gross one before others; None where none is known.

    Parameters
    ----------
    problem : Problem
    t : ndarray, shape (N + 1,)
        Times of the nodes [s].
    qs, vs : ndarray, shapes (N + 1, nq) and (N + 1, nv)
    us : ndarray, shape (N, nu) or (N, k, nu)
        Controls, which are constant in each step, or vary within them.
    shares : tuple of float, length k
        Where in the steps these are, if they vary.
    """
    limits = {letter: sides for letter, sides in problem.limits_along().items() if np.isfinite(sides).any()}
    steps = np.flatnonzero(np.diff(t) > 0.0)  # impacts take no time
    of_speeds, of_paths = over_speed(problem), paths_within(problem) if is_followed(problem) else ()
    if not (
        (limits or of_speeds or of_paths) and steps.size and all(np.isfinite(x).all() for x in (qs, vs, us))
    ):
        return None
    within = us[steps].reshape(steps.size, -1, us.shape[-1])
    motion = _Steps(
        problem, _cubics(problem, steps, t, qs, vs, within), qs[steps], qs[steps + 1], within, shares
    )
    of_limits = motion.looks({letter: widest_within(sides, steps) for letter, sides in limits.items()})
    of_rows = (motion.look_at_lines(path, steps) for path in of_speeds)
    looks = chain(of_limits, *of_rows, *(motion.look_at_path(path, steps) for path in of_paths))
    found = [one for look in looks for one in look.excesses() if one.ratio > _NONE]
    return max(found, key=lambda one: (one.is_gross, one.ratio), default=None)


@dataclass(frozen=True, eq=False)
class _Look:
    """Values of a kind at times, and their limits, all of the shape (n, columns)."""

    kind: str
    values: Array
    times: Array
    sides: Sides
    labels: tuple[Label, ...]
    most: float = GROSS_EXCESS

    def ratios(self) -> Iterator[tuple[Array, Array]]:
        """Of either side bounds, and by which part of a limit they are left; below 0 where they are not."""
        lower, upper = self.sides
        largest = np.maximum(*(np.where(np.isfinite(side), np.abs(side), 0.0) for side in self.sides))
        is_range = (self.kind == "position") & np.isfinite(upper - lower)
        size = np.maximum(np.where(is_range, upper - lower, largest), LEAST_SIZE)
        for bound, over in ((lower, lower - self.values), (upper, self.values - upper)):
            yield bound, np.where(np.isfinite(bound) & np.isfinite(self.values), over, -np.inf) / size

    def of_steps(self, which: BoolArray) -> _Look:
        """Of some steps alone."""
        sides = self.sides[0][which], self.sides[1][which]
        return replace(self, values=self.values[which], times=self.times[which], sides=sides)

    def excesses(self) -> Iterator[LimitExcess]:
        """The largest excess of either side."""
        for bound, ratios in self.ratios():
            n, k = np.unravel_index(int(ratios.argmax()), ratios.shape)
            if ratios[n, k] > 0.0:
                numbers = (self.values[n, k], bound[n, k], self.times[n, k], ratios[n, k])
                label = self.labels[k]
                value, limit, time, ratio = map(float, numbers)
                yield LimitExcess(self.kind, label.name, value, limit, time, ratio, label.unit, self.most)


@dataclass(frozen=True, eq=False)
class _Steps:
    """Steps of a motion: their cubics, configurations at both ends, and controls at shares of them."""

    problem: Problem
    cubics: StepCubics
    begins: Array
    ends: Array
    us: Array
    shares: tuple[float, ...]

    def looks(self, limits: Mapping[str, Sides]) -> Iterator[_Look]:
        """At each kind of limit that there is, by its letter."""
        kinds = {"power": self._powers, "u": self._efforts}
        if is_followed(self.problem):
            kinds |= {"v": self._speeds, "q": self._positions, "a": self._accelerations}
        for letter in kinds.keys() & limits.keys():
            yield from kinds[letter](limits[letter])

    def _speeds(self, sides: Sides) -> Iterator[_Look]:
        s = self.cubics.extremes_of_speeds()
        of_cubics = _Look(
            "speed", self.cubics.speeds(s), self.cubics.times(s), sides, self.problem.robot.v_labels
        )
        largest = np.max([ratios.max(axis=1) for _, ratios in of_cubics.ratios()], axis=0)
        is_coarse = largest > _COARSE
        if not (is_coarse.any() or self.problem.limits_within) or not is_open(self.problem):
            yield of_cubics
            return
        followed = np.argsort(-self._nearest(sides))[: max(_FOLLOWED, np.count_nonzero(is_coarse))]
        looks = list(self._follow_speeds(followed, (sides[0][followed], sides[1][followed])))
        yield from looks
        counts = np.ones(len(largest), dtype=np.bool_)
        is_known = np.isfinite(looks[-1].values).all(axis=1)
        counts[followed] = ~is_known | (SCHEMES[self.problem.scheme].order > 2)
        if counts.any():
            yield of_cubics.of_steps(counts)

    def _follow_speeds(self, chosen: IntArray, within: Sides) -> Iterator[_Look]:
        """Along the flow of the robot in some steps."""
        robot, cubics = self.problem.robot, self.cubics
        begins, lengths = cubics.begins[chosen], cubics.lengths[chosen]
        start = self.begins[chosen], cubics.v0[chosen]
        states = StepFlow.states(robot, start, lambda share: self._controls(share)[chosen], lengths, _PARTS)
        for k, (_, vs) in enumerate(states):
            times = np.broadcast_to(begins + lengths * (k + 1) / _PARTS, vs.shape)
            yield _Look("speed", vs, times, within, robot.v_labels)

    def _nearest(self, sides: Sides) -> Array:
        """By which part of a limit speeds of each step may leave it at most, shape (n,)."""
        cubics, robot = self.cubics, self.problem.robot
        values = [cubics.v0, cubics.v1, cubics.speeds(cubics.extremes_of_speeds())]
        begin = cubics.accelerations(0.0) - accelerations(robot, self.begins, cubics.v0, self._controls(0.0))
        end = cubics.accelerations(1.0) - accelerations(robot, self.ends, cubics.v1, self._controls(1.0))
        wrong = cubics.lengths * np.maximum(np.abs(begin), np.abs(end)) / 4.0
        extremes = np.min(values, axis=0) - wrong, np.max(values, axis=0) + wrong
        looks = [_Look("speed", one, np.zeros_like(one), sides, robot.v_labels) for one in extremes]
        return np.max([ratios.max(axis=1) for look in looks for _, ratios in look.ratios()], axis=0)

    def _positions(self, sides: Sides) -> Iterator[_Look]:
        robot = self.problem.robot
        places = [(j.idx_q, j.idx_v) for j in robot.model.joints if j.nq == j.nv == 1]
        at_q, at_v = (list(numbers) for numbers in zip(*places, strict=True)) if places else ([], [])
        labels = tuple(robot.q_labels[i] for i in at_q)
        within = sides[0][:, at_q], sides[1][:, at_q]
        for s in self.cubics.extremes_of_ways() if places else ():
            values = self.begins[:, at_q] + self.cubics.ways(s)[:, at_v]
            yield _Look("position", values, self.cubics.times(s)[:, at_v], within, labels)

    def _accelerations(self, sides: Sides) -> Iterator[_Look]:
        rates = RATE_TERMS["acceleration"]
        labels = tuple(Label(label.name, rates.unit(label.unit)) for label in self.problem.robot.v_labels)
        most = GROSS_EXCESS if "a" in can_hold_within(self.problem) else _GROSS_MEAN
        for s in (0.0, 1.0):
            values = self.cubics.accelerations(s)
            times = self.cubics.times(np.full(values.shape, s))
            yield _Look("acceleration", values, times, sides, labels, most)

    def _efforts(self, sides: Sides) -> Iterator[_Look]:
        for s in np.linspace(0.0, 1.0, _PLACES) if self.shares else ():
            values = self._controls(float(s))
            times = self.cubics.times(np.full(values.shape, s))
            yield _Look("effort", values, times, sides, self.problem.robot.u_labels)

    def _powers(self, sides: Sides) -> Iterator[_Look]:
        """At the begins of the steps, and where controls vary within them, too: at their ends limits hold."""
        robot, rates = self.problem.robot, RATE_TERMS["power"]
        labels = tuple(Label(label.name, rates.unit(label.unit)) for label in robot.u_labels)
        for s in np.linspace(0.0, 1.0, _PLACES) if self.shares else np.zeros(1):
            values = powers(robot, self._configurations(s), self.cubics.speeds(s), self._controls(s))
            yield _Look("power", values, self.cubics.times(np.full(values.shape, s)), sides, labels)

    def look_at_lines(self, path: PathConstraint, steps: IntArray) -> Iterator[_Look]:
        """At rows that fall with a speed, in the steps of some numbers at both of whose ends these hold.

        Where the robot does not follow cubics, at the begins alone, with the means of accelerations.
        """
        problem = self.problem
        held = find_steps_held(path, problem)[steps]
        if not held.any():
            return
        shares = np.linspace(0.0, 1.0, _PLACES) if is_followed(problem) else np.zeros(1)
        qs = np.vstack([self._configurations(s)[held] for s in shares])
        vs = np.vstack([self.cubics.speeds(s)[held] for s in shares])
        us = np.vstack([self._controls(s)[held] for s in shares])
        times = np.vstack([self.cubics.times(s)[held] for s in shares])
        means = (self.cubics.v1 - self.cubics.v0) / self.cubics.lengths
        is_cubic = has_cubics(problem)
        rates = [self.cubics.accelerations(float(s)) if is_cubic else means for s in shares]
        values = path.values_along(problem.robot, qs, vs, us, np.vstack([rate[held] for rate in rates]))
        lower, upper, times = (np.broadcast_to(x, values.shape) for x in (path.lower, path.upper, times))
        yield _Look(kind_of(path).excess, values, times, (lower, upper), path.labels)

    def look_at_path(self, path: PathConstraint, steps: IntArray) -> Iterator[_Look]:
        """At rows of a path constraint, one after the other, within the steps of some numbers."""
        held, robot = rows_within(path, self.problem)[steps], self.problem.robot
        (taken,) = np.nonzero(held.any(axis=1))
        if not taken.size:
            return
        shares = np.arange(1, _PARTS_OF_PATHS) / _PARTS_OF_PATHS
        qs, vs, times = (
            np.concatenate(np.stack([of(s)[taken] for s in shares], axis=1))  # by the time
            for of in (self._configurations, self.cubics.speeds, self.cubics.times)
        )
        values = path.values_along(robot, qs, vs, np.zeros((len(qs), robot.nu)))
        for k in np.flatnonzero(held.any(axis=0)):
            here = np.repeat(held[taken, k], len(shares))
            lower, upper = (
                np.full((np.count_nonzero(here), 1), side[k]) for side in (path.lower, path.upper)
            )
            most = tolerances_within(path)[k]
            yield _Look(PATH, values[here][:, [k]], times[here], (lower, upper), (path.labels[k],), most)

    def _configurations(self, s: Array) -> Array:
        """At a share of each step, shape (n, nq)."""
        return move_along(self.problem.robot, self.begins, self.cubics.ways(s))

    def _controls(self, s: float) -> Array:
        """At a share of each step, shape (n, nu)."""
        if not self.shares:
            return self.us[:, 0]
        return np.einsum("k,nku->nu", control_basis(self.shares, [s])[0], self.us)


def is_open(problem: Problem) -> bool:
    """Whether accelerations follow from forces alone."""
    return not (problem.robot.nc or problem.robot.drives or problem.timeline.switches)


def _cubics(problem: Problem, steps: IntArray, t: Array, qs: Array, vs: Array, us: Array) -> StepCubics:
    """Of steps by their numbers.

    What configurations of schemes of order two are wrong by is as large as what speeds leave between nodes;
    the midpoint's means are those of both velocities. Means are then those of the cubics through velocities
    and accelerations at both ends: (v_0 + v_1) / 2 + h (a_0 - a_1) / 12.
    """
    cubics = StepCubics.through(problem.robot, t, qs, vs)
    if SCHEMES[problem.scheme].order != 2 or not is_open(problem):
        return cubics
    ends = [accelerations(problem.robot, qs[n], vs[n], us[:, 0]) for n in (steps, steps + 1)]
    means = (vs[steps] + vs[steps + 1]) / 2.0 + cubics.lengths * (ends[0] - ends[1]) / 12.0
    return replace(cubics, means=means)


def widest_within(limits: Sides, steps: IntArray) -> Sides:
    """Limits within the steps, from those of the nodes 1..N: the wider ones of both ends."""
    count = int(steps[-1]) + 1
    lower, upper = (np.broadcast_to(side, (max(count, len(side)), side.shape[1])) for side in limits)
    before = np.maximum(steps - 1, 0)
    return np.minimum(lower[steps], lower[before]), np.maximum(upper[steps], upper[before])
