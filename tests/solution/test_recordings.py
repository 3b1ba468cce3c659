"""Recordings for viewers, read back by the libraries that made the formats."""

from __future__ import annotations

import io
import json
import sys
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from mbocp.exceptions import InvalidValue, LimitsExceeded, ResultFileError
from mbocp.robot import Robot, load_robot
from mbocp.solution import Labels, Solution
from mbocp.solution.recordings import record
from tests.robot import urdfs

STEPS, T = 10, 0.5


def a_motion(robot: Robot) -> Solution:
    """All joints and the base at constant velocity, from a time that is not zero."""
    speed = 0.4 * np.resize([1.0, -1.2, 0.8, 0.9, -0.5], robot.nv)
    t = np.linspace(2.0, 2.0 + T, STEPS + 1)
    qs = np.array([robot.integrate(robot.q0, (x - t[0]) * speed) for x in t])
    vs = np.tile(speed, (STEPS + 1, 1))
    us = np.arange(1.0, STEPS + 1)[:, None] * np.arange(1.0, robot.nu + 1)
    return Solution(
        status="converged", solver="none", iterations=0, cost=1.0, residual=0.0, unknowns=1, t=t,
        qs=qs, vs=vs, ps=vs, us=us, mus=np.zeros((STEPS + 1, 2 * robot.nv)), lams=np.zeros((STEPS, robot.nc)),
        zetas=np.zeros((STEPS, robot.nc)), robot_name=robot.name, robot_spec=dict(robot.spec),
        labels=Labels.of_robot(robot),
    )  # fmt: skip


@pytest.fixture(scope="module")
def walker() -> Robot:
    return load_robot("solo12")


def test_a_recording_has_the_poses_of_all_links_and_the_base(walker: Robot) -> None:
    solution = a_motion(walker)
    motion = record(solution, walker)
    assert len(motion.joints) == 12
    np.testing.assert_allclose(motion.t, solution.t - 2.0)
    for name in ("base_link", "FL_LOWER_LEG"):
        place = walker.frame_placement(name, solution.qs[7])
        np.testing.assert_allclose(motion.links[name][7], pin.SE3ToXYZQUAT(place), atol=1e-12)
    position, velocity, effort = motion.joints["FL_KFE"]
    column = [c.name for c in solution.labels.q].index("FL_KFE")
    np.testing.assert_array_equal(position, solution.qs[:, column])
    assert (velocity == solution.vs[0, column - 1]).all()
    driven = [c.name for c in solution.labels.u].index("FL_KFE")
    np.testing.assert_array_equal(effort[:-1], solution.us[:, driven])


def test_between_nodes_it_follows_the_tangent(walker: Robot) -> None:
    """Here the motion has constant velocity, so that this is exact; its end is there, too."""
    solution = a_motion(walker)
    motion = record(solution, walker, rate=37.0)
    np.testing.assert_allclose(motion.t[:3], [0.0, 1.0 / 37.0, 2.0 / 37.0])
    assert (motion.t[-1], len(motion.t)) == (pytest.approx(T), 20)
    q = walker.integrate(walker.q0, motion.t[11] * solution.vs[0])
    place = pin.SE3ToXYZQUAT(walker.frame_placement("base_link", q))
    np.testing.assert_allclose(motion.links["base_link"][11], place, atol=1e-12)


def test_a_joint_without_end_counts_its_turns(tmp_path) -> None:
    robot = load_robot(urdfs.write(tmp_path, urdfs.chain("continuous")))
    solution = a_motion(robot)
    angles = np.linspace(3.0, 10.0, STEPS + 1)
    turning = replace(solution, qs=np.column_stack([np.cos(angles), np.sin(angles)]))
    ((position, _, _),) = record(turning, robot).joints.values()
    np.testing.assert_allclose(position, angles)


def test_a_quadrotor_has_controls_and_no_joints() -> None:
    robot = load_robot("hector")
    motion = record(a_motion(robot), robot)
    assert not motion.joints
    assert len(motion.controls) == robot.nu


@pytest.mark.parametrize("name", ["mcap", "rerun"])
def test_what_cannot_be_recorded(name: str, tmp_path, monkeypatch) -> None:
    robot = load_robot("double_pendulum")
    solution, path = a_motion(robot), tmp_path / "motion.bin"
    with pytest.raises(InvalidValue, match="interpolation: got quintic, expected none"):
        solution.export(path, kind=name, interpolation="quintic")
    with pytest.raises(InvalidValue, match="rate: got -1"):
        solution.export(path, kind=name, rate=-1.0)
    with pytest.raises(InvalidValue, match="qs: got NaN"):
        record(replace(solution, qs=np.full_like(solution.qs, np.nan)), robot)
    for module in ("mcap", "mcap.writer", "rerun"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ResultFileError, match=rf"pip install 'mbocp\[{name}\]'"):
        solution.export(path, kind=name)
    assert not path.exists()


def test_ros2_has_the_base_as_one_joint_of_many(walker: Robot, tmp_path) -> None:
    """Poses of the base, and velocities along the axes of the world, by Pinocchio's kinematics of frames."""
    yaml = pytest.importorskip("yaml")
    solution = a_motion(walker)
    path = solution.export(tmp_path / "base.yaml", kind="multidof", rate=20.0)
    message = yaml.safe_load(path.read_text())
    assert message["joint_names"] == ["root_joint"]
    assert len(message["points"]) == 11
    point, q, v = message["points"][6], walker.integrate(walker.q0, 0.3 * solution.vs[0]), solution.vs[0]
    assert point["time_from_start"] == {"sec": 0, "nanosec": 300_000_000}
    (transform,), (velocity,) = point["transforms"], point["velocities"]
    pose = [*transform["translation"].values(), *transform["rotation"].values()]
    np.testing.assert_allclose(pose, pin.SE3ToXYZQUAT(walker.frame_placement("base_link", q)), atol=1e-12)
    model, data = walker.model, walker.model.createData()
    pin.forwardKinematics(model, data, q, v)
    expected = pin.getFrameVelocity(model, data, walker.frame_id("base_link"), pin.LOCAL_WORLD_ALIGNED)
    told = [*velocity["linear"].values(), *velocity["angular"].values()]
    np.testing.assert_allclose(told, expected.vector, atol=1e-12)
    arm = load_robot("double_pendulum")
    with pytest.raises(ResultFileError, match="expected a joint of several velocities"):
        a_motion(arm).export(tmp_path / "arm.yaml", kind="multidof")


@pytest.mark.parametrize("has_speeds", [True, False])
def test_a_base_that_leaves_limits_from_point_to_point_is_not_written(
    walker: Robot, tmp_path, has_speeds: bool
) -> None:
    """At 0.4 m/s along x; without speeds at the nodes the poses tell."""
    solution = a_motion(walker)
    limits = np.tile(np.inf, (2, walker.nv)) * np.array([[-1.0], [1.0]])
    limits[:, 0] = -0.3, 0.3
    bounded = replace(solution, limits_v=limits, vs=solution.vs if has_speeds else 0.0 * solution.vs)
    path = tmp_path / "base.yaml"
    with pytest.raises(LimitsExceeded) as refused:
        bounded.export(path, kind="multidof", rate=200.0)
    (excess,) = refused.value.excesses
    assert (excess.kind, excess.bound) == ("speed", 0.3)
    assert excess.value == pytest.approx(0.4 if has_speeds else 0.6, rel=1e-9)  # a cubic from rest to rest
    assert not path.exists()
    bounded.export(path, kind="multidof", rate=200.0, check=False)
    assert path.exists()


def test_mcap(walker: Robot, tmp_path) -> None:
    reader = pytest.importorskip("mcap.reader")
    solution = a_motion(walker)
    path = solution.export(tmp_path / "motion.mcap")
    motion = record(solution, walker)
    read = reader.make_reader(io.BytesIO(path.read_bytes()))
    rows = [(s.name, c.topic, m.log_time, json.loads(m.data)) for s, c, m in read.iter_messages()]
    assert {(schema, topic) for schema, topic, *_ in rows} == {
        ("foxglove.FrameTransforms", "/tf"), ("foxglove.PosesInFrame", "/path/base_link"),
        ("mbocp.Controls", "/controls"), ("sensor_msgs/JointState", "/joint_states"),
    }  # fmt: skip
    states = [(time, message) for _, topic, time, message in rows if topic == "/joint_states"]
    assert [time for time, _ in states] == [round(1e9 * t) for t in motion.t]
    assert states[4][1]["header"]["stamp"] == {"sec": 0, "nsec": 200_000_000}
    assert states[4][1]["name"] == [*motion.joints]
    for k, field in enumerate(("position", "velocity", "effort")):
        assert states[4][1][field] == [joint[k][4] for joint in motion.joints.values()]
    transforms = [message["transforms"] for _, topic, _, message in rows if topic == "/tf"]
    base = next(each for each in transforms[4] if each["child_frame_id"] == "base_link")
    assert base["parent_frame_id"] == "world"
    assert [*base["translation"].values(), *base["rotation"].values()] == [*motion.links["base_link"][4]]
    (path_of_base,) = (message["poses"] for _, topic, _, message in rows if topic.startswith("/path"))
    assert len(path_of_base) == STEPS + 1


def test_rerun(walker: Robot, tmp_path) -> None:
    chunks = pytest.importorskip("rerun.chunk")
    escape = pytest.importorskip("rerun").escape_entity_path_part
    solution = a_motion(walker)
    path = solution.export(tmp_path / "motion.rrd")
    motion = record(solution, walker)
    stream = chunks.RrdReader(str(path)).stream()
    read = {chunk.entity_path: chunk.to_record_batch().to_pydict() for chunk in stream}
    curves = {
        f"/joints/{name}/{field}": values
        for name, joint in motion.joints.items()
        for field, values in zip(("position", "velocity", "effort"), joint, strict=True)
    }
    curves |= {f"/controls/{escape(name)}": values for name, values in motion.controls.items()}
    links = {f"/world/{escape(name)}": poses for name, poses in motion.links.items()}
    shown = {path for path in read if not path.startswith("/__")}
    assert shown == {*curves, *links, "/path/base_link"}
    for entity in (*curves, *links):
        assert [time.total_seconds() for time in read[entity]["time"]] == pytest.approx([*motion.t]), entity
    for entity, values in curves.items():
        assert np.ravel(read[entity]["Scalars:scalars"]) == pytest.approx(values), entity
    for entity, poses in links.items():
        for part, columns in (("translation", slice(0, 3)), ("quaternion", slice(3, 7))):
            found = np.squeeze(read[entity][f"Transform3D:{part}"])
            assert found == pytest.approx(poses[:, columns], abs=1e-6), entity  # single precision
    (strip,) = np.squeeze(read["/path/base_link"]["LineStrips3D:strips"], axis=1)
    assert strip == pytest.approx(motion.paths["base_link"][:, :3], abs=1e-6)
