"""What a trajectory says about itself: conserved quantities, violation of constraints, drift."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import DimensionMismatch
from mbocp.mechanics.symmetries import find_symmetries, momentum_map
from mbocp.mechanics.symmetries.fields import Symmetry
from mbocp.robot import Robot


def control_momenta(
    robot: Robot, qs: Array, vs: Array, costates: Array, *, tracked: Any = None, weighs_changes: bool = False
) -> tuple[Array, tuple[str, ...]]:
    r"""Control momenta, eq. (15), in the directions that are symmetries of the robot.

    They are conserved if the running cost is invariant, too: effort :math:`|u|^2` is; for a tracking term
    pass the components that it weighs as `tracked`, and the symmetries that move one of them are left out.

    Parameters
    ----------
    robot : Robot
    qs : ndarray, shape (N + 1, nq)
        Configurations [m, rad, quaternion xyzw].
    vs : ndarray, shape (N + 1, nv)
        Velocities [m/s, rad/s].
    costates : ndarray, shape (N + 1, 2 nv)
        Boundary duals of the nodes, see `mbocp.mechanics.symmetries.momentum_map`.
    tracked : array_like of bool, shape (2 nv,), optional
        Components of (q, p) that the running cost weighs.
    weighs_changes : bool
        Whether the cost weighs changes of controls from step to step. Momenta of symmetries that turn
        controls then have a part of the control before, which is not looked for: they are left out.

    Returns
    -------
    momenta : ndarray, shape (N + 1, k)
    names : tuple of str
        "translation along x", "rotation about z", ...; empty if there is no symmetry.

    Raises
    ------
    DimensionMismatch
        If the shapes do not fit the robot.
    """
    nodes = len(qs)
    widths = (("qs", qs, robot.nq), ("vs", vs, robot.nv), ("costates", costates, 2 * robot.nv))
    for name, array, width in widths:
        if array.shape != (nodes, width):
            raise DimensionMismatch(name, array.shape, (nodes, width))
    symmetries = find_kept_symmetries(robot, tracked, weighs_changes=weighs_changes)
    columns = [momentum_map(s, qs, vs, costates) for s in symmetries]
    momenta: Array = np.array(columns).T if columns else np.zeros((nodes, 0))
    return momenta, tuple(s.name for s in symmetries)


def find_kept_symmetries(
    robot: Robot, tracked: Any = None, *, weighs_changes: bool = False
) -> list[Symmetry]:
    """Symmetries of the robot that the running cost keeps; parameters and errors of `control_momenta`."""
    mask = np.zeros(2 * robot.nv, dtype=bool) if tracked is None else np.asarray(tracked, dtype=bool)
    if mask.shape != (2 * robot.nv,):
        raise DimensionMismatch("tracked", mask.shape, (2 * robot.nv,))
    symmetries = [s for s in find_symmetries(robot) if not s.touches(mask)]
    return [s for s in symmetries if not (weighs_changes and s.control.any())]


@dataclass(frozen=True)
class ConstraintViolation:
    """Largest violation of the holonomic constraints along a trajectory, with where and when.

    Attributes
    ----------
    position : float
        Largest |Phi(q)| [m^2 for rods]; 0 without constraints.
    position_name : str
        Name of that constraint.
    position_node : int
        Node n at which it is that large.
    velocity : float
        Largest |Phi_q(q) v|, the hidden constraint, which schemes of index 3 keep to O(dt) [m^2/s for rods].
    velocity_name : str
    velocity_node : int
    """

    position: float = 0.0
    position_name: str = ""
    position_node: int = 0
    velocity: float = 0.0
    velocity_name: str = ""
    velocity_node: int = 0


def constraint_violation(robot: Robot, qs: Array, vs: Array) -> ConstraintViolation:
    """Find the largest violation of the holonomic constraints at position and at velocity level.

    Parameters
    ----------
    qs : ndarray, shape (N + 1, nq)
    vs : ndarray, shape (N + 1, nv)
    """
    if not robot.nc:
        return ConstraintViolation()
    kept = list(robot.kept_rows)
    residuals, jacobians = robot.closure_along(qs)
    position, velocity = residuals[:, kept], np.einsum("nij,nj->ni", jacobians[:, kept], vs)
    return worst_violation(position, velocity, [label.name for label in robot.constraint_labels])


def worst_violation(position: Array, velocity: Array, names: Sequence[str]) -> ConstraintViolation:
    """Find the worst of given violations.

    Parameters
    ----------
    position, velocity : ndarray, shape (N + 1, nc)
    names : sequence of str
        Of the nc constraints.
    """
    if not names:
        return ConstraintViolation()
    worst = []
    for values in (position, velocity):
        # NaN is the worst there is: argmax finds it first.
        node, row = np.unravel_index(np.argmax(np.abs(values)), values.shape)
        worst.append((float(np.abs(values[node, row])), names[int(row)], int(node)))
    return ConstraintViolation(*worst[0], *worst[1])


def manifold_drift(robot: Robot, qs: Array) -> float:
    """Largest deviation of a quaternion's or a (cos, sin) pair's norm from one along a trajectory.

    Parameters
    ----------
    qs : ndarray, shape (N + 1, nq)

    Returns
    -------
    drift : float
        0 for a robot without such joints.
    """
    norms = [np.linalg.norm(qs[:, group], axis=1) for _, group in robot.unit_groups]
    return float(np.max(np.abs(np.array(norms) - 1.0), initial=0.0))


def largest_turn(robot: Robot, qs: Array, vs: Array, dt: float, substeps: int = 1) -> tuple[str, float]:
    """Find the joint that turns furthest within one step of the integrator; wheels are none.

    Parameters
    ----------
    robot : Robot
    qs : ndarray, shape (N + 1, nq)
        Configurations; between two of them joints of one angle may leap where `vs` does not show it, in
        natural coordinates.
    vs : ndarray, shape (N + 1, nv)
        Velocities [m/s, rad/s].
    dt : float
        Length of one of the N steps [s].
    substeps : int
        Steps of the integrator in each of them.

    Returns
    -------
    name : str
        "" if no joint turns.
    turn : float
        [rad]
    """
    labels = robot.v_labels
    angular = list(robot.angular)
    if not angular:
        return "", 0.0
    speeds = np.abs(vs).max(axis=0)
    at_q, at_v = robot.single
    leaps = np.abs(np.diff(qs[:, at_q], axis=0)).max(axis=0, initial=0.0) / dt
    speeds[at_v] = np.maximum(speeds[at_v], leaps)
    turns = speeds[angular] * dt / substeps
    worst = int(turns.argmax())
    return labels[angular[worst]].name, float(turns[worst])
