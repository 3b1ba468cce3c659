"""The HDF5 part of a result file: it says of every number what it is and in which unit.

    /                  attributes: format, format_version, description
    /summary           attributes: status, cost, residual, ..., one number or text each
    /trajectories/*    one dataset each; attributes: description, symbol, rows, columns, units
    /text/*            JSON (history, phases, options, versions, robot) and the problem file as it was solved

It is made and read in memory: HDF5 never sees a disk, let alone a full one. What is read has the kinds that
are expected, holds no links into other files, and no more numbers than there are bytes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mbocp.exceptions import ResultFileError
from mbocp.storage.content import ITERATE, QUANTITIES, FileContent
from mbocp.storage.seal import FORMAT_VERSION, LARGEST, SEAL_SIZE, newer_words

FORMAT = "mbocp solution"
_EVERY = {**QUANTITIES, **ITERATE}
_ROBOT, _LIST, _CONTENTS = "robot", "list", "contents"  # group of the robot's files, and what is in it

# What h5py raises where an image is damaged or somebody else's.
_FOREIGN = (
    OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, RecursionError, MemoryError
)  # fmt: skip


def image_of(content: FileContent) -> bytes:
    """Write an HDF5 image, to be put behind a user block of 512 bytes."""
    # Attributes of more than 64 kB, the names of very many columns, need what came with HDF5 1.8.
    with h5py.File(
        "result", "w", driver="core", backing_store=False, userblock_size=SEAL_SIZE, libver=("v108", "v108")
    ) as file:
        _write(file, content)
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def _write(file: h5py.File, content: FileContent) -> None:
    file.attrs["format"] = FORMAT
    file.attrs["format_version"] = FORMAT_VERSION
    file.attrs["description"] = "Solution of an optimal control problem of a multibody system, by mbocp"
    summary = file.create_group("summary")
    for name, value in content.summary.items():
        summary.attrs[name] = value
    group = file.create_group("trajectories")
    for name, array in content.arrays.items():
        entry, columns = _EVERY[name], content.columns[name]
        data = group.create_dataset(name, data=array)
        data.attrs["symbol"], data.attrs["description"] = entry.symbol, entry.description
        data.attrs["rows"] = entry.rows
        data.attrs["columns"] = _strings(name for name, _ in columns)
        data.attrs["units"] = _strings(unit for _, unit in columns)
        if name in content.meanings:
            data.attrs["meanings"] = _strings(content.meanings[name])
    text = file.create_group("text")
    for name, structure in content.structures.items():
        _write_text(text, name, json.dumps(_pack(structure), allow_nan=False), "JSON")
    for name, words in content.texts.items():
        _write_text(text, name, words, "plain text")
    if content.robot_list is not None:
        _write_robot(file.create_group(_ROBOT), content.robot_list, content.robot_contents)


def _write_robot(group: h5py.Group, listed: Mapping[str, Any], contents: Mapping[str, bytes]) -> None:
    """The robot's files, each content once, by the SHA-256 of what it unfolds to."""
    group.attrs["description"] = "files of the robot: what they are, and their contents, zlib by SHA-256"
    _write_text(group, _LIST, json.dumps(_pack(listed), allow_nan=False), "JSON")
    files = group.create_group(_CONTENTS)
    for digest, content in contents.items():
        files.create_dataset(digest, data=np.frombuffer(content, dtype=np.uint8))


def _write_text(group: h5py.Group, name: str, words: str, kind: str) -> None:
    # Bytes, because HDF5 strings end at the first NUL.
    dataset = group.create_dataset(name, data=np.frombuffer(words.encode(), dtype=np.uint8))
    dataset.attrs["description"] = f"{name.replace('_', ' ')}: UTF-8 bytes of {kind}"


def _strings(values: Iterable[str]) -> Any:
    return np.array(list(values), dtype=h5py.string_dtype())


def content_of(path: str | Path, image: bytes | memoryview, *, is_sealed: bool = True) -> FileContent:
    """Read an HDF5 image.

    Parameters
    ----------
    path : str or Path
        What the file is called in errors.
    image : bytes
        Without the user block.
    is_sealed : bool
        Whether it stood behind a digest, as all do since format 3. What mbocp wrote unfolds to no more bytes
        than it has, for HDF5 compresses nothing in it; what had no digest may have been packed since.

    Raises
    ------
    ResultFileError
        If it is no result of mbocp, its parts are missing or of another kind, or a newer mbocp wrote it.
    """
    try:
        with h5py.File(h5py.h5f.open_file_image(bytes(image))) as file:
            _check_format(path, file, is_sealed=is_sealed)
            return _read(path, file, len(image) if is_sealed else LARGEST)
    except _FOREIGN as error:
        words = str(error).strip().partition("\n")[0] or type(error).__name__
        raise ResultFileError(
            path, f"is damaged or incomplete ({words}); solve again, or take a copy of it"
        ) from error


def _check_format(path: str | Path, file: h5py.File, *, is_sealed: bool) -> None:
    if "format" not in file.attrs or _attribute(file, "format") != FORMAT:
        raise ResultFileError(
            path, "is HDF5, but not a result file of mbocp; give a file that `mbocp solve -o` wrote"
        )
    version = _attribute(file, "format_version")
    if not isinstance(version, int) or version < 1 or (is_sealed and version != FORMAT_VERSION):
        raise ValueError(f"format_version is {version!r}")
    if version > FORMAT_VERSION:
        raise ResultFileError(path, newer_words(version))
    if version == FORMAT_VERSION and not is_sealed:
        raise ResultFileError(
            path, "has lost its first 512 bytes, with the digest in them; take a copy of the file, unchanged"
        )


def _read_words(words: Mapping[str, h5py.Dataset]) -> tuple[dict[str, Any], dict[str, str]]:
    """Values that are written as JSON, and other texts."""
    structures: dict[str, Any] = {}
    texts: dict[str, str] = {}
    for name, dataset in words.items():
        written = dataset[()].tobytes().decode()
        if _text(dataset, "description").endswith("JSON"):
            structures[name] = _unpack(json.loads(written))
        else:
            texts[name] = written
    return structures, texts


def _read(path: str | Path, file: h5py.File, largest: int) -> FileContent:
    group, text = _member(file, "trajectories", h5py.Group), _member(file, "text", h5py.Group)
    names = [name for name, entry in _EVERY.items() if name in group or not entry.may_lack]
    data = {name: _dataset(group, name, np.float64) for name in names}
    words = {name: _dataset(text, name, np.uint8) for name in text}
    robot, contents = _robot_of(file)
    _check_sizes(path, [*data.items(), *words.items(), *robot.items(), *contents.items()], largest)
    structures, texts = _read_words(words)
    summary = _member(file, "summary", h5py.Group)
    return FileContent(
        arrays={name: dataset[()] for name, dataset in data.items()},
        columns={name: _columns(dataset) for name, dataset in data.items()},
        summary={name: _attribute(summary, name) for name in summary.attrs},
        structures=structures,
        texts=texts,
        meanings={name: _meanings(dataset) for name, dataset in data.items()},
        robot_list=_list(robot[_LIST]) if robot else None,
        robot_contents={name: dataset[()].tobytes() for name, dataset in contents.items()},
    )


def _check_sizes(path: str | Path, every: Sequence[tuple[str, h5py.Dataset]], largest: int) -> None:
    """Refuse what a file declares and cannot hold."""
    declared = sum(dataset.nbytes for _, dataset in every)
    if declared > largest:
        raise ResultFileError(path, f"is damaged: it declares {declared} bytes, and {largest} are possible")
    for name, dataset in every:
        _check_written(name, dataset)


def _columns(dataset: h5py.Dataset) -> tuple[tuple[str, str], ...]:
    return tuple(zip(_texts(dataset, "columns"), _texts(dataset, "units"), strict=True))


def _meanings(dataset: h5py.Dataset) -> tuple[str, ...]:
    """What columns mean; files of 0.1.0 do not say it."""
    return _texts(dataset, "meanings") if "meanings" in dataset.attrs else ()


def _robot_of(file: h5py.File) -> tuple[dict[str, h5py.Dataset], dict[str, h5py.Dataset]]:
    """The list of the robot's files, and their contents; nothing in files that do not hold a robot."""
    if _ROBOT not in file:
        return {}, {}
    group = _member(file, _ROBOT, h5py.Group)
    files = _member(group, _CONTENTS, h5py.Group)
    return (
        {_LIST: _dataset(group, _LIST, np.uint8)},
        {name: _dataset(files, name, np.uint8) for name in files},
    )


def _list(dataset: h5py.Dataset) -> dict[str, Any]:
    listed = _unpack(json.loads(dataset[()].tobytes().decode()))
    if not isinstance(listed, dict):
        raise ValueError("the list of the robot's files is no table")
    return listed


def _member(group: h5py.Group, name: str, kind: type) -> Any:
    """A group or dataset of this file; links to other places and files are not followed."""
    link = group.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        raise ValueError(f"{name} is {'missing' if link is None else 'a link'}")
    member = group[name]
    if not isinstance(member, kind):
        raise ValueError(f"{name} is no {kind.__name__.lower()}")
    return member


def _dataset(group: h5py.Group, name: str, dtype: type[np.generic]) -> h5py.Dataset:
    data = _member(group, name, h5py.Dataset)
    if data.shape is None or data.dtype != dtype:
        raise ValueError(f"{name} is not of {np.dtype(dtype).name}")
    if data.external is not None or data.is_virtual:
        raise ValueError(f"{name} is stored in another file")
    return data


def _check_written(name: str, data: h5py.Dataset) -> None:
    """Refuse values that are declared and stand nowhere: HDF5 would fill the memory with zeros for them."""
    stored = data.id.get_storage_size()
    is_packed = data.id.get_create_plist().get_nfilters() > 0
    if stored * (_MAX_COMPRESSION if is_packed else 1) < data.nbytes:
        raise ValueError(f"{name} declares {data.nbytes} bytes, and {stored} were written")


_MAX_ATTRIBUTE_BYTES = 1 << 24  # [bytes] an attribute
_MAX_COMPRESSION = 1100  # bytes that one may unfold to: deflate's limit is 1032


def _attribute(item: h5py.Group | h5py.Dataset, name: str) -> Any:
    """A number, a text, or a tuple of texts."""
    stored = item.attrs.get_id(name)
    if math.prod(stored.shape or ()) * stored.dtype.itemsize > _MAX_ATTRIBUTE_BYTES:
        raise ValueError(f"attribute {name} is too long")
    value = item.attrs[name]
    if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind == "O":
        texts = tuple(value.tolist())
        if all(isinstance(text, str) for text in texts):
            return tuple(_as_utf8(text) for text in texts)
    value = value.item() if isinstance(value, np.generic) else value
    if not isinstance(value, (int, float, str)):
        raise ValueError(f"attribute {name} is neither a number nor text")
    return _as_utf8(value) if isinstance(value, str) else value


def _as_utf8(text: str) -> str:
    text.encode()  # raises where the bytes are no UTF-8
    return text


def _text(item: h5py.Dataset, name: str) -> str:
    value = _attribute(item, name)
    if not isinstance(value, str):
        raise ValueError(f"attribute {name} is no text")
    return value


def _texts(item: h5py.Dataset, name: str) -> tuple[str, ...]:
    value = _attribute(item, name)
    if not isinstance(value, tuple):
        raise ValueError(f"attribute {name} is no list of texts")
    return value


# JSON has no NaN and no infinity: they travel as {"__float__": "nan"}.
def _pack(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return {"__float__": repr(float(value))}  # a float of NumPy writes its type, too
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
