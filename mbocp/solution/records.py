"""What a solution has besides its trajectories: the solver's records, and names and units of the columns."""

from __future__ import annotations

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
