"""SE1 by forward simulation: its order, the constraint, the group."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.guess import make_guess
from mbocp.problem import Problem
from mbocp.transcription import transcribe

EXAMPLES = Path(__file__).parents[2] / "examples"


def simulate(problem: Problem) -> np.ndarray:
    iterate, _ = make_guess("control", problem, transcribe(problem))
    return iterate.xs


CASES = {
    "rigid_pendulum": ("paper/rigid_pendulum.toml", []),
    "cart_pendulum_rigid": ("paper/cart_pendulum_rigid.toml", ["horizon.duration=0.5"]),
    "ur5": ("arms/ur5_reach.toml", ["horizon.duration=0.3", "guess.u=[1, 2, -1, 0.1, 0.1, 0.1]"]),
    "drone": (
        "free_flyer/drone_flip.toml",
        ["horizon.duration=0.4", "guess.u=[0.2, 0, 14, 0.01, 0.02, -0.01]", "start.v=[1, 0, 0, 0.5, 1, 2]"],
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_first_order(name: str) -> None:
    path, settings = CASES[name]

    def final(steps: int) -> tuple[np.ndarray, Problem]:
        problem = mbocp.load_problem(EXAMPLES / path, [*settings, f"horizon.steps={steps}"])
        return simulate(problem)[-1], problem

    exact, problem = final(6400)
    nq, errors = problem.robot.nq, []
    steps = (50, 100, 200, 400)
    for n in steps:
        x, _ = final(n)
        position = problem.robot.difference(exact[:nq], x[:nq])
        errors.append(np.linalg.norm(np.concatenate([position, x[nq:] - exact[nq:]])))
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(1.0, abs=0.2)


def test_rod_keeps_its_length_over_many_steps() -> None:
    problem = mbocp.load_problem(
        EXAMPLES / "paper" / "rigid_pendulum.toml",
        ["horizon.duration=20", "horizon.steps=4000", "guess.u=[1, 0.5, 2]"],
    )
    lengths = np.linalg.norm(simulate(problem)[:, :3], axis=1)
    assert np.abs(lengths - 5).max() < 1e-12


def test_free_rotation_stays_on_the_group_over_many_steps() -> None:
    problem = mbocp.load_problem(
        EXAMPLES / "free_flyer" / "drone_flip.toml",
        [
            "horizon.duration=20",
            "horizon.steps=10000",
            "guess.u=[0, 0, 14, 0, 0, 0]",
            "start.v=[0, 0, 0, 3, 2, 1]",
        ],
    )
    quaternions = simulate(problem)[:, 3:7]
    assert np.abs(np.linalg.norm(quaternions, axis=1) - 1).max() < 1e-12
