"""Where the pieces of a state are: coordinates of the configuration, speeds, memory, length, time."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from mbocp.mechanics import Mechanics

__all__ = ["StateLayout", "StateSpace", "start_move"]


@dataclass(frozen=True)
class StateLayout:
    """Pieces of a state x = (z, s, r, h, t) and of its tangent dx = (dq, ds, dr, dh, dt).

    Attributes
    ----------
    nz : int
        Coordinates of the configuration: Pinocchio's q, or with rotation matrices.
    nv : int
        Tangent directions of the configuration.
    ns : int
        Speeds: the velocities v, unless controls prescribe some of them.
    memory : tuple of (str, int)
        Names and sizes of what it remembers of the step that led to it, see `memory`.
    is_flat : bool
        Whether the state is taken as a plain vector, although its configurations may form a group: what a
        general nonlinear programming solver and integrators that leave the group need.
    nh : int
        1 where the length of the steps is free: h, in units of its guess; else 0. See `step_lengths`.
    nt : int
        1 where there are several such lengths: the time, in units of the guessed duration; else 0.
    moves : tuple of int
        Directions of (q, v) in which the start is free; see `moved_start`.
    nu : int
        Controls of the robot.
    shares : tuple of float
        Where in a step they have values; empty where they are constant. See `control_values`.
    is_continuous : bool
        Whether the first value of a step is the last of the step before, which states remember.
    """

    nz: int
    nv: int
    ns: int
    is_flat: bool
    memory: tuple[tuple[str, int], ...] = ()
    nh: int = 0
    nt: int = 0
    moves: tuple[int, ...] = ()
    nu: int = 0
    shares: tuple[float, ...] = ()
    is_continuous: bool = False

    @property
    def num_values(self) -> int:
        """Values of each control in a step."""
        return max(len(self.shares), 1)

    @property
    def num_own(self) -> int:
        """Controls of the programme that are values of those of the robot; they come first."""
        return self.nu * self.num_values

    @property
    def nr(self) -> int:
        """Entries of what is remembered."""
        return sum(size for _, size in self.memory)

    @property
    def num_paces(self) -> int:
        """Controls of the progress along paths that frames follow; the first beyond those of the robot."""
        return dict(self.memory).get("progress", 0)

    @property
    def num_moves(self) -> int:
        """Controls that move the start; between those of paths and those of lengths."""
        return len(self.moves)

    def of_moves(self, num_controls: int) -> slice:
        """Places of the moves among all controls of the programme."""
        stop = num_controls - self.nh
        return slice(stop - self.num_moves, stop)

    @property
    def num_more_controls(self) -> int:
        """Controls of the programme beyond those of the robot."""
        return self.num_paces + self.num_moves + self.nh

    @property
    def remembered(self) -> dict[str, slice]:
        """Places of the blocks in a state, by name."""
        return self._blocks(self.nz + self.ns)

    @property
    def remembered_rows(self) -> dict[str, slice]:
        """Places of the blocks in a tangent, and in the rows of a step, by name."""
        return self._blocks(self.nw + self.ns)

    def _blocks(self, start: int) -> dict[str, slice]:
        found = {}
        for name, size in self.memory:
            found[name] = slice(start, start + size)
            start += size
        return found

    @property
    def nx(self) -> int:
        """Length of a state."""
        return self.nz + self.ns + self.nr + self.nh + self.nt

    @property
    def nw(self) -> int:
        """Tangent directions of the configuration as the programme counts them."""
        return self.nz if self.is_flat else self.nv

    @property
    def ndx(self) -> int:
        """Length of a state's tangent."""
        return self.nw + self.ns + self.nr + self.nh + self.nt

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
    def h(self) -> slice:
        """Step length in a state."""
        return slice(self.nx - self.nt - self.nh, self.nx - self.nt)

    @property
    def t(self) -> slice:
        """Time in a state."""
        return slice(self.nx - self.nt, self.nx)

    @property
    def ds(self) -> slice:
        """Speeds in a tangent, and in the rows of a step."""
        return slice(self.nw, self.nw + self.ns)

    @property
    def dr(self) -> slice:
        """All that is remembered in a tangent, and in the rows of a step."""
        return slice(self.nw + self.ns, self.nw + self.ns + self.nr)

    @property
    def dh(self) -> slice:
        """Step length in a tangent, and in the rows of a step."""
        return slice(self.ndx - self.nt - self.nh, self.ndx - self.nt)

    @property
    def dt(self) -> slice:
        """Time in a tangent, and in the rows of a step."""
        return slice(self.ndx - self.nt, self.ndx)


def start_move(at: StateLayout, e: ca.SX, w: ca.SX) -> ca.SX:
    """Move e E w of the start in (q, v), shape (2 nv,)."""
    move = ca.SX.zeros(2 * at.nv)
    for k, i in enumerate(at.moves):
        move[i] = e * w[k]
    return move


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

    def moved(self, x: ca.SX, dx: ca.SX, move: ca.SX) -> ca.SX:
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
        self,
        nodes: list[ca.SX],
        expressions: list[ca.SX],
        others: list[ca.SX],
        tangents: list[ca.SX],
    ) -> list[ca.SX]:
        """Expressions in retracted nodes, evaluated at zero tangents (nothing to do where all is flat)."""
        if self.layout.is_flat:
            return expressions
        function = ca.Function("at_zero", [*nodes, *others, *tangents], expressions)
        zeros = [ca.SX.zeros(t.shape) for t in tangents]
        return list(function(*nodes, *others, *zeros))
