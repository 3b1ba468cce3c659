"""Logs of robots: what was measured, by joint, from CSV, Parquet and MCAP."""

from __future__ import annotations

import csv
import io
import json
import re
import struct
from collections.abc import Mapping, Sequence
from math import pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp._files import read_bytes, read_text
from mbocp._text import find_repeated, show
from mbocp.exceptions import InvalidValue, LogError, Unreadable
from mbocp.solution.atomic import csv_of, replace_file

_KINDS = {
    "q": ("q", "position", "pos"),
    "v": ("v", "velocity", "vel", "qd"),
    "a": ("a", "acceleration", "acc", "qdd"),
    "tau": ("tau", "torque", "effort", "u"),
    "current": ("current", "i"),
}
_KIND = {word: kind for kind, words in _KINDS.items() for word in words}
_TIMES = ("t", "time", "__time", "timestamp", "header.stamp")
_UNITS = {
    **dict.fromkeys(("", "s", "rad", "m", "rad/s", "m/s", "rad/s^2", "m/s^2", "N m", "Nm", "N", "A"), 1.0),
    **dict.fromkeys(("deg", "deg/s", "deg/s^2"), pi / 180.0),
    **dict.fromkeys(("ms", "mm", "mm/s", "mA"), 1e-3),
    "us": 1e-6,
    "ns": 1e-9,
}
_JOINT_STATES = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
_TOPIC = "/joint_states"
_SHORTEST = 50  # samples
_GAP = 5.0  # median time steps
_SLOWEST = 0.5  # [s] time step; samples at 2 kHz are as far apart in milliseconds
_LIMIT = 2_000_000_000  # [bytes] of a file


@dataclass(frozen=True, eq=False)
class Log:
    """Measurements at K times.

    Parameters
    ----------
    t : ndarray, shape (K,)
        Ascending [s].
    joints : mapping of str to mapping of str to ndarray of shape (K,)
        By joint: ``"q"`` position [rad, m], ``"v"`` velocity, ``"a"`` acceleration, ``"tau"`` torque [N m, N]
        or ``"current"`` [A].
    source : str
        What messages call it.

    Raises
    ------
    InvalidValue
        For times that do not ascend, gaps, slow or few samples, numbers that are not finite, unknown kinds.
    """

    t: Array
    joints: Mapping[str, Mapping[str, Array]]
    source: str = "log"

    def __repr__(self) -> str:
        return f"<Log {self.source}: {len(self.t)} samples of {', '.join(self.joints)}>"

    def __post_init__(self) -> None:
        where = f"{self.source}: t"
        t = frozen_array(self.t, shape=(None,), name=where)
        if len(t) < _SHORTEST:
            raise InvalidValue(where, f"{len(t)} samples", f"at least {_SHORTEST}")
        self._refuse_not_finite("t", t)
        steps = np.diff(t)
        k, usual = int(steps.argmin()), float(np.median(steps))
        if steps[k] <= 0.0:
            words = f"{t[k + 1]:.9g} in sample {k + 1} after {t[k]:.9g}"
            raise InvalidValue(where, words, "times that ascend: sort the rows, each time once")
        if usual >= _SLOWEST:
            expected = f"less than {_SLOWEST} s, or a unit behind the name, as in t [ms]"
            raise InvalidValue(where, f"steps of {usual:.4g} s", expected)
        k = int(steps.argmax())
        if steps[k] > _GAP * usual:
            words = f"a gap of {steps[k]:.4g} s after {t[k]:.6g} s"
            raise InvalidValue(where, words, "no gap: cut the log there")
        kept: dict[str, dict[str, Array]] = {}
        for joint, columns in self.joints.items():
            for kind, values in columns.items():
                if kind not in _KINDS:
                    raise InvalidValue.of_choice(f"{self.source}: {joint}", kind, tuple(_KINDS))
                column = frozen_array(values, shape=(len(t),), name=f"{self.source}: {joint}.{kind}")
                self._refuse_not_finite(f"{joint}.{kind}", column)
                kept.setdefault(joint, {})[kind] = column
        object.__setattr__(self, "t", t)
        object.__setattr__(self, "joints", kept)

    def _refuse_not_finite(self, name: str, values: Array) -> None:
        if not np.isfinite(values).all():
            k = int(np.argmin(np.isfinite(values)))
            raise InvalidValue(f"{self.source}: {name}", f"{values[k]} in sample {k}", "finite numbers")


def read_log(path: str | Path) -> Log:
    """Read a log from CSV, Parquet or MCAP.

    MCAP has messages JointState in ROS 2's encoding or in JSON. Columns of the others are ``t`` [s], and by
    joint ``JOINT.q``, ``.v``, ``.a``, ``.tau``, ``.current``, or position, velocity, acceleration, torque,
    effort in place of these letters; what `mbocp export` writes; or JointState messages of ROS 2 as tools
    write them, ``/joint_states/JOINT/position``, or ``name[0]`` beside ``position[0]``. A unit may stand in
    brackets behind a name, ``JOINT.q [deg]``.

    Raises
    ------
    LogError
        If the file cannot be read, or for a wrong column or number, naming it.
    """
    path = Path(path)
    try:
        read = {".parquet": _read_parquet, ".mcap": _read_mcap}.get(path.suffix.lower(), _read_csv)
        columns = read(path)
        t = _times(columns)
        joints = _by_joint(columns)
        return Log(t, joints, path.name)
    except Unreadable as error:
        raise LogError(path, error.reason) from error
    except InvalidValue as error:
        raise LogError(path, str(error).removeprefix(f"{path.name}: ")) from error


def write_log(log: Log, path: str | Path) -> Path:
    """Write a log as CSV, as `read_log` takes it.

    Raises
    ------
    ResultFileError
        If it cannot be written.
    """
    columns = {"t": log.t}
    columns |= {
        f"{joint}.{kind}": values for joint, kinds in log.joints.items() for kind, values in kinds.items()
    }
    return replace_file(path, csv_of(columns, np.column_stack(list(columns.values())).tolist()))


def _read_csv(path: Path) -> dict[str, Sequence[Any]]:
    text = read_text(path, expected="a log (CSV)", limit=_LIMIT)
    text = text.lstrip("\ufeff#")  # what Excel and NumPy write before a header
    separator = max(",;\t", key=text.partition("\n")[0].count)
    rows = [row for row in csv.reader(io.StringIO(text), delimiter=separator) if row]
    if not rows:
        raise Unreadable("is empty, expected a log (CSV) with a header")
    header = [name.strip() for name in rows[0]]
    if repeated := find_repeated(header):
        raise InvalidValue("header", f"{show(repeated[0])} twice", "each column once")
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise InvalidValue(f"row {number}", f"{len(row)} values", f"{len(header)}, as in the header")
    values = list(zip(*rows[1:], strict=True)) or [()] * len(header)
    return dict(zip(header, values, strict=True))


def _read_parquet(path: Path) -> dict[str, Sequence[Any]]:
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise InvalidValue.of_missing("parquet", error) from error
    try:
        table = parquet.read_table(io.BytesIO(read_bytes(path, expected="a log (Parquet)", limit=_LIMIT)))
    except pyarrow.ArrowInvalid as error:
        raise Unreadable(f"is no Parquet file: {error}") from error
    return {name: table[name].to_pylist() for name in table.column_names}


def _read_mcap(path: Path) -> dict[str, Sequence[Any]]:
    """Columns of the messages JointState, which are in one topic or in /joint_states."""
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise InvalidValue.of_missing("mcap", error) from error
    content = io.BytesIO(read_bytes(path, expected="a log (MCAP)", limit=_LIMIT))
    topics: dict[str, list[tuple[int, Any]]] = {}
    ros2 = DecoderFactory()
    try:
        for schema, channel, message in make_reader(content).iter_messages():
            if schema is None or schema.name not in _JOINT_STATES:
                continue
            if channel.message_encoding == "json":
                state = json.loads(message.data, object_hook=lambda fields: SimpleNamespace(**fields))
            elif decode := ros2.decoder_for(channel.message_encoding, schema):
                state = decode(message.data)
            else:
                words = f"{channel.message_encoding}, schema in {schema.encoding}"
                raise InvalidValue(
                    f"{channel.topic}: encoding", words, "json, or cdr with a schema in ros2msg"
                )
            topics.setdefault(channel.topic, []).append((message.log_time, state))
    except (McapError, ValueError, IndexError, struct.error) as error:
        raise Unreadable(f"is no whole MCAP file with messages JointState: {error}") from error
    topic = _TOPIC if _TOPIC in topics else "".join(topics)
    if topic not in topics:
        found = ", ".join(sorted(topics)) or "none"
        raise InvalidValue("topics with messages JointState", found, f"one, or {_TOPIC} among them")
    try:
        return _columns_of(topic, topics[topic])
    except (AttributeError, TypeError) as error:
        raise Unreadable(f"has messages that are no JointState: {error}") from error


def _columns_of(topic: str, messages: Sequence[tuple[int, Any]]) -> dict[str, Sequence[Any]]:
    """Columns of messages; times are those of their headers, or of the recorder where these have none."""
    first, columns = sorted(messages[0][1].name), dict[str, list[Any]]()
    for k, (_, state) in enumerate(messages):
        if sorted(state.name) != first:
            where = f"{topic}: joints of message {k}"
            raise InvalidValue(where, ", ".join(state.name), f"those of the first, {', '.join(first)}")
        for field in ("position", "velocity", "effort"):
            for name, value in zip(state.name, getattr(state, field, ()), strict=False):
                columns.setdefault(f"{name}.{field}", []).append(value)
    for column, values in columns.items():
        if len(values) != len(messages):
            raise InvalidValue(
                f"{topic}: {column}", f"{len(values)} values", f"{len(messages)}, one a message"
            )
    stamps = [state.header.stamp for _, state in messages]
    times = [10**9 * at.sec + (at.nsec if hasattr(at, "nsec") else at.nanosec) for at in stamps]
    if not any(times):
        times = [time for time, _ in messages]
    return {"t": [1e-9 * (time - times[0]) for time in times], **columns}


def _numbers(name: str, values: Sequence[Any]) -> Array:
    name, unit = _split_unit(name)
    if unit not in _UNITS:
        raise InvalidValue.of_choice(f"{name}: unit", unit, [each for each in _UNITS if each])
    try:
        return np.array(values, dtype=np.float64) * _UNITS[unit]
    except (TypeError, ValueError):
        for k, value in enumerate(values):
            try:
                float(value)
            except (TypeError, ValueError):
                raise InvalidValue(name, f"{show(value)} in sample {k}", "a number") from None
        raise


def _split_unit(name: str) -> tuple[str, str]:
    found = re.fullmatch(r"(.*\S)\s+\[([^\]]*)\]", name)
    return (found[1], found[2]) if found else (name, "")


def _times(columns: Mapping[str, Sequence[Any]]) -> Array:
    for name in columns:
        if _split_unit(name)[0].lower() in _TIMES:
            t = _numbers(name, columns[name])
            break
    else:
        parts = {name.rpartition(".")[2]: name for name in columns if ".stamp." in f".{name}"}
        if not {"sec", "nanosec"} <= set(parts):
            raise InvalidValue("header", "no column of times", f"one of {', '.join(_TIMES[:3])}")
        seconds = _numbers(parts["sec"], columns[parts["sec"]])
        t = seconds - seconds[0] + 1e-9 * _numbers(parts["nanosec"], columns[parts["nanosec"]])
    return t - t[0] if len(t) else t


def _by_joint(columns: Mapping[str, Sequence[Any]]) -> dict[str, dict[str, Array]]:
    found: dict[str, dict[str, Array]] = {}
    for column, values in columns.items():
        plain = _split_unit(column)[0]
        indexed = re.fullmatch(r"(?:.*[./])?(position|velocity|effort)[\[_.](\d+)\]?", plain)
        if indexed:
            joint, kind = _name_of(columns, indexed[2]), _KIND[indexed[1]]
        elif re.match(r"[qvau]:", plain):  # as `mbocp export` writes them
            joint, kind = plain[2:], _KIND[plain[0]]
        else:
            before, _, word = plain.replace("/", ".").rpartition(".")
            if word.lower() not in _KIND or not before:
                continue
            joint = plain[: -len(word) - 1]
            joint, kind = joint.rpartition("/")[2] if joint.startswith("/") else joint, _KIND[word.lower()]
        if kind in found.setdefault(joint, {}):
            raise InvalidValue(f"{joint}.{kind}", f"another column for it, {show(column)}", "one")
        found[joint][kind] = _numbers(column, values)
    return found


def _name_of(columns: Mapping[str, Sequence[Any]], number: str) -> str:
    for column, values in columns.items():
        if re.fullmatch(rf"(?:.*[./])?name[\[_.]{number}\]?", column):
            names = set(values)
            if len(names) != 1:
                raise InvalidValue(column, f"{len(names)} names", "the same joint in all samples")
            return str(names.pop())
    raise InvalidValue("header", f"position {number} without a name", f"a column name[{number}]")
