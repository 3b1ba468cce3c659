"""What is read off an optimum, and how that moves with its unknowns: explicit functions of these."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from mbocp._arrays import Array, IntArray, dataclass
from mbocp.formulation import Formulation, Motion
from mbocp.formulation.features.changing_constraints import repeat_steps
from mbocp.formulation.features.moved_start import MovedStart
from mbocp.formulation.inequalities import inequalities
from mbocp.formulation.motion import NodeSlopes
from mbocp.programme import BoundMultipliers, Iterate
from mbocp.programme.evaluation import call
from mbocp.robot.kinematics import momenta_of
from mbocp.sensitivity.change import POINTS
from mbocp.sensitivity.kkt import Optimum, Parts, check_unique

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
    free : Parts, optional
        Of multipliers alone: any multiple of it may be added to the step.
    """

    start: Array
    step: Parts
    theta: Array
    rho: Array
    rho_terminal: Array
    stretch: float = 0.0
    free: Parts | None = None

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
        return replace(cast(Any, self.before), programme=programme)


def _alone(step: Parts, like: Move) -> Move:
    """A move of unknowns and multipliers, while numbers stay."""
    return Move(step=step, **{name: np.zeros_like(getattr(like, name)) for name in ("start", *_NUMBERS)})


def _momenta(at: At) -> Array:
    return momenta_of(at.formulation.problem.robot.model, at.motion.qs, at.motion.vs)


def _of_limits(name: str) -> Callable[[At], Array]:
    def read(at: At) -> Array:
        return inequalities(at.formulation, at.iterate, at.motion)[name]

    return read


_MULTIPLIERS = ("lam_us", "lam_qs", "lam_vs", "lam_path")
OF_MOTION = ("dts", "qs", "vs", "us", "u_values")  # what states and controls say by themselves
OF_MODEL = ("ps", "mus")  # what the robot's numbers say, too
_DIFFERENCED: Mapping[str, Callable[[At], Array]] = {
    "ps": _momenta,
    "mus": lambda at: at.formulation.duals_of(at.iterate, at.motion).mus,
    "lams": lambda at: at.formulation.duals_of(at.iterate, at.motion).lams,
    "eta": lambda at: at.iterate.eta,
    **{name: _of_limits(name) for name in _MULTIPLIERS},
}


def readings_of(formulation: Formulation) -> Iterator[str]:
    """Names of those that are functions of the unknowns."""
    has_loops = bool(formulation.problem.robot.nc)
    # Multipliers of explicit steps are no unknowns; rows of the end condition are any basis of a space.
    left_out = {"eta": has_loops, "lams": has_loops and not formulation.solves_for_lams}
    yield from (name for name in ("dts", "t", *OF_MOTION[1:], *_DIFFERENCED) if not left_out.get(name, False))


@dataclass(frozen=True, eq=False)
class OptimumReader:
    """What is read off an optimum of a formulation."""

    formulation: Formulation
    optimum: Optimum

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
        """Derivatives of readings along a move; of configurations in their tangent space.

        Raises
        ------
        SingularSystem
            If multipliers are among them that are not unique.
        """
        exact = self._of_motion(move)
        rest = [name for name in names if name not in exact]
        exact |= self._differences(move, rest)
        if rest and move.free is not None:
            for name, free in self._differences(_alone(move.free, move), rest).items():
                check_unique(exact[name], free)
        return {name: exact[name] for name in names}

    def _differences(self, move: Move, names: Collection[str]) -> dict[str, Array]:
        """Derivatives of readings along a move, by differences of fourth order."""
        points = [(weight, self._at(move, at / move.largest)) for at, weight in POINTS] if names else []
        return {
            name: move.largest * np.sum([w * _DIFFERENCED[name](at) for w, at in points], axis=0)
            for name in names
        }

    @cached_property
    def motion(self) -> Motion:
        """That of the optimum."""
        return self.formulation.motion_of(self.optimum.iterate)

    @cached_property
    def _nodes(self) -> NodeSlopes:
        """How configurations and velocities move with states and controls; a free start as `_first` says."""
        return self.formulation.node_slopes(self.optimum.iterate, self.motion)

    @cached_property
    def _first(self) -> tuple[Array, Array] | None:
        """How a free start moves with the given one, and with the first controls."""
        features, us = self.formulation.pieces.signature.features, self.optimum.iterate.us
        found = next((feature for feature in features if isinstance(feature, MovedStart)), None)
        return None if found is None else found.slopes(self.formulation.problem, self.formulation.layout, us)

    @cached_property
    def _steps(self) -> IntArray:
        """Whose controls each step has."""
        return repeat_steps(self.formulation.problem.timeline.is_impact)

    def _of_motion(self, move: Move) -> dict[str, Array]:
        """Derivatives of what states and controls say by themselves, exact."""
        formulation, nodes, at = self.formulation, self._nodes, self.formulation.layout
        problem, nv = formulation.problem, formulation.problem.robot.nv
        xs, us = np.vstack([move.start, move.step.xs]), move.step.us
        # What is read of controls is linear in these.
        still = Motion(np.zeros((len(xs), 0)), np.zeros((len(xs), 0)), us, np.zeros(len(us)))
        read = formulation.pieces.signature.control_values.read(problem, at, xs, us, still)
        states = np.einsum("nij,nj->ni", nodes.in_states, xs)
        states += np.einsum("nij,nj->ni", nodes.in_us, np.vstack([read.us, read.us[-1:]]))
        if self._first is not None:
            in_given, in_us = self._first
            states[0] = in_given @ (nodes.in_states[0] @ xs[0]) + in_us @ us[0]
        dts = move.stretch * self.motion.dts
        if "h" in at.rows:
            dts = problem.dt * np.where(problem.timeline.is_impact, 0.0, xs[1:, at.rows["h"]][:, 0])
        return {
            "qs": states[:, :nv],
            "vs": states[:, nv:],
            "us": read.us[self._steps],
            "u_values": read.values,
            "dts": dts,
            "t": np.append(0.0, np.cumsum(dts)),
        }

    def pull_back(self, bars: Mapping[str, Array]) -> tuple[Array, Array, float]:
        """From derivatives of a scalar in readings of the motion to those in states and controls.

        Returns
        -------
        xs : ndarray, shape (N + 1, ndx)
        us : ndarray, shape (N, nu)
        stretch : float
            In the share by which all given lengths of steps grow.
        """
        formulation, motion, at = self.formulation, self.motion, self.formulation.layout
        problem, iterate = formulation.problem, self.optimum.iterate
        values = bars.get("u_values", np.zeros_like(motion.values))
        dts = bars.get("dts", np.zeros_like(motion.dts))
        xs, us = np.zeros((len(iterate.xs), at.ndx)), np.zeros_like(iterate.us)
        of_us = np.zeros((len(xs), problem.robot.nu))
        if bars.keys() & {"qs", "vs"}:
            of_states = np.hstack([bars.get(name, np.zeros_like(motion.vs)) for name in ("qs", "vs")])
            of_us = np.einsum("nij,ni->nj", self._nodes.in_us, of_states)
            if self._first is not None:
                in_given, in_us = self._first
                us[0], of_us[0] = in_us.T @ of_states[0], 0.0
                of_states[0] = in_given.T @ of_states[0]
            xs = np.einsum("nij,ni->nj", self._nodes.in_states, of_states)
            of_us[-2] += of_us[-1]
        if "us" in bars:
            np.add.at(of_us, self._steps, bars["us"])
        control_values = formulation.pieces.signature.control_values
        us[:, : at.num_own] += control_values.pull_back(of_us[:-1], values)
        if "h" not in at.rows:
            return xs, us, float(dts @ motion.dts)
        xs[1:, at.rows["h"]] += problem.dt * np.where(problem.timeline.is_impact, 0.0, dts)[:, None]
        return xs, us, 0.0
