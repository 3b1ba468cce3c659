r"""Periodic motion: the end is the start, moved by a symmetry of the robot.

.. math:: q(T) = S(q(0)), \qquad v(T) = S_v\, v(0), \qquad S(q) = A q + d

S exchanges joints, changes the signs of some, combines others, and moves some by a given distance. Floating
and planar bases are reflected in the plane y = 0 of the world, turned about its z axis, and moved. It is for
the user to say a symmetry of the mechanics: the motion that is repeated is S(motion) then, and not the motion
itself.

Where the motion ends with an inelastic impact, at which a point comes to rest, it is the velocity after it
that is compared:

.. math:: M(q)\, (v^+ - v(T)) = J(q)^T L, \qquad J(q)\, v^+ = 0, \qquad v^+ = S_v\, v(0)

with the Jacobian J of the point and the impulse L, which acts at the point alone: what was held before lets
go at that moment. Walking with two equal legs is such a motion: the swinging foot touches the ground, becomes
the standing one, and the legs have changed their roles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, IntArray, dataclass
from mbocp._quantities import is_number
from mbocp._text import find_repeated, show
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import ProblemError, UnknownFrame
from mbocp.mechanisms.consistent_states import project_on_constraints
from mbocp.robot import Robot
from mbocp.robot.kinematics import frame_jacobian

_KEY = "goal.periodic"
_BEND = 0.4  # [m, rad] from the initial pose, for configurations that are not special
_FLOATING, _PLANAR = "JointModelFreeFlyer", "JointModelPlanar"
_PLACES = {_FLOATING: ("x", "y", "z", "yaw"), _PLANAR: ("x", "y", "yaw")}  # by which a base is moved
_REFLECTED = {  # signs of coordinates and velocities of a base in the plane y = 0; quaternions are xyzw
    _FLOATING: ([1, -1, 1, -1, 1, -1, 1], [1, -1, 1, -1, 1, -1]),
    _PLANAR: ([1, -1, 1, -1], [1, -1, -1]),
}


@dataclass(frozen=True, kw_only=True)
class Periodic:
    """What the symmetry does, by names of joints.

    Attributes
    ----------
    swap : tuple of (str, str)
        Pairs of joints that exchange their values.
    mirror : tuple of str
        Joints whose values change signs, after the exchange; bases that are reflected in the plane y = 0.
    combine : mapping of str to mapping of str to float
        Joints whose values become sums of those of others, with these factors; in the place of the above.
    moved : mapping of str to float, or to a mapping of str to float
        How much further joints are at the end [m, rad]; of a base x, y, z [m] and yaw [rad] of the world, by
        which the reflected one is turned about the origin and moved.
    apart : tuple of str
        Joints whose positions are not compared: how far the motion leads is found. Velocities are compared.
    impact : str
        Frame whose origin comes to rest at the end, by an inelastic impact; empty: there is none.
    """

    swap: tuple[tuple[str, str], ...] = ()
    mirror: tuple[str, ...] = ()
    combine: Mapping[str, Mapping[str, float]] = field(default_factory=lambda: MappingProxyType({}))
    moved: Mapping[str, float | Mapping[str, float]] = field(default_factory=lambda: MappingProxyType({}))
    apart: tuple[str, ...] = ()
    impact: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "swap", tuple((str(a), str(b)) for a, b in self.swap))
        object.__setattr__(self, "mirror", tuple(self.mirror))
        combine = {name: MappingProxyType(dict(parts)) for name, parts in self.combine.items()}
        object.__setattr__(self, "combine", MappingProxyType(combine))
        moved = {
            name: MappingProxyType(dict(far)) if isinstance(far, Mapping) else far
            for name, far in self.moved.items()
        }
        object.__setattr__(self, "moved", MappingProxyType(moved))
        object.__setattr__(self, "apart", tuple(self.apart))

    def check(self, robot: Robot) -> None:
        """Refuse joints that are unknown, or have no such symmetry.

        Raises
        ------
        UnknownJoint, UnknownFrame, ProblemError
        """
        for key, names in self._uses().items():
            for name in names:
                self._check_kind(robot, name, key)
        for name in self.apart:
            if name not in robot.joint_names:
                raise robot.unknown_joint(name, robot.joint_names)
        self._check_twice()
        self._check_kinds(robot)
        self._check_together()
        if self.impact:
            self._check_impact(robot)

    def _uses(self) -> dict[str, tuple[str, ...]]:
        """Joints by the key that names them."""
        parts = [part for sums in self.combine.values() for part in sums]
        return {
            "swap": tuple(name for pair in self.swap for name in pair),
            "mirror": self.mirror,
            "combine": (*self.combine, *parts),
            "moved": tuple(self.moved),
        }

    def _check_twice(self) -> None:
        uses = self._uses()
        for key, names in (("swap", uses["swap"]), ("mirror", self.mirror), ("except", self.apart)):
            if twice := find_repeated(names):
                raise ProblemError(f"{_KEY}.{key}: {twice[0]!r} is there twice; name it once")

    def _check_kinds(self, robot: Robot) -> None:
        """Refuse joints of different units that take each other's values."""
        pairs = [*self.swap, *((name, part) for name, sums in self.combine.items() for part in sums)]
        for a, b in pairs:
            if _unit(robot, a) != _unit(robot, b):
                raise ProblemError(f"{_KEY}: {a!r} and {b!r} are joints of different kinds; take two alike")

    def _check_together(self) -> None:
        """Refuse keys that say different things of one joint, and factors that are no numbers."""
        uses = self._uses()
        for name in self.combine:
            if name in (*uses["swap"], *self.mirror):
                raise ProblemError(f"{_KEY}: {name!r} is in `combine` and in `swap` or `mirror`; take one")
        numbers = [pair for sums in self.combine.values() for pair in sums.items()]
        for name, far in self.moved.items():
            numbers += [(name, x) for x in (far.values() if isinstance(far, Mapping) else (far,))]
        for name, value in numbers:
            if not (is_number(value) and np.isfinite(value)):
                raise ProblemError(f"{_KEY}: {name!r} has {value!r}, expected a number")
        for name in self.moved:
            if name in self.apart:
                raise ProblemError(f"{_KEY}: {name!r} is in `moved` and in `except`; leave out one")

    def _check_impact(self, robot: Robot) -> None:
        if self.impact not in robot.frame_names:
            raise UnknownFrame(self.impact, robot.name, robot.frame_names)
        axes = impact_axes(robot, self.impact)
        J = point_jacobian(robot, self.impact, robot.q0)[list(axes)]
        if not axes or np.linalg.matrix_rank(J, tol=RANK_TOLERANCE) < len(axes):
            raise ProblemError(
                f"{_KEY}.impact: {self.impact!r} cannot be moved along each of the axes of the world that it "
                "moves along: an impulse there has many values; name one that joints move, along whole axes"
            )

    def guess(self, robot: Robot, q: Array, *, closes_loops: bool = True) -> Array:
        """Image of a configuration, with constraints kept by moving what is not compared; shape (nq,)."""
        image = self.image(robot)
        q_image = image.configuration(q)
        apart = np.flatnonzero(~image.compared)
        closes = robot.nc and apart.size and closes_loops
        return project_on_constraints(robot, q_image, apart) if closes else q_image

    def after_impact(self, robot: Robot, q: Array, v: Array) -> Array:
        """Velocity after the impact, where there is one, shape (nv,)."""
        if not self.impact:
            return np.array(v)
        J = point_jacobian(robot, self.impact, q)[list(impact_axes(robot, self.impact))]
        W = np.linalg.solve(robot.mass_matrix(q), J.T)
        return v - W @ np.linalg.solve(J @ W, J @ v)

    def defect(self, robot: Robot, start: tuple[Array, Array], end: tuple[Array, Array]) -> Array:
        """End less image of the start in q, on the group, and in v, shape (2 nv,); zero in a cycle."""
        image, after = self.image(robot), self.after_impact(robot, *end)
        between = robot.difference(image.configuration(start[0]), end[0])
        return np.concatenate([np.where(image.compared, between, 0.0), after - image.velocity(start[1])])

    def _check_kind(self, robot: Robot, name: str, key: str) -> None:
        """Refuse joints that cannot be in a key."""
        if name not in robot.joint_names:
            raise robot.unknown_joint(name, robot.joint_names)
        at_q, base, far = robot.configuration_indices(name), _base(robot, name), self.moved.get(name)
        if at_q.stop - at_q.start != 1 and not (base and key in ("mirror", "moved")):
            raise ProblemError(
                f"{_KEY}.{key}: {name!r} is no joint of one number; revolute and prismatic ones are swapped, "
                "mirrored and moved, floating and planar bases mirrored and moved, others come back to where "
                "they were or are in `except`"
            )
        if key == "moved" and not base and isinstance(far, Mapping):
            raise ProblemError(f"{_KEY}.moved: {name!r} is a joint of one number; give that")
        if key == "moved" and base and not (isinstance(far, Mapping) and set(far) <= set(_PLACES[base])):
            raise ProblemError(
                f"{_KEY}.moved: {name!r} has {show(far)}, expected a table with {', '.join(_PLACES[base])}"
            )

    def image(self, robot: Robot) -> Image:
        """The symmetry by places."""
        A, C = np.eye(robot.nv), np.eye(robot.nq)
        moved, compared = np.zeros(robot.nq), np.ones(robot.nv, dtype=np.bool_)
        at = {name: robot.velocity_indices(name) for name in robot.joint_names}
        at_q = {name: robot.configuration_indices(name) for name in robot.joint_names}
        for a, b in self.swap:
            for matrix, place in ((A, at), (C, at_q)):
                matrix[[place[a].start, place[b].start]] = matrix[[place[b].start, place[a].start]]
        for name in self.mirror:
            signs_q, signs_v = _REFLECTED.get(_base(robot, name), ([-1], [-1]))
            A[at[name]] *= np.array(signs_v)[:, None]
            C[at_q[name]] *= np.array(signs_q)[:, None]
        for name, sums in self.combine.items():
            A[at[name]], C[at_q[name]] = 0.0, 0.0
            for part, factor in sums.items():
                A[at[name], at[part]], C[at_q[name], at_q[part]] = factor, factor
        for name, far in self.moved.items():
            if isinstance(far, Mapping):
                base = _base(robot, name)
                C[at_q[name]] = _turn(base, far.get("yaw", 0.0)) @ C[at_q[name]]
                places = _PLACES[base][:-1]
                moved[at_q[name]][: len(places)] = [far.get(place, 0.0) for place in places]
            else:
                moved[at_q[name]] = far
        for name in self.apart:
            compared[at[name]] = False
        return Image(A, C, moved, compared)


@dataclass(frozen=True, eq=False)
class Image:
    """The symmetry by places.

    Attributes
    ----------
    A : ndarray, shape (nv, nv)
        Velocity of the image by that of the start.
    C, moved : ndarray, shapes (nq, nq) and (nq,)
        Its configuration, C q + moved.
    compared : ndarray of bool, shape (nv,)
        Which positions are compared.
    """

    A: Array
    C: Array
    moved: Array
    compared: BoolArray

    def configuration(self, q: Array) -> Array:
        """Image of a configuration, shape (nq,)."""
        return self.C @ q + self.moved

    def velocity(self, v: Array) -> Array:
        """Image of a velocity, shape (nv,)."""
        return self.A @ v


def numbers_of(robot: Robot) -> IntArray:
    """Place in q of each direction whose joint has one number and is no circle; else -1; shape (nv,)."""
    found = np.full(robot.nv, -1)
    for name in robot.joint_names:
        at_q, at_v = robot.configuration_indices(name), robot.velocity_indices(name)
        if at_q.stop - at_q.start == at_v.stop - at_v.start == 1:
            found[at_v] = at_q.start
    return found


def point_jacobian(robot: Robot, frame: str, q: Array) -> Array:
    """Velocity of a frame's origin in world axes per velocity of the joints, shape (3, nv)."""
    place, world = robot.frame_names.index(frame), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    return frame_jacobian(robot.model, np.asarray(q), place, world)[:3]


def impact_axes(robot: Robot, frame: str) -> tuple[int, ...]:
    """Axes of the world along which joints can move a frame's origin, at one of a few configurations."""
    bends = (np.zeros(robot.nv), np.full(robot.nv, _BEND), _BEND * np.cos(np.arange(robot.nv)))
    rates = [point_jacobian(robot, frame, robot.integrate(robot.q0, bend)) for bend in bends]
    return tuple(int(i) for i in np.flatnonzero(np.abs(rates).max(axis=(0, 2)) > RANK_TOLERANCE))


def _base(robot: Robot, name: str) -> str:
    """The type of a joint that is a floating or planar base, else empty."""
    kind = str(robot.model.joints[robot.model.getJointId(name)].shortname())
    return kind if kind in _PLACES else ""


def _turn(kind: str, yaw: float) -> Array:
    """Turn of a base about z by its numbers: position, and quaternion xyzw or (cos, sin)."""
    turn = np.eye(4 if kind == _PLANAR else 7)
    c, s = np.cos(yaw), np.sin(yaw)
    turn[:2, :2] = [[c, -s], [s, c]]
    if kind == _PLANAR:
        turn[2:, 2:] = turn[:2, :2]
    else:
        c, s = np.cos(yaw / 2), np.sin(yaw / 2)
        turn[3:, 3:] = [[c, -s, 0, 0], [s, c, 0, 0], [0, 0, c, s], [0, 0, -s, c]]
    return turn


def _unit(robot: Robot, name: str) -> str:
    return str(robot.v_labels[robot.velocity_indices(name).start].unit)
