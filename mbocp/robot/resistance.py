r"""Damping and friction of joints, such as those of ``<dynamics damping= friction=>``, and elastic joints.

.. math:: \tau = -r\,\bigl(d\,w + F \tanh(w / w_s)\bigr), \qquad w = r\,v

on the velocity v of a joint, with the viscous damping d and the Coulomb friction F. The ratio r is that of a
mimic joint to its leader, which feels what its followers lose, and 1 for a joint of its own. Coulomb friction
jumps where the joint stops; tanh smooths it over the speed w_s, and below that speed a joint creeps where it
would stick.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import InvalidValue

FRICTION_SPEED = 0.1  # [rad/s, m/s]


@dataclass(frozen=True)
class JointResistance:
    r"""Damping and friction of one joint, see this module.

    Parameters
    ----------
    name : str
        The joint; a mimic joint acts on its leader.
    dof : int
        Velocity component that feels it.
    ratio : float
        Velocity of the joint by that component.
    damping : float
        d [N m s/rad, N s/m].
    friction : float
        F [N m, N].
    speed : float
        w_s, at which the friction is 0.76 F [rad/s, m/s].
    """

    name: str
    dof: int
    ratio: float = 1.0
    damping: float = 0.0
    friction: float = 0.0
    speed: float = FRICTION_SPEED

    kind = "resistance"
    units: ClassVar[dict[str, str]] = {"damping": "N m s/rad", "friction": "N m"}  # where it turns

    @property
    def place(self) -> tuple[int, float, float]:
        """Where it acts, and how."""
        return self.dof, self.ratio, self.speed

    def __post_init__(self) -> None:
        for key in ("damping", "friction"):
            value = getattr(self, key)
            if not (np.isfinite(value) and value >= 0):
                raise InvalidValue(f"joint {self.name!r}: {key}", value, "a finite number >= 0")
        if not (np.isfinite(self.speed) and self.speed > 0):
            raise InvalidValue(f"joint {self.name!r}: friction_speed", self.speed, "a positive finite number")


def resistance_forces(resistances: Iterable[JointResistance], v: Array) -> Array:
    """Generalised force of the losses, of the shape of v, (nv, ...) [N, N m]."""
    total = np.zeros(v.shape)
    for loss in resistances:
        w = loss.ratio * v[loss.dof]
        total[loss.dof] -= loss.ratio * (loss.damping * w + loss.friction * np.tanh(w / loss.speed))
    return total


@dataclass(frozen=True)
class ElasticJoint:
    r"""A spring and damper between a joint and the rotor of its motor.

    .. math:: M(q)\,\ddot q + h(q, \dot q) = \tau_e, \qquad B\,\ddot\theta + \tau_e = u, \qquad
              \tau_e = K (\theta - q) + D (\dot\theta - \dot q)

    of [Spong1987]_: rotors are balanced, and the motion of the links does not turn them. So theta is the
    coordinate of a joint of its own, on which the motor acts. All is at the link's side of the gear.

    Parameters
    ----------
    name, motor : str
        The joint, and that of the motor.
    at_q, at_v : (int, int)
        Where the two have their coordinates in q, and in v.
    stiffness : float
        K [N m/rad, N/m].
    damping : float
        D [N m s/rad, N s/m].
    """

    name: str
    motor: str
    at_q: tuple[int, int]
    at_v: tuple[int, int]
    stiffness: float
    damping: float = 0.0

    def effort(self, q: Any, v: Any) -> Any:
        """Torque or force on the joint, and against the motor [N m, N]; of numbers or symbols."""
        (link, motor), (rate, motor_rate) = self.at_q, self.at_v
        return self.stiffness * (q[motor] - q[link]) + self.damping * (v[motor_rate] - v[rate])

    def energy(self, q: Any) -> Any:
        """Potential energy of the spring [J]; of numbers or symbols."""
        link, motor = self.at_q
        return self.stiffness / 2 * (q[motor] - q[link]) ** 2
