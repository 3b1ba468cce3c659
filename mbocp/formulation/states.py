"""States and controls of a programme at a motion of the joints, and the motion they stand for.

All formulations store coordinates and speeds in the same way; the rest is what features make of a motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.formulation.features.changing_constraints import join_partings
from mbocp.formulation.features.feature import Feature, join
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.motion import Motion, Passage
from mbocp.mechanics import JointMechanics
from mbocp.mechanics.motion_rates import spacings
from mbocp.problem import Problem


@dataclass(frozen=True, eq=False)
class States:
    """What states and controls of a programme are.

    Attributes
    ----------
    problem : Problem
    features : sequence of Feature
        That states and controls have blocks of.
    layout : StateLayout
    """

    problem: Problem
    features: Sequence[Feature]
    layout: StateLayout

    def first(self, z: Array, speeds: Array) -> Array:
        """Return the state at coordinates and speeds with which a programme begins, shape (nx,)."""
        state = np.concatenate([z, speeds, np.zeros(self.layout.num_more_states)])
        for name, values in join(feature.first(self.problem) for feature in self.features).items():
            state[self.layout.states[name]] = values
        return state

    def of_motion(
        self, motion: Motion, z_and_speeds: tuple[Array, Array], start: Array
    ) -> tuple[Array, Array]:
        """States, shape (N + 1, nx), and controls, shape (N, nu), of a programme at a motion.

        Parameters
        ----------
        z_and_speeds : tuple of ndarray, shapes (N + 1, nz), (N + 1, ns)
            Coordinates, and the motion's velocities or what a formulation has in their place.
        start : ndarray, shape (nx,)
            The programme's first state. Memory of the step before is left at zero.
        """
        problem, at, features = self.problem, self.layout, self.features
        xs = np.zeros((len(motion.qs), at.nx))
        xs[:, at.z], xs[:, at.s] = z_and_speeds
        for name, values in join(feature.states_of(problem, motion) for feature in features).items():
            xs[:, at.states[name]] = values
        xs[0] = start
        us = join(feature.controls_of(problem, motion) for feature in features)
        return xs, np.hstack(list(us.values()))

    def read(self, qs_and_vs: tuple[Array, Array], xs: Array, us: Array) -> Motion:
        """Return the motion of states and controls, whose configurations and velocities are given."""
        motion = Motion(*qs_and_vs, us, self.problem.timeline.lengths())
        for feature in self.features:
            motion = feature.read(self.problem, self.layout, xs, us, motion)
        return motion

    def remember(self, xs: Array, us: Array, lams: Array | None = None) -> Array:
        """States (N + 1, nx) that remember what their speeds, controls (N, any) and lengths of steps say.

        `lams`: forces of the robot's constraints, shape (N, nc), where any are remembered.
        """
        problem, at, features = self.problem, self.layout, self.features
        if not at.nr:
            return xs
        is_impact = problem.timeline.is_impact
        still = np.zeros((1, problem.robot.nq)), np.zeros((1, problem.robot.nv))  # nobody looks at them
        motion, lams = self.read(still, xs, us), np.zeros((len(is_impact), 0)) if lams is None else lams
        forces = join_partings(problem, np.where(is_impact[:, None], lams / problem.dt, lams))
        units = join(feature.units(problem) for feature in features)
        given = join(feature.stage_numbers(problem) for feature in features)
        for_all = join(feature.numbers(problem) for feature in features)

        def passage(taken: BoolArray, before: Mapping[str, Any]) -> Passage:
            dts, speeds = motion.dts[taken], xs[:, at.s]
            return Passage(
                s0=speeds[:-1][taken],
                s1=speeds[1:][taken],
                u=motion.us_at_ends[taken],
                units_of_u=1.0,
                dt=dts[:, None],
                spacing=spacings(dts)[:, None],
                has_before=(np.arange(len(dts)) > 0).astype(np.float64)[:, None],
                before=before,
                units=units,
                controls={name: us[:, where][taken] for name, where in at.controls.items()},
                given={**for_all, **{name: rows[taken] for name, rows in given.items()}},
                forces=lambda rows: forces[taken][:, list(rows) if forces.size else []],
                q0=xs[:-1, at.z][taken],
                way=lambda: self._ways(xs, taken),
                mechanics=lambda: JointMechanics(problem.robot),
                begin=motion.values[taken, 0] if problem.controls == "linear" else None,
            )

        first = join(feature.first(problem) for feature in features)
        known: dict[str, Array] = {}
        filled = np.array(xs)
        blocks = (
            (feature, block) for feature in features for block in feature.blocks(at.ns, problem.robot.nu)
        )
        for feature, block in ((feature, block) for feature, block in blocks if block.is_remembered):
            taken = np.ones_like(is_impact) if block.has_impacts else ~is_impact
            before = {name: values[:-1] for name, values in known.items()} | {block.name: 0.0}
            after = feature.next_value(block.name, passage(taken, before))
            begin = first.get(block.name, np.zeros(after.shape[1]))
            after = begin + np.cumsum(after, axis=0) if block.adds_up else after
            known[block.name] = np.vstack([begin, after])
            nodes = np.cumsum(np.append(0, taken))  # for each its place among those after such steps
            filled[:, at.states[block.name]] = known[block.name][nodes]
        return filled

    def _ways(self, xs: Array, taken: BoolArray) -> Array:
        """What leads from node to node in the steps that are taken; coordinates are those of the joints."""
        zs = xs[:, self.layout.z]
        pairs = zip(zs[:-1][taken], zs[1:][taken], strict=True)
        return np.array([self.problem.robot.difference(before, after) for before, after in pairs])
