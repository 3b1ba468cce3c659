"""Random landings: goals hold where the place of a landing is found, and the judge sees what is off."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mbocp
from tests.campaign.landings import failures, landing, run_landing


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        *(("pendulum_slides", seed) for seed in (1, 2, 3)),
        ("drone_lands", 3),
        ("ur5_slides", 7),  # the scheme leaves velocities across the plane
    ],
)
def test_a_goal_is_met_wherever_the_frame_lands(name: str, seed: int, tmp_path: Path) -> None:
    row = run_landing(name, seed, tmp_path)
    assert (row["status"], row["failures"]) == ("converged", [])


def test_the_judge_sees_what_is_off(tmp_path: Path) -> None:
    task = landing("pendulum_slides", 1, tmp_path)
    s = mbocp.solve(mbocp.Problem.create(**task.tables))
    fields: dict[str, Any] = {key: np.array(getattr(s, key)) for key in ("qs", "vs", "us", "t")}
    assert failures(task, SimpleNamespace(**fields)) == []  # type: ignore[arg-type]
    for key, word in (("qs", "goal"), ("vs", "rate"), ("us", "force")):
        off = {**fields, key: fields[key].copy()}
        off[key][-1] += 0.1
        assert any(failure.startswith(word) for failure in failures(task, SimpleNamespace(**off)))  # type: ignore[arg-type]
