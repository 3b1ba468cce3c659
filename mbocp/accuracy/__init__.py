"""How far a discrete motion is from what the robot would do."""

from mbocp.accuracy.errors import accuracy_of
from mbocp.accuracy.of_solution import follows_fast, with_accuracy
from mbocp.accuracy.refining import refined

__all__ = ["accuracy_of", "follows_fast", "refined", "with_accuracy"]
