"""Motions for other tools: cubics through the nodes, and files that say the same."""

from __future__ import annotations

import csv
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbocp.exceptions import InvalidValue, ResultFileError
from mbocp.solution import Column, Solution
from mbocp.solution.curves import Curves
from mbocp.solution.joints_sent import Excess
from mbocp.solution.problem_facts import Facts
from mbocp.solution.sampled import JointSamples
from mbocp.solution.sampled import sample as sample_sent
from mbocp.solution.sent import compute_motion_sent

from .fabricated import fabricate


def sample(solution: Solution, rate: float | None = None, interpolation: str | None = None) -> JointSamples:
    return sample_sent(compute_motion_sent(solution, rate, interpolation))


def excesses(
    solution: Solution, rate: float | None = None, interpolation: str | None = None
) -> tuple[Excess, ...]:
    return compute_motion_sent(solution, rate, interpolation).excesses


def arm(joints: int = 6, **others) -> Solution:
    names = [f"j{i}" for i in range(joints)]
    q, v, u = ([Column(name, unit) for name in names] for unit in ("rad", "rad/s", "N m"))
    made = fabricate(q, v, u, num_steps=20, **others)
    t = made.t
    k = np.arange(joints)
    qs = np.sin(np.outer(t, 1.0 + k)) / (1.0 + k)
    return replace(made, qs=qs, vs=np.cos(np.outer(t, 1.0 + k)))


def test_cubics_go_through_the_nodes_with_their_velocities():
    solution = arm()
    nodes = sample(solution)
    np.testing.assert_allclose(nodes.positions, solution.qs, atol=1e-14)
    np.testing.assert_allclose(nodes.velocities, solution.vs, atol=1e-12)
    fine = sample(solution, 1000.0)
    assert fine.t[-1] == solution.t[-1]
    exact = np.sin(np.outer(fine.t, 1.0 + np.arange(6))) / (1.0 + np.arange(6))
    np.testing.assert_allclose(fine.positions, exact, atol=2e-4)
    slopes = np.gradient(fine.positions[:, 5], fine.t)
    np.testing.assert_allclose(slopes[2:-2], fine.velocities[2:-2, 5], atol=1e-3)
    bends = np.gradient(fine.velocities[:, 0], fine.t)
    assert np.median(np.abs(bends - fine.accelerations[:, 0])) < 1e-3


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30)
def test_quintics_have_continuous_accelerations_and_jerks(seed):
    """Through the positions and velocities of any motion, with steps of any lengths."""
    rng = np.random.default_rng(seed)
    t = np.cumsum([0.0, *rng.uniform(0.02, 0.1, 20)])
    solution = replace(arm(2), t=t, qs=rng.normal(size=(21, 2)), vs=rng.normal(size=(21, 2)))
    nodes = sample(solution, None, "quintic")
    np.testing.assert_allclose(nodes.positions, solution.qs, atol=1e-12)
    np.testing.assert_allclose(nodes.velocities, solution.vs, atol=1e-10)
    curves = Curves(t, solution.qs, solution.vs).smooth(np.zeros(2, dtype=bool))
    values = [one.reshape(20, 2, 2) for one in curves.places(1)[1]]  # step, begin or end, joint
    for one in values:
        np.testing.assert_allclose(one[:-1, 1], one[1:, 0], rtol=1e-6, atol=1e-8 * np.abs(one).max())
    assert np.abs(values[3][0, 0]).max() < 1e-6 * np.abs(values[3]).max()


def test_efforts_at_nodes_are_those_of_the_steps_that_begin_there():
    """Where times are rounded to nanoseconds, too, as messages have them."""
    solution = arm(t=np.cumsum([0.0, *np.sqrt(np.arange(2.0, 22.0))]))
    messages = sample_sent(compute_motion_sent(solution, None, "cubic", is_joined=True))
    assert (messages.t[:-1] < solution.t[:-1]).any()
    np.testing.assert_array_equal(messages.efforts[:-1], solution.us)


def test_quintics_are_of_order_four_and_more():
    """Between the nodes of a sine; cubics are of order four."""
    errors = {"cubic": [], "quintic": []}
    for steps in (20, 40):
        t = np.linspace(0.0, 1.5, steps + 1)
        column = [Column("j", "rad")], [Column("j", "rad/s")], [Column("j", "N m")]
        made = fabricate(*column, num_steps=steps)
        solution = replace(made, t=t, qs=np.sin(3 * t)[:, None], vs=3 * np.cos(3 * t)[:, None])
        for name, found in errors.items():
            fine = sample(solution, 1000.0, name)
            inside = (fine.t > 0.3) & (fine.t < 1.2)
            found.append(np.abs(fine.positions[:, 0] - np.sin(3 * fine.t))[inside].max())
    assert errors["quintic"][0] < errors["cubic"][0]
    assert errors["quintic"][0] / errors["quintic"][1] > 14.0


def test_where_jerks_are_limited_rest_has_no_acceleration():
    """At both ends; of a joint without such a limit the jerk is zero there."""
    t = np.linspace(0.0, 1.5, 21)
    s, rate = t / 1.5, 1.5
    q, v = s**2 * (3 - 2 * s), 6 * s * (1 - s) / rate
    rates = {"jerk": ((-np.inf, -90.0), (np.inf, 90.0))}
    solution = replace(
        arm(2),
        t=t,
        qs=np.column_stack([q, q]),
        vs=np.column_stack([v, v]),
        facts_kept=Facts(rates=rates),
    )
    nodes = sample(solution, None, "quintic")
    np.testing.assert_allclose(nodes.accelerations[[0, -1], 1], 0.0, atol=1e-12)
    assert np.abs(nodes.accelerations[[0, -1], 0]).min() > 1.0
    found = {(e.kind, e.name) for e in excesses(solution, None, "quintic")}
    assert found <= {("jerk", "j1")}


def test_an_impact_parts_quintics():
    t = np.array([0.0, 0.5, 0.5, 1.0])
    column = [Column("j", "rad")], [Column("j", "rad/s")], [Column("j", "N m")]
    made = fabricate(*column, num_steps=3)
    qs, vs = np.array([0.0, 0.5, 0.5, 0.0])[:, None], np.array([1.0, 1.0, -1.0, -1.0])[:, None]
    found = sample(replace(made, t=t, qs=qs, vs=vs), 100.0, "quintic")
    np.testing.assert_allclose(found.positions[:, 0], 0.5 - np.abs(found.t - 0.5), atol=1e-12)
    np.testing.assert_allclose(found.accelerations, 0.0, atol=1e-9)


def test_controls_are_constant_over_their_steps():
    solution = arm()
    fine = sample(solution, 4.0 / solution.duration * solution.num_steps)
    np.testing.assert_array_equal(fine.efforts[1:4, 0], np.full(3, solution.us[0, 0]))


def test_continuous_joints_count_their_turns():
    t = np.linspace(0.0, 1.5, 21)
    angle = 9.0 * t
    q = [Column("wheel.cos", ""), Column("wheel.sin", "")]
    made = fabricate(q, [Column("wheel", "rad/s")], [Column("wheel", "N m")], num_steps=20)
    qs, vs = np.column_stack([np.cos(angle), np.sin(angle)]), np.full((21, 1), 9.0)
    found = sample(replace(made, qs=qs, vs=vs), 100.0)
    np.testing.assert_allclose(found.positions[:, 0], 9.0 * found.t, atol=1e-9)


def test_limits_are_looked_at_between_nodes():
    solution = arm(2)
    assert excesses(solution) == ()
    jump = np.array(solution.qs)
    jump[10:, 1] += 0.3
    limits = np.array([[-1.2, -1.2], [1.2, 1.2]])
    (found,) = excesses(replace(solution, qs=jump, limits_v=limits))
    assert (found.kind, found.name, found.bound) == ("speed", "j1", 1.2)
    assert 0.7 <= found.time < 0.8
    assert found.ratio == pytest.approx(found.value / 1.2 - 1.0)
    assert re.fullmatch(r"speed [0-9.]+ rad/s at 0\.7\d* s, [0-9.]+ % beyond 1\.2", found.words)


def test_the_worst_excess_comes_first():
    solution = arm(3)
    jump = np.array(solution.qs)
    jump[10:] += [0.1, 0.3, 0.2]
    limits = np.array([[-1.2, -1.2, -0.2], [1.2, 1.2, 0.2]])
    found = excesses(replace(solution, qs=jump, limits_v=limits))
    assert found[0].name == "j2"
    assert [e.ratio for e in found] == sorted((e.ratio for e in found), reverse=True)


def test_jerks_of_cubics_are_differences_of_samples_and_accelerations_at_nodes_alone():
    """Of sin(k t) / k the acceleration is k at most, and the jerk k^2."""
    rates = {"acceleration": ((-1.0, -1.5), (1.0, 1.5)), "jerk": ((-20.0, -2.0), (20.0, 2.0))}
    solution = replace(arm(2), facts_kept=Facts(rates=rates))
    for rate in (None, 125.0, 500.0):
        found = {(e.kind, e.name): e for e in excesses(solution, rate)}
        assert ("acceleration", "j0") not in found
        assert found["acceleration", "j1"].value == pytest.approx(-2.0, rel=0.02)
        assert ("jerk", "j0") not in found
        assert abs(found["jerk", "j1"].value) >= 3.8


@pytest.mark.filterwarnings("ignore:efforts are those of the solution")
def test_files_say_the_motion(tmp_path):
    solution = arm()
    motion = sample(solution, 50.0)
    table = list(csv.reader(solution.export(tmp_path / "m.csv", rate=50.0).read_text().splitlines()))
    assert table[0][:2] == ["t [s]", "q:j0 [rad]"]
    np.testing.assert_array_equal(np.array(table[1:], dtype=float)[:, 1:7], motion.positions)
    with np.load(solution.export(tmp_path / "m.npz", rate=50.0)) as data:
        np.testing.assert_array_equal(data["v"], motion.velocities)
        assert data["joints"].tolist() == list(motion.joints)
    ros = solution.export(tmp_path / "m.yaml", rate=50.0).read_text()
    assert ros.startswith('joint_names: ["j0", "j1", "j2", "j3", "j4", "j5"]\npoints:\n- positions: [')
    assert ros.count("time_from_start") >= len(motion.t)  # the nodes are among them
    assert "time_from_start: {sec: 1, nanosec: 500000000}" in ros
    assert ros.count("accelerations") == ros.count("positions")
    cubics = solution.export(tmp_path / "m.yaml", rate=50.0, interpolation="cubic").read_text()
    assert "accelerations" not in cubics
    script = solution.export(tmp_path / "m.script").read_text()
    assert script.count("servoj(") == len(sample(solution, 125.0).t) - 1
    assert script.rstrip().endswith(")")


def test_each_part_has_a_file_of_its_own(tmp_path):
    """By the names that its own controller knows; all of them at the same times."""
    names = [f"arm/j{i}" for i in range(6)] + ["base/x"]
    q, v, u = ([Column(name, unit) for name in names] for unit in ("rad", "rad/s", "N m"))
    whole = fabricate(q, v, u, num_steps=20)
    of_arm, both = tmp_path / "arm.npz", tmp_path / "both.npz"
    whole.export(of_arm, rate=50.0, part="arm")
    whole.export(both, rate=50.0)
    with np.load(of_arm) as part, np.load(both) as all_of_them:
        assert part["joints"].tolist() == [f"j{i}" for i in range(6)]
        for key in "qvau":
            np.testing.assert_array_equal(part[key], all_of_them[key][:, :6])
        np.testing.assert_array_equal(part["t"], all_of_them["t"])
    assert "servoj(" in whole.export(tmp_path / "arm.script", part="arm").read_text()
    with pytest.raises(ResultFileError, match="one of its parts: arm, base"):
        whole.export(tmp_path / "both.script")
    with pytest.raises(InvalidValue, match=r"part: got 'amr'.*did you mean 'arm'"):
        whole.export(tmp_path / "other.csv", part="amr")
    with pytest.raises(InvalidValue, match="the robot has no parts"):
        arm().export(tmp_path / "one.csv", part="arm")


def test_what_does_not_fit_is_refused(tmp_path):
    with pytest.raises(ResultFileError, match="six joints that turn"):
        arm(3).export(tmp_path / "m.script")
    with pytest.raises(InvalidValue, match="format"):
        arm(3).export(tmp_path / "m.xls")
    with pytest.raises(InvalidValue, match="rate"):
        arm(3).export(tmp_path / "m.csv", rate=-1.0)
    point = fabricate(
        [Column(f"base.q{c}", "") for c in "xyzw"], [Column(f"base.w{c}", "rad/s") for c in "xyz"], []
    )
    with pytest.raises(InvalidValue, match=r"floating bases.*to \.mcap.*Solution\.to_csv"):
        sample(point)
