"""Derivatives of an optimal motion in the numbers of its problem."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mbocp._arrays import Array, dataclass
from mbocp._text import warn_caller
from mbocp.exceptions import DimensionMismatch, InvalidValue
from mbocp.formulation import Formulation, Motion
from mbocp.programme import Iterate
from mbocp.sensitivity.change import Change, ProblemNumbers
from mbocp.sensitivity.lagrangian_slopes import ParameterFunctions
from mbocp.sensitivity.of_ends import check_rates_at_end
from mbocp.sensitivity.of_robot import OfRobot
from mbocp.sensitivity.optimum import Found, find_optimum, formulate_again, with_active_limits
from mbocp.sensitivity.parameters import parameters_of
from mbocp.sensitivity.reading import OF_MODEL, OF_MOTION, Move, readings_of
from mbocp.sensitivity.slopes import OptimumSlopes
from mbocp.solution import Solution

_LISTED = 4  # degenerate limits in a message


class DegenerateLimitWarning(UserWarning):
    """A limit is active with no multiplier, or all but active: derivatives are those of one side."""


def sensitivities(solution: Solution, wrt: Sequence[str]) -> Sensitivities:
    """Derivatives of an optimal motion in numbers of its problem.

    Parameters
    ----------
    solution : Solution
        One that converged.
    wrt : sequence of str
        Words of parameters, as a problem file has them: ``start.q``, ``goal.v``, ``cost.effort``,
        ``goal.frame.tool0.position``, ``limits.effort.upper``, ``horizon.duration``,
        ``robot.payload.crate.mass``, ...

    Returns
    -------
    Sensitivities
        What it works out when asked for.

    Raises
    ------
    SolverError
        If the solution did not converge, or ends where contacts allow other velocities than at `goal.q`.
    ProblemError
        If the problem has no such parameter; the message has those that it has.
    InvalidValue
        If the solution does not hold the solver's last iterate, or is one of several goals.
    """
    words = (wrt,) if isinstance(wrt, str) else tuple(wrt)
    formulation, iterate = formulate_again(solution, words)
    if "goal.v" in words and formulation.problem.timeline.switches is not None:
        check_rates_at_end(formulation.problem, solution.qs[-1])
    return Sensitivities(formulation, iterate, tuple(parameters_of(formulation, words)))


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivities:
    r"""Derivatives of an optimum, by the implicit-function theorem on its optimality conditions.

    Derivatives in configurations, and of these, are in the tangent space of the robot's joints: nv numbers,
    body-frame rotations for free-flyers and ball joints, angles for continuous ones. Where loops tie joints,
    moves of configurations and velocities are projected onto what the loops allow.

    Attributes
    ----------
    formulation : Formulation
    iterate : Iterate
        Of the solution.
    parameters : tuple of ProblemNumbers
    """

    formulation: Formulation
    iterate: Iterate
    parameters: tuple[ProblemNumbers, ...]

    def __repr__(self) -> str:
        return f"<Sensitivities of {self.formulation.problem.name} in {', '.join(self.names)}>"

    @cached_property
    def names(self) -> dict[str, tuple[str, ...]]:
        """By the words of the parameters what each of their numbers is."""
        return {parameter.word: parameter.names for parameter in self.parameters}

    @property
    def quantities(self) -> tuple[str, ...]:
        """What `of` knows: the cost and arrays of a `Solution`, and the lengths of the steps, `dts`."""
        return ("cost", *readings_of(self.formulation))

    @property
    def degenerate(self) -> tuple[str, ...]:
        """Limits that are active with next to no multiplier, or nearly active."""
        return self._optimum.degenerate

    @property
    def motion(self) -> Motion:
        """That whose conditions hold to round-off; the solution's own ends at a barrier."""
        return self._slopes.reader.motion

    @cached_property
    def cost(self) -> dict[str, Array]:
        """Gradient of the cost by parameter, by the envelope theorem: no system is solved.

        It is as exact as the multipliers of the solve: beside limits to about 1e-7 of the largest entry.
        Conditions of the end stay as the solve chose them, also where some depend on others.
        ``of("cost", word)`` takes multipliers to round-off first and such conditions along, or refuses.
        """
        optimum = with_active_limits(self.formulation.programme, self.iterate)
        return self._by_word(self._functions.gradient(optimum, self._given))

    def of(self, quantity: str, word: str) -> Array:
        """Derivative of a quantity of the solution in a parameter.

        Parameters
        ----------
        quantity : str
            One of `quantities`.
        word : str
            One of the parameters.

        Returns
        -------
        ndarray, shape (..., k)
            The shape of the quantity, of configurations (N + 1, nv), and one for each of the numbers.

        Raises
        ------
        InvalidValue
            If there is no such quantity or parameter, or the two have no derivative here.
        SingularSystem
            If the optimum is not the only one near.

        Warns
        -----
        DegenerateLimitWarning
            Once, if there are degenerate limits.
        """
        _check_known("quantity", quantity, self.quantities)
        _check_known("word", word, self.names)
        parameter = next(p for p in self.parameters if p.word == word)
        if quantity in OF_MODEL and isinstance(parameter, OfRobot):
            raise InvalidValue("quantity", quantity, f"one that depends on {word} by the motion alone")
        if quantity == "cost":
            return self._by_word(self._slopes.of_cost(self._slopes.sound_change))[word]
        columns = [self._slopes.reader.along(move, [quantity])[quantity] for move in self._moves[word]]
        return np.stack(columns, axis=-1)

    def along(self, **moves: ArrayLike) -> dict[str, Array]:
        """Derivatives of the cost and the motion along one move of the parameters, by one solve.

        Parameters
        ----------
        **moves : array_like
            How much each number of a parameter moves, by its word; those left out stay. Words have dots:
            ``along(**{"start.q": dq})``.

        Returns
        -------
        dict of str to ndarray
            Of `cost`, `qs`, `vs`, `us`, `u_values` and `dts`, as `of` gives them.
        """
        given = self._by_word(np.zeros(len(self._stretches)))
        for word, move in moves.items():
            _check_known("word", word, given)
            given[word][:] = _array_of_shape(word, move, given[word].shape)
        weights = np.concatenate(list(given.values()))
        stretch = np.array([weights @ self._stretches])
        slopes = self._slopes
        (along,) = slopes.moves(slopes.change.along(weights[None]), stretch)
        return {
            "cost": weights @ slopes.of_cost(slopes.change),
            **slopes.reader.along(along, OF_MOTION),
        }

    def gradient(self, **bars: ArrayLike) -> dict[str, Array]:
        """Gradient of a scalar function of cost and motion by parameter, with one solve for all parameters.

        Parameters
        ----------
        **bars : array_like
            Derivatives of the scalar in `cost`, `qs` (N + 1, nv), in the tangent space, `vs`, `us`,
            `u_values` and `dts`; those left out are zero.

        Raises
        ------
        InvalidValue, DimensionMismatch
            If a quantity is none of these, or of another shape.
        SingularSystem
            If the optimum is not the only one near.
        """
        motion = self.motion
        shapes = {
            "cost": (),
            "qs": motion.vs.shape,
            "vs": motion.vs.shape,
            "us": motion.us.shape,
            "u_values": motion.values.shape,
            "dts": motion.dts.shape,
        }
        for name in bars:
            _check_known("quantity", name, shapes)
        given = {name: _array_of_shape(name, bar, shapes[name]) for name, bar in bars.items()}
        of_cost = given.pop("cost", np.zeros(()))
        whole, stretch = self._slopes.pull(given, self._slopes.sound_change)
        whole += stretch * self._stretches
        if of_cost:
            whole += of_cost * self._slopes.of_cost(self._slopes.sound_change)
        return self._by_word(whole)

    @cached_property
    def _optimum(self) -> Found:
        found = find_optimum(self.formulation, self.iterate)
        if found.degenerate:
            more = ", ..." if len(found.degenerate) > _LISTED else ""
            warn_caller(
                f"{len(found.degenerate)} limits are active with next to no multiplier, or nearly active: "
                f"{', '.join(found.degenerate[:_LISTED])}{more}; derivatives hold on one side alone",
                DegenerateLimitWarning,
            )
        return found

    @cached_property
    def _functions(self) -> ParameterFunctions:
        return ParameterFunctions(self.formulation)

    @cached_property
    def _given(self) -> Change:
        """What the parameters make of the programme's numbers."""
        return Change.join([parameter.change() for parameter in self.parameters])

    @cached_property
    def _slopes(self) -> OptimumSlopes:
        return OptimumSlopes(self.formulation, self._optimum.kkt, self._functions, self._given)

    @cached_property
    def _stretches(self) -> Array:
        """By which part of them each number makes all given lengths of steps grow."""
        T = self.formulation.problem.duration
        pairs = zip(self.names.values(), self.parameters, strict=True)
        return np.concatenate([np.full(len(names), p.scales_time / T) for names, p in pairs])

    @cached_property
    def _moves(self) -> dict[str, list[Move]]:
        """Of each parameter a move of the optimum for each of its numbers."""
        return self._by_word(self._slopes.moves(self._slopes.change, self._stretches))

    def _by_word(self, whole: Any) -> dict[str, Any]:
        """Parts of what belongs to all parameters, one after the other."""
        ends = accumulate(map(len, self.names.values()), initial=0)
        return {word: whole[slice(*pair)] for word, pair in zip(self.names, pairwise(ends), strict=True)}


def _array_of_shape(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    found = np.asarray(values, dtype=np.float64)
    if found.shape != shape:
        raise DimensionMismatch(name, found.shape, shape)
    return found


def _check_known(name: str, value: str, known: Collection[str]) -> None:
    if value not in known:
        raise InvalidValue(name, value, f"one of {', '.join(known)}")
