"""The short form: a dozen sets of features on a small arm, and what the cover of pairs promises."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.pairs.cover import cover, pairs_within
from tests.pairs.features import FEATURES, pairs
from tests.pairs.run import FAILED, refusal, run_set

_SAMPLE = (
    ("acceleration", "jerk", "obstacle"),
    ("jerk", "movable", "path_position", "via_q"),
    ("effort_rate", "linear", "power", "via_box"),
    ("free_duration", "obstacle", "via_time_free"),
    ("free_phases", "goal_box", "obstacle", "velocity"),
    ("lock", "payload", "phase_limits", "via_q"),
    ("hold_soft", "payload", "velocity"),
    ("free_start", "periodic", "effort"),
    ("goal_any", "path_distance", "position"),
    ("goal_frame", "path_speed", "self_collision"),
    ("control_rate", "fuel", "path_kept", "semi_implicit"),
    ("path_follow", "payload", "tracking"),
)


@pytest.mark.parametrize("names", _SAMPLE, ids="+".join)
def test_features_go_together(names: tuple[str, ...], tmp_path: Path) -> None:
    row = run_set("small", names, tmp_path)
    assert row["status"] not in (*FAILED, "refused"), row


def test_each_feature_is_taken_alone(tmp_path: Path) -> None:
    """One that is refused by itself would leave all its pairs out of a run."""
    rows = [refusal("small", (name,), tmp_path) for name in FEATURES]
    assert [row for row in rows if row["status"] != "made"] == []


def test_what_does_not_go_together_is_refused_by_its_keys(tmp_path: Path) -> None:
    row = refusal("small", ("acceleration", "natural"), tmp_path)
    assert row["status"] == "refused"
    assert "limits.acceleration" in row["says"]
    assert "coordinates" in row["says"]


def test_a_cover_has_all_pairs_and_no_refused_one() -> None:
    wanted = pairs(list(FEATURES))
    refused = wanted[::17]
    sets = cover([pair for pair in wanted if pair not in refused], refused, 6)
    found = {pair for names in sets for pair in pairs_within(names)}
    assert found == set(wanted) - set(refused)
    assert max(map(len, sets)) <= 6
    assert len(sets) < len(wanted) / 6
