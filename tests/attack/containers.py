"""Mutations of result files: bits anywhere, and the structure of HDF5 and of the texts in it."""

from __future__ import annotations

import io
import json
from random import Random
from typing import Any

import h5py
import numpy as np

from mbocp.storage.seal import SEAL_SIZE, is_sealed, seal

from .raw import EXTREMES, mutate_bytes, mutate_lines
from .trees import mutate_tree

__all__ = ["mutate_result"]

_HUGE = 10**9  # rows that are declared and never written
_VALUES: tuple[Any, ...] = (
    *(0, -1, 1e308, np.nan, np.inf, 2**62, True, "x", b"\xff", "", np.array([]), np.zeros((2, 2)), 1j),
    *(np.array(["a", "b"], dtype=object), np.uint8(255), "converged", "x" * 60_000, h5py.Empty("f8")),
)
_SHAPES = ((), (0,), (1,), (0, 3), (3, 0), (2, 2, 2), (21, 3), (5,), (1, 1, 1, 1))
_TYPES = ("f8", "f4", "i8", "u1", "c16", "S3", "?", ">f8", "f2", [("a", "f8"), ("b", "i4")])
_TEXTS = (
    *(
        "",
        "{}",
        "[]",
        "null",
        "[1]",
        "NaN",
        "1e999",
        '{"a": 1, "a": 2}',
        "[" * 200_000,
        "9" * 5000,
        "x",
        "\x00",
    ),
    *(
        '{"__float__": "x"}',
        '{"__float__": 1}',
        '[{"name": 1}]',
        '[{"__float__": "nan"}]',
        "[[[[[[]]]]]]",
        "1e400",
    ),
    *(
        "limits = 3",
        "robot = 3",
        "[limits]\nu = 1",
        "[integrator]\nscheme = 3",
        "path = []",
        "[integrator]\nlie = []",
    ),
    *(
        "limits = [1]",
        "integrator = 'x'",
        "x = " + "[" * 5000 + "]" * 5000,
        "x = " + "9" * 5000,
        "[horizon]\nsteps=1e9",
    ),
)


def mutate_result(data: bytes, random: Random) -> bytes:
    """Bits anywhere, or another structure: then with the seal that goes with it, where the file has one."""
    if random.random() < 0.35:
        return mutate_bytes(data, random)
    edited = _edited(data, random)
    return seal(edited[SEAL_SIZE:]) if is_sealed(data) else edited


def _edited(data: bytes, random: Random) -> bytes:
    buffer = io.BytesIO(data)
    with h5py.File(buffer, "r+") as file:
        for _ in range(random.choice((1, 1, 2, 3))):
            try:
                random.choice(_EDITS)(file, random)
            except (
                ValueError,
                TypeError,
                KeyError,
                IndexError,
                OSError,
                RuntimeError,
                AttributeError,
                MemoryError,
            ):
                continue  # h5py itself refuses to write it, so no file holds it
    return buffer.getvalue()


def _nodes(file: h5py.File) -> list[str]:
    """Names of what hard links lead to; cycles are not followed."""
    names: list[str] = []
    file.visit(names.append)
    return names


def _any(file: h5py.File, random: Random) -> str:
    return random.choice(_nodes(file))


def _arrays(file: h5py.File) -> list[str]:
    return [name for name in _nodes(file) if name.startswith("trajectories/")]


def _delete(file: h5py.File, random: Random) -> None:
    del file[_any(file, random)]


def _rename(file: h5py.File, random: Random) -> None:
    file.move(
        _any(file, random), random.choice(("x", "trajectories/x", "text/x", "text/history", "summary/x"))
    )


def _link(file: h5py.File, random: Random) -> None:
    name = _any(file, random)
    links = (h5py.SoftLink("/"), h5py.SoftLink(f"/{name}"), h5py.ExternalLink("/dev/zero", "/"))
    links = (
        *links,
        h5py.ExternalLink("/etc/passwd", "/x"),
        h5py.SoftLink("/" + _any(file, random)),
        file["/"],
    )
    del file[name]
    file[name] = random.choice(links)


def _reshape(file: h5py.File, random: Random) -> None:
    """Another shape or type of the same name, with the attributes that were there."""
    name = random.choice(_arrays(file))
    attributes = dict(file[name].attrs)
    shape, kind = random.choice(_SHAPES), np.dtype(random.choice(_TYPES))
    del file[name]
    _with_attributes(file.create_dataset(name, data=np.zeros(shape, kind)), attributes)


def _declare(file: h5py.File, random: Random) -> None:
    """A size that is declared, and no data."""
    name = random.choice(_nodes(file)[1:])
    attributes = dict(file[name].attrs)
    shape = random.choice(((_HUGE, 100), (_HUGE,), (10**7, 3), (2**40,), (2**62,)))
    del file[name]
    made = file.create_dataset(name, shape, dtype=random.choice(("f8", "u1")), chunks=True, fillvalue=0)
    _with_attributes(made, attributes)


def _compress(file: h5py.File, random: Random) -> None:
    """Gigabytes of zeros in kilobytes."""
    name = random.choice(_arrays(file))
    attributes = dict(file[name].attrs)
    del file[name]
    made = file.create_dataset(
        name, (40_000, 100), "f8", data=None, chunks=(4000, 100), compression="gzip", fillvalue=0
    )
    _with_attributes(made, attributes)


def _with_attributes(data: Any, attributes: dict[str, Any]) -> None:
    for key, value in attributes.items():
        data.attrs[key] = value


def _numbers(file: h5py.File, random: Random) -> None:
    """Other numbers: the file is sound, what it says is not."""
    data = file[random.choice(_arrays(file))]
    if data.size:
        values = data[()]
        values.flat[random.randrange(data.size)] = random.choice((np.nan, np.inf, -np.inf, 1e308, 0.0, -1.0))
        data[...] = values


def _attribute(file: h5py.File, random: Random) -> None:
    holders = [name for name in ["/", *_nodes(file)] if len(file[name].attrs)]
    attributes = file[random.choice(holders)].attrs
    key = random.choice(list(attributes))
    if random.random() < 0.3:
        del attributes[key]
    else:
        attributes[key] = random.choice(_VALUES)


def _new_attribute(file: h5py.File, random: Random) -> None:
    key = random.choice(
        ("cost", "status", "x", "qs", "labels", "meanings", "format_version", "columns", "self", "history")
    )
    file[random.choice(("/", "summary", "text", _any(file, random)))].attrs[key] = random.choice(_VALUES)


def _text(file: h5py.File, random: Random) -> None:
    """Another text of JSON or TOML, or the same with another value in it."""
    name = random.choice([name for name in _nodes(file) if name.startswith("text/")])
    attributes, words = dict(file[name].attrs), bytes(file[name][()]).decode(errors="replace")
    kind = random.random()
    if kind < 0.4:
        words = random.choice(_TEXTS)
    elif kind < 0.7 and words[:1] in ("{", "["):
        words = json.dumps(mutate_tree({"x": json.loads(words)}, random).get("x"), default=str)
    else:
        words = mutate_lines(words.replace(",", ",\n"), random)
    if random.random() < 0.2:
        words = words.replace("1", random.choice(EXTREMES), 1)
    del file[name]
    made = file.create_dataset(name, data=np.frombuffer(words.encode(errors="replace"), dtype=np.uint8))
    _with_attributes(made, attributes)


_EDITS = (_delete, _rename, _link, _reshape, _reshape, _declare, _compress, _numbers, _numbers, _attribute)
_EDITS += (_attribute, _new_attribute, _text, _text)
