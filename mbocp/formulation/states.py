"""States and controls of a programme at a motion of the joints, and the motion they stand for.

All formulations store coordinates and speeds in the same way; the rest is what features make of a motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.formulation.features.feature import Feature, join
from mbocp.formulation.features.passage import Passage
from mbocp.formulation.layout import Block, StateLayout
from mbocp.formulation.motion import Motion
from mbocp.mechanics.motion_rates import spacings
from mbocp.problem import Problem


def first_state(
    problem: Problem, features: Sequence[Feature], at: StateLayout, z: Array, speeds: Array
) -> Array:
    """Return the state at coordinates and speeds with which a programme begins, shape (nx,)."""
    state = np.concatenate([z, speeds, np.zeros(at.num_more_states)])
    for name, values in join(feature.first(problem) for feature in features).items():
        state[at.states[name]] = values
    return state


def states_and_controls(
    problem: Problem,
    features: Sequence[Feature],
    at: StateLayout,
    motion: Motion,
    z_and_speeds: tuple[Array, Array],
    start: Array,
) -> tuple[Array, Array]:
    """States, shape (N + 1, nx), and controls, shape (N, nu), of a programme at a motion.

    Parameters
    ----------
    z_and_speeds : tuple of ndarray, shapes (N + 1, nz), (N + 1, ns)
        Coordinates, and the motion's velocities or what a formulation has in their place.
    start : ndarray, shape (nx,)
        The programme's first state. Memory of the step before is left at zero.
    """
    xs = np.zeros((len(motion.qs), at.nx))
    xs[:, at.z], xs[:, at.s] = z_and_speeds
    for name, values in join(feature.states_of(problem, motion) for feature in features).items():
        xs[:, at.states[name]] = values
    xs[0] = start
    us = join(feature.controls_of(problem, motion) for feature in features)
    return xs, np.hstack(list(us.values()))


def read_motion(
    problem: Problem,
    features: Sequence[Feature],
    at: StateLayout,
    qs_and_vs: tuple[Array, Array],
    xs: Array,
    us: Array,
) -> Motion:
    """Return the motion that states and controls stand for, whose configurations and velocities are given."""
    motion = Motion(*qs_and_vs, us, problem.timeline.lengths())
    for feature in features:
        motion = feature.read(problem, at, xs, us, motion)
    return motion


def with_memory(
    problem: Problem,
    features: Sequence[Feature],
    at: StateLayout,
    xs: Array,
    us: Array,
    lams: Array | None = None,
) -> Array:
    """States (N + 1, nx) that remember what their speeds, controls (N, any) and lengths of steps say.

    `lams`: forces of the robot's constraints, shape (N, nc), where any are remembered.
    """
    if not at.nr:
        return xs
    is_impact = problem.timeline.is_impact
    still = np.zeros((1, problem.robot.nq)), np.zeros((1, problem.robot.nv))  # nobody looks at them
    motion = read_motion(problem, features, at, still, xs, us)
    between = partial(_ways, problem, xs[:, at.z])
    forces = None if lams is None else np.where(is_impact[:, None], lams / problem.dt, lams)
    given = join(feature.stage_numbers(problem) for feature in features)
    units = join(feature.units(problem) for feature in features)
    first = join(feature.first(problem) for feature in features)
    controls = {name: us[:, where] for name, where in at.controls.items()}
    known: dict[str, Array] = {}
    filled = np.array(xs)
    for feature, block in _remembered_blocks(features, at.ns, problem.robot.nu):
        taken = np.ones_like(is_impact) if block.has_impacts else ~is_impact
        before = {name: values[:-1] for name, values in known.items()} | {block.name: 0.0}
        step = _passage(problem, motion, xs[:, at.s], taken, before, units, controls, given, forces, between)
        after = feature.following(block.name, step)
        begin = first.get(block.name, np.zeros(after.shape[1]))
        after = begin + np.cumsum(after, axis=0) if block.adds_up else after
        known[block.name] = np.vstack([begin, after])
        nodes = np.cumsum(np.append(0, taken))  # for each its place among those after such steps
        filled[:, at.states[block.name]] = known[block.name][nodes]
    return filled


def _remembered_blocks(features: Sequence[Feature], ns: int, nu: int) -> Iterator[tuple[Feature, Block]]:
    for feature in features:
        yield from ((feature, block) for block in feature.blocks(ns, nu) if block.is_remembered)


def _ways(problem: Problem, zs: Array, taken: BoolArray) -> Array:
    """What leads from node to node where coordinates are those of the joints, in the steps that are taken."""
    pairs = zip(zs[:-1][taken], zs[1:][taken], strict=True)
    return np.array([problem.robot.difference(before, after) for before, after in pairs])


def _passage(
    problem: Problem,
    motion: Motion,
    speeds: Array,
    taken: BoolArray,
    before: Mapping[str, Any],
    units: Mapping[str, float],
    controls: Mapping[str, Array],
    given: Mapping[str, Array],
    forces: Array | None,
    between: Callable[[BoolArray], Array],
) -> Passage:
    """Steps of a motion as the rules see them, of those that are taken."""
    dts = motion.dts[taken]

    def forces_of(rows: Sequence[int]) -> Array:
        return np.zeros((len(dts), 0)) if forces is None else forces[taken][:, list(rows)]

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
        controls={name: values[taken] for name, values in controls.items()},
        given={name: rows[taken] for name, rows in given.items()},
        forces=forces_of,
        way=partial(between, taken),
        begin=motion.values[taken, 0] if problem.controls == "linear" else None,
    )
