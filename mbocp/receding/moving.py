"""What is asked for at times, and moves with a horizon: phases, which repeat for ever, and via points.

All stages of a programme have the same functions, and differ in parameters and bounds alone: which rows of
constraints act, which stages are impacts, where path constraints hold. So a horizon that has moved on by a
step has the same programme with these numbers moved by a stage, and no other functions. The horizon of phases
is one round of them, and what the first stage asked for is asked of the last one. A via point comes nearer
until it is over.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, BoolArray, IntArray
from mbocp.exceptions import ProblemError
from mbocp.formulation import Formulation
from mbocp.formulation.updates import ParameterUpdates
from mbocp.problem import Problem
from mbocp.problem.coordinates import COORDINATES
from mbocp.programme.kernel import set_bounds

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelProgramme


def check_repeats(problem: Problem) -> None:
    """Refuse phases after whose last the first one cannot follow.

    Raises
    ------
    ProblemError
    """
    table, steps = problem.timeline.switches, problem.timeline.is_impact
    words = ""
    if table is not None and (
        (table.own[0] != table.own[-1]).any() or (table.rows[0] != table.rows[-1]).any()
    ):
        words = "what is held in the last is not what is held in the first, which follows it again"
    elif steps[0] or steps[-1]:
        words = "an impact is their first step or their last one"
    if words:
        raise ProblemError(
            f"receding horizon: phase: {words}; cut the phases within one of them, as [gait] does with "
            "repeats = true"
        )
    if problem.cost.is_trajectory:
        raise ProblemError(
            "receding horizon: cost.target: has a row for each step, and phases turn round; give one row, "
            "and a speed in each step"
        )
    if not COORDINATES[problem.coordinates].has_joint_states:
        raise ProblemError(f'receding horizon: coordinates: "{problem.coordinates}" take no phases here')


class MovingStages:
    """Stages that differ, as a horizon moves on over them.

    Parameters
    ----------
    formulation : Formulation
        Of the horizon at its start: of phases one round.
    native : KernelProgramme
        The programme that the horizon steps, at its iterate.
    """

    def __init__(self, formulation: Formulation, native: KernelProgramme) -> None:
        self._formulation, self._native = formulation, native
        programme, problem = formulation.programme, formulation.problem
        self._bounds, self._has_limits = programme.bounds, bool(native.slack.size)
        self._repeats = bool(problem.phase)
        self.is_impact: BoolArray = np.array(problem.timeline.is_impact)

    @property
    def times(self) -> Array:
        """Times of the nodes from now on [s], shape (N + 1,)."""
        return np.append(0.0, np.cumsum(~self.is_impact)) * self._formulation.problem.dt

    def move_on(self, steps: int, numbers: ParameterUpdates) -> None:
        """Move by steps that take time, and by the impacts after each: those are over by then.

        The last stages begin with what the first ones did, one round before; without phases as the last did.
        """
        N = len(self.is_impact)
        if not self._repeats:
            self._move(np.minimum(np.arange(N) + min(steps, N), N - 1), min(steps, N))
            return
        timed = np.flatnonzero(~self.is_impact)
        rounds, rest = divmod(steps, len(timed))
        count = int(timed[rest])
        for part in (N if rounds else 0, count):
            self._move((np.arange(N) + part) % N, part)
        self.is_impact = np.roll(self.is_impact, -count)
        tau = self._formulation.pieces.signature.steps.tau
        numbers.turn(count, self.times[:-1] + tau * np.diff(self.times))

    def _move(self, sources: IntArray, count: int) -> None:
        """Move the iterate, its slacks and what is bounded: each stage has what its source had."""
        native, N = self._native, len(sources)
        x = native.x.reshape(N + 1, -1)
        native.x = np.vstack([x[count:], self._states_after(x, count)]).ravel()
        for name in ("y", "u", "m"):
            rows = getattr(native, name).reshape(N, -1)[sources]
            if name == "m" and self._repeats:  # costates of a first stage make the Hessian indefinite
                rows[N - count :] = 0.0
            setattr(native, name, rows.ravel())
        if not self._has_limits:
            return
        limited, moved = self._bounds.has_limit, {}
        for name in ("slack", "z_lower", "z_upper"):
            full = np.zeros(limited.shape)
            full[limited], guards = np.split(getattr(native, name), [np.count_nonzero(limited)])
            moved[name] = full[sources], guards
        self._bounds = self._bounds.with_sides(self._bounds.lower[sources], self._bounds.upper[sources])
        set_bounds(native, self._formulation.programme, self._bounds)
        for name, (full, guards) in moved.items():
            setattr(native, name, np.append(full[self._bounds.has_limit], guards))

    def _states_after(self, x: Array, count: int) -> Array:
        """States after the last one, with the moves and the changes of speed that followed the first one.

        Without phases the last one stays.
        """
        if not self._repeats:
            return np.repeat(x[-1:], count, axis=0)
        robot, at, space = self._formulation.problem.robot, self._formulation.layout, self._formulation.space
        found, qs = np.array(x[1 : count + 1]), space.configurations(x[: count + 1, at.z])
        found[:, at.s] += x[-1, at.s] - x[0, at.s]
        q = space.configurations(x[-1:, at.z])[0]
        for n in range(count):
            q = robot.integrate(q, robot.difference(qs[n], qs[n + 1]))
            found[n, at.z] = space.coordinates(q[None])[0]
        return found

    def forces(self) -> dict[str, Array]:
        """Forces of the contacts, by names of what is held, see `RecedingHorizon.contact_forces`."""
        contacts = self._formulation.problem.contacts
        lams = self._native.y.reshape(len(self.is_impact), -1) / self._formulation.problem.dt
        return {one.contact.constraint: one.wrenches(lams) for one in contacts}
