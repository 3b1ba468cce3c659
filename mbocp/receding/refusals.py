"""Problems that a receding horizon cannot take, refused by name."""

from __future__ import annotations

from mbocp.exceptions import ProblemError
from mbocp.formulation import Formulation
from mbocp.problem import Problem
from mbocp.receding.moving import check_repeats

_METHODS = ("auto", "monolithic")
_WHY = "its times would have to move with the horizon"


def check_can_recede(problem: Problem) -> None:
    """Refuse a problem whose horizon cannot be shifted.

    Raises
    ------
    ProblemError
        If something of it belongs to a given time, or is found with the motion.
    """
    refused = {
        "horizon.duration": (problem.timeline.has_free_lengths, "is free; give it as a number"),
        "horizon.lengths": (
            problem.timeline.has_unequal_lengths,
            "differ; leave them out, so that steps are alike",
        ),
        "horizon.accuracy": (problem.accuracy is not None, "is to choose the steps; give their number"),
        "robust": (problem.robust is not None, "is of a whole motion; leave it out"),
        "goal.excite": (problem.excite is not None, "is of a whole motion; leave it out"),
        "hold, release, impact": (
            problem.timeline.switches is not None and not problem.phase,
            f"there are some; {_WHY}: say them in phases, which repeat",
        ),
        "goal": (bool(problem.goals), "there are several; give one of them"),
        "goal.periodic": (problem.goal.periodic is not None, "is not for a horizon that moves; give q and v"),
        "goal.a": (
            bool(problem.goal.a_active.any()) and problem.goal.a_rule == "given",
            "is the mean of a given step; leave it out",
        ),
        "goal.u": (problem.goal.u.rule == "given", "is of the end of a given motion; leave it out"),
        "parameter": (bool(problem.parameter), "is found for a whole motion; take the robot that was found"),
        "start.free": (problem.start_free is not None, "the state is given in each step; leave it out"),
        "horizon.controls": (
            problem.controls != "constant",
            f'is "{problem.controls}"; take "constant", since a loop gives one control at a time',
        ),
        "limits.effort_rms": (
            bool(problem.limits.finite("rms").any()),
            "is of a whole motion, of which a horizon that moves knows a part; leave it out",
        ),
        "solver.method": (
            problem.solver.method not in _METHODS,
            f'is "{problem.solver.method}"; take "auto" or "monolithic"',
        ),
    }
    for name, (is_there, words) in refused.items():
        if is_there:
            raise ProblemError(f"receding horizon: {name}: {words}")
    if problem.phase:
        check_repeats(problem)


def check_functions(formulation: Formulation) -> None:
    """Refuse functions of progress along a path and of obstacles that move, and steps that begin elsewhere.

    Raises
    ------
    ProblemError
        If there are some.
    """
    robot = formulation.problem.robot
    if formulation.tau == 0.0 and robot.nc:
        raise ProblemError(
            "receding horizon: integrator.scheme: velocities that this one begins with have to fit closed "
            "loops after a step, and measured ones do not; take another"
        )
    clearance = formulation.problem.clearance
    if clearance is not None and clearance.movers:
        raise ProblemError(
            "receding horizon: obstacle.motion: its horizons begin at other times; leave it out"
        )
    if "progress" in formulation.layout.states:
        raise ProblemError("receding horizon: path: frames follow paths; give goals that move in their place")
