"""A second opinion on feet that leave the ground when they like: what pushes them, and what they do there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from tests.checker.implicit import ImplicitStep
from tests.checker.system import Array, System
from tests.checker.walking import Steps, foot_jacobian, foot_place, outside_cone

__all__ = ["check_free_feet"]


def check_free_feet(
    system: System, feet: Sequence[str], steps: Steps, forces: Array, friction: float, ground: float
) -> dict[str, float]:
    """Return the worst of each measure, of steps of the implicit Euler method.

    Parameters
    ----------
    forces : ndarray, shape (N, len(feet), 3)
        Of the ground on each foot in each step, along x, y and z of the world [N].

    Returns
    -------
    dict of str to float
        "dynamics": what the forces do not balance, as a part of what cancels. "pulls", "cone": how far they
        pull, and are outside the cone [weight]. "below": of a foot in the ground at a node [m]. "far": force
        by height [weight by height of the centre of mass]. "drives": power of friction that does not brake;
        "slides": what friction along x and y in the pyramid within the cone brakes less than it could
        [weight by the speed of a fall from there].
    """
    found: dict[str, float] = {}

    def note(name: str, value: float) -> None:
        found[name] = max(found.get(name, 0.0), float(value))

    weight = pin.computeTotalMass(system.model) * float(np.linalg.norm(system.model.gravity.linear))
    length = float(pin.centerOfMass(system.model, system.data, steps.qs[0])[2]) - ground
    speed = np.sqrt(9.81 * length)
    for n, dt in enumerate(np.diff(steps.t)):
        x0, x1 = (np.concatenate([steps.qs[k], steps.vs[k]]) for k in (n, n + 1))
        step = ImplicitStep(system, "se1", float(dt))
        rows, sizes = (part[system.nv :] for part in step.rows(x0, x1, np.zeros(0), steps.us[n]))
        J = foot_jacobian(system, feet, steps.qs[n + 1])
        note("dynamics", np.abs(rows + dt * J.T @ forces[n].ravel()).max() / sizes.max())
        note("cone", outside_cone(forces[n], friction) / weight)
        slips = (J @ steps.vs[n + 1]).reshape(-1, 3)[:, :2]
        for foot, force, slip in zip(feet, forces[n], slips, strict=True):
            height = float(foot_place(system, foot, steps.qs[n + 1])[2]) - ground
            power, most = float(force[:2] @ slip), friction / np.sqrt(2.0) * force[2]
            note("pulls", -force[2] / weight)
            note("below", -height)
            note("far", force[2] * height / (weight * length))
            note("drives", power / (weight * speed))
            note("slides", (most * np.abs(slip).sum() + power) / (weight * speed))
    return found
