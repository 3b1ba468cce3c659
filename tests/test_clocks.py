"""Clocks that jump: nothing in mbocp measures time by the clock on the wall; it dates files alone."""

from __future__ import annotations

import ast
import itertools
import time
from pathlib import Path

import pytest

import mbocp
from mbocp.solution import Status

ROOT = Path(mbocp.__file__).parent
EXAMPLE = ROOT.parent / "examples/paper/rigid_pendulum.toml"
WALL_CLOCKS = {("time", "time"), ("datetime", "now"), ("datetime", "utcnow")}


def test_no_module_reads_the_clock_on_the_wall() -> None:
    texts = {module: module.read_text(encoding="utf-8") for module in ROOT.rglob("*.py")}
    assert len(texts) > 100
    suspects = {
        module: text
        for module, text in texts.items()
        if any(f"{owner}.{name}" in text for owner, name in WALL_CLOCKS)
    }
    found = [
        f"{module.relative_to(ROOT)}:{node.lineno}"
        for module, text in suspects.items()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
        if (node.value.id, node.attr) in WALL_CLOCKS
    ]
    assert not found


@pytest.mark.parametrize("jump", [-1e6, 1e6])
def test_a_clock_that_jumps_changes_no_solve(jump: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Backwards or forwards by days at every look."""
    looks = itertools.count()
    monkeypatch.setattr(time, "time", lambda: 1.7e9 + jump * next(looks))
    problem = mbocp.load_problem(EXAMPLE, ["horizon.steps=10", "solver.time_limit=60"])
    for method in ("monolithic", "ipopt", "fatrop"):
        solution = mbocp.solve(problem, solver=method)
        assert solution.status is Status.CONVERGED
        assert 0.0 <= solution.wall_time_s < 60.0
        assert all(0.0 <= phase.wall_time_s < 60.0 for phase in solution.phases)
