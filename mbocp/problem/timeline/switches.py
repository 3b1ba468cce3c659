"""When which constraints act: holds, releases and impacts of a problem, row by row and step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp._linear import null_space
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import InconsistentStart, ProblemError
from mbocp.mechanics.held import HeldFrame, held_jacobians, held_labels, held_residuals
from mbocp.mechanisms.consistency import CONSISTENCY_TOLERANCE
from mbocp.mechanisms.held import independent_rows_held, is_moved
from mbocp.problem.timeline.hold import Hold, Release, holds_in
from mbocp.robot import Label, Robot


@dataclass(frozen=True, eq=False)
class Begin:
    """A constraint is taken on.

    Attributes
    ----------
    step : int
        The first in which it acts.
    frame : HeldFrame
    rows : tuple of int
        Those of its rows that act.
    """

    step: int
    frame: HeldFrame
    rows: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class SwitchTable:
    """What acts in which step.

    Attributes
    ----------
    robot : Robot
    held : tuple of HeldFrame
        In the order of `Problem.holds`.
    own : ndarray of bool, shape (N, nc)
        Rows of the robot's own constraints, those that are kept.
    rows : ndarray of bool, shape (N, rows)
        Rows of the held frames; of rows that others imply the first are taken.
    is_impact : ndarray of bool, shape (N,)
    begins : tuple of Begin
        Where spans begin after the start, and where released constraints are taken on again.
    """

    robot: Robot
    held: tuple[HeldFrame, ...]
    own: BoolArray
    rows: BoolArray
    is_impact: BoolArray
    begins: tuple[Begin, ...]

    @property
    def has_releases(self) -> bool:
        """Whether constraints of the robot are let go."""
        return not bool(self.own.all())

    @property
    def labels(self) -> tuple[Label, ...]:
        """Name and unit of each row of the held frames."""
        return held_labels(self.held)

    @property
    def coincides(self) -> BoolArray:
        """Which rows of the held frames say where these are, and not that they stay, shape (rows,)."""
        return np.array([not frame.is_anchored for frame in self.held for _ in frame.rows], dtype=np.bool_)

    @property
    def anchors(self) -> Array:
        """The node from which each row is held, by step, shape (N, rows); -1 where it does not act."""
        found = np.full(self.rows.shape, -1)
        for step, acts in enumerate(self.rows):
            before = found[step - 1] if step else np.full(len(acts), -1)
            found[step] = np.where(acts, np.where(before < 0, step, before), -1)
        return found

    @property
    def last_timed(self) -> int:
        """The last step that takes time."""
        return int(np.flatnonzero(~self.is_impact)[-1])

    def jacobians(self, qs: Array) -> Array:
        """Derivatives of the rows of the held frames at n configurations, shape (n, rows, nv)."""
        if not self.held:
            return np.zeros((len(qs), 0, self.robot.nv))
        return held_jacobians(self.robot, self.held, qs)

    def residuals(self, qs: Array, anchors: Array) -> Array:
        """Rows of the held frames at n configurations from n anchors, shape (n, rows)."""
        if not self.held:
            return np.zeros((len(qs), 0))
        return held_residuals(self.robot, self.held, qs, anchors)

    def at_end(self, q: Array, *, of_rates: bool) -> Array:
        """Derivatives of what ties the end, shape (any, nv).

        An impact at the end ties velocities; positions are tied by what acted before it. A frame that is held
        where it was when its hold began ties them only as far as its place then was tied.
        """
        if of_rates:
            return self.in_step(q, len(self.rows) - 1)
        return self._tied(q, self.last_timed)

    def _tied(self, q: Array, step: int) -> Array:
        """Derivatives of what ties the configuration after a step, the start being given, shape (any, nv)."""
        at = np.where(self.rows[step], self.anchors[step], -1)
        found = [self.derivatives(q, self.own[step], self.rows[step] & ((at <= 0) | self.coincides))]
        for anchor in np.unique(at[(at > 0) & ~self.coincides]):
            mine = self.derivatives(q, np.zeros_like(self.own[step]), (at == anchor) & ~self.coincides)
            before = self._tied(q, anchor - 1)
            # combinations of these rows that those which tie the place do not let move there
            loose = null_space(before, RANK_TOLERANCE)
            found.append(null_space((mine @ loose).T, RANK_TOLERANCE).T @ mine)
        return np.vstack(found)

    def acting_at_start(self, *, of_rates: bool) -> tuple[BoolArray, BoolArray]:
        """Which rows a start has to keep, of the robot's constraints (nc,) and of the held frames (rows,).

        Before an impact velocities are whatever they are, and what is held where it is, is there.
        """
        if not of_rates:
            return self.own[0], self.rows[0] & self.coincides
        takes_time = not self.is_impact[0]
        return self.own[0] & takes_time, self.rows[0] & takes_time

    def at_start(self, q: Array, *, of_rates: bool) -> Array:
        """Derivatives of the rows that a start has to keep, shape (any, nv)."""
        return self.derivatives(q, *self.acting_at_start(of_rates=of_rates))

    def in_step(self, q: Array, step: int) -> Array:
        """Derivatives of all rows that act in a step, at a configuration, shape (any, nv)."""
        return self.derivatives(q, self.own[step], self.rows[step])

    def derivatives(self, q: Array, own: BoolArray, rows: BoolArray) -> Array:
        """Derivatives of some rows of the robot's constraints and of the held frames, shape (any, nv)."""
        of_robot = self.robot.constraint_jacobian(q)[own]
        return np.vstack([of_robot, self.jacobians(q[None])[0][rows]])

    def along(self, qs: Array, own: Array) -> Array:
        """Derivatives of all rows, zero where they do not act, shape (N, nc + rows, nv).

        Parameters
        ----------
        qs : ndarray, shape (N, nq)
            A configuration of each step.
        own : ndarray, shape (N, nc, nv)
            Derivatives of the robot's own rows there.
        """
        acts = np.hstack([self.own, self.rows])
        found: Array = np.concatenate([own, self.jacobians(qs)], axis=1) * acts[:, :, None]
        return found


def switch_table(
    robot: Robot,
    holds: Sequence[Hold],
    releases: Sequence[Release],
    impacts: Sequence[int],
    num_steps: int,
    start: tuple[Array, Array],
) -> SwitchTable:
    """Rows that act in each step; of those that others imply, the first.

    Parameters
    ----------
    start : tuple of ndarray
        Configuration and velocity of the start.

    Raises
    ------
    ProblemError
        If a hold holds nothing that moves, or a constraint cannot be released alone.
    InconsistentStart
        If what acts from the start does not fit it.
    """
    held = tuple(hold.held(robot) for hold in holds)
    own, wanted = _own_rows(robot, releases, num_steps), _wanted_rows(holds, held, num_steps)
    q = start[0]
    _check_holds_something(robot, holds, held, q)
    rows, known = np.zeros_like(wanted), dict[bytes, BoolArray]()
    for step in range(num_steps):
        key = own[step].tobytes() + b"|" + wanted[step].tobytes()
        if key not in known:
            known[key] = independent_rows_held(robot, q, held, own[step], wanted[step])
        rows[step] = known[key]
    is_impact = np.zeros(num_steps, dtype=np.bool_)
    is_impact[list(impacts)] = True
    begins = (*_begins(holds, held, rows), *_begun_again(robot, releases, num_steps))
    found = SwitchTable(robot, held, own, rows, is_impact, begins)
    _check_start(found, *start)
    return found


def check_impacts(table: SwitchTable) -> None:
    """Refuse what begins without an impact, where coordinates have no velocities of joints.

    Raises
    ------
    ProblemError
    """
    for begin in table.begins:
        if not table.is_impact[begin.step]:
            raise ProblemError(
                f"hold {begin.frame.constraint.name!r}: natural coordinates have no soft landing; let it "
                'begin with an impact, or take coordinates = "joint"'
            )


def _own_rows(robot: Robot, releases: Sequence[Release], num_steps: int) -> BoolArray:
    acts = np.ones((num_steps, robot.nc), dtype=np.bool_)
    for release in releases:
        mine = [row for row, name in enumerate(_names_of_own(robot)) if name == release.constraint]
        for first, last in release.spans:
            acts[first:last, mine] = False
        _check_release(robot, release, mine)
    return acts


def _names_of_own(robot: Robot) -> list[str]:
    """Name of the constraint that each kept row of the robot belongs to."""
    names = [constraint.name for constraint in robot.constraints for _ in constraint.rows]
    return [names[row] for row in robot.kept_rows]


def _check_release(robot: Robot, release: Release, mine: Sequence[int]) -> None:
    """Refuse to release what implies rows of others that the robot leaves out."""
    names = [constraint.name for constraint in robot.constraints for _ in constraint.rows]
    others = [row for row, name in enumerate(names) if name != release.constraint]
    kept = [row for row in robot.kept_rows if row in set(others)]
    jacobian = robot.closure_jacobian(robot.q0)
    ranks = [np.linalg.matrix_rank(jacobian[rows], tol=1e-6) if rows else 0 for rows in (others, kept)]
    if ranks[0] != ranks[1]:
        raise ProblemError(
            f"release {release.constraint!r}: other constraints of robot {robot.name!r} lean on it: rows of "
            "theirs are left out because it implies them; close the loop with a hold in its place"
        )


def _wanted_rows(holds: Sequence[Hold], held: Sequence[HeldFrame], num_steps: int) -> BoolArray:
    steps = range(num_steps)
    columns = [
        np.repeat([[holds_in(hold.spans, step)] for step in steps], len(frame.rows), axis=1)
        for hold, frame in zip(holds, held, strict=True)
    ]
    return np.hstack(columns) if columns else np.zeros((num_steps, 0), dtype=np.bool_)


def rows_by_frame(held: Sequence[HeldFrame]) -> dict[str, list[list[int]]]:
    """Rows that say the same under other names, row by row of each frame that there is."""
    found: dict[str, list[list[int]]] = {}
    for frame, where in zip(held, _rows_of(held), strict=True):
        rows = found.setdefault(repr(frame.signature), [[] for _ in frame.rows])
        for row, place in zip(rows, range(where.start, where.stop), strict=True):
            row.append(place)
    return found


def _rows_of(held: Sequence[HeldFrame]) -> list[slice]:
    ends = np.cumsum([0, *(len(frame.rows) for frame in held)])
    return [slice(int(first), int(last)) for first, last in pairwise(ends)]


def _begins(holds: Sequence[Hold], held: Sequence[HeldFrame], rows: BoolArray) -> list[Begin]:
    found = []
    for hold, frame, where in zip(holds, held, _rows_of(held), strict=True):
        for first, _ in hold.spans:
            acting = tuple(int(row) for row in np.flatnonzero(rows[first, where]))
            if first > 0 and acting:
                found.append(Begin(first, frame, acting))
    return found


def _begun_again(robot: Robot, releases: Sequence[Release], num_steps: int) -> list[Begin]:
    found, kept = [], set(robot.kept_rows)
    for release in releases:
        count = 0
        for constraint in robot.constraints:
            rows = tuple(i for i in range(len(constraint.rows)) if count + i in kept)
            count += len(constraint.rows)
            if constraint.name == release.constraint:
                again = [last for _, last in release.spans if last < num_steps]
                found += [Begin(step, HeldFrame(constraint, False), rows) for step in again]
    return found


def _check_holds_something(robot: Robot, holds: Sequence[Hold], held: Sequence[HeldFrame], q: Array) -> None:
    for hold, frame in zip(holds, held, strict=True):
        if not is_moved(robot, q, frame):
            raise ProblemError(
                f"hold {hold.name!r}: nothing moves frame {hold.frame!r} against {hold.to!r}; hold another "
                "frame, or leave it out"
            )
        from_start = any(first == 0 for first, _ in hold.spans)
        if from_start and not np.abs(held_jacobians(robot, (frame,), q[None])).max() > CONSISTENCY_TOLERANCE:
            raise ProblemError(
                f"hold {hold.name!r}: the start is a singular pose, in which nothing moves frame "
                f"{hold.frame!r} against {hold.to!r}; begin in another one"
            )


def _check_start(table: SwitchTable, q: Array, v: Array) -> None:
    """Refuse a start that what acts from there does not allow; an impact asks for positions alone."""
    acts = table.rows[0]
    if not acts.any():
        return
    residual = table.residuals(q[None], q[None])[0]
    rate = np.zeros_like(residual) if table.is_impact[0] else table.jacobians(q[None])[0] @ v
    for values, key, per in ((residual, "start.q", ""), (rate, "start.v", "/s")):
        worst = int(np.argmax(np.abs(values) * acts))
        if np.abs(values[worst]) * acts[worst] > CONSISTENCY_TOLERANCE:
            label = table.labels[worst]
            advice = (
                "begin with the frames in one place, or hold them where they are"
                if key == "start.q"
                else "begin with a velocity that it allows, or with an impact"
            )
            raise InconsistentStart(
                f"{key}: violates hold {label.name!r}, which acts from the start, by {values[worst]:.3g} "
                f"{label.unit}{per}; {advice}"
            )
