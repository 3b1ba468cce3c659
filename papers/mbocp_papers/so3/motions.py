"""Solutions that the figures of single tasks show, and their states integrated anew."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.formulation import formulate
from mbocp.problem import Problem
from mbocp.programme.kernel import kernel_programme
from mbocp.solution import Solution
from mbocp.solving import solve
from mbocp_papers.so3.data import formulation
from mbocp_papers.so3.experiment import task_problem

_SWEEP_TOLERANCE = 1e-12
_SWEEP_ITERATIONS = 50
_TURN = "pendulum"


@dataclass(frozen=True, eq=False)
class Motion:
    """A problem and its solution."""

    problem: Problem
    solution: Solution


@lru_cache(maxsize=6)
def task_motion(label: str) -> Motion:
    """Solve x = y = 0.5 m, theta = pi by the formulation of that label, once a process.

    Raises
    ------
    ProblemError
        If no solution is found: there would be nothing to draw.
    """
    problem = task_problem(formulation(label))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = solve(problem)
    if not solution.converged:
        raise ProblemError(f"{label}: {solution.status} at x = y = 0.5 m, theta = pi; {solution.advice}")
    return Motion(problem, solution)


def resimulate(problem: Problem, us: Array) -> Array:
    """Coordinates of the configurations, integrated from the start with controls, shape (N + 1, nz).

    What the integrator makes of the controls, without what a solver leaves open.

    Raises
    ------
    ProblemError
        If a step cannot be taken.
    """
    formulation = formulate(problem)
    programme = formulation.programme
    native = kernel_programme(programme, sweeps=True)
    native.u = np.ascontiguousarray(us).ravel()
    xs = np.zeros((problem.num_steps + 1, programme.x_start.size))
    xs[0] = programme.x_start
    native.x = xs.ravel()
    sweep = native.simulate(_SWEEP_TOLERANCE, _SWEEP_ITERATIONS)
    if not sweep.ok:
        raise ProblemError(f"the simulation fails in step {sweep.failed_stage + 1}")
    zs: Array = native.x.reshape(xs.shape)[:, formulation.layout.z]
    return zs


def drift_of(problem: Problem, zs: Array) -> Array:
    """Defect of the rotation at each node, shape (N + 1,): abs(norm(q) - 1) or norm(R'R - I)."""
    space = formulate(problem).space
    z = ca.SX.sym("z", space.nz)
    defects = ca.Function("defects", [z], [ca.densify(space.defects(z))])
    found: Array = np.abs(np.asarray(defects.map(len(zs))(zs.T))).max(axis=0)
    return found


def representation_matrices(problem: Problem, zs: Array) -> Array:
    """Matrix P that stands for the pendulum's rotation, eq. (54), shape (N + 1, 3, 3).

    For rotation matrices the nine numbers themselves; for quaternions that of eq. (11), which is
    norm(q)^2 times a rotation.
    """
    place = problem.robot.configuration_indices(_TURN)
    first = int(np.arange(problem.robot.nq)[place][0])
    if problem.robot.rotations == "dcm":
        columns = zs[:, first : first + 9].reshape(-1, 3, 3)
        return np.ascontiguousarray(columns.transpose(0, 2, 1))
    x, y, z, w = zs[:, first : first + 4].T
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1))


def stretch_of(problem: Problem, zs: Array) -> float:
    """Largest singular value of the representation matrices less one, eq. (55)."""
    matrices = representation_matrices(problem, zs)
    if not np.isfinite(matrices).all():
        return float("inf")
    return float(np.linalg.svd(matrices, compute_uv=False).max()) - 1.0
