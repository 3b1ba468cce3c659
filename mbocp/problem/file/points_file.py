"""Points of a path, and orientations there, from a file: a table of numbers in columns."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp._files import MEGABYTE, is_file, read_bytes, read_text
from mbocp._text import show
from mbocp.exceptions import ProblemError, Unreadable

_MAX_BYTES = 16 * MEGABYTE
_COLUMNS = "x, y, z, or x, y, z, qx, qy, qz, qw"


def read_points(path: Path, key: str) -> dict[str, Any]:
    """Keys `points` and perhaps `orientations` of a path that is followed.

    Parameters
    ----------
    path : Path
        A CSV table, with or without a row of names, or an array of NumPy's format .npy.
    key : str
        What messages call it.

    Raises
    ------
    ProblemError
        If there is no such file, or it holds no table of three or seven columns.
    """
    if not is_file(path):
        raise ProblemError(f"{key}: no such file {show(str(path))}")
    try:
        table = _array(path) if path.suffix.lower() == ".npy" else _table(path)
    except Unreadable as error:
        raise ProblemError(f"{key}: {path} {error.reason}") from error
    except (ValueError, csv.Error) as error:
        raise ProblemError(f"{key}: {path} holds no table of numbers ({error})") from error
    if table.ndim != 2 or table.shape[1] not in (3, 7):
        raise ProblemError(f"{key}: {path} is of shape {table.shape}, expected columns {_COLUMNS}")
    turns = {"orientations": table[:, 3:].tolist()} if table.shape[1] == 7 else {}
    return {"points": table[:, :3].tolist(), **turns}


def _table(path: Path) -> Array:
    rows = [
        row
        for row in csv.reader(read_text(path, expected="a CSV table", limit=_MAX_BYTES).splitlines())
        if row
    ]
    if rows and not _is_number(rows[0][0]):
        rows = rows[1:]
    return np.array([[float(entry) for entry in row] for row in rows])


def _array(path: Path) -> Array:
    read = read_bytes(path, expected="an array of NumPy", limit=_MAX_BYTES)
    return np.asarray(np.load(io.BytesIO(read), allow_pickle=False), dtype=np.float64)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
