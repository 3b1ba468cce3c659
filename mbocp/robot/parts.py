"""Parts of a robot beside its multibody model: actuation, forces, limits, labels.

All of it is data. A frame is an index into `pin.Model.frames`; frame 0 is the universe, called "world".
"""

from __future__ import annotations

from dataclasses import field
from functools import cached_property
from typing import ClassVar, Literal, TypeAlias

import numpy as np

from mbocp._arrays import Array, dataclass, freeze, frozen_array
from mbocp.exceptions import InvalidValue

Rotations: TypeAlias = Literal["quaternion", "dcm"]  # what explicit schemes integrate


@dataclass(frozen=True)
class Label:
    """Name and unit of one column of a trajectory, e.g. ``Label("shoulder_pan_joint", "rad")``."""

    name: str
    unit: str

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds of the robot; infinite where there is none.

    Parameters
    ----------
    effort : ndarray, shape (nu,)
        Largest control [N m, N].
    velocity : ndarray, shape (nv,)
        Largest absolute velocity [rad/s, m/s].
    position_lower, position_upper : ndarray, shape (nq,)
        Range of the configuration [rad, m].
    effort_lower : ndarray, shape (nu,), optional
        Least control [N m, N]: rotors that only push have 0. Default: ``-effort``.
    """

    effort: Array
    velocity: Array
    position_lower: Array
    position_upper: Array
    effort_lower: Array = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        given: Array | None = self.effort_lower
        if given is None:
            object.__setattr__(self, "effort_lower", -np.asarray(self.effort))
        for name in ("effort", "effort_lower", "velocity", "position_lower", "position_upper"):
            freeze(self, name, (None,), f"limits.{name}")

    @property
    def any_finite(self) -> bool:
        """Whether there is any limit at all."""
        bounds = (self.effort, self.effort_lower, self.velocity, self.position_lower, self.position_upper)
        return any(bool(np.isfinite(b).any()) for b in bounds)


@dataclass(frozen=True, eq=False)
class FrameActuator:
    r"""A wrench of one number, fixed to a frame: :math:`\tau = J_\mathrm{local}(q)^T\, d\, u`.

    Parameters
    ----------
    name : str
        Name of the control.
    frame_id : int
        Frame that the wrench acts on.
    direction : ndarray, shape (6,)
        Wrench for u = 1 in the frame's own axes, force before moment [N, N m].
    unit : str
        Unit of u.
    """

    name: str
    frame_id: int
    direction: Array
    unit: str = "N"

    def __post_init__(self) -> None:
        freeze(self, "direction", (6,), f"actuator {self.name}")


@dataclass(frozen=True, eq=False)
class Drive:
    r"""A motion that a control prescribes: velocity components that are given instead of driven by a force.

    The components move by :math:`v_\mathrm{dofs} = S(q)\,w` with the drive's speed w. The control is w itself
    ("velocity") or its rate ("acceleration"). For a joint S = 1; for a frame
    :math:`S(q) = J(q)_\mathrm{dofs}^T R(q)\,d`, J the Jacobian of the frame's origin in world axes, R the
    frame's rotation, d the direction: these components move the origin at w along d. One by one they must
    move it at unit speed, along orthogonal directions.

    Parameters
    ----------
    name : str
        Name of the control.
    control : {"velocity", "acceleration"}
        What the control is.
    dofs : tuple of int
        Velocity components that it moves.
    frame_id : int or None
        The frame; None for a joint's own component (one dof).
    direction : ndarray, shape (3,)
        Unit vector d in the frame's own axes; of no meaning for a joint.
    unit : str
        Unit of the control.
    speed_unit : str
        Unit of w.
    """

    name: str
    control: str
    dofs: tuple[int, ...]
    frame_id: int | None = None
    direction: Array = field(default_factory=lambda: np.zeros(3))
    unit: str = "rad/s"
    speed_unit: str = "rad/s"

    def __post_init__(self) -> None:
        where = f"drive {self.name!r}"
        if self.control not in ("velocity", "acceleration"):
            raise InvalidValue(f"{where}: control", repr(self.control), "'velocity' or 'acceleration'")
        if not self.dofs or (self.frame_id is None and len(self.dofs) != 1):
            raise InvalidValue(f"{where}: dofs", self.dofs, "one for a joint, at least one for a frame")
        freeze(self, "direction", (3,), f"{where}: direction")

    @property
    def has_state(self) -> bool:
        """Whether the speed is part of the state: the control is its rate."""
        return self.control == "acceleration"


@dataclass(frozen=True, eq=False)
class Actuation:
    r"""How the controls act: :math:`\tau = B(q)\,u`, with columns in the order of `Robot.u_labels`.

    Parameters
    ----------
    selection : ndarray, shape (nv, nu_joint)
        The constant part of B: actuated joints, and wrenches that are constant in joint coordinates
        (a rotor on the free-flyer's own body, a force on a body that only slides).
    labels : tuple of Label
        Name and unit of each control: constant part, frame actuators, drives.
    frame_actuators : tuple of FrameActuator
        The columns that depend on q.
    drives : tuple of Drive
        Controls that prescribe a motion; their columns of B are zero.
    """

    selection: Array
    labels: tuple[Label, ...]
    frame_actuators: tuple[FrameActuator, ...] = ()
    drives: tuple[Drive, ...] = ()

    def __post_init__(self) -> None:
        constant = len(self.labels) - len(self.frame_actuators) - len(self.drives)
        freeze(self, "selection", (None, constant), "actuation.selection")

    @property
    def nu(self) -> int:
        """Number of controls."""
        return len(self.labels)

    @property
    def is_constant(self) -> bool:
        """Whether B does not depend on q."""
        return not self.frame_actuators

    @cached_property
    def lengths(self) -> Array:
        """Of the columns of B, shape (nu,); 1 for those that depend on q, and of drives."""
        of_constant = np.linalg.norm(self.selection, axis=0)
        return frozen_array(np.append(of_constant, np.ones(self.nu - of_constant.size)))

    @cached_property
    def inverse(self) -> Array:
        """Pseudo-inverse of the constant part of B, shape (nu_joint, nv)."""
        products = self.selection.T @ self.selection
        squares = np.diagonal(products)
        if (squares > 0.0).all() and np.array_equal(products, np.diag(squares)):
            return frozen_array(self.selection.T / squares[:, None])  # without round-off
        return frozen_array(np.linalg.pinv(self.selection))


@dataclass(frozen=True)
class QuarticSpring:
    r"""A spring whose potential is a polynomial, so that nothing is singular at zero length.

    .. math:: V(q) = \tfrac{c}{4} \left(|p_a - p_b|^2 - l^2\right)^2

    The first paper has c = k / (2 l^2) with a stiffness k [N/m] in 6.1, and c = lambda in 6.3.

    Parameters
    ----------
    name : str
        Appears in messages.
    frame_a, frame_b : int
        Frames whose origins it joins.
    coefficient : float
        c [N/m^3].
    length : float
        Length at rest l [m].
    frames : (str, str)
        Names of the two frames, for messages.
    """

    name: str
    frame_a: int
    frame_b: int
    coefficient: float
    length: float
    frames: tuple[str, str] = ("", "")

    kind = "quartic_spring"
    units: ClassVar[dict[str, str]] = {"coefficient": "N/m^3", "length": "m"}

    def __post_init__(self) -> None:
        _require_positive(f"spring {self.name!r}: coefficient", self.coefficient)
        _require_not_negative(f"spring {self.name!r}: length", self.length)

    @property
    def place(self) -> tuple[int, int]:
        """Where it acts."""
        return self.frame_a, self.frame_b


@dataclass(frozen=True)
class SpringDamper:
    r"""A linear spring and damper along the line of centres of two frames.

    .. math:: V(q) = \tfrac{k}{2} (|d| - l)^2, \qquad d = p_a - p_b,

    and a damping force :math:`-c\,\dot{|d|}` along d. With l = 0 the potential is :math:`\tfrac{k}{2}|d|^2`,
    smooth everywhere, and the damper acts on the whole relative velocity: :math:`-c\,\dot d`.

    Parameters
    ----------
    name : str
        Appears in messages.
    frame_a, frame_b : int
        Frames whose origins it joins.
    stiffness : float
        k [N/m].
    damping : float
        c [N s/m].
    length : float
        Length at rest l [m].
    frames : (str, str)
        Names of the two frames, for messages.
    """

    name: str
    frame_a: int
    frame_b: int
    stiffness: float
    damping: float = 0.0
    length: float = 0.0
    frames: tuple[str, str] = ("", "")

    kind = "spring_damper"
    units: ClassVar[dict[str, str]] = {"stiffness": "N/m", "damping": "N s/m", "length": "m"}

    def __post_init__(self) -> None:
        for key in ("stiffness", "damping", "length"):
            _require_not_negative(f"spring_damper {self.name!r}: {key}", getattr(self, key))

    @property
    def place(self) -> tuple[int, int]:
        """Where it acts."""
        return self.frame_a, self.frame_b


@dataclass(frozen=True)
class Motor:
    r"""A motor that turns a joint by a gear; its control is the torque before the gear.

    .. math:: \tau = n u, \qquad |n v| \le \omega_{\max}, \qquad M_{ii} = \ldots + n^2 J

    Parameters
    ----------
    name : str
        The joint.
    dof : int
        Its component of v.
    column : int
        Of B.
    gear_ratio : float
        n, turns of the motor for one of the joint.
    inertia : float
        J, of the rotor [kg m^2].
    speed : float
        Largest speed of the motor [rad/s].
    """

    name: str
    dof: int
    column: int
    gear_ratio: float
    inertia: float
    speed: float = np.inf

    kind = "motor"
    units: ClassVar[dict[str, str]] = {"gear_ratio": "", "inertia": "kg m^2"}

    def __post_init__(self) -> None:
        _require_positive(f"motor of {self.name!r}: gear_ratio", self.gear_ratio)
        _require_not_negative(f"motor of {self.name!r}: inertia", self.inertia)

    @property
    def place(self) -> tuple[int, int]:
        """Where it acts."""
        return self.dof, self.column


@dataclass(frozen=True)
class Connector:
    """Something to draw between two frames that are not rigidly attached to each other.

    A replay draws it from the origin of `frame_a` to the origin of `frame_b`, anew at each time:

    - ``"rod"``: a solid cylinder of `radius`;
    - ``"spring"``: a coil of outer radius `radius`, stretched to the distance, its number of turns constant;
    - ``"line"``: a thin line; `radius` is a hint and may be ignored.

    Parameters
    ----------
    frame_a, frame_b : int
        Frames whose origins it joins; 0 is the universe.
    kind : {"rod", "spring", "line"}
        How it looks.
    radius : float
        [m].
    color : (float, float, float, float)
        Red, green, blue, opacity in 0..1.
    """

    frame_a: int
    frame_b: int
    kind: str
    radius: float = 0.01
    color: tuple[float, float, float, float] = field(default=(0.35, 0.35, 0.38, 1.0))

    def __post_init__(self) -> None:
        _require_positive("visual: radius", self.radius)


def _require_positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise InvalidValue(name, value, "a positive finite number")


def _require_not_negative(name: str, value: float) -> None:
    if not (np.isfinite(value) and value >= 0):
        raise InvalidValue(name, value, "a finite number >= 0")
