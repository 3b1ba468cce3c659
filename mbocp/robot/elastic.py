r"""Elastic joints: between a joint and the rotor of its motor there is a spring with a damper.

.. math:: M(q)\,\ddot q + h(q, \dot q) = \tau_e, \qquad B\,\ddot\theta + \tau_e = u, \qquad
          \tau_e = K (\theta - q) + D (\dot\theta - \dot q)

of [Spong1987]_: rotors are balanced, and the motion of the links does not turn them. So theta is the
coordinate of a joint of its own, on which the motor acts. All is at the link's side of the gear.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class ElasticJoint:
    """A spring and damper between a joint and its motor, see this module.

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
