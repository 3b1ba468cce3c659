"""Which flow a motion is compared with in which of its steps, where constraints begin and end along the way.

A span is a run of steps in which the same rows of constraints act. In a step of no duration, an impact or a
parting, the flow leaves the configuration, and velocities become those nearest in kinetic energy that the
rows of that step allow. A span begins with velocities that its constraints allow, too: those of nodes are off
by an error of the scheme.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.accuracy.flow import Flow
from mbocp.mechanics.held_frames import ActiveRows
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.robot import Robot


@dataclass(frozen=True, eq=False)
class FlowSpan:
    """Steps ``[first, last)`` with one flow.

    Attributes
    ----------
    first, last : int
    flow : Flow
    takes_time : bool
        Whether they are not an impact or a parting.
    """

    first: int
    last: int
    flow: Flow
    takes_time: bool = True

    @property
    def steps(self) -> slice:
        """Its steps, and the nodes with which they begin."""
        return slice(self.first, self.last)

    @property
    def ends(self) -> slice:
        """The nodes at the ends of its steps."""
        return slice(self.first + 1, self.last + 1)


@dataclass(frozen=True, eq=False)
class Course:
    """Flows of all steps, span by span."""

    spans: tuple[FlowSpan, ...]

    @property
    def flow(self) -> Flow:
        """One of them, for what does not depend on constraints."""
        return self.spans[0].flow

    def starts(self, qs: Array, vs: Array) -> Array:
        """Velocities with which steps begin, from those of the nodes, shape (N, nv).

        Before a step of no duration they are those that the constraints before it allow.
        """
        return np.vstack(
            [self._allowance(i, qs[span.steps], vs[span.steps]) for i, span in enumerate(self.spans)]
        )

    def end_velocities(self, qs: Array, vs: Array) -> Array:
        """Velocities with which steps end, from those of the nodes, shape (N, nv)."""
        return np.vstack([span.flow.consistent(qs[span.ends], vs[span.ends]) for span in self.spans])

    def _allowance(self, i: int, qs: Array, vs: Array) -> Array:
        if self.spans[i].takes_time:
            return self.spans[i].flow.consistent(qs, vs)
        return self.spans[i - 1].flow.consistent(qs, vs) if i else vs

    def ends(self, qs: Array, speeds: Array, us: Array, dts: Array, parts: int) -> tuple[Array, Array]:
        """States after the flows over all steps, each from its own begin; see `Flow.ends`."""
        found = []
        for span in self.spans:
            q, s = qs[span.steps], speeds[span.steps]
            if span.takes_time:
                found.append(span.flow.ends(q, s, us[span.steps], dts[span.steps], parts))
            else:
                found.append((q, span.flow.consistent(q, s)))
        return np.vstack([q for q, _ in found]), np.vstack([s for _, s in found])

    def replay(self, q: Array, speeds: Array, us: Array, dts: Array, parts: int) -> Array:
        """Configuration at the end of one flow under the controls of all steps, shape (nq,)."""
        for span in self.spans:
            speeds = span.flow.consistent(q[None], speeds[None])[0]
            if span.takes_time:
                qs, after = span.flow.replay(q, speeds, us[span.steps], dts[span.steps], parts)
                q, speeds = qs[-1], after[-1]
        return q

    def track(self, planned: tuple[Array, Array], us: Array, dts: Array, parts: int, gains: Array) -> Array:
        """Configuration at the end of one flow that answers deviations; see `Flow.track`, shape (nq,)."""
        (qs, vs), robot = planned, self.flow.robot
        x = np.concatenate([qs[0], vs[0], np.zeros(robot.nu)])
        at_v = slice(robot.nq, robot.nq + robot.nv)
        for span in self.spans:
            x[at_v] = span.flow.consistent(x[None, : robot.nq], x[None, at_v])[0]
            if span.takes_time:
                of = span.steps
                x = span.flow.track(x, (qs[of], vs[of]), us[of], dts[of], parts, gains[of])
        return x[: robot.nq]


def course_of(
    robot: Robot, table: SwitchTable | None, num_steps: int, *, deadline: float = math.inf
) -> Course:
    """Flows of the steps of a motion.

    Parameters
    ----------
    robot : Robot
    table : SwitchTable or None
        What acts in which step; None: the constraints of the robot, always.
    num_steps : int
    deadline : float
        Time of `time.perf_counter` at which compiling is given up.

    Raises
    ------
    CompilationError
        If a flow cannot be compiled, or not before the deadline.
    """
    if table is None:
        return Course((FlowSpan(0, num_steps, Flow.of(robot, deadline=deadline)),))
    acts = np.hstack([table.own, table.rows, table.is_impact[:, None]])
    leaps = 1 + np.flatnonzero((acts[1:] != acts[:-1]).any(axis=1) | table.is_impact[1:])
    flow = _flows(robot, table, deadline)
    runs = pairwise([0, *(int(step) for step in leaps), num_steps])
    return Course(tuple(FlowSpan(*run, flow(run[0]), not table.is_impact[run[0]]) for run in runs))


def _flows(robot: Robot, table: SwitchTable, deadline: float) -> Callable[[int], Flow]:
    """The flow of a step: one for each set of rows."""
    known: dict[ActiveRows, Flow] = {}

    def flow(step: int) -> Flow:
        own, rows = (np.flatnonzero(acts[step]).tolist() for acts in (table.own, table.rows))
        acting = ActiveRows(table.held, tuple(own), tuple(rows))
        if acting not in known:
            known[acting] = Flow.of(robot, acting, deadline=deadline)
        return known[acting]

    return flow
