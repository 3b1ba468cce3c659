"""A few of the motions of `python -m tests.sent`, and what its reader finds where there is something."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.sent import amid, cones, seams
from tests.sent.cases import ROBOTS, TOLERANCE, row_of, time_to_brake
from tests.sent.reader import ends_of_points, limits_of, violation_of_points, violation_of_samples

LIMITS = {"position": np.array([[-3.0], [3.0]]), "velocity": np.array([[-2.0], [2.0]])}
LIMITS |= {"acceleration": np.array([[-9.0], [9.0]]), "jerk": np.array([[-70.0], [70.0]])}


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ROBOTS)
def test_nothing_is_left_as_it_is_sent(name: str, seed: int) -> None:
    row = row_of(name, seed)
    assert row["status"] == "converged"
    assert max(row["violations"].values()) <= TOLERANCE
    assert 1.0 <= row["sent"] / row["least"] < 1.03
    assert row["end_speed"] < 1e-6
    if name == "fr3":
        assert row["end_acceleration"] < 1e-4


@pytest.mark.parametrize(
    ("name", "seed"),
    [("ur5e", 1474), ("ur5e", 1820), ("fr3", 1003), pytest.param("fr3", 1022, marks=pytest.mark.slow)],
)
def test_controls_at_stages_are_as_fast_as_the_slowest_joint(name: str, seed: int) -> None:
    """Where accelerations change in 10 ms, or speeds fall towards the limits of positions."""
    row = row_of(name, seed, controls="stages")
    assert row["status"] == "converged"
    assert 1.0 <= row["sent"] / row["least"] < 1.005
    assert row["iterations"] < 100


@pytest.mark.parametrize("is_stop", [True, False])
@pytest.mark.parametrize("name", ROBOTS)
def test_what_begins_moving_goes_on_from_what_was_sent(name: str, tmp_path: Path, *, is_stop: bool) -> None:
    """A stop, or a replan, from an instant of a motion as it is sent, with the samples before it."""
    row = amid.row_of(name, 2, tmp_path, is_stop=is_stop)
    assert row["status"] == "converged"
    assert max(row["violations"].values()) <= 1e-6
    assert row["away"] < 1e-9
    assert row["longer"] < 0.05


@pytest.mark.parametrize(
    ("name", "speed", "is_curved"),
    [("ur5e", 0.1, False), ("ur5e", 0.1, True), pytest.param("fr3", 0.05, False, marks=pytest.mark.slow)],
)
def test_a_tool_goes_along_a_seam_at_a_steady_speed(
    name: str, speed: float, tmp_path: Path, *, is_curved: bool
) -> None:
    row = seams.row_of(name, speed, tmp_path, is_curved=is_curved)
    assert row["status"] == "converged"
    assert row["violation"] <= 1e-6
    assert row["off"] <= seams.MOST_OFF
    assert row["aside"] <= 2.0 * seams.TUBE


@pytest.mark.parametrize("seed", [9, 5])
def test_a_tool_keeps_in_a_cone_in_a_tube_or_among_spheres(seed: int) -> None:
    row = cones.row_of("ur5e", seed)
    assert row["status"] == "converged"
    assert row["violation"] <= 1e-6
    assert row["cone"] <= 5e-3
    assert row["tube"] <= 5e-4
    assert not row["touches"]


@settings(max_examples=30)
@given(seed=st.integers(0, 10_000))
def test_the_least_time_is_that_of_ruckig_far_from_limits_of_positions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = rng.uniform(-2.0, 2.0) + np.array([0.0, rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 4.0)])
    limits = rng.uniform(0.5, 5.0), rng.uniform(5.0, 20.0), 5000.0
    planner, given_, found = ruckig.Ruckig(1), ruckig.InputParameter(1), ruckig.Trajectory(1)
    given_.current_position, given_.target_position = [ends[0]], [ends[1]]
    given_.max_velocity, given_.max_acceleration, given_.max_jerk = ([x] for x in limits)
    planner.calculate(given_, found)
    own = time_to_brake(tuple(ends), (-1e6, 1e6), (0.2, 3.0), limits)
    assert own == pytest.approx(found.duration, rel=1e-3)
    near = time_to_brake(tuple(ends), (min(ends) - 0.1, max(ends) + 0.1), (0.2, 3.0), limits)
    assert near >= own


def test_a_joint_that_is_slowed_all_along_takes_the_time_of_its_curve() -> None:
    """v = sqrt(2 a (room - x)) - v_0 integrates in closed form; accelerations are hardly a limit."""
    slowing, reserve, room, way = 2.0, 0.3, 2.0, 1.5
    begin, end = np.sqrt(2.0 * slowing * np.array([room, room - way]))
    exact = (begin - end + reserve * np.log((begin - reserve) / (end - reserve))) / slowing
    found = time_to_brake((0.0, way), (-1.0, room), (reserve, slowing), (1e3, 1e6, 1e12))
    assert found == pytest.approx(exact, rel=1e-4)


def swing(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sine of 1 rad and 2 s: at most pi rad/s, 9.87 rad/s^2, 31 rad/s^3."""
    w = np.pi
    return np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)


def test_the_reader_finds_what_samples_leave(tmp_path: Path) -> None:
    t = np.arange(0.0, 1.0005, 1e-3)
    file = tmp_path / "samples.csv"
    rows = "\n".join(f"{x},{q}" for x, q in zip(t.tolist(), swing(t)[0].tolist(), strict=True))
    file.write_text(f"t [s],q:j [rad]\n{rows}\n")
    found = violation_of_samples(file, 1000.0, LIMITS)
    assert found["position"] == 0.0
    assert found["velocity"] == pytest.approx(np.pi / 2.0 - 1.0, rel=1e-3)
    assert found["acceleration"] > 100.0  # from rest at full speed
    assert found["jerk"] > 100.0


def test_the_reader_finds_what_points_leave_between_them(tmp_path: Path) -> None:
    t = np.linspace(0.0, 1.0, 11)
    q, v, a = swing(t)
    lines = ["joint_names: [j]", "points:"]
    for k, time in enumerate(t):
        seconds, rest = divmod(round(1e9 * time), 10**9)
        lines += [f"- positions: [{q[k]}]", f"  velocities: [{v[k]}]", f"  accelerations: [{a[k]}]"]
        lines.append(f"  time_from_start: {{sec: {seconds}, nanosec: {rest}}}")
    file = tmp_path / "points.yaml"
    file.write_text("\n".join(lines))
    found = violation_of_points(file, LIMITS)
    assert found["velocity"] == pytest.approx(np.pi / 2.0 - 1.0, rel=1e-3)
    assert found["acceleration"] == pytest.approx(np.pi**2 / 9.0 - 1.0, rel=1e-2)
    assert found["jerk"] == 0.0
    assert ends_of_points(file)[0] == pytest.approx(np.pi)
    file.write_text("\n".join(line for line in lines if "accelerations" not in line))
    assert violation_of_points(file, LIMITS)["jerk"] == float("inf")


def test_limits_are_those_of_the_profile() -> None:
    from tests.sent.cases import PROFILES

    found = limits_of(PROFILES / "ur5e.toml", acceleration=15.0)
    assert found["velocity"][1] == pytest.approx(np.full(6, np.pi))
    assert found["acceleration"][0] == pytest.approx(np.full(6, -15.0))
    assert set(limits_of(PROFILES / "fr3.toml")) == {
        "position",
        "velocity",
        "acceleration",
        "jerk",
        "braking",
    }
