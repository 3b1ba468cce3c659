"""Functions of a stage that would be too large are refused before they are built."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

import mbocp
from mbocp.exceptions import InvalidValue, TooManyOperations
from mbocp.formulation import build, transcribe
from mbocp.formulation.stage import build_functions
from mbocp.problem import Problem
from mbocp.programme.compilation import CompiledFunctions
from mbocp.robot import load_robot

PENDULUM = Path(__file__).parents[2] / "examples" / "paper" / "elastic_pendulum.toml"


def reach(robot: str, **integrator: object) -> Problem:
    arm = load_robot(robot)
    return Problem.create(arm, 1.0, 3, goal={"q": arm.q0.tolist()}, integrator=integrator)


@pytest.mark.parametrize("substeps", [2000, 10**9])
def test_substeps_are_bounded(substeps: int) -> None:
    clock = time.process_time()
    problem = reach("ur5", scheme="rk4", substeps=substeps)
    with pytest.raises(TooManyOperations, match=f"Take fewer integrator.substeps than {substeps} and more"):
        transcribe(problem)
    assert time.process_time() - clock < 5.0


def test_large_robots_are_bounded() -> None:
    """Whoever describes a robot may not be able to solve problems with it, and is told so at once."""
    clock = time.process_time()
    problem = reach("chain_200")
    with pytest.raises(
        TooManyOperations, match=r"'chain_200' \(nv = 200\).* the limit is 1e\+07. Take coordinates"
    ):
        mbocp.solve(problem)
    assert time.process_time() - clock < 10.0


def test_the_limit_may_be_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = mbocp.load_problem(PENDULUM)
    monkeypatch.setenv("MBOCP_OPERATIONS_LIMIT", "1000")
    with pytest.raises(TooManyOperations, match=r"the limit is 1e\+03.*set MBOCP_OPERATIONS_LIMIT"):
        transcribe(problem)
    monkeypatch.setenv("MBOCP_OPERATIONS_LIMIT", "none")
    with pytest.raises(InvalidValue, match="MBOCP_OPERATIONS_LIMIT: got 'none', expected a number > 0"):
        transcribe(problem)


@pytest.mark.parametrize(
    ("robot", "integrator"),
    [
        ("chain_4", {}),
        ("chain_8", {"scheme": "midpoint"}),
        ("ur5", {}),
        ("solo12", {}),
        ("ur5", {"scheme": "euler"}),
        ("chain_4", {"scheme": "heun", "substeps": 2}),
    ],
)
def test_the_estimate_is_of_the_right_size(
    robot: str, integrator: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = reach(robot, **integrator)
    shapes = []
    check = build.check_operations

    def remember(*args: object) -> None:
        shapes.append(args)
        check(*args)

    monkeypatch.setattr(build, "check_operations", remember)
    none = CompiledFunctions.interpret({})
    monkeypatch.setattr(build, "load_functions", lambda *_, **__: none)
    transcribe(problem)
    _, nv, signature = shapes[0]
    whole = build_functions(signature.steps.mechanics(problem.robot), signature)["complete"]
    found = sum(f.n_instructions() for f in (whole, *whole.find_functions()) if f.is_a("SXFunction"))
    assert found / 3 < signature.steps.operations(nv) < 15 * found
