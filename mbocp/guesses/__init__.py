"""Initial guesses: a trajectory to start the solver from, in the programme's unknowns.

Guesses are made once a solve from Pinocchio's numeric algorithms; their loops over the steps are not in the
hot path.
"""

from mbocp.guesses.from_solution import iterate_from_solution
from mbocp.guesses.make import guess_candidates, make_guess

__all__ = ["guess_candidates", "iterate_from_solution", "make_guess"]
