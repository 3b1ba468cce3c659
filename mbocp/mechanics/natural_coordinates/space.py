"""Between joint coordinates, in which people give and read a motion, and natural coordinates."""

from __future__ import annotations

from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.lie.configuration import JointSpace
from mbocp.mechanics.natural_coordinates.bodies import SIZE
from mbocp.mechanics.natural_coordinates.mechanics import NaturalMechanics
from mbocp.mechanics.symmetries.fields import Symmetry
from mbocp.robot import Robot


@lru_cache(maxsize=16)
def natural_mechanics(robot: Robot) -> NaturalMechanics:
    """Natural coordinates of a robot, made once for a robot object, which never changes."""
    return NaturalMechanics(robot)


class NaturalSpace:
    """Natural coordinates as the space of configurations: a plain vector space with constraints on it.

    Offers of `mbocp.lie.ConfigurationSpace` what programmes in a vector space need.

    Parameters
    ----------
    mechanics : NaturalMechanics
    q_start : ndarray, shape (nq,)
        Joint configuration at the beginning: where several turns of a joint look the same, this one is meant.

    Attributes
    ----------
    nq, nz, nv : int
        Numbers of a joint configuration; natural coordinates, and their tangent directions.
    """

    is_vector = True
    parts: tuple[JointSpace, ...] = ()

    def __init__(self, mechanics: NaturalMechanics, q_start: Array) -> None:
        self.mechanics, self.q_start = mechanics, q_start
        self.nq, self.nz, self.nv = mechanics.robot.nq, mechanics.nq, mechanics.nv

    def integrate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Coordinates moved, z + v."""
        return z + v

    def difference(self, z0: ca.SX, z1: ca.SX) -> ca.SX:
        """What leads from z0 to z1."""
        return z1 - z0

    def defects(self, z: ca.SX) -> ca.SX:
        """How far the directors are from orthonormal ones, body by body: Frobenius norm of D'D - 1."""
        found = [ca.SX(0)]
        for body in self.mechanics.tree.turning:
            D = ca.reshape(z[body.at + 3 : body.at + SIZE], 3, 3)
            found.append(ca.norm_fro(D.T @ D - ca.SX.eye(3)))
        return ca.vertcat(*found)

    def coordinates(self, qs: Array) -> Array:
        """Natural coordinates, shape (k, nz), of joint configurations (k, nq)."""
        return self.mechanics.tree.coordinates(qs)

    def configurations(self, zs: Array) -> Array:
        """Joint configurations, shape (k, nq), of the nodes of a motion (k, nz)."""
        found = np.asarray(_maps(self.mechanics).configuration.map(len(zs))(zs.T)).T
        return self._unwind(self.mechanics.joint_space.configurations(found))

    def velocities(self, zs: Array, ws: Array) -> Array:
        """Joint velocities, shape (k, robot.nv), of coordinates and their rates."""
        return np.asarray(_maps(self.mechanics).velocity.map(len(zs))(zs.T, ws.T)).T

    def slopes(self, zs: Array, ws: Array) -> Array:
        """Derivatives of joint configurations, in their tangent space, and velocities, (k, 2 nv, 2 nz)."""
        maps, joints = _maps(self.mechanics), self.mechanics.joint_space
        read = np.asarray(maps.configuration.map(len(zs))(zs.T)).T
        in_z, of_velocity = (
            found.reshape(len(found), len(zs), -1).transpose(1, 0, 2)
            for found in map(np.asarray, maps.slopes.map(len(zs))(zs.T, ws.T))
        )
        of_configuration = joints.slopes_of_configurations(read) @ in_z
        return np.hstack([np.dstack([of_configuration, np.zeros_like(of_configuration)]), of_velocity])

    def rates(self, qs: Array, vs: Array) -> Array:
        """Rates of the natural coordinates, shape (k, nz), at joint configurations and velocities."""
        tree = self.mechanics.tree
        return np.array([tree.jacobian(q) @ v for q, v in zip(qs, vs, strict=True)])

    def costates(self, zs: Array, vs: Array, duals: Array) -> Array:
        """Duals of joint configurations and velocities, shape (k, 2 robot.nv), from those of (z, w).

        Parameters
        ----------
        zs : ndarray, shape (k, nz)
        vs : ndarray, shape (k, robot.nv)
            Joint velocities.
        duals : ndarray, shape (k, 2 nz)
        """
        return np.asarray(_maps(self.mechanics).costate.map(len(zs))(zs.T, vs.T, duals.T)).T

    def generator(self, symmetry: Symmetry, zs: Array, ws: Array) -> Array:
        r"""How a symmetry moves coordinates and rates, shape (k, 2 nz).

        Every body moves by the symmetry's twist: :math:`\delta r = s + \omega \times r`, :math:`\delta d =
        \omega \times d`, and the rates turn along. What slides moves as in joint coordinates.
        """
        tree, num = self.mechanics.tree, len(self.mechanics.tree.sliding)
        linear, angular = symmetry.twist[:3], symmetry.twist[3:]
        moved, turned = np.zeros_like(zs), np.zeros_like(ws)
        if num:
            dofs = list(tree.sliding)
            block = symmetry.linear[np.ix_(dofs, dofs)]
            moved[:, :num] = symmetry.constant[dofs] + zs[:, :num] @ block.T
            turned[:, :num] = ws[:, :num] @ block.T
        for body in tree.turning:
            if body.joint not in symmetry.joints:
                continue
            for k in range(4):
                at = slice(body.at + 3 * k, body.at + 3 * k + 3)
                moved[:, at] = np.cross(angular, zs[:, at]) + (linear if k == 0 else 0.0)
                turned[:, at] = np.cross(angular, ws[:, at])
        return np.hstack([moved, turned])

    def _unwind(self, qs: Array) -> Array:
        """Angles of revolute joints without jumps, beginning with the turn of the start."""
        for body in self.mechanics.tree.turning:
            if body.kind == "revolute" and not body.leader:
                angles = np.unwrap(qs[:, body.at_q])
                turns = np.round((self.q_start[body.at_q] - angles[0]) / (2 * np.pi))
                qs[:, body.at_q] = angles + 2 * np.pi * turns
        return qs


class _Maps:
    """Functions of a robot's natural coordinates, made once."""

    def __init__(self, mechanics: NaturalMechanics) -> None:
        n, nv = mechanics.nq, mechanics.robot.nv
        z, w, v = ca.SX.sym("z", n), ca.SX.sym("w", n), ca.SX.sym("v", nv)
        dual = ca.SX.sym("dual", 2 * n)
        self.configuration = ca.Function("configuration", [z], [ca.densify(mechanics.joint_coordinates(z))])
        self.velocity = ca.Function("velocity", [z, w], [ca.densify(mechanics.joint_velocity(z, w))])
        J = mechanics.joint_motions(z)
        along = dual[:n] + ca.gradient(ca.dot(dual[n:], J @ v), z)
        costate = ca.vertcat(J.T @ along, J.T @ dual[n:])
        self.costate = ca.Function("costate", [z, v, dual], [ca.densify(costate)])

    @cached_property
    def slopes(self) -> ca.Function:
        """Derivatives of configurations in z, and of velocities in (z, w)."""
        z, w = self.velocity.sx_in()
        configuration, velocity = self.configuration(z), self.velocity(z, w)
        slopes = [ca.jacobian(configuration, z), ca.jacobian(velocity, ca.vertcat(z, w))]
        return ca.Function("slopes", [z, w], [ca.densify(slope) for slope in slopes])


@lru_cache(maxsize=16)
def _maps(mechanics: NaturalMechanics) -> _Maps:
    return _Maps(mechanics)
