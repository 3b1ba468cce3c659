"""Logs are read from what tools write, and what is wrong with them is named."""

from __future__ import annotations

import numpy as np
import pytest

from mbocp.exceptions import InvalidValue, LogError
from mbocp.identification import Log, read_log, write_log

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
    log = read(tmp_path, table(**{"t [ms]": 1e3 * T, "a.q [deg]": T}))
    np.testing.assert_allclose(log.t, T)
    np.testing.assert_allclose(log.joints["a"]["q"], np.deg2rad(T))
    with pytest.raises(LogError, match="unit: got 'turns'"):
        read(tmp_path, table(**{"t": T, "a.q [turns]": T}))


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


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"a.q": T}, "no column of times"),
        ({"t": T[::-1], "a.q": T}, "t: got .* in sample 1 after .* expected times that ascend"),
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
