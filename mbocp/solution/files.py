"""The result file: one HDF5 file that says of every number what it is and in which unit.

Layout, format 2 (format 1 has no limits, drift and integrator):

    /                  attributes: format, format_version, description
    /summary           attributes: status, cost, residual, ..., one number or text each
    /trajectories/*    one dataset each; attributes: description, symbol, rows, columns, units
    /text/*            JSON (history, phases, options, versions, robot) and the problem file as it was solved

Datasets carry a checksum, so that a damaged file is an error and never a wrong number.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import ResultFileError
from mbocp.solution.atomic import atomic_path
from mbocp.solution.records import Column

__all__ = ["FORMAT", "FORMAT_VERSION", "FileContent", "read_content", "write_content"]

FORMAT = "mbocp solution"
FORMAT_VERSION = 2


class _Entry(NamedTuple):
    symbol: str
    description: str
    rows: str


_NODES = "nodes n = 0..N"
_STEPS = "steps n -> n+1, n = 0..N-1"
_SIDES = "lower, upper"

_ENTRIES: dict[str, _Entry] = {
    "t": _Entry("t", "time of the nodes", _NODES),
    "qs": _Entry("q", "configuration", _NODES),
    "vs": _Entry("v", "velocity in the tangent space of the joints", _NODES),
    "ps": _Entry("p", "momentum M(q) v", _NODES),
    "us": _Entry("u", "control, constant over its step", _STEPS),
    "lams": _Entry("lambda", "multiplier of the holonomic constraints in the step", _STEPS),
    "mus": _Entry("mu", "adjoint of the state: first of q, then of p", _NODES),
    "zetas": _Entry("zeta", "adjoint of the holonomic constraints", _STEPS),
    "eta": _Entry("eta", "multiplier of the exact end condition", "end conditions"),
    "control_hamiltonians": _Entry("H", "control Hamiltonian, eq. (11)", _STEPS),
    "control_momenta": _Entry("xi", "control momentum, eq. (15), one column a symmetry", _NODES),
}
_OPTIONAL: dict[str, _Entry] = {
    "manifold_drifts": _Entry("d", "distance of the rotations from their manifold", _NODES),
    "lam_us": _Entry("lambda_u", "multiplier of the limits of u: positive at an upper one", _STEPS),
    "lam_qs": _Entry("lambda_q", "multiplier of the limits of q: positive at an upper one", _NODES),
    "lam_vs": _Entry("lambda_v", "multiplier of the limits of v: positive at an upper one", _NODES),
    "lam_path": _Entry("lambda_h", "multiplier of the path constraints", "nodes n = 1..N"),
    "limits_u": _Entry("u_min, u_max", "limits of the control", _SIDES),
    "limits_v": _Entry("v_min, v_max", "limits of the velocity", _SIDES),
    "limits_q": _Entry("q_min, q_max", "limits of the configuration", _SIDES),
}


class FileContent(NamedTuple):
    """What goes into a result file and comes back.

    Arrays and their columns, values, structures, texts; and for some arrays a line on each column.
    """

    arrays: Mapping[str, Array]
    columns: Mapping[str, tuple[Column, ...]]
    summary: Mapping[str, str | int | float]
    structures: Mapping[str, Any]
    texts: Mapping[str, str]
    meanings: Mapping[str, tuple[str, ...]]


def write_content(path: str | Path, content: FileContent) -> Path:
    """Write a result file; an interrupted write leaves the old file whole.

    Raises
    ------
    ResultFileError
        If the file cannot be written.
    """
    with atomic_path(path) as temporary:
        try:
            with h5py.File(temporary, "w") as file:
                _write(file, content)
        except RuntimeError as error:  # how HDF5 reports a full disk when it closes a file
            raise ResultFileError(path, f"cannot be written: {error}") from error
    return Path(path)


def _write(file: h5py.File, content: FileContent) -> None:
    file.attrs["format"] = FORMAT
    file.attrs["format_version"] = FORMAT_VERSION
    file.attrs["description"] = "Solution of an optimal control problem of a multibody system, by mbocp"
    summary = file.create_group("summary")
    for name, value in content.summary.items():
        summary.attrs[name] = value
    group = file.create_group("trajectories")
    for name, array in content.arrays.items():
        entry, columns = (_ENTRIES | _OPTIONAL)[name], content.columns[name]
        # fletcher32: a checksum for each chunk; an empty dataset has no chunks.
        data = group.create_dataset(name, data=array, fletcher32=array.size > 0)
        data.attrs["symbol"], data.attrs["description"], data.attrs["rows"] = entry
        data.attrs["columns"] = _strings([c.name for c in columns])
        data.attrs["units"] = _strings([c.unit for c in columns])
        if name in content.meanings:
            data.attrs["meanings"] = _strings(list(content.meanings[name]))
    text = file.create_group("text")
    for name, structure in content.structures.items():
        _write_text(text, name, json.dumps(_pack(structure), allow_nan=False), "JSON")
    for name, words in content.texts.items():
        _write_text(text, name, words, "plain text")


def _write_text(group: h5py.Group, name: str, words: str, kind: str) -> None:
    # Bytes, for the checksum and because HDF5 strings end at the first NUL.
    data = np.frombuffer(words.encode(), dtype=np.uint8)
    dataset = group.create_dataset(name, data=data, fletcher32=data.size > 0)
    dataset.attrs["description"] = f"{name.replace('_', ' ')}: UTF-8 bytes of {kind}"


def _strings(values: list[str]) -> Any:
    return np.array(values, dtype=h5py.string_dtype())


def read_content(path: str | Path) -> FileContent:
    """Read a result file.

    Raises
    ------
    ResultFileError
        If there is no such file, it is not a result of mbocp, it is damaged, or a newer mbocp wrote it.
    """
    source = Path(path).expanduser()
    if not source.exists():
        raise ResultFileError(path, "no such file")
    if source.is_dir():
        raise ResultFileError(path, "is a folder: give the name of a result file")
    try:
        with h5py.File(source, "r") as file:
            _check_format(path, file)
            return _read(file)
    except PermissionError as error:
        raise ResultFileError(path, "cannot be read: permission denied") from error
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise ResultFileError(path, _diagnosis(source, error)) from error


def _diagnosis(source: Path, error: Exception) -> str:
    signature = b"\x89HDF\r\n\x1a\n"
    with source.open("rb") as file:
        is_hdf5 = file.read(len(signature)) == signature
    if not is_hdf5:
        return "is not a result file of mbocp (not even HDF5); give a file that `mbocp solve -o` wrote"
    return f"is damaged or incomplete ({error}); solve again, or take a copy of it"


def _check_format(path: str | Path, file: h5py.File) -> None:
    if file.attrs.get("format") != FORMAT:
        raise ResultFileError(
            path, "is HDF5, but not a result file of mbocp; give a file that `mbocp solve -o` wrote"
        )
    version = int(file.attrs["format_version"])
    if version > FORMAT_VERSION:
        raise ResultFileError(
            path,
            f"has format {version}, written by a newer mbocp; this one reads up to {FORMAT_VERSION}: upgrade",
        )


def _read(file: h5py.File) -> FileContent:
    arrays: dict[str, Array] = {}
    columns: dict[str, tuple[Column, ...]] = {}
    meanings: dict[str, tuple[str, ...]] = {}
    for name in (*_ENTRIES, *(name for name in _OPTIONAL if name in file["trajectories"])):
        data = file["trajectories"][name]
        arrays[name] = data[()]
        names, units = (data.attrs[key] for key in ("columns", "units"))
        columns[name] = tuple(Column(str(n), str(u)) for n, u in zip(names, units, strict=True))
        meanings[name] = tuple(map(str, data.attrs.get("meanings", ())))  # files of 0.1.0 have none
    structures: dict[str, Any] = {}
    texts: dict[str, str] = {}
    for name, data in file["text"].items():
        words = data[()].tobytes().decode()
        if str(data.attrs["description"]).endswith("JSON"):
            structures[name] = _unpack(json.loads(words))
        else:
            texts[name] = words
    summary = {name: _plain(value) for name, value in file["summary"].attrs.items()}
    return FileContent(arrays, columns, summary, structures, texts, meanings)


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


# JSON has no NaN and no infinity: they travel as {"__float__": "nan"}.
def _pack(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return {"__float__": repr(value)}
    if isinstance(value, Mapping):
        return {key: _pack(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_pack(v) for v in value]
    return value


def _unpack(value: Any) -> Any:
    if isinstance(value, dict):
        if value.keys() == {"__float__"}:
            return float(value["__float__"])
        return {key: _unpack(v) for key, v in value.items()}
    return [_unpack(v) for v in value] if isinstance(value, list) else value
