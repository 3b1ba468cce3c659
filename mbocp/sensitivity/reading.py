"""What is read off an optimum, and how that moves with its unknowns: explicit functions of these."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation import Formulation, Motion
from mbocp.formulation.inequalities import inequalities
from mbocp.programme import BoundMultipliers, Iterate
from mbocp.robot.kinematics import momenta_of
from mbocp.sensitivity.kkt import Optimum, Parts, call
from mbocp.sensitivity.numbers import POINTS

_COLOURS = 3  # of places that are moved at once: readings depend on those beside them alone
_NUMBERS = ("theta", "rho", "rho_terminal")


@dataclass(frozen=True, eq=False)
class Move:
    """A move of an optimum and of its programme's numbers.

    Attributes
    ----------
    start : ndarray, shape (ndx,)
        Of the given state.
    step : Parts
        Of the unknowns and of the multipliers, without a first axis.
    theta, rho, rho_terminal : ndarray
    stretch : float
        By which part of it all given lengths of steps grow.
    """

    start: Array
    step: Parts
    theta: Array
    rho: Array
    rho_terminal: Array
    stretch: float = 0.0

    @property
    def largest(self) -> float:
        """Largest entry of a state, or one."""
        return max(1.0, *(float(np.abs(move).max(initial=0.0)) for move in (self.start, self.step.xs)))


@dataclass(frozen=True, eq=False)
class At:
    """An optimum that is moved.

    Attributes
    ----------
    before : Formulation
        Without the move.
    numbers : mapping
        What is moved of its programme.
    iterate : Iterate
    motion : Motion
    """

    before: Formulation
    numbers: Mapping[str, Array]
    iterate: Iterate
    motion: Motion

    @cached_property
    def formulation(self) -> Formulation:
        """That whose programme has the numbers."""
        programme = replace(cast(Any, self.before.programme), **self.numbers, x_start=self.iterate.xs[0])
        return cast(Formulation, replace(cast(Any, self.before), programme=programme))


def _times(at: At) -> Array:
    return np.append(0.0, np.cumsum(at.motion.dts))


def _momenta(at: At) -> Array:
    found: Array = momenta_of(at.formulation.problem.robot.model, at.motion.qs, at.motion.vs)
    return found


def _of_limits(name: str) -> Callable[[At], Array]:
    def read(at: At) -> Array:
        found: Array = inequalities(at.formulation, at.iterate, at.motion)[name]
        return found

    return read


_MULTIPLIERS = ("lam_us", "lam_qs", "lam_vs", "lam_path")
READINGS: Mapping[str, Callable[[At], Array]] = {
    "dts": lambda at: at.motion.dts,
    "t": _times,
    "qs": lambda at: at.motion.qs,
    "vs": lambda at: at.motion.vs,
    "us": lambda at: at.motion.us,
    "u_values": lambda at: at.motion.values,
    "ps": _momenta,
    "mus": lambda at: at.formulation.duals_of(at.iterate, at.motion).mus,
    "lams": lambda at: at.formulation.duals_of(at.iterate, at.motion).lams,
    "eta": lambda at: at.iterate.eta,
    **{name: _of_limits(name) for name in _MULTIPLIERS},
}
OF_MOTION = ("qs", "vs", "us", "u_values", "dts")  # what states and controls near say
OF_MODEL = ("ps", "mus")  # what the robot's numbers say, too


def readings_of(formulation: Formulation) -> Iterator[str]:
    """Names of those that are functions of the unknowns."""
    has_loops = bool(formulation.problem.robot.nc)
    # Multipliers of explicit steps are no unknowns; rows of the end condition are any basis of a space.
    left_out = {"eta": has_loops, "lams": has_loops and not formulation.solves_for_lams}
    yield from (name for name in READINGS if not left_out.get(name, False))


@dataclass(frozen=True, eq=False)
class Reader:
    """What is read off an optimum of a formulation."""

    formulation: Formulation
    optimum: Optimum

    @cached_property
    def _qs(self) -> Array:
        return self._at(self._still, 0.0).motion.qs

    @cached_property
    def _still(self) -> Move:
        """No move."""
        programme = self.optimum.programme
        step = Parts(*(part[0] for part in Parts.zeros(programme, 1)))
        numbers = (np.zeros_like(getattr(programme, name)) for name in _NUMBERS)
        return Move(np.zeros(programme.kind.ndx), step, *numbers)

    def _at(self, along: Move, size: float) -> At:
        """The optimum after so much of a move."""
        formulation, programme, kind = self.formulation, self.optimum.programme, self.optimum.programme.kind
        before, step = self.optimum.iterate, along.step
        steps = size * np.vstack([along.start, step.xs])
        (xs,) = call(programme.functions, "retract", programme.num_steps + 1, [before.xs, steps])
        ws = self.optimum.ws + size * step.ws
        of_states, of_controls, of_path = np.split(ws, [kind.nx, kind.nx + kind.nu], axis=1)
        iterate = Iterate(
            xs=xs.dense(kind.nx),
            ys=before.ys + size * step.ys,
            us=before.us + size * step.us,
            ms=before.ms + size * step.ms,
            eta=before.eta + size * step.eta,
            bounds=BoundMultipliers(
                xs=np.vstack([np.zeros((1, kind.nx)), of_states]),
                us=of_controls,
                path=of_path,
                guard=np.zeros(programme.num_guards),
            ),
        )
        numbers = {name: getattr(programme, name) + size * getattr(along, name) for name in _NUMBERS}
        motion = formulation.motion_of(iterate)
        if along.stretch:
            motion = replace(motion, dts=motion.dts * (1.0 + size * along.stretch))
        return At(formulation, numbers, iterate, motion)

    def along(self, move: Move, names: Collection[str]) -> dict[str, Array]:
        """Derivatives of readings along a move; of configurations in their tangent space."""
        points = [(weight, self._at(move, at / move.largest)) for at, weight in POINTS]
        return {
            name: move.largest * np.sum([w * self._read(name, at) for w, at in points], axis=0)
            for name in names
        }

    def _read(self, name: str, at: At) -> Array:
        """A reading; of configurations how far they are from those of the optimum."""
        found = READINGS[name](at)
        if name != "qs":
            return found
        robot = self.formulation.problem.robot
        if robot.is_vector_space:
            away: Array = found - self._qs
            return away
        return np.array([robot.difference(q, moved) for q, moved in zip(self._qs, found, strict=True)])

    def pull_back(self, bars: Mapping[str, Array]) -> tuple[Array, Array, float]:
        """From derivatives of a scalar in readings of the motion to those in states and controls.

        Returns
        -------
        xs : ndarray, shape (N + 1, ndx)
        us : ndarray, shape (N, nu)
        stretch : float
            In the share by which all given lengths of steps grow.
        """
        N, still = self.optimum.programme.num_steps, self._still
        places = {"xs": np.arange(N + 1.0), "us": np.arange(N) + 0.5}  # in steps
        found = {"xs": np.zeros((N + 1, len(still.start))), "us": np.zeros_like(still.step.us)}
        for name, at in places.items():
            for column in range(found[name].shape[1]):
                for colour in range(min(_COLOURS, len(at))):
                    unit = np.zeros_like(found[name])
                    unit[colour::_COLOURS, column] = 1.0
                    xs, us = (unit, still.step.us) if name == "xs" else (np.zeros_like(found["xs"]), unit)
                    along = replace(still, start=xs[0], step=still.step._replace(xs=xs[1:], us=us))
                    for reading, read in self.along(along, bars).items():
                        shares = (bars[reading] * read).reshape(len(read), -1).sum(axis=1)
                        read_at = np.arange(len(read)) + (0.0 if len(read) > N else 0.5)
                        owners = np.abs(read_at[:, None] - at[colour::_COLOURS]).argmin(axis=1)
                        np.add.at(found[name][:, column], colour + _COLOURS * owners, shares)
        whole = self.along(replace(still, stretch=1.0), bars)
        return found["xs"], found["us"], sum(float((bars[r] * whole[r]).sum()) for r in bars)
