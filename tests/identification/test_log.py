"""Logs are read from what tools write, and what is wrong with them is named."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from mbocp import load_robot
from mbocp.exceptions import InvalidValue, LogError
from mbocp.identification import Log, read_log, write_log
from tests.solution.test_recordings import a_motion

K = 60
T = np.arange(K) / 100.0


def table(**columns):
    names = list(columns)
    rows = [",".join(f"{columns[name][k]}" for name in names) for k in range(K)]
    return "\n".join([",".join(names), *rows, ""])


def read(tmp_path, text, name="log.csv"):
    (tmp_path / name).write_text(text)
    return read_log(tmp_path / name)


@pytest.mark.parametrize(
    "names",
    [
        ("t", "a.q", "a.tau"),
        ("time", "a.position", "a.effort"),
        ("t [s]", "q:a [rad]", "u:a [N m]"),
        ("__time", "/joint_states/a/position", "/joint_states/a/effort"),
    ],
)
def test_headers_of_tools(tmp_path, names):
    log = read(tmp_path, table(**dict(zip(names, (T, 2.0 * T, 3.0 * T), strict=True))))
    np.testing.assert_allclose(log.joints["a"]["q"], 2.0 * T)
    np.testing.assert_allclose(log.joints["a"]["tau"], 3.0 * T)


def test_joint_states_with_names_in_columns(tmp_path):
    columns = {
        "header.stamp.sec": [1700000000] * K,
        "header.stamp.nanosec": (1e7 * np.arange(K)).astype(int),
        "name[0]": ["arm/b"] * K,
        "position[0]": T,
        "effort[0]": T,
    }
    log = read(tmp_path, table(**columns))
    np.testing.assert_allclose(log.t, T)
    np.testing.assert_allclose(log.joints["arm/b"]["q"], T)


def test_units_behind_names(tmp_path):
    for unit, size in (("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        log = read(tmp_path, table(**{f"t [{unit}]": size * T, "a.q [deg]": T}))
        np.testing.assert_allclose(log.t, T)
    np.testing.assert_allclose(log.joints["a"]["q"], np.deg2rad(T))
    with pytest.raises(LogError, match="unit: got 'turns'"):
        read(tmp_path, table(**{"t": T, "a.q [turns]": T}))


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: "# " + text,
        lambda text: text.replace(",", ";"),
        lambda text: text.replace(",", "\t"),
    ],
)
def test_what_spreadsheets_and_numpy_write(tmp_path, change):
    text = table(**{"t": T, "a.q": 2.0 * T})
    np.testing.assert_allclose(read(tmp_path, change(text)).joints["a"]["q"], 2.0 * T)


def test_it_is_written_and_read_again(tmp_path):
    log = Log(T, {"a": {"q": np.sin(T), "current": T}, "b.c": {"v": T}})
    again = read_log(write_log(log, tmp_path / "log.csv"))
    for joint, columns in log.joints.items():
        for kind, values in columns.items():
            np.testing.assert_array_equal(again.joints[joint][kind], values)


def test_parquet(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    parquet.write_table(pa.table({"t": T, "a.q": T}), tmp_path / "log.parquet")
    np.testing.assert_array_equal(read_log(tmp_path / "log.parquet").joints["a"]["q"], T)


def messages(names=("a/b", "c"), effort=True, stamped=True):
    """JointState of each sample; a recorder that is 5 ms late."""
    for k, t in enumerate(T):
        sec, rest = divmod(1_700_000_000 * 10**9 + round(t * 1e9) if stamped else 0, 10**9)
        state = {"header": {"stamp": {"sec": sec, "nanosec": rest}, "frame_id": ""}, "name": list(names)}
        rates = {"velocity": [], "effort": [3.0 * t, 4.0 * t] if effort else []}
        yield (
            1_700_000_000 * 10**9 + round(t * 1e9) + 5_000_000 * (k % 2),
            {
                **state,
                "position": [t, 2.0 * t],
                **rates,
            },
        )


def ros2(path, states, topics=("/joint_states",)):
    writer = pytest.importorskip("mcap_ros2.writer").Writer(str(path))
    text = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
    line = "=" * 80
    text += f"{line}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    text += f"{line}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    schema = writer.register_msgdef("sensor_msgs/msg/JointState", text)
    for time, state in states:
        for topic in topics:
            writer.write_message(topic, schema, state, time, time)
    writer.finish()
    return path


def as_json(path, states, encoding="json"):
    writer = pytest.importorskip("mcap.writer").Writer(str(path))
    writer.start()
    schema = writer.register_schema("sensor_msgs/msg/JointState", "jsonschema", b"{}")
    channel = writer.register_channel("/state", encoding, schema)
    for time, state in states:
        writer.add_message(channel, time, json.dumps(state).encode(), time)
    writer.finish()
    return path


@pytest.mark.parametrize("write", [ros2, as_json])
def test_joint_states_in_mcap(tmp_path, write):
    log = read_log(write(tmp_path / "log.mcap", messages()))
    np.testing.assert_allclose(log.t, T, atol=1e-12)
    assert set(log.joints) == {"a/b", "c"}
    assert set(log.joints["c"]) == {"q", "tau"}
    np.testing.assert_array_equal(log.joints["c"]["tau"], 4.0 * T)
    late = read_log(write(tmp_path / "late.mcap", messages(stamped=False)))
    np.testing.assert_allclose(late.t, T + 0.005 * (np.arange(K) % 2), atol=1e-12)


def test_a_recording_of_ones_own_is_read(tmp_path):
    pytest.importorskip("mcap_ros2")
    robot = load_robot("double_pendulum")
    solution = a_motion(robot)
    log = read_log(solution.export(tmp_path / "motion.mcap", rate=100.0))
    for k, joint in enumerate(robot.joint_names):
        assert log.joints[joint]["q"][-1] == pytest.approx(solution.qs[-1, k])


def test_what_is_wrong_with_mcap_is_named(tmp_path):
    path, joints = tmp_path / "log.mcap", list(messages())
    with pytest.raises(LogError, match="JointState: got /a, /b, expected one, or /joint_states"):
        read_log(ros2(path, joints, ("/b", "/a")))
    with pytest.raises(LogError, match="messages JointState: got none"):
        read_log(ros2(path, []))
    with pytest.raises(LogError, match=r"joints of message [0-9]+: got c, d, expected .*, a/b, c"):
        read_log(ros2(path, [*joints, *messages(("c", "d"))]))
    with pytest.raises(LogError, match=r"a/b.effort: got 60 values, expected 120"):
        read_log(ros2(path, [*joints, *messages(effort=False)]))
    with pytest.raises(LogError, match="/state: encoding: got protobuf, schema in jsonschema"):
        read_log(as_json(path, joints, "protobuf"))
    with pytest.raises(LogError, match=r"no JointState: .* 'name'"):
        read_log(as_json(path, [(0, {"position": [1.0]})]))
    ros2(path, joints)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(LogError, match="is no whole MCAP file"):
        read_log(path)


@pytest.mark.parametrize(("extra", "module"), [("mcap", "mcap.reader"), ("parquet", "pyarrow")])
def test_packages_that_are_missing_are_named(tmp_path, monkeypatch, extra, module):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(LogError, match=rf"pip install 'mbocp\[{extra}\]'"):
        read(tmp_path, "", f"log.{extra}")


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"a.q": T}, "no column of times"),
        ({"t": T[::-1], "a.q": T}, "t: got .* in sample 1 after .* expected times that ascend: sort"),
        ({"t": 1e3 * T, "a.q": T}, r"t: got steps of 10 s, expected less than .* t \[ms\]"),
        ({"t": np.where(np.arange(K) > 30, T + 1.0, T), "a.q": T}, "a gap of 1.01 s after 0.3 s"),
        ({"t": T, "a.q": ["x", *T[1:]]}, "a.q: got .*x.* in sample 0, expected a number"),
        ({"t": T, "a.q": ["nan", *T[1:]]}, "a.q: got nan in sample 0, expected finite numbers"),
        ({"t": T, "a.q": T, "a.position": T}, "a.q: got another column"),
        ({"t": T, "position[0]": T}, "position 0 without a name"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, columns, words):
    with pytest.raises(LogError, match=words):
        read(tmp_path, table(**columns))


def test_files_that_are_none(tmp_path):
    with pytest.raises(LogError, match="no such file"):
        read_log(tmp_path / "none.csv")
    with pytest.raises(LogError, match="is empty"):
        read(tmp_path, "")
    with pytest.raises(LogError, match=r"at least 50"):
        read(tmp_path, "t,a.q\n0,0\n0.1,0\n")
    with pytest.raises(LogError, match=r"row 2.*got 1 values, expected 2"):
        read(tmp_path, "t,a.q\n0\n")
    with pytest.raises(InvalidValue, match=r'"q" \| "v"'):
        Log(T, {"a": {"speed": T}})
