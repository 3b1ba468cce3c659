"""The second paper, [Manara2017]_: its system, its tasks, the choices it leaves open, forces at its wheels.

from mbocp_papers.so3 import FORMULATIONS, lattice
"""

from mbocp_papers.so3.data import (
    CHOICES,
    FORMULATIONS,
    UNICYCLE,
    Choices,
    Formulation,
    Task,
    Unicycle,
    lattice,
)
from mbocp_papers.so3.wheels import WheelEfforts, wheel_efforts, wheel_efforts_of_joints

__all__ = [
    "CHOICES",
    "FORMULATIONS",
    "UNICYCLE",
    "Choices",
    "Formulation",
    "Task",
    "Unicycle",
    "WheelEfforts",
    "lattice",
    "wheel_efforts",
    "wheel_efforts_of_joints",
]
