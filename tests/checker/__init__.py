"""A second opinion on solutions: Pinocchio's numbers and NumPy, none of mbocp's equations."""

from tests.checker.check import Report, check_solution
from tests.checker.system import System, read_system
from tests.checker.task import Task

__all__ = ["Report", "System", "Task", "check_solution", "read_system"]
