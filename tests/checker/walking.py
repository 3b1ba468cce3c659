"""A second opinion on robots that walk: what the ground does, and where feet are, between nodes, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tests.checker.implicit import ImplicitStep
from tests.checker.system import Array, System

__all__ = ["PROJECTED", "Stance", "Steps", "check_walk", "foot_jacobian", "foot_place", "outside_cone"]

PROJECTED = "projected_midpoint"
_NO_TIME = 1e-12  # s
_PARTS = 10  # of a step, between whose nodes feet are looked at


@dataclass(frozen=True)
class Stance:
    """Feet that stand, by their frames, in the steps from one node to another."""

    first: int
    last: int
    feet: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Steps:
    """Nodes of a motion, and the controls between them."""

    t: Array
    qs: Array
    vs: Array
    us: Array


def check_walk(
    system: System, stances: Sequence[Stance], steps: Steps, friction: float, scheme: str
) -> dict[str, float]:
    """Return the worst of each measure, on a level ground as high as the lowest foot at the start.

    Returns
    -------
    dict of str to float
        "dynamics", "impact": what no force of the feet balances, as a part of what cancels. "cone",
        "impulse": how far forces, and impulses where feet land, are outside the cone [weight, of impulses in
        a step], "parting": that of a last step, forces and impulses of the parting after it. "slip": speed of
        feet that stand after an impact or a projection [m/s]. "stands", "below": how far feet are from where
        they landed, and in the air below the ground [m]; "stands between", "below between": beside nodes,
        too, on geodesics from node to node.
    """
    found: dict[str, float] = {}

    def note(name: str, value: float) -> None:
        found[name] = max(found.get(name, 0.0), float(value))

    dts = np.diff(steps.t)
    weight = pin.computeTotalMass(system.model) * float(np.linalg.norm(system.model.gravity.linear))
    feet = sorted({foot for stance in stances for foot in stance.feet})
    ground = min(foot_place(system, foot, steps.qs[0])[2] for foot in feet)
    landed: dict[str, Array] = {}
    before: tuple[str, ...] = stances[0].feet
    for stance in stances:
        forces = np.zeros(3 * len(stance.feet))
        for n in range(stance.first, stance.last):
            (q0, q1), (v0, v1) = steps.qs[n : n + 2], steps.vs[n : n + 2]
            if dts[n] < _NO_TIME:
                leap, J = system.mass(q1) @ (v1 - v0), foot_jacobian(system, stance.feet, q1)
                impulses = _forces(J, leap)
                size = max(float(np.abs(leap).max()), 1e-3 * weight * float(dts.max()))
                note("impact", np.abs(leap - J.T @ impulses).max() / size)
                note("slip", np.abs(J @ v1).max(initial=0.0))
                is_landing = n == stance.first and not set(stance.feet) <= set(before)
                if is_landing:
                    note("impulse", outside_cone(impulses, friction) / (weight * float(dts.max())))
                else:
                    note("parting", outside_cone(forces + impulses / dts[n - 1], friction) / weight)
                continue
            projects = scheme == PROJECTED
            step = ImplicitStep(system, "midpoint" if projects else scheme, float(dts[n]))
            # A mean of velocities, and where the step goes, say with which it ends.
            reached = 2.0 * system.away(q0, q1) / dts[n] - v0 if projects else v1
            x0, x1 = np.concatenate([q0, v0]), np.concatenate([q1, reached])
            rows, sizes = (part[system.nv :] for part in step.rows(x0, x1, np.zeros(0), steps.us[n]))
            J = foot_jacobian(system, stance.feet, step.at(x0, x1)[0])
            forces = _forces(J, -rows / dts[n])
            note("dynamics", np.abs(rows + dts[n] * J.T @ forces).max() / sizes.max())
            if projects:
                lost, J = system.mass(q1) @ (v1 - reached), foot_jacobian(system, stance.feet, q1)
                impulses = _forces(J, lost)
                forces = forces + impulses / dts[n]
                note("dynamics", np.abs(lost - J.T @ impulses).max() / sizes.max())
                note("slip", np.abs(J @ v1).max(initial=0.0))
            if n + 1 == stance.last or dts[n + 1] > _NO_TIME:
                note("cone", outside_cone(forces, friction) / weight)
            path = [system.step(q0, part * system.away(q0, q1)) for part in np.linspace(0, 1, _PARTS + 1)]
            for foot in feet:
                places = np.array([foot_place(system, foot, q) for q in path])
                if foot in stance.feet:
                    off = np.linalg.norm(places - landed.setdefault(foot, places[0]), axis=1)
                    name = "stands"
                else:
                    landed.pop(foot, None)
                    off, name = ground - places[:, 2], "below"
                note(name, off[[0, -1]].max())
                note(f"{name} between", off.max())
        before = stance.feet
    return found


def foot_place(system: System, foot: str, q: Array) -> Array:
    """Where the origin of a frame is [m]."""
    system.place(q)
    return np.array(system.data.oMf[system.model.getFrameId(foot)].translation)


def foot_jacobian(system: System, feet: Sequence[str], q: Array) -> Array:
    """Speeds of feet, in axes of the world."""
    system.place(q)
    rows = [
        system.frame_jacobian(system.model.getFrameId(f), pin.LOCAL_WORLD_ALIGNED)[:3].copy() for f in feet
    ]
    return np.vstack([np.zeros((0, system.nv)), *rows])


def _forces(jacobian: Array, wanted: Array) -> Array:
    """Those of the feet that balance a generalised force best."""
    return np.asarray(np.linalg.lstsq(jacobian.T, wanted, rcond=1e-10)[0])


def outside_cone(forces: Array, friction: float) -> float:
    """How far forces along x, y and z are outside the cone at most [N]."""
    x, y, normal = forces.reshape(-1, 3).T
    return float((np.hypot(x, y) - friction * normal).max(initial=0.0))
