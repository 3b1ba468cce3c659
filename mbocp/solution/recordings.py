"""A motion as a recording: for viewers MCAP, which Foxglove shows, and Rerun's format; bases for ROS 2.

Unlike what is sent to a controller, a recording is the solution itself, with floating bases and ball joints:
poses of links, joints, controls, paths of the tool. A new format is a function, and an entry of `RECORDINGS`.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, IntArray, dataclass
from mbocp.exceptions import InvalidValue
from mbocp.robot import Robot
from mbocp.robot.kinematics import frame_poses
from mbocp.robot.nodes import along_with_velocities
from mbocp.solution.solution_data import SolutionData

_MOST_SAMPLES = 200_000
_FORCES = ("N", "N m")
_WORLD = "world"
_FIELDS = ("position", "velocity", "effort")
_SAME = 1e-9  # [s]
SENT = "multidof"  # the one of `RECORDINGS` that a controller follows


@dataclass(frozen=True, eq=False)
class MotionSamples:
    """A motion at some times.

    Attributes
    ----------
    t : ndarray, shape (K,)
        From its start [s].
    qs, vs : ndarray, shapes (K, nq) and (K, nv)
        Configurations and velocities.
    joints : mapping of str to (ndarray, ndarray, ndarray)
        Position, velocity and effort of each joint of one velocity, shape (K,) each [rad, m, s, N m, N];
        efforts are zero where there is no motor.
    controls : mapping of str to ndarray
        By name and unit, shape (K,).
    links : mapping of str to ndarray
        Poses in the world, shape (K, 7): position [m], quaternion xyzw.
    paths : mapping of str to ndarray
        The same of frames that the robot traces.
    bases : mapping of str to (ndarray, ndarray)
        Of each joint of several velocities, floating, planar or a ball: poses in the frame that it is fixed
        to, shape (K, 7), and velocities along its axes, linear before angular, shape (K, 6) [m/s, rad/s].
    """

    t: Array
    qs: Array
    vs: Array
    joints: Mapping[str, tuple[Array, Array, Array]]
    controls: Mapping[str, Array]
    links: Mapping[str, Array]
    paths: Mapping[str, Array]
    bases: Mapping[str, tuple[Array, Array]]


def record(solution: SolutionData, robot: Robot, rate: float | None = None) -> MotionSamples:
    """Record a motion at its nodes, or at a rate [1/s].

    Between nodes configurations are on the cubics of `mbocp.robot.nodes.along`.

    Raises
    ------
    InvalidValue
        If the rate cannot be right, or the motion has numbers that are not finite.
    """
    t, qs, vs = _sample(solution, robot, rate)
    us = solution.controls_at(t)
    for name, values in (("qs", qs), ("vs", vs), ("us", us)):
        if not np.isfinite(values).all():
            raise InvalidValue(name, "NaN or infinity", "finite numbers, of a motion that can be shown")
    labels = solution.labels.u
    efforts = {c.name: us[:, k] for k, c in enumerate(labels) if c.unit in _FORCES}
    model: Any = robot.model
    joints = {}
    for joint in range(1, model.njoints):
        at, name = model.joints[joint], model.names[joint]
        if at.nv == 1:
            columns = qs[:, at.idx_q : at.idx_q + at.nq]
            turned = np.unwrap(np.arctan2(columns[:, -1], columns[:, 0]))  # of cos and sin
            position = columns[:, 0] if at.nq == 1 else turned
            joints[name] = (position, vs[:, at.idx_v], efforts.get(name, np.zeros(len(t))))
    bodies = [k for k, f in enumerate(model.frames) if f.type == pin.FrameType.BODY and f.name != _WORLD]
    traced = [robot.frame_id(name) for name in robot.trace_frames]
    frames = [*bodies, *traced]
    poses = dict(zip(frames, frame_poses(model, qs, frames), strict=True))
    return MotionSamples(
        t - t[0],
        qs,
        vs,
        joints,
        {f"{c.name} [{c.unit}]": us[:, k] for k, c in enumerate(labels)},
        {model.frames[k].name: poses[k] for k in bodies},
        {model.frames[k].name: poses[k] for k in traced},
        {model.names[k]: _base(model, k, qs, vs) for k in range(1, model.njoints) if model.joints[k].nv > 1},
    )


def _base(model: Any, joint: int, qs: Array, vs: Array) -> tuple[Array, Array]:
    """Poses and velocities of a joint in the frame that it is fixed to."""
    own, data, rows = model.joints[joint], model.joints[joint].createData(), []
    for q, v in zip(qs, vs, strict=True):
        own.calc(data, q, v)
        place = model.jointPlacements[joint] * data.M
        rows.append(
            (pin.SE3ToXYZQUAT(place), *(place.rotation @ part for part in (data.v.linear, data.v.angular)))
        )
    poses, linear, angular = map(np.array, zip(*rows, strict=True))
    return poses, np.hstack([linear, angular])


def _sample(solution: SolutionData, robot: Robot, rate: float | None) -> tuple[Array, Array, Array]:
    """Times [s], configurations and velocities."""
    nodes = solution.t
    if rate is None:
        return nodes, solution.qs, solution.vs
    if not (rate > 0.0 and solution.duration * rate <= _MOST_SAMPLES):
        raise InvalidValue("rate", rate, f"a positive number [1/s], and {_MOST_SAMPLES} samples at most")
    grid = np.arange(0.0, solution.duration - _SAME, 1.0 / rate)
    t = nodes[0] + np.append(grid, solution.duration)
    return t, *along_with_velocities(robot, nodes, solution.qs, solution.vs, t)


def _mcap(motion: MotionSamples) -> bytes:
    """Write topics /tf, /joint_states, /controls, and /path/FRAME once.

    MCAP with messages in JSON: poses as Foxglove has them, joints as `sensor_msgs/JointState`.
    """
    try:
        from mcap.writer import CompressionType, Writer
    except ImportError as error:
        raise InvalidValue.of_missing("mcap", error) from error
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.ZSTD)
    writer.start(profile="", library="mbocp")
    channels: dict[str, int] = {}
    times = [round(float(t) * 1e9) for t in motion.t]  # [ns]
    for n, topic, kind, message in _messages(motion, times):
        if topic not in channels:
            schema = json.dumps(_schema_of(message)).encode()
            number = writer.register_schema(name=kind, encoding="jsonschema", data=schema)
            channels[topic] = writer.register_channel(topic, message_encoding="json", schema_id=number)
        data = json.dumps(message, allow_nan=False).encode()
        writer.add_message(channels[topic], log_time=times[n], publish_time=times[n], data=data)
    writer.finish()
    return file.getvalue()


def _messages(motion: MotionSamples, times: list[int]) -> Iterator[tuple[int, str, str, Any]]:
    """Number of the sample, topic, name of the schema, and message."""
    stamps = [dict(zip(("sec", "nsec"), divmod(t, 1_000_000_000), strict=True)) for t in times]
    for name, poses in motion.paths.items():
        listed = [{"position": place, "orientation": turn} for place, turn in map(_pose, poses)]
        path = {"timestamp": stamps[0], "frame_id": _WORLD, "poses": listed}
        yield 0, f"/path/{name}", "foxglove.PosesInFrame", path
    for n, stamp in enumerate(stamps):
        transforms = []
        for name, poses in motion.links.items():
            place, turn = _pose(poses[n])
            frames = {"timestamp": stamp, "parent_frame_id": _WORLD, "child_frame_id": name}
            transforms.append({**frames, "translation": place, "rotation": turn})
        yield n, "/tf", "foxglove.FrameTransforms", {"transforms": transforms}
        header = {"header": {"stamp": stamp, "frame_id": ""}}
        values = {
            field: [float(joint[k][n]) for joint in motion.joints.values()] for k, field in enumerate(_FIELDS)
        }
        yield n, "/joint_states", "sensor_msgs/JointState", {**header, "name": [*motion.joints], **values}
        controls = {"name": [*motion.controls], "value": [float(u[n]) for u in motion.controls.values()]}
        yield n, "/controls", "mbocp.Controls", {**header, **controls}


def _pose(row: Array) -> tuple[dict[str, float], dict[str, float]]:
    place, turn = (map(float, part) for part in (row[:3], row[3:]))
    return dict(zip("xyz", place, strict=True)), dict(zip("xyzw", turn, strict=True))


def _schema_of(value: Any) -> dict[str, Any]:
    """JSON schema of a message, by its first one."""
    if isinstance(value, dict):
        return {"type": "object", "properties": {key: _schema_of(item) for key, item in value.items()}}
    if isinstance(value, list):
        return {"type": "array", "items": _schema_of(value[0]) if value else {}}
    if isinstance(value, str):
        return {"type": "string"}
    return {"type": "integer" if isinstance(value, int) else "number"}


def _rerun(motion: MotionSamples) -> bytes:
    """Write entities world/LINK, path/FRAME, joints/JOINT/position, ..., controls/NAME over "time".

    Rerun's .rrd: poses of links, paths, and a curve for each joint and control.
    """
    try:
        import rerun as rr
    except ImportError as error:
        raise InvalidValue.of_missing("rerun", error) from error
    recording = rr.RecordingStream("mbocp")
    memory = recording.memory_recording()
    times = [rr.TimeColumn("time", duration=motion.t)]

    def entity(*parts: str) -> str:
        return "/".join(map(rr.escape_entity_path_part, parts))

    for name, poses in motion.links.items():
        columns = rr.Transform3D.columns(translation=poses[:, :3], quaternion=poses[:, 3:])
        recording.send_columns(entity(_WORLD, name), times, columns)
    for name, poses in motion.paths.items():
        recording.log(entity("path", name), rr.LineStrips3D([poses[:, :3]]), static=True)
    curves = {
        entity("joints", name, field): values
        for name, joint in motion.joints.items()
        for field, values in zip(_FIELDS, joint, strict=True)
    }
    curves |= {entity("controls", name): values for name, values in motion.controls.items()}
    for path, values in curves.items():
        recording.send_columns(path, times, rr.Scalars.columns(scalars=values))
    recording.flush()
    return bytes(memory.drain_as_bytes())


def ros_duration(t: float) -> str:
    """Return a time [s] as builtin_interfaces/msg/Duration in YAML."""
    seconds, rest = divmod(round(float(t) * 1e9), 1_000_000_000)
    return f"{{sec: {seconds}, nanosec: {rest}}}"


def _multidof(motion: MotionSamples) -> bytes:
    """Write trajectory_msgs/msg/MultiDOFJointTrajectory as `ros2 topic pub` reads it, a point a time [ns]."""
    if not motion.bases:
        expected = "a joint of several velocities: a floating or planar base, or a ball"
        raise InvalidValue("format", SENT, expected)
    lines = [f"joint_names: {json.dumps([*motion.bases], ensure_ascii=False)}", "points:"]
    for n in points_of(motion).tolist():
        transforms, velocities = [], []
        for poses, rates in motion.bases.values():
            place, turn = _pose(poses[n])
            transforms.append({"translation": place, "rotation": turn})
            linear, angular = (dict(zip("xyz", part.tolist(), strict=True)) for part in np.split(rates[n], 2))
            velocities.append({"linear": linear, "angular": angular})
        lines += [
            f"- transforms: {json.dumps(transforms)}",
            f"  velocities: {json.dumps(velocities)}",
            f"  time_from_start: {ros_duration(motion.t[n])}",
        ]
    return ("\n".join(lines) + "\n").encode()


def points_of(motion: MotionSamples) -> IntArray:
    """Samples that are points of a message: the last of each time [ns]."""
    ns = np.round(1e9 * motion.t)
    return np.flatnonzero(np.append(np.diff(ns) > 0.0, True))


RECORDINGS: Mapping[str, Callable[[MotionSamples], bytes]] = MappingProxyType(
    {"mcap": _mcap, "rerun": _rerun, SENT: _multidof}
)
