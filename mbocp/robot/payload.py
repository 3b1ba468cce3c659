"""Payloads, rigidly attached to a frame of the robot, and inertias of links that its file does not give."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import InvalidValue, UnknownFrame, UnsupportedRobot, locate
from mbocp.robot import kinematics
from mbocp.robot.rotors import kinds_of_ends

INERTIA_KEYS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
SHAPES = {"box": 3, "sphere": 1, "cylinder": 2}  # keys that give a shape, and how many lengths it has
MAX_VALUE = 1e15  # of mass, lengths and moments, as in files of robots
_LENGTHS = {1: "a positive length [m]", 2: "two positive lengths [m]", 3: "three positive lengths [m]"}
_ROUND_OFF = 1e-9  # of the largest moment of inertia
_PRINT_TOLERANCE = 0.02  # of the largest moment: error of numbers with few digits, as in files of robots
_STEEL = 7850.0  # [kg/m^3]: a payload without a shape is drawn as a ball of this density
_MIN_RADIUS = 0.005  # [m] of that ball
_COLOR = (0.92, 0.62, 0.18, 1.0)


@dataclass(frozen=True, kw_only=True)
class Payload:
    """A rigid body attached to a frame of a robot.

    Parameters
    ----------
    frame : str
        Frame of the robot that it is attached to.
    mass : float
        [kg]. Zero moves nothing.
    com : (float, float, float)
        Centre of mass in the frame [m].
    inertia : tuple of 6 floats
        Moments and products of inertia ixx, iyy, izz, ixy, ixz, iyz about the centre of mass, in the axes of
        the frame [kg m^2]. Zero: a point mass.
    name : str
        What it is called: also the name of a frame, at its centre of mass and with the axes of `frame` unless
        the next two say otherwise. The frame of a tool is at its tip.
    position : (float, float, float) or None
        Origin of the frame of this name, in `frame` [m]; None: the centre of mass.
    orientation : tuple of 3 or 4 floats, or None
        Axes of the frame of this name, in `frame`: roll, pitch, yaw [rad], or a quaternion xyzw;
        None: those of `frame`.
    box : (float, float, float) or None
        Lengths of the box that a replay draws about the centre of mass [m].
    sphere : float or None
        Radius of a sphere to draw [m].
    cylinder : (float, float) or None
        Radius and length of a cylinder to draw, along the frame's z axis [m].

    Raises
    ------
    InvalidValue
        For a number that is not finite, a negative mass or length, a physically impossible inertia, and more
        than one shape.
    """

    frame: str
    mass: float
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    name: str = "payload"
    position: tuple[float, float, float] | None = None
    orientation: tuple[float, ...] | None = None
    box: tuple[float, float, float] | None = None
    sphere: float | None = None
    cylinder: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.mass <= MAX_VALUE:
            raise InvalidValue(self._where("mass"), self.mass, f"0 to {MAX_VALUE:g} kg")
        object.__setattr__(self, "mass", float(self.mass))
        self._take("com", 3, "three finite numbers [m]")
        self._take("inertia", 6, f"{', '.join(INERTIA_KEYS)} [kg m^2]")
        if fault := _fault(self.inertia_matrix):
            raise InvalidValue(self._where("inertia"), list(self.inertia), f"that of a body: {fault}")
        if self.position is not None:
            self._take("position", 3, "three finite numbers [m]")
        if self.orientation is not None:
            turn = np.asarray(self.orientation, dtype=np.float64)
            if turn.size == 4 and not np.linalg.norm(turn) > 0.0:
                raise InvalidValue(self._where("orientation"), turn.tolist(), "a quaternion that is not zero")
            self._take("orientation", 4 if turn.size == 4 else 3, "3 angles [rad] or a quaternion xyzw")
        shapes = [key for key in SHAPES if getattr(self, key) is not None]
        if len(shapes) > 1:
            raise InvalidValue(self._where("shape"), " and ".join(shapes), "one of them")
        for key in shapes:
            self._take(key, SHAPES[key], _LENGTHS[SHAPES[key]], positive=True)

    @property
    def inertia_matrix(self) -> Array:
        """Rotational inertia about the centre of mass in the axes of the frame, shape (3, 3) [kg m^2]."""
        xx, yy, zz, xy, xz, yz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    @property
    def tip(self) -> pin.SE3:
        """Placement of the frame of its name in `frame`."""
        position = self.com if self.position is None else self.position
        return kinematics.placement_from(position, self.orientation or (0.0, 0.0, 0.0))

    @property
    def solid_inertia(self) -> tuple[float, float, float, float, float, float]:
        """Moments of inertia ixx, iyy, izz (and zero products) of its shape filled evenly [kg m^2].

        Zero without a shape.
        """
        m = self.mass
        if self.box is not None:
            x, y, z = (side**2 for side in self.box)
            moments = ((y + z) / 12, (x + z) / 12, (x + y) / 12)
        elif self.sphere is not None:
            moments = (0.4 * self.sphere**2,) * 3
        elif self.cylinder is not None:
            radius, length = self.cylinder
            moments = ((3 * radius**2 + length**2) / 12,) * 2 + (radius**2 / 2,)
        else:
            moments = (0.0, 0.0, 0.0)
        xx, yy, zz = (m * moment for moment in moments)
        return xx, yy, zz, 0.0, 0.0, 0.0

    @property
    def table(self) -> dict[str, Any]:
        """Keys and values as in a file, without those that say nothing."""
        said: dict[str, Any] = {"name": self.name, "frame": self.frame, "mass": self.mass}
        said |= {key: list(getattr(self, key)) for key in ("com", "inertia") if any(getattr(self, key))}
        given = ("position", "orientation", *SHAPES)
        shapes = {key: getattr(self, key) for key in given if getattr(self, key) is not None}
        return said | {key: list(v) if isinstance(v, tuple) else v for key, v in shapes.items()}

    def _take(self, key: str, count: int, expected: str, *, positive: bool = False) -> None:
        """Keep finite numbers as floats."""
        array = np.asarray(getattr(self, key), dtype=np.float64)
        fits = array.size == count and array.ndim < 2 and bool(np.all(np.abs(array) <= MAX_VALUE))  # no NaN
        if not fits or (positive and not np.all(array > 0.0)):
            raise InvalidValue(self._where(key), array.tolist(), expected)
        values = array.tolist()
        object.__setattr__(self, key, tuple(values) if isinstance(values, list) else values)

    def _where(self, key: str) -> str:
        return f"payload {self.name!r}: {key}"


def attach(
    model: pin.Model, visuals: pin.GeometryModel, payloads: Sequence[Payload], robot: str
) -> tuple[pin.Model, pin.GeometryModel]:
    """Copies of model and visuals with payloads: inertias, a frame and a shape for each.

    Raises
    ------
    UnknownFrame
        If a frame does not exist.
    UnsupportedRobot
        If a frame does not move, or moves without dynamics, or the name of a payload is taken.
    """
    model, visuals = pin.Model(model), pin.GeometryModel(visuals)
    for payload in payloads:
        where = f"robot {robot!r}: payload {payload.name!r}"
        taken = {kinematics.WORLD, *(frame.name for frame in model.frames)}
        if payload.name in taken:
            raise UnsupportedRobot(f"{where}: a frame has this name already; give the payload another name")
        index = _frame(model, payload, robot, where)
        frame = model.frames[index]
        joint = frame.parentJoint
        if joint == 0:
            raise UnsupportedRobot(
                f"{where}: frame {payload.frame!r} is fixed to the world: nothing would move with it"
            )
        if payload.mass and True in kinds_of_ends(model, (index,)):
            words = "dynamics = false: a payload has a mass, and links have none; leave one of the two out"
            raise UnsupportedRobot(f"{where}: {words}")
        body = pin.Inertia(payload.mass, np.zeros(3), payload.inertia_matrix)
        centre = frame.placement * pin.SE3(np.eye(3), np.array(payload.com))
        model.appendBodyToJoint(joint, body, centre)
        tip = frame.placement * payload.tip
        place = model.addFrame(pin.Frame(payload.name, joint, index, tip, pin.FrameType.OP_FRAME), False)
        visuals.addGeometryObject(
            pin.GeometryObject(
                shape_name(payload),
                joint,
                place,
                centre,
                _geometry(payload),
                "",
                np.ones(3),
                True,
                np.array(_COLOR),
            )
        )
    return model, visuals


def _frame(model: pin.Model, payload: Payload, robot: str, where: str) -> int:
    with locate(where, UnknownFrame):
        return kinematics.frame_id(model, payload.frame, robot)


def shape_name(payload: Payload) -> str:
    """Name of a payload's shape among the visuals."""
    return f"payload:{payload.name}"


def _geometry(payload: Payload) -> coal.CollisionGeometry:
    if payload.box is not None:
        return coal.Box(*map(float, payload.box))
    if payload.cylinder is not None:
        return coal.Cylinder(*map(float, payload.cylinder))
    ball = max(_MIN_RADIUS, (3.0 * payload.mass / (4.0 * math.pi * _STEEL)) ** (1.0 / 3.0))
    return coal.Sphere(float(ball if payload.sphere is None else payload.sphere))


def _fault(inertia: Array) -> str:
    """Why no body has this inertia; an empty text if one may."""
    size = float(np.abs(inertia).max())
    if size == 0.0:
        return ""
    moments = size * np.linalg.eigvalsh(inertia / size)
    if moments[0] < -_ROUND_OFF * size:
        return f"its principal moments must not be negative, one is {moments[0]:.3g} kg m^2"
    if moments[2] > moments[0] + moments[1] + _PRINT_TOLERANCE * size:
        principal = ", ".join(f"{moment:.3g}" for moment in moments)
        return f"none of its principal moments {principal} kg m^2 may be above the sum of the other two"
    return ""


@dataclass(frozen=True)
class LinkInertia:
    """What stands in place of a link's inertial element.

    Parameters
    ----------
    link : str
    mass : float
        [kg].
    com : (float, float, float)
        Centre of mass in the link [m].
    inertia : tuple of 6 floats
        ixx, iyy, izz, ixy, ixz, iyz about the centre of mass, in the axes of the link [kg m^2].
    origin : str
        Where the numbers are from, in words.
    """

    link: str
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]
    origin: str

    @classmethod
    def of(cls, link: str, body: pin.Inertia, origin: str) -> LinkInertia:
        """Make it of a body in the axes of the link."""
        com, moments = np.asarray(body.lever), np.asarray(body.inertia)
        rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
        return cls(
            link, float(body.mass), tuple(com.tolist()), tuple(moments[rows, columns].tolist()), origin
        )

    @property
    def table(self) -> dict[str, Any]:
        """The numbers as in a file."""
        return {"mass": self.mass, "com": list(self.com), "inertia": list(self.inertia)}
