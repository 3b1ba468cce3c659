"""The joints that mbocp knows: coordinates by name and unit, and which of them are circles or spheres."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from mbocp._arrays import Array
from mbocp.exceptions import UnknownJoint, UnsupportedRobot
from mbocp.robot.parts import Label

if TYPE_CHECKING:
    import pinocchio as pin

_LINEAR, _ANGULAR = "m", "rad"
# Arrays of a model with numbers of its joints, beside those that joints have themselves.
_OF_VELOCITIES = (
    *("armature", "rotorInertia", "rotorGearRatio", "damping"),
    *("lowerDryFrictionLimit", "upperDryFrictionLimit", "lowerEffortLimit", "upperEffortLimit"),
    *("lowerVelocityLimit", "upperVelocityLimit"),
)
_OF_POSITIONS = ("lowerPositionLimit", "upperPositionLimit", "positionLimitMargin")


class JointKind(NamedTuple):
    """Coordinates of one type of joint.

    Parameters
    ----------
    word : str
        What a person calls it.
    q : tuple of (str, str)
        Suffix and unit of each configuration number.
    v : tuple of (str, str)
        Suffix and unit of displacement ("m" or "rad") of each velocity number.
    unit_groups : tuple of (int, int)
        Ranges of the configuration numbers that form a unit vector: quaternions, cos/sin pairs.
    is_vector : bool
        Whether the configuration is a plain vector, q + v.
    actuated : bool
        Whether a file that has it means it to have a motor.
    """

    word: str
    q: tuple[tuple[str, str], ...]
    v: tuple[tuple[str, str], ...]
    unit_groups: tuple[tuple[int, int], ...] = ()
    is_vector: bool = True
    actuated: bool = False

    @property
    def has_angle(self) -> bool:
        """Whether the last two numbers of q are the cosine and sine of an angle."""
        return self.q[-2:] == _CIRCLE


class JointPlace(NamedTuple):
    """Where one joint is in q and in v, and whether its q ends with the cosine and sine of an angle."""

    name: str
    q: slice
    v: slice
    has_angle: bool

    @property
    def nq(self) -> int:
        """Numbers of q."""
        return int(self.q.stop - self.q.start)

    @property
    def nv(self) -> int:
        """Numbers of v."""
        return int(self.v.stop - self.v.start)

    @property
    def n_written(self) -> int:
        """Numbers that a person writes, with the angle [rad] instead of cosine and sine."""
        return self.nq - 1 if self.has_angle else self.nq


_CIRCLE = (("cos", ""), ("sin", ""))
_QUATERNION = (("qx", ""), ("qy", ""), ("qz", ""), ("qw", ""))
_POSITION = (("x", _LINEAR), ("y", _LINEAR), ("z", _LINEAR))
_TWIST = tuple((kind + axis, unit) for kind, unit in (("v", _LINEAR), ("w", _ANGULAR)) for axis in "xyz")

_REVOLUTE = JointKind("revolute", (("", _ANGULAR),), (("", _ANGULAR),), actuated=True)
_PRISMATIC = JointKind("prismatic", (("", _LINEAR),), (("", _LINEAR),), actuated=True)
_HELICAL = JointKind("helical", (("", _ANGULAR),), (("", _ANGULAR),), actuated=True)
_CONTINUOUS = JointKind("continuous", _CIRCLE, (("", _ANGULAR),), ((0, 2),), False, actuated=True)
_PLANAR = JointKind(
    "planar",
    (("x", _LINEAR), ("y", _LINEAR), *_CIRCLE),
    (("vx", _LINEAR), ("vy", _LINEAR), ("wz", _ANGULAR)),
    ((2, 4),),
    False,
)
_FLOATING = JointKind("floating", _POSITION + _QUATERNION, _TWIST, ((3, 7),), False)
_SPHERICAL = JointKind("spherical", _QUATERNION, _TWIST[3:], ((0, 4),), False)
_TRANSLATION = JointKind("translation", _POSITION, _TWIST[:3])
_MIMIC = JointKind("mimic", (), ())

JOINT_KINDS: dict[str, JointKind] = {
    **{f"JointModel{n}": _REVOLUTE for n in ("RX", "RY", "RZ", "RevoluteUnaligned")},
    **{f"JointModel{n}": _PRISMATIC for n in ("PX", "PY", "PZ", "PrismaticUnaligned")},
    **{f"JointModel{n}": _HELICAL for n in ("HX", "HY", "HZ", "HelicalUnaligned")},
    **{f"JointModel{n}": _CONTINUOUS for n in ("RUBX", "RUBY", "RUBZ", "RevoluteUnboundedUnaligned")},
    "JointModelPlanar": _PLANAR,
    "JointModelFreeFlyer": _FLOATING,
    "JointModelSpherical": _SPHERICAL,
    "JointModelTranslation": _TRANSLATION,
    "JointModelMimic": _MIMIC,
}


def joint_kind(model: pin.Model, joint: int) -> JointKind:
    """Kind of joint number `joint`."""
    return JOINT_KINDS[model.joints[joint].shortname()]


def check_joints(model: pin.Model, robot: str) -> None:
    """Refuse by name what is not supported (composite joints, for one)."""
    for joint in range(1, model.njoints):
        type_name = model.joints[joint].shortname()
        if type_name not in JOINT_KINDS:
            raise UnsupportedRobot(
                f"robot {robot!r}: joint {model.names[joint]!r} is of type "
                f"{type_name.removeprefix('JointModel')}, which mbocp does not support; supported: "
                f"{', '.join(sorted({k.word for k in JOINT_KINDS.values()}))}. Write it as a chain of those."
            )


def joint_names(model: pin.Model) -> tuple[str, ...]:
    """Names of the joints, without the universe."""
    return tuple(model.names)[1:]


def joint_id(model: pin.Model, name: str, robot: str) -> int:
    """Index of a joint; raises `UnknownJoint` with near misses."""
    found: int = model.getJointId(name)
    if not 0 < found < model.njoints:
        raise UnknownJoint(name, robot, joint_names(model))
    return found


def why_without_numbers(model: pin.Model, name: str) -> str:
    """What a name is that a person takes for a joint with numbers of its own; "" of any other name."""
    for leader, follower in zip(model.mimicked_joints, model.mimicking_joints, strict=True):
        if model.names[follower] == name:
            of = repr(model.names[leader])
            return f"mimics {of} and has no numbers of its own: name {of}, or load with mimic = false"
    if any(f.name == name and f.type.name == "FIXED_JOINT" for f in model.frames):
        return "is fixed, by its file or by lock, and has no numbers: leave it out, or do not lock it"
    return ""


def configuration_slice(model: pin.Model, joint: int) -> slice:
    """Range of the joint in q; empty for a mimic joint."""
    j = model.joints[joint]
    return slice(j.idx_q, j.idx_q + j.nq)


def velocity_slice(model: pin.Model, joint: int) -> slice:
    """Range of the joint in v; empty for a mimic joint."""
    j = model.joints[joint]
    return slice(j.idx_v, j.idx_v + j.nv)


def copy_numbers(model: pin.Model, joint: int, out: pin.Model, there: int, skip: int = 0) -> None:
    """Copy limits, losses and rotors of a joint to one of another model, but for the first `skip`."""
    for keys, where in ((_OF_VELOCITIES, velocity_slice), (_OF_POSITIONS, configuration_slice)):
        source = where(model, joint)
        for key in keys:
            getattr(out, key)[where(out, there)] = getattr(model, key)[source.start + skip : source.stop]


def displacement(model: pin.Model, joint: int, q: Array) -> float:
    """Angle [rad] or length [m] of a joint with one velocity; that of a continuous one in -pi ... pi."""
    numbers = q[configuration_slice(model, joint)]
    return math.atan2(numbers[1], numbers[0]) if len(numbers) == 2 else float(numbers[0])


def position_labels(model: pin.Model) -> tuple[Label, ...]:
    """One label for each number of q: joint name, or joint name and component."""
    return tuple(
        Label(_join(model.names[joint], suffix), unit)
        for joint in range(1, model.njoints)
        for suffix, unit in joint_kind(model, joint).q
    )


_MOVES = {f"{of_v}{axis}": f"{of_q}{axis}" for of_v, of_q in (("v", ""), ("w", "r")) for axis in "xyz"}


def move_labels(model: pin.Model) -> tuple[Label, ...]:
    """One label for each direction in which q moves: ``x`` in place of ``vx``, ``rx`` in place of ``wx``."""
    return tuple(
        Label(_join(model.names[joint], _MOVES.get(suffix, suffix)), displacement)
        for joint in range(1, model.njoints)
        for suffix, displacement in joint_kind(model, joint).v
    )


def velocity_labels(model: pin.Model, units: dict[str, str]) -> tuple[Label, ...]:
    """One label for each number of v.

    Parameters
    ----------
    units : dict
        Unit of the quantity along a displacement in "m" and in "rad", e.g. ``{"m": "N", "rad": "N m"}``.
    """
    return tuple(
        Label(_join(model.names[joint], suffix), units[displacement])
        for joint in range(1, model.njoints)
        for suffix, displacement in joint_kind(model, joint).v
    )


def joint_places(model: pin.Model) -> tuple[JointPlace, ...]:
    """Where the joints with numbers of their own are, in their order."""
    numbered = [(joint, kind) for joint in range(1, model.njoints) if (kind := joint_kind(model, joint)).v]
    return tuple(
        JointPlace(model.names[k], configuration_slice(model, k), velocity_slice(model, k), kind.has_angle)
        for k, kind in numbered
    )


def unit_groups(model: pin.Model) -> tuple[tuple[str, slice], ...]:
    """Joint name and range in q of each unit vector (quaternion or cos/sin pair)."""
    return tuple(
        (model.names[joint], slice(model.joints[joint].idx_q + a, model.joints[joint].idx_q + b))
        for joint in range(1, model.njoints)
        for a, b in joint_kind(model, joint).unit_groups
    )


def _join(joint: str, suffix: str) -> str:
    return f"{joint}.{suffix}" if suffix else joint
