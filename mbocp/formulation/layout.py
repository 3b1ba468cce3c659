"""Where the pieces of a state are: coordinates of the configuration, speeds, and what features add."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import casadi as ca

from mbocp._arrays import dataclass
from mbocp.mechanics import Mechanics


@dataclass(frozen=True)
class Block:
    """Entries that a feature adds to a state; they begin with zero where the feature says nothing else.

    Attributes
    ----------
    name : str
    size : int
    is_remembered : bool
        Whether it follows from the step that led to the state, see `Feature.next_value`; others have rows of
        their own.
    has_unit : bool
        Whether it counts in a unit of its own, which is a parameter.
    counts_as_control : bool
        Whether it counts in the units of the controls.
    adds_up : bool
        Whether its rule adds something to what was before.
    has_impacts : bool
        Whether impacts, steps of no duration, have a value, too; else they leave what is remembered.
    """

    name: str
    size: int
    is_remembered: bool = True
    has_unit: bool = False
    counts_as_control: bool = False
    adds_up: bool = False
    has_impacts: bool = False


@dataclass(frozen=True)
class StateLayout:
    """Pieces of a state x = (z, s, blocks) and of its tangent dx = (dq, ds, blocks), and of the controls.

    Attributes
    ----------
    nz : int
        Coordinates of the configuration: Pinocchio's q, or with rotation matrices.
    nv : int
        Tangent directions of the configuration.
    ns : int
        Speeds: the velocities v, unless controls prescribe some of them.
    is_flat : bool
        Whether the state is taken as a plain vector, although its configurations may form a group: what a
        general nonlinear programming solver and integrators that leave the group need.
    blocks : tuple of Block
        What features add to states: first all that is remembered of the step before.
    control_sizes : tuple of (str, int)
        Names and sizes of the programme's controls: "own", those of the robot, and what features add.
    """

    nz: int
    nv: int
    ns: int
    is_flat: bool
    blocks: tuple[Block, ...] = ()
    control_sizes: tuple[tuple[str, int], ...] = ()

    @cached_property
    def states(self) -> dict[str, slice]:
        """Places of the blocks in a state, by name."""
        return places({block.name: block.size for block in self.blocks}, self.nz + self.ns)

    @cached_property
    def rows(self) -> dict[str, slice]:
        """Places of the blocks in a tangent, and in the rows of a step, by name."""
        return places({block.name: block.size for block in self.blocks}, self.nw + self.ns)

    @cached_property
    def controls(self) -> dict[str, slice]:
        """Places of the controls, by name."""
        return places(dict(self.control_sizes))

    @property
    def num_controls(self) -> int:
        """Controls of the programme."""
        return sum(size for _, size in self.control_sizes)

    @property
    def num_own(self) -> int:
        """Controls of the programme that are values of those of the robot; they come first."""
        return dict(self.control_sizes).get("own", 0)

    @property
    def num_more_controls(self) -> int:
        """Controls of the programme beyond those of the robot."""
        return self.num_controls - self.num_own

    @property
    def num_more_states(self) -> int:
        """Entries of all blocks."""
        return sum(block.size for block in self.blocks)

    @property
    def nr(self) -> int:
        """Entries of what is remembered."""
        return sum(block.size for block in self.blocks if block.is_remembered)

    @property
    def nx(self) -> int:
        """Length of a state."""
        return self.nz + self.ns + self.num_more_states

    @property
    def nw(self) -> int:
        """Tangent directions of the configuration as the programme counts them."""
        return self.nz if self.is_flat else self.nv

    @property
    def ndx(self) -> int:
        """Length of a state's tangent."""
        return self.nw + self.ns + self.num_more_states

    @property
    def z(self) -> slice:
        """Coordinates in a state."""
        return slice(0, self.nz)

    @property
    def s(self) -> slice:
        """Speeds in a state."""
        return slice(self.nz, self.nz + self.ns)

    @property
    def r(self) -> slice:
        """All that is remembered in a state."""
        return slice(self.nz + self.ns, self.nz + self.ns + self.nr)

    @property
    def ds(self) -> slice:
        """Speeds in a tangent, and in the rows of a step."""
        return slice(self.nw, self.nw + self.ns)

    @property
    def dr(self) -> slice:
        """All that is remembered in a tangent, and in the rows of a step."""
        return slice(self.nw + self.ns, self.nw + self.ns + self.nr)


def places(sizes: Mapping[str, int], start: int = 0) -> dict[str, slice]:
    """Return where each piece of a vector is, by name, the first at `start`."""
    found = {}
    for name, size in sizes.items():
        found[name] = slice(start, start + size)
        start += size
    return found


@dataclass(frozen=True)
class StateSpace:
    """Symbolic maps of states."""

    layout: StateLayout
    configurations: Mechanics

    def retract(self, x: ca.SX, dx: ca.SX) -> ca.SX:
        """State moved along a tangent."""
        at = self.layout
        if at.is_flat:
            return x + dx
        moved = self.configurations.integrate(x[at.z], dx[: at.nw])
        return ca.vertcat(moved, x[at.nz :] + dx[at.nw :])

    def move(self, x: ca.SX, dx: ca.SX, move: ca.SX) -> ca.SX:
        """State moved along a tangent, the first state by `move` (2 nv,) in q and v, too."""
        at, nv = self.layout, self.layout.nv
        rest = ca.SX.zeros(at.ndx - at.nw - at.ns)
        if not at.is_flat:
            return self.retract(x, dx + ca.vertcat(move, rest))
        z = x[at.z]
        away = move[:nv] if at.nz == nv else self.configurations.integrate(z, move[:nv]) - z
        return x + dx + ca.vertcat(away, move[nv:], rest)

    def difference(self, x0: ca.SX, x1: ca.SX) -> ca.SX:
        """Tangent that leads from one state to another."""
        at = self.layout
        between = self.configuration_difference(x0[at.z], x1[at.z])
        return ca.vertcat(between, x1[at.nz :] - x0[at.nz :])

    def configuration_difference(self, z0: ca.SX, z1: ca.SX) -> ca.SX:
        """What leads from one configuration to another, shape (nw,)."""
        return z1 - z0 if self.layout.is_flat else self.configurations.difference(z0, z1)

    def at_zero_tangents(
        self, nodes: list[ca.SX], expressions: list[ca.SX], others: list[ca.SX], tangents: list[ca.SX]
    ) -> list[ca.SX]:
        """Expressions in retracted nodes, evaluated at zero tangents (nothing to do where all is flat)."""
        if self.layout.is_flat:
            return expressions
        function = ca.Function("at_zero", [*nodes, *others, *tangents], expressions)
        zeros = [ca.SX.zeros(t.shape) for t in tangents]
        return list(function(*nodes, *others, *zeros))
