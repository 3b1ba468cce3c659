"""What the second paper prints, [Manara2017]_; for each number that it leaves out, a choice and why."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

DURATION = 3.0  # [s], section 5.2
NUM_STEPS = 100  # N, section 5.3
GAMMA_QUATERNION = 2.0  # [1/s], of eq. (46), section 4.1
GAMMA_DCM = 1.0  # [1/s], of eq. (47), section 4.1

# Orientations of the pendulum, quaternions xyzw, figure 2. About which axis the hanging pendulum has been
# turned upside down is not printed: here x. With the scalar first they are (0, 1, 0, 0) and (1, 0, 0, 0).
HANGING = (1.0, 0.0, 0.0, 0.0)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Unicycle:
    """Table 1, in its order.

    Attributes
    ----------
    r : float
        Radius of a wheel [m].
    a : float
        Half the length of the axle [m].
    l : float
        Half the length of the pendulum, from joint B to its centre of mass G [m].
    d : float
        Distance of the middle A of the axle and the joint B [m].
    g : float
        Gravity [m/s^2].
    m_w : float
        Mass of a wheel [kg].
    J_w, J_wd : float
        Moments of inertia of a wheel about its axis, and about a diameter [kg m^2].
    m_a : float
        Mass of the axle [kg].
    J_a : float
        Moment of inertia of the axle about the vertical z_a [kg m^2].
    m_p : float
        Mass of the pendulum [kg].
    J_pG : (float, float, float)
        Moments of inertia of the pendulum about its axes through G [kg m^2].
    """

    r: float = 0.05
    a: float = 0.10
    l: float = 0.25  # noqa: E741  # the paper's letter
    d: float = 0.0
    g: float = 9.81
    m_w: float = 0.25
    J_w: float = 3.25e-4
    J_wd: float = 1.625e-4
    m_a: float = 0.5
    J_a: float = 1.66e-3
    m_p: float = 1.0
    J_pG: tuple[float, float, float] = (2.08e-2, 2.08e-2, 2.08e-3)

    @property
    def J_pB(self) -> tuple[float, float, float]:
        """Moments of inertia of the pendulum about its axes through B [kg m^2]."""
        x, y, z = self.J_pG
        return x + self.m_p * self.l**2, y + self.m_p * self.l**2, z

    @property
    def J_yaw(self) -> float:
        """Moment of inertia of axle and wheels about the vertical through B, eq. (24) [kg m^2]."""
        return self.J_a + 2 * self.J_wd + 2 * self.m_w * self.a**2


UNICYCLE = Unicycle()


@dataclass(frozen=True)
class Formulation:
    """Representation of rotations and way to integrate them: one of the six that the paper compares.

    Attributes
    ----------
    label : str
        As in the paper's figures.
    rotations : {"quaternion", "dcm"}
        `robot.rotations`.
    lie : {"plain", "baumgarte", "munthe_kaas"}
        `integrator.lie`.
    nodes : tuple of int
        Table 3: nodes of the paper's graph; of the integrator, and of the exponential map, if apart.
    milliseconds : float
        Table 4: time of an iteration [ms].
    """

    label: str
    rotations: Literal["quaternion", "dcm"]
    lie: Literal["plain", "baumgarte", "munthe_kaas"]
    nodes: tuple[int, ...]
    milliseconds: float


FORMULATIONS = (
    Formulation("Q RK", "quaternion", "plain", (639,), 67.0),
    Formulation("Q RK+BG", "quaternion", "baumgarte", (712,), 68.0),
    Formulation("Q RK-MK", "quaternion", "munthe_kaas", (903, 49), 102.0),
    Formulation("DCM RK", "dcm", "plain", (521,), 91.0),
    Formulation("DCM RK+BG", "dcm", "baumgarte", (810,), 113.0),
    Formulation("DCM RK-MK", "dcm", "munthe_kaas", (900, 112), 148.0),
)


@dataclass(frozen=True)
class Choices:
    """What the paper leaves open, and why each number is what it is.

    Attributes
    ----------
    k_1, k_2 : float
        Weights of eq. (33) on the distance and on the potential energy. On a square of 2 m the distance
        costs about 1, and the pendulum's energy varies by m_p g l = 2.5 J to both sides: the same order, as
        the paper asks.
    k_3 : float
        Weight of eq. (33) on the rates of the controls. One that crosses its range in half a second has a
        rate of about 25 per second, and 1e-3 times its square is 0.6: again the same order.
    c_x, c_y : float
        Weights of eq. (34) on the position [1/m^2]: metres as they are.
    c_theta : float
        Weight of eq. (34) on the yaw angle [1/rad^2]: half a turn costs as much as 1 m.
    yaw_rate : float
        Bound on abs(u_theta) [rad/s]: one turn a second.
    acceleration : float
        Bound on abs(u_v) [m/s^2]: 0.6 g, a coefficient of friction that wheels can count on.
    """

    k_1: float = 1.0
    k_2: float = 1.0
    k_3: float = 1e-3
    c_x: float = 1.0
    c_y: float = 1.0
    c_theta: float = 0.1
    yaw_rate: float = 2 * np.pi
    acceleration: float = 6.0


CHOICES = Choices()


@dataclass(frozen=True)
class Task:
    """Where the axle has to be at the end, at rest, with the pendulum upright.

    Attributes
    ----------
    x, y : float
        Position of B [m].
    yaw : float
        theta_des [rad].
    """

    x: float
    y: float
    yaw: float


def formulation(label: str) -> Formulation:
    """Formulation by its label in the figures, e.g. "Q RK-MK". Raises `KeyError`."""
    return {one.label: one for one in FORMULATIONS}[label]


@cache
def lattice(positions: int = 13, yaws: int = 12) -> tuple[Task, ...]:
    """Tasks of section 5.2: a grid of positions on a square of 2 m, times yaw angles.

    The paper takes the angles from [0, 2 pi]; here the end is left out, so that no angle is there twice.

    Parameters
    ----------
    positions : int
        Along each side; 1 for the centre alone.
    yaws : int
        Number of yaw angles.

    Returns
    -------
    tasks : tuple of Task
        positions * positions * yaws of them: 2028.
    """
    side = np.linspace(-1.0, 1.0, positions) if positions > 1 else np.zeros(1)
    angles = 2 * np.pi * np.arange(yaws) / yaws
    return tuple(Task(float(x), float(y), float(yaw)) for x in side for y in side for yaw in angles)
