r"""Configuration space of a Pinocchio model: the product of its joints' Lie groups.

`integrate` is :math:`q \exp(v)` and `difference` :math:`\log(q_0^{-1} q_1)`, with Pinocchio's coordinates and
conventions (quaternion xyzw, (cos, sin) pairs, body-frame tangents, linear before angular) and the same
values. Its own symbolic functions are not used for Newton's method: their logarithm takes arccosines of
numbers at 1, whose derivatives are infinite in the branch that is not taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import UnsupportedRobot
from mbocp.lie.groups import Circle, Group, Plane, Quaternion, RigidBody, RotationMatrix, Vector


@dataclass(frozen=True)
class JointSpace:
    """One joint: its group, and where its numbers are.

    Attributes
    ----------
    group : Group
    at_q, at_z, at_v : slice
        In Pinocchio's configuration, in the coordinates z, in a tangent vector.
    at_matrix : int
        Where in z a rotation matrix begins; -1 if there is none.
    """

    group: Group
    at_q: slice
    at_z: slice
    at_v: slice
    at_matrix: int = -1

    @property
    def structure(self) -> tuple[str, int, int, int, int]:
        """The same for parts with the same maps at the same places."""
        return type(self.group).__name__, self.at_q.start, self.at_z.start, self.at_v.start, self.at_matrix


class ConfigurationSpace:
    """Symbolic maps of a model's configurations, in Pinocchio's coordinates or with rotation matrices.

    Spaces with the same maps are equal, whatever their models.

    Parameters
    ----------
    model : pinocchio.Model
        Its joints' types decide the groups.
    rotations : {"quaternion", "dcm"}
        Coordinates of the attitudes of free-flyers and ball joints.

    Attributes
    ----------
    nq, nz, nv : int
        Sizes of Pinocchio's configuration, of the coordinates z, and of a tangent vector; nz = nq and z = q
        with quaternions.

    Raises
    ------
    UnsupportedRobot
        If a joint's group is not known here; the message names the joint.
    """

    def __init__(self, model: pin.Model, rotations: str = "quaternion") -> None:
        self.nq, self.nv = model.nq, model.nv
        self.parts = _parts(model, rotations == "dcm")
        self.nz = sum(part.group.nz for part in self.parts)
        self._structure = (self.nq, self.nz, self.nv, *(part.structure for part in self.parts))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ConfigurationSpace) and self._structure == other._structure

    def __hash__(self) -> int:
        return hash(self._structure)

    @property
    def is_vector(self) -> bool:
        """Whether every configuration is a plain vector."""
        return all(part.group.is_vector for part in self.parts)

    def integrate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Configuration (nz,) reached from `z` along the tangent vector `v` (nv,)."""
        return self._join(lambda part: part.group.integrate(z[part.at_z], v[part.at_v]))

    def difference(self, z0: ca.SX, z1: ca.SX) -> ca.SX:
        """Tangent vector (nv,) at `z0` that leads to `z1`."""
        return self._join(lambda part: part.group.difference(z0[part.at_z], z1[part.at_z]))

    def partial_difference(self, z0: ca.SX, z1: ca.SX, parts: Sequence[int]) -> ca.SX:
        """Like `difference`, with zeros for all but some parts, whose logarithm may not be wanted."""
        between = (
            part.group.difference(z0[part.at_z], z1[part.at_z]) if i in parts else ca.SX.zeros(part.group.nv)
            for i, part in enumerate(self.parts)
        )
        return ca.vertcat(ca.SX.zeros(0, 1), *between)

    def find_weighed_parts(self, weights: Array) -> tuple[int, ...]:
        """Parts in whose tangent directions a weight is not zero."""
        return tuple(i for i, part in enumerate(self.parts) if np.any(weights[part.at_v]))

    def rate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Derivative of the coordinates along the velocity v, shape (nz,)."""
        return self._join(lambda part: part.group.rate(z[part.at_z], v[part.at_v]))

    def bracket(self, a: ca.SX, b: ca.SX) -> ca.SX:
        """Lie bracket of two tangent vectors, shape (nv,)."""
        return self._join(lambda part: part.group.bracket(a[part.at_v], b[part.at_v]))

    def dexp(self, w: ca.SX, dw: ca.SX) -> ca.SX:
        """Velocity (nv,) of z exp(w(t)) where w' = dw, in the tangent space there: dexp_{-w} dw."""
        return self._join(lambda part: part.group.dexp(w[part.at_v], dw[part.at_v]))

    def attraction(self, z: ca.SX, gamma_quaternion: ca.SX, gamma_dcm: ca.SX) -> ca.SX:
        """Baumgarte's fictitious rate towards the groups, Eqs. (46), (47) of [Manara2017]_, shape (nz,)."""
        return self._join(lambda part: part.group.attraction(z[part.at_z], gamma_quaternion, gamma_dcm))

    def projection(self, goal: ca.SX, z: ca.SX) -> ca.SX:
        """Difference from `goal`, null-space projected as in Eq. (37) of [Manara2017]_, shape (nv,)."""
        return self._join(lambda part: part.group.projection(goal[part.at_z], z[part.at_z]))

    def guards(self, goal: ca.SX, z: ca.SX) -> list[tuple[JointSpace, ca.SX]]:
        """What must not be negative for a vanishing `projection` to mean the goal, joint by joint."""
        return [(p, g) for p in self.parts for g in p.group.guards(goal[p.at_z], z[p.at_z])]

    def defects(self, z: ca.SX) -> ca.SX:
        """What vanishes where z is a configuration, shape (number of circles and attitudes,)."""
        return self._join(lambda part: ca.vertcat(ca.SX.zeros(0, 1), *part.group.defects(z[part.at_z])))

    def coordinates(self, qs: Array) -> Array:
        """Coordinates z of Pinocchio's configurations, shape (n, nz) from (n, nq)."""
        zs = np.empty((qs.shape[0], self.nz))
        for part in self.parts:
            zs[:, part.at_z] = _with_matrices(qs[:, part.at_q]) if part.at_matrix >= 0 else qs[:, part.at_q]
        return zs

    def configurations(self, zs: Array) -> Array:
        """Pinocchio's configurations nearest to coordinates z, shape (n, nq) from (n, nz).

        A rotation matrix that has left the group is taken to the rotation of its polar decomposition,
        Eq. (54) of [Manara2017]_; quaternions and (cos, sin) are normalised.
        """
        qs = np.empty((zs.shape[0], self.nq))
        for part in self.parts:
            z = zs[:, part.at_z]
            qs[:, part.at_q] = _with_quaternions(z) if part.at_matrix >= 0 else _normalise(part.group, z)
        return qs

    def tangents(self, zs: Array) -> Array:
        """Derivatives of coordinates z along the tangent directions, shape (n, nz, nv) from (n, nz)."""
        if self.is_vector:
            return np.broadcast_to(np.eye(self.nv), (len(zs), self.nz, self.nv))
        found = np.asarray(_tangents(self).map(len(zs))(zs.T))
        return found.reshape(self.nz, len(zs), self.nv).transpose(1, 0, 2)

    def slopes_of_configurations(self, zs: Array) -> Array:
        """Derivatives of `configurations` in coordinates z, in the tangent space, shape (n, nv, nz)."""
        if self.is_vector:
            return np.broadcast_to(np.eye(self.nv), (len(zs), self.nv, self.nz))
        nearest = self.coordinates(self.configurations(zs))
        slopes = np.asarray(np.linalg.pinv(self.tangents(nearest)), dtype=np.float64)
        for part in (part for part in self.parts if not part.group.is_vector):
            turns = 1 if isinstance(part.group, (Circle, Plane)) else 3
            at = slice(part.at_v.stop - turns, part.at_v.stop)
            if part.at_matrix < 0:
                norms = np.linalg.norm(zs[:, part.at_z.stop - turns - 1 : part.at_z.stop], axis=1)
                slopes[:, at] /= norms[:, None, None]
            else:  # of the polar decomposition Z = R S, which turns by (tr(S) - S)^-1 of what turns R
                at_matrix = slice(part.at_matrix, part.at_matrix + 9)
                S = _matrices(nearest[:, at_matrix]).transpose(0, 2, 1) @ _matrices(zs[:, at_matrix])
                traces = np.trace(S, axis1=1, axis2=2)[:, None, None]
                slopes[:, at] = 2.0 * np.linalg.solve(traces * np.eye(3) - S, slopes[:, at])
        return slopes

    def affine(self, C: Array, moved: Array) -> tuple[Array, Array]:
        """Return the matrix and vector of the map of coordinates z that is C q + moved of configurations.

        Parameters
        ----------
        C, moved : ndarray, shapes (nq, nq) and (nq,)
            Attitudes that are matrices are turned or reflected with their body's position, or stay.
        """
        places = {  # of each number of q that z has, too
            part.at_q.start + i: part.at_z.start + i
            for part in self.parts
            for i in range(part.group.nz - 9 if part.at_matrix >= 0 else part.group.nz)
        }
        of_q, of_z = list(places), list(places.values())
        C_z, moved_z = np.eye(self.nz), np.zeros(self.nz)
        C_z[np.ix_(of_z, of_z)], moved_z[of_z] = C[np.ix_(of_q, of_q)], moved[of_q]
        for part in self.parts:
            if part.at_matrix >= 0 and part.group.nz == 12:
                at_position = slice(part.at_q.start, part.at_q.start + 3)
                turn, at_matrix = C[at_position, at_position], slice(part.at_matrix, part.at_matrix + 9)
                body = np.diag([1.0, np.sign(np.linalg.det(turn)), 1.0])  # of bases that are reflected
                C_z[at_matrix, at_matrix] = np.kron(body, turn)
        return C_z, moved_z

    def _join(self, piece: Callable[[JointSpace], ca.SX]) -> ca.SX:
        return ca.vertcat(ca.SX.zeros(0, 1), *(piece(part) for part in self.parts))


@lru_cache(maxsize=64)
def _tangents(space: ConfigurationSpace) -> ca.Function:
    z, v = ca.SX.sym("z", space.nz), ca.SX.sym("v", space.nv)
    return ca.Function("tangents", [z], [ca.densify(ca.jacobian(space.rate(z, v), v))])


@lru_cache(maxsize=64)
def _parts(model: pin.Model, with_matrices: bool) -> tuple[JointSpace, ...]:
    at_z, parts = 0, list[JointSpace]()
    for index in range(1, model.njoints):
        joint = model.joints[index]
        if joint.nv == 0 or joint.shortname() == "JointModelMimic":
            continue  # moves with another joint: no numbers of its own
        group = _group(model, index, with_matrices)
        is_matrix = with_matrices and (group.nz, group.nv) in ((9, 3), (12, 6))
        part = JointSpace(
            group,
            slice(joint.idx_q, joint.idx_q + joint.nq),
            slice(at_z, at_z + group.nz),
            slice(joint.idx_v, joint.idx_v + joint.nv),
            at_z + group.nz - 9 if is_matrix else -1,
        )
        parts.append(part)
        at_z += group.nz
    return tuple(parts)


def _group(model: pin.Model, index: int, with_matrices: bool) -> Group:
    joint = model.joints[index]
    name, kind = joint.shortname(), (joint.nq, joint.nv)
    if joint.nq == joint.nv and "Composite" not in name:
        return Vector(joint.nv)
    attitude = RotationMatrix() if with_matrices else Quaternion()
    known: dict[tuple[int, int], Group] = {(2, 1): Circle(), (4, 3): Plane(), (7, 6): RigidBody(attitude)}
    if "Spherical" in name:
        known[(4, 3)] = attitude
    if "Composite" in name or kind not in known:
        raise UnsupportedRobot(
            f"joint {model.names[index]!r} is of type {name}, whose configuration space is not supported; "
            "split it into simple joints, or lock it"
        )
    return known[kind]


def _with_matrices(qs: Array) -> Array:
    """Position and quaternion, or quaternion alone, to position and matrix by columns."""
    rotations = [pin.Quaternion(q[-4:].copy()).matrix().ravel(order="F") for q in qs]
    return np.hstack([qs[:, :-4], np.array(rotations).reshape(-1, 9)])


def _matrices(columns: Array) -> Array:
    return columns.reshape(-1, 3, 3).transpose(0, 2, 1)


def _with_quaternions(zs: Array) -> Array:
    left, _, right = np.linalg.svd(_matrices(zs[:, -9:]))
    turns = left @ right
    turns[np.linalg.det(turns) < 0] *= -1.0  # a mirror image has no nearest rotation; any will do
    quaternions = np.array([pin.Quaternion(R).coeffs() for R in turns]).reshape(-1, 4)
    for n in range(1, len(quaternions)):  # q and -q are the same: without jumps along a trajectory
        if quaternions[n] @ quaternions[n - 1] < 0.0:
            quaternions[n] *= -1.0
    return np.hstack([zs[:, :-9], quaternions])


def _normalise(group: Group, zs: Array) -> Array:
    if group.is_vector:
        return zs
    size = 2 if isinstance(group, (Circle, Plane)) else 4
    norms = np.linalg.norm(zs[:, -size:], axis=1, keepdims=True)
    return np.hstack([zs[:, :-size], zs[:, -size:] / norms])
