"""What a solution has besides trajectories: the solver's records, its errors, names and units of columns."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from mbocp._arrays import dataclass
from mbocp.exceptions import DimensionMismatch
from mbocp.solvers.records import Status

if TYPE_CHECKING:
    from mbocp.robot import Robot


class Column(NamedTuple):
    """Name and unit of one column of a trajectory."""

    name: str
    unit: str

    @property
    def header(self) -> str:
        """`name [unit]`; just the name for a number without unit."""
        return f"{self.name} [{self.unit}]" if self.unit not in ("", "1", "-") else self.name


@dataclass(frozen=True)
class StartRecord:
    """What the solver came to from one of several guesses.

    Attributes
    ----------
    guess : str
        Words for the guess.
    status : Status
    cost : float
        Objective J at the end.
    iterations : int
        Of all phases.
    goal : int, optional
        Place of the goal among several; None where there is one.
    """

    guess: str
    status: Status
    cost: float
    iterations: int
    goal: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "status", Status(self.status))


@dataclass(frozen=True)
class Labels:
    """Columns of the trajectories, named after joints, actuators and constraints.

    Every field takes anything with `name` and `unit`, or pairs of the two. What is left out is numbered.

    Attributes
    ----------
    q, v, p, u : tuple of Column
        Configuration (nq), velocity (nv), momentum (nv), control (nu).
    lam, zeta : tuple of Column
        Multiplier of the holonomic constraints and its adjoint (nc).
    mu : tuple of Column
        Adjoint of the state (2 nv): first of q, then of p.
    """

    q: tuple[Column, ...] = ()
    v: tuple[Column, ...] = ()
    p: tuple[Column, ...] = ()
    u: tuple[Column, ...] = ()
    lam: tuple[Column, ...] = ()
    mu: tuple[Column, ...] = ()
    zeta: tuple[Column, ...] = ()

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, _columns(getattr(self, name)))

    @classmethod
    def of_robot(cls, robot: Robot, constraints: Iterable[Any] | None = None) -> Labels:
        """Columns of a trajectory of `robot`; the adjoints' units are those of the cost over the state's.

        Parameters
        ----------
        robot : Robot
        constraints : iterable of labels, optional
            Of the constraints, if they are others than the robot's own.
        """
        v = _columns(robot.v_labels)
        p = _columns(robot.p_labels)
        rows = _columns(robot.constraint_labels if constraints is None else constraints)
        # mu^q is dual to the tangent of q, whose unit is that of v times a second.
        mu_q = [Column(c.name, f"cost/{_over_rate(c.unit)}") for c in v]
        mu_p = [Column(c.name, f"cost/({c.unit})") for c in p]
        return cls(
            q=_columns(robot.q_labels),
            v=v,
            p=p,
            u=_columns(robot.u_labels),
            lam=tuple(Column(c.name, f"J/{_group(c.unit)}" if c.unit else "J") for c in rows),
            mu=tuple(mu_q + mu_p),
            zeta=tuple(Column(c.name, f"cost/(s {c.unit})" if c.unit else "cost/s") for c in rows),
        )

    def complete(self, **sizes: int) -> Labels:
        """Number the columns that have no name yet, and check the count of those that have."""
        filled: dict[str, tuple[Column, ...]] = {}
        for field in self.__dataclass_fields__:
            columns: tuple[Column, ...] = getattr(self, field)
            size = sizes[field]
            if columns and len(columns) != size:
                raise DimensionMismatch(f"labels.{field}", len(columns), size)
            filled[field] = columns or tuple(Column(str(i), "") for i in range(size))
        if not self.mu:  # the adjoint has a column for each of v and of p
            filled["mu"] = tuple(Column(c.name, "") for c in filled["v"] + filled["p"])
        return Labels(**filled)


def _columns(labels: Iterable[Any]) -> tuple[Column, ...]:
    return tuple(
        _pair(c) if isinstance(c, (tuple, list)) else Column(str(c.name), str(c.unit)) for c in labels
    )


def _pair(label: Sequence[str]) -> Column:
    name, unit = label
    return Column(str(name), str(unit))


def dual_columns(columns: tuple[Column, ...]) -> tuple[Column, ...]:
    """Columns of the multipliers of bounds on `columns`."""
    return tuple(Column(c.name, f"cost/{_group(c.unit)}" if c.unit else "cost") for c in columns)


def _group(unit: str) -> str:
    """Put a unit of several factors in brackets, to divide by it."""
    return f"({unit})" if " " in unit or "/" in unit else unit


def _over_rate(unit: str) -> str:
    return unit.removesuffix("/s") if unit.endswith("/s") else f"({unit} s)"


_SMALL = 0.02  # of a joint's way: the sum of its local errors


@dataclass(frozen=True)
class Accuracy:
    """Errors of a motion; NaN where nobody knows.

    Attributes
    ----------
    local_error : float
        Largest error of a configuration after one step [rad, m].
    local_joint : str
        Name of the velocity component along which it is, and
    local_time : float
        at the end of which step [s].
    sum_of_errors : float
        Local errors of all steps, added up, of the component where this is most of its way [rad, m].
    way : float
        Way of that component [rad, m].
    way_joint : str
        Its name.
    replay_error : float
        Error of the configuration at the end when the controls act on the robot in an open loop [rad, m], to
        two digits; infinite where errors grow too fast for that.
    replay_joint : str
    tracked_error : float
        The same where the controls answer deviations with the gains of the optimum, see `Solution.gains`.
    tracked_joint : str
    made_energy : float
        Energy that the steps make (positive) or lose, the largest sum up to a node [J].
    energy_range : float
        Difference of the greatest and the least energy along the motion, or the greatest kinetic energy if
        that is more [J].
    own_error : float
        What the local errors are wrong by, as far as it can tell [rad, m].
    asked : float
        What `horizon.accuracy` asked for; NaN where the number of steps was given.
    cost_error : float
        Error of the cost against that of steps of no length, as a share of it: an estimate of the rounds in
        which the steps were found. Zero where the cost is.
    rounds : int
        Number of these.
    """

    local_error: float = math.nan
    local_joint: str = ""
    local_time: float = math.nan
    sum_of_errors: float = math.nan
    way: float = math.nan
    way_joint: str = ""
    replay_error: float = math.nan
    replay_joint: str = ""
    tracked_error: float = math.nan
    tracked_joint: str = ""
    made_energy: float = math.nan
    energy_range: float = math.nan
    own_error: float = math.nan
    asked: float = math.nan
    cost_error: float = math.nan
    rounds: int = 0

    @property
    def is_known(self) -> bool:
        """Whether a flow was found that is better than the motion."""
        return math.isfinite(self.local_error)

    @property
    def share(self) -> float:
        """Sum of the local errors over the way."""
        return self.sum_of_errors / self.way if self.way > 0.0 else math.nan

    @property
    def is_small(self) -> bool:
        """Whether the local errors are small against the motion, as far as anything is known."""
        return not self.share > _SMALL
