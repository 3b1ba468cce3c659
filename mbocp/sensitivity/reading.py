"""What is read off an optimum, and how that moves with its unknowns: explicit functions of these."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation import Formulation, Motion
from mbocp.formulation.inequalities import inequalities
from mbocp.programme import BoundMultipliers, Iterate
from mbocp.robot.kinematics import momenta_of
from mbocp.sensitivity.kkt import Optimum, Parts, call
from mbocp.sensitivity.numbers import fourth_order

_COLOURS = 3  # of places that are moved at once: readings depend on those beside them alone


@dataclass(frozen=True, eq=False)
class Move:
    """A move of an optimum and of its programme's numbers.

    Attributes
    ----------
    xs : ndarray, shape (N + 1, ndx)
        Of the states, the given one included.
    rest : Parts
        Of the other unknowns and of the multipliers, without a first axis.
    theta, rho, rho_terminal : ndarray
    stretch : float
        By which part of it all given lengths of steps grow.
    """

    xs: Array
    rest: Parts
    theta: Array
    rho: Array
    rho_terminal: Array
    stretch: float = 0.0


@dataclass(frozen=True, eq=False)
class At:
    """An optimum that is moved."""

    formulation: Formulation
    iterate: Iterate
    motion: Motion


def move(formulation: Formulation, optimum: Optimum, along: Move, size: float) -> At:
    """The optimum after so much of a move."""
    programme, N = formulation.programme, formulation.programme.num_steps
    (xs,) = call(programme.functions, "retract", N + 1, [optimum.iterate.xs, size * along.xs])
    rest, nx, nu = along.rest, programme.kind.nx, programme.kind.nu
    ws = optimum.ws + size * rest.ws
    iterate = Iterate(
        xs=xs.dense(nx),
        **{
            name: getattr(optimum.iterate, name) + size * getattr(rest, name)
            for name in ("ys", "us", "ms", "eta")
        },
        bounds=BoundMultipliers(
            xs=np.vstack([np.zeros((1, nx)), ws[:, :nx]]),
            us=ws[:, nx : nx + nu],
            path=ws[:, nx + nu :],
            guard=np.zeros(programme.num_guards),
        ),
    )
    numbers = {
        name: getattr(programme, name) + size * getattr(along, name)
        for name in ("theta", "rho", "rho_terminal")
    }
    moved = replace(cast(Any, formulation), programme=replace(programme, **numbers, x_start=iterate.xs[0]))
    motion = formulation.motion_of(iterate)
    if along.stretch:
        motion = replace(motion, dts=motion.dts * (1.0 + size * along.stretch))
    return At(cast(Formulation, moved), iterate, motion)


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


def read_along(formulation: Formulation, optimum: Optimum, along: Move, name: str) -> Array:
    """Derivative of a reading along a move; of configurations in their tangent space."""
    robot = formulation.problem.robot

    before = move(formulation, optimum, along, 0.0).motion.qs if name == "qs" else np.zeros(0)

    largest = max(1.0, float(np.abs(along.xs).max(initial=0.0)))

    def values(size: float) -> Array:
        found = READINGS[name](move(formulation, optimum, along, size / largest))
        if name != "qs":
            return found
        return np.array([robot.difference(q, moved) for q, moved in zip(before, found, strict=True)])

    return largest * fourth_order(values)


def pull_back(
    formulation: Formulation, optimum: Optimum, bars: Mapping[str, Array]
) -> tuple[Array, Array, float]:
    """From derivatives of a scalar in readings of the motion to those in states and controls.

    Returns
    -------
    xs : ndarray, shape (N + 1, ndx)
    us : ndarray, shape (N, nu)
    stretch : float
        In the share by which all given lengths of steps grow.
    """
    N, still = optimum.programme.num_steps, _still(optimum)
    places = {"xs": np.arange(N + 1.0), "us": np.arange(N) + 0.5}  # in steps
    found = {"xs": np.zeros_like(still.xs), "us": np.zeros_like(still.rest.us)}
    for name, at in places.items():
        for column in range(found[name].shape[1]):
            for colour in range(min(_COLOURS, len(at))):
                moved = np.zeros_like(found[name])
                moved[colour::_COLOURS, column] = 1.0
                along = replace(still, xs=moved)
                if name == "us":
                    along = replace(still, rest=still.rest._replace(us=moved))
                for reading, bar in bars.items():
                    shares = (bar * read_along(formulation, optimum, along, reading)).reshape(len(bar), -1)
                    read_at = np.arange(len(bar)) + (0.0 if len(bar) > N else 0.5)
                    owners = np.abs(read_at[:, None] - at[colour::_COLOURS]).argmin(axis=1)
                    np.add.at(found[name][:, column], colour + _COLOURS * owners, shares.sum(axis=1))
    whole = replace(still, stretch=1.0)
    stretch = sum(float((bar * read_along(formulation, optimum, whole, r)).sum()) for r, bar in bars.items())
    return found["xs"], found["us"], stretch


def _still(optimum: Optimum) -> Move:
    """No move."""
    programme = optimum.programme
    rest = Parts(*(part[0] for part in Parts.zeros(programme, 1)))
    numbers = (np.zeros_like(getattr(programme, name)) for name in ("theta", "rho", "rho_terminal"))
    return Move(np.zeros((programme.num_steps + 1, programme.kind.ndx)), rest, *numbers)
