r"""What a state remembers of the step that led to it: named blocks r, each with the rule of its next value.

A function of two steps, such as a rate, is a function of one state that remembers. With s the speeds, u the
controls and dt the length of the step from one state to the next, the blocks and their next values are

.. math::
    \text{control} \quad & u, &
    \text{control\_rate} \quad & (u - u^-) / \delta t, \\
    \text{acceleration} \quad & a = (s_1 - s_0) / \Delta t, &
    \text{jerk} \quad & (a - a^-) / \delta t, &
    \text{progress} \quad & s^- + e\, w, &
    \text{reaction} \quad & \lambda, &
    \text{start} \quad & r^- + e\, w

where lambda are forces of constraints in the step, a minus means what was remembered before, and delta t is
the time from the middle of the step before to that of this one: dt where steps are as long as each other. All
begin with zero, but for the acceleration before the start where a problem gives one; the control of the
first step has no rate. Rates
count in units of the size of their limits, so that the numbers that solvers see are of ordinary size.

The rules are plain arithmetic: they take symbols of one step, and arrays of all steps at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.mechanics.rates import spacings

__all__ = ["HAS_BEFORE", "MEMORY", "Block", "Passage", "memory_along", "ordered", "unit_of"]

HAS_BEFORE = "has_before"  # the stage parameter: 1 in steps that have one before them, else 0


@dataclass(frozen=True, eq=False)
class Passage:
    """A step as the rules see it: symbols of one, or arrays with a row for each.

    Attributes
    ----------
    s0, s1 : casadi.SX, shape (ns,), or ndarray, shape (N, ns)
        Speeds before and after it.
    u : casadi.SX, shape (nu,), or ndarray, shape (N, nu)
        Controls as the state counts them.
    units_of_u : casadi.SX, shape (nu,), or float
        From there to the user's.
    dt : casadi.SX, or ndarray, shape (N, 1)
        Its length [s].
    spacing : casadi.SX, or ndarray, shape (N, 1)
        Time from the middle of the step before to its own [s]; in the first step its length.
    has_before : casadi.SX, or ndarray, shape (N, 1)
        0 in the first step, 1 in all others.
    before : mapping of str
        What was remembered before it, by name.
    units : mapping of str
        Units of the blocks, by name.
    paces, advances : casadi.SX, shape (paths,), or ndarray, shape (N, paths)
        Controls of the progress along followed paths, and what they are multiplied by; see `progress`.
    reactions : casadi.SX, shape (rows,), or ndarray, shape (N, rows)
        Forces of constraints in the step, of the rows that are asked for; see `reactions`.
    moves : casadi.SX, shape (moves,), or ndarray, shape (N, moves)
        Controls that move the start, in the first step; see `moved_start`.
    begin : casadi.SX, shape (nu,), or ndarray, shape (N, nu), or None
        Controls at the begin of the step where they are linear in it; u is at its end.
    """

    s0: Any
    s1: Any
    u: Any
    units_of_u: Any
    dt: Any
    spacing: Any
    has_before: Any
    before: Mapping[str, Any]
    units: Mapping[str, Any]
    paces: Any = 0.0
    advances: Any = 0.0
    reactions: Any = 0.0
    moves: Any = 0.0
    begin: Any = None

    @property
    def acceleration(self) -> Any:
        """Mean acceleration."""
        return (self.s1 - self.s0) / self.dt


@dataclass(frozen=True)
class Block:
    """A block of what is remembered.

    Attributes
    ----------
    of : {"u", "s", "path", "reaction", "start"}
        Whether it has an entry for each control, each speed, each path that a frame follows, each row of
        constraints whose force is asked for, or each free direction of the start.
    following : callable
        `Passage` -> the value after the step.
    has_unit : bool
        Whether it counts in a unit of its own.
    needs : tuple of str
        Blocks that its rule looks at.
    asks_for_first : bool
        Whether its rule looks at `Passage.has_before`.
    adds_up : bool
        Whether its rule adds something to what was before.
    has_impacts : bool
        Whether impacts, steps of no duration, have a value, too; else they leave what is remembered.
    """

    of: str
    following: Callable[[Passage], Any]
    has_unit: bool = True
    needs: tuple[str, ...] = ()
    asks_for_first: bool = False
    adds_up: bool = False
    has_impacts: bool = False


def _control(at: Passage) -> Any:
    return at.u


def _control_rate(at: Passage) -> Any:
    if at.begin is not None:
        return at.units_of_u * (at.u - at.begin) / (at.dt * at.units["control_rate"])
    change = at.units_of_u * (at.u - at.before["control"])
    return at.has_before * change / (at.spacing * at.units["control_rate"])


def _acceleration(at: Passage) -> Any:
    return at.acceleration / at.units["acceleration"]


def _jerk(at: Passage) -> Any:
    change = at.acceleration - at.units["acceleration"] * at.before["acceleration"]
    return change / (at.spacing * at.units["jerk"])


def _progress(at: Passage) -> Any:
    return at.before["progress"] + at.advances * at.paces


def _reaction(at: Passage) -> Any:
    return at.reactions / at.units["reaction"]


def _start(at: Passage) -> Any:
    return at.before["start"] + (1.0 - at.has_before) * at.moves


MEMORY: Mapping[str, Block] = MappingProxyType(
    {
        "control": Block("u", _control, has_unit=False),
        "control_rate": Block("u", _control_rate, needs=("control",), asks_for_first=True),
        "acceleration": Block("s", _acceleration),
        "jerk": Block("s", _jerk, needs=("acceleration",)),
        "progress": Block("path", _progress, has_unit=False, adds_up=True),
        "reaction": Block("reaction", _reaction, has_impacts=True),
        "start": Block("start", _start, has_unit=False, asks_for_first=True, adds_up=True),
    }
)


def ordered(names: set[str]) -> tuple[str, ...]:
    """Names of blocks and of those that they need, in the order in which states have them."""
    wanted = names | {need for name in names for need in MEMORY[name].needs}
    return tuple(name for name in MEMORY if name in wanted)


def unit_of(name: str) -> str:
    """Name of the parameter that holds the unit of a block."""
    return f"unit.{name}"


def memory_along(
    names: tuple[str, ...],
    speeds: Array,
    us: Array,
    dts: Array,
    units: Mapping[str, float],
    paces: tuple[Array, Array] | None = None,
    is_impact: BoolArray | None = None,
    reactions: Array | None = None,
    moves: Array | None = None,
    begins: Array | None = None,
    first: Mapping[str, Array] = MappingProxyType({}),
) -> dict[str, Array]:
    """What the nodes of a motion remember, by name, shapes (N + 1, size).

    Parameters
    ----------
    names : tuple of str
    speeds : ndarray, shape (N + 1, ns)
    us : ndarray, shape (N, nu)
    dts : ndarray, shape (N,)
        Lengths of the steps [s].
    units : mapping of str to float
    paces : tuple of ndarray, shapes (N, paths), optional
        Paces, and what they are multiplied by.
    is_impact : ndarray of bool, shape (N,), optional
        Steps that take no time, and leave what is remembered, but for reactions; their lengths are not looked
        at.
    reactions : ndarray, shape (N, rows), optional
        Forces of constraints; of impacts their impulses by the length of a step.
    moves : ndarray, shape (N, moves), optional
        Moves of the start.
    begins : ndarray, shape (N, nu), optional
        Controls at the begins of the steps, where they are linear in them; `us` are at the ends.
    first : mapping of str to ndarray
        What the first node remembers, by name, where it is not zero.
    """
    none = np.zeros((len(us), 0))
    w, e = (none, none) if paces is None else paces
    forces, moved = (none if given is None else given for given in (reactions, moves))
    of_all = np.vstack([np.zeros(forces.shape[1]), forces])
    timed = np.ones(len(us), dtype=np.bool_) if is_impact is None else ~is_impact
    nodes = np.cumsum(np.append(0, timed))  # for each its place among those after steps that take time
    starts, speeds = speeds[:-1][timed], speeds[1:][timed]
    us, dts, w, e, forces, moved = (values[timed] for values in (us, dts, w, e, forces, moved))
    begin = None if begins is None else begins[timed]
    has_before = (np.arange(len(us)) > 0).astype(np.float64)[:, None]
    between = spacings(dts)[:, None]
    found: dict[str, Array] = {}
    for name in names:
        before = {known: values[:-1] for known, values in found.items()} | {"progress": 0.0, "start": 0.0}
        own = (dts[:, None], between, has_before, before, units, w, e, forces, moved)
        at = Passage(starts, speeds, us, 1.0, *own, begin)
        after = MEMORY[name].following(at)
        after = np.cumsum(after, axis=0) if MEMORY[name].adds_up else after
        found[name] = np.vstack([first.get(name, np.zeros(after.shape[1])), after])
    at_nodes = {name: values[nodes] for name, values in found.items()}
    return {
        name: of_all / units[name] if MEMORY[name].has_impacts else values
        for name, values in at_nodes.items()
    }
