"""A feature is one class: nothing of the package has to know it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from mbocp.formulation import Motion, formulate
from mbocp.formulation.features import all_features
from mbocp.formulation.features.feature import Feature, StepRequests
from mbocp.formulation.layout import Block, StateLayout
from mbocp.formulation.motion import Passage
from mbocp.formulation.steps import StepSymbols
from mbocp.problem import Problem
from mbocp.robot import Label, load_robot
from tests.formulation.stages import check_derivatives, near

N, BEGIN = 6, np.array([3.0, 4.0])


@dataclass(frozen=True)
class Haste(Feature):
    """A state that adds up the mean speeds of the steps, and a control that makes steps shorter."""

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> Haste:
        return cls()

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        return (Block("way", ns, adds_up=True),)

    def controls(self, nu: int) -> Mapping[str, int]:
        return {"haste": 1}

    @property
    def stage_parameters(self) -> Mapping[str, int]:
        return {"hurry": 1}

    @property
    def state_key(self) -> Mapping[str, Any]:
        return {"haste": True}

    def enter(self, at: StepSymbols) -> StepSymbols:
        dt = at.dt * (1 - at.given["hurry"] * at.named_inputs["haste"])
        return replace(at, dt=dt, spacing=dt)

    def next_value(self, name: str, step: Passage) -> Any:
        return step.before[name] + step.dt * (step.s0 + step.s1) / 2

    def stage_numbers(self, problem: Problem) -> Mapping[str, np.ndarray]:
        return {"hurry": np.linspace(0.5, 1.0, problem.num_steps)[:, None]}

    def first(self, problem: Problem) -> Mapping[str, np.ndarray]:
        return {"way": BEGIN}

    def control_bounds(self, problem: Problem) -> Mapping[str, tuple[np.ndarray, np.ndarray]]:
        return {"haste": (np.zeros((1, 1)), np.ones((1, 1)))}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        return [f"way of {label.name}" for label in speeds]

    def control_words(self, problem: Problem) -> Sequence[str]:
        return ["limit of haste"]

    def controls_of(self, problem: Problem, motion: Motion) -> Mapping[str, np.ndarray]:
        return {"haste": (1 - motion.dts / problem.dt)[:, None] / self.stage_numbers(problem)["hurry"]}

    def read(
        self, problem: Problem, at: StateLayout, xs: np.ndarray, us: np.ndarray, motion: Motion
    ) -> Motion:
        haste = us[:, at.controls["haste"]] * self.stage_numbers(problem)["hurry"]
        return replace(motion, dts=problem.dt * (1 - haste[:, 0]))


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(all_features, "_KINDS", (*all_features._KINDS, Haste))


def problem(scheme: str) -> Problem:
    goal = {"q": [0.5, 0.2], "v": 0}
    return Problem.create("double_pendulum", 0.1, N, goal=goal, scheme=scheme)


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize("scheme", ["se1", "midpoint", "gauss2"])
def test_motions_go_there_and_back(scheme: str) -> None:
    robot, formulation, rng = (
        load_robot("double_pendulum"),
        formulate(problem(scheme)),
        np.random.default_rng(0),
    )
    programme, at = formulation.programme, formulation.layout
    qs, vs = np.zeros((N + 1, 2)), np.vstack([np.zeros(2), rng.standard_normal((N, 2))])
    motion = Motion(
        qs, vs, rng.standard_normal((N, robot.nu)), formulation.problem.dt * rng.uniform(0.5, 1.5, N)
    )
    iterate = formulation.iterate_of(motion, np.zeros((N, robot.nc)))
    iterate.check(programme)
    found = formulation.motion_of(iterate)
    for name in ("qs", "vs", "us", "dts"):
        np.testing.assert_allclose(getattr(found, name), getattr(motion, name), atol=1e-14)
    ways = np.cumsum(motion.dts[:, None] * (vs[1:] + vs[:-1]) / 2, axis=0)
    np.testing.assert_allclose(
        iterate.xs[:, at.states["way"]], BEGIN + np.vstack([np.zeros(2), ways]), atol=1e-14
    )
    np.testing.assert_array_equal(programme.bounds.u_upper[:, at.controls["haste"]], np.ones((N, 1)))
    assert programme.describe_row(0, at.rows["way"].start).startswith("way of ")


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize("scheme", ["se1", "midpoint", "gauss2", "rk4"])
def test_its_rows_are_those_of_its_rule(scheme: str) -> None:
    formulation = formulate(problem(scheme))
    programme, at = formulation.programme, formulation.layout
    point, _ = near(formulation)
    rho = programme.rho.reshape(N, -1)[2]
    c, _ = programme.functions.function("values")(*point, programme.theta, rho)
    dt = formulation.problem.dt * (1 - rho[-1] * point.u[at.controls["haste"]])
    before, after = (x[at.states["way"]] for x in (point.x0, point.x1))
    reached = point.x1[at.s] if not programme.rows_are_gaps else np.asarray(c).ravel()[at.ds] + point.x1[at.s]
    wanted = before + dt * (point.x0[at.s] + reached) / 2 - after
    np.testing.assert_allclose(np.asarray(c).ravel()[at.rows["way"]], wanted, atol=1e-12)


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize("scheme", ["se1", "midpoint", "gauss2", "rk4"])
def test_its_derivatives_are_exact(scheme: str) -> None:
    formulation = formulate(problem(scheme))
    check_derivatives(formulation, 2, [formulation.layout.rows["way"].start])
