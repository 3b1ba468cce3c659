"""What moves with a horizon: phases, which repeat, and via points; and problems that it cannot take.

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
from mbocp.programme.kernel import set_bounds, sides

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
        programme = self._formulation.programme
        set_bounds(native, programme, sides(self._bounds), num_guards=programme.num_guards)
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
        formulation = self._formulation
        rows, ys = len(formulation.constraint_labels), self._native.y.reshape(len(self.is_impact), -1)
        impulses = formulation.pieces.signature.steps.impulses_of(ys.T, rows).T
        lams = impulses / formulation.problem.dt
        return {one.contact.constraint: one.wrenches(lams) for one in contacts}


_METHODS = ("auto", "monolithic")
_WHY = "its times would have to move with the horizon"


def check_can_recede(problem: Problem) -> None:
    """Refuse a problem whose horizon cannot be shifted.

    Raises
    ------
    ProblemError
        If something of it belongs to a given time, or is found with the motion.
    """
    refused = {
        "horizon.duration": (problem.timeline.has_free_lengths, "is free; give it as a number"),
        "horizon.lengths": (
            problem.timeline.has_unequal_lengths,
            "differ; leave them out, so that steps are alike",
        ),
        "horizon.accuracy": (problem.accuracy is not None, "is to choose the steps; give their number"),
        "robust": (problem.robust is not None, "is of a whole motion; leave it out"),
        "goal.excite": (problem.excite is not None, "is of a whole motion; leave it out"),
        "hold, release, impact": (
            problem.timeline.switches is not None and not problem.phase,
            f"there are some; {_WHY}: say them in phases, which repeat",
        ),
        "goal": (bool(problem.goals), "there are several; give one of them"),
        "goal.periodic": (problem.goal.periodic is not None, "is not for a horizon that moves; give q and v"),
        "goal.a": (
            bool(problem.goal.a_active.any()) and problem.goal.a_rule == "given",
            "is the mean of a given step; leave it out",
        ),
        "goal.u": (problem.goal.u.rule == "given", "is of the end of a given motion; leave it out"),
        "parameter": (bool(problem.parameter), "is found for a whole motion; take the robot that was found"),
        "start.free": (problem.start_free is not None, "the state is given in each step; leave it out"),
        "horizon.controls": (
            problem.controls != "constant",
            f'is "{problem.controls}"; take "constant", since a loop gives one control at a time',
        ),
        "limits.effort_rms": (
            bool(problem.limits.finite("rms").any()),
            "is of a whole motion, of which a horizon that moves knows a part; leave it out",
        ),
        "solver.method": (
            problem.solver.method not in _METHODS,
            f'is "{problem.solver.method}"; take "auto" or "monolithic"',
        ),
    }
    for name, (is_there, words) in refused.items():
        if is_there:
            raise ProblemError(f"receding horizon: {name}: {words}")
    if problem.phase:
        check_repeats(problem)


def check_functions(formulation: Formulation) -> None:
    """Refuse functions of progress along a path and of obstacles that move, and steps that begin elsewhere.

    Raises
    ------
    ProblemError
        If there are some.
    """
    robot = formulation.problem.robot
    if formulation.tau == 0.0 and robot.nc:
        raise ProblemError(
            "receding horizon: integrator.scheme: velocities that this one begins with have to fit closed "
            "loops after a step, and measured ones do not; take another"
        )
    clearance = formulation.problem.clearance
    if clearance is not None and clearance.movers:
        raise ProblemError(
            "receding horizon: obstacle.motion: its horizons begin at other times; leave it out"
        )
    if "progress" in formulation.layout.states:
        raise ProblemError("receding horizon: path: frames follow paths; give goals that move in their place")
