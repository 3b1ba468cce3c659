"""Mutations of mesh files: OBJ and MTL by line, STL by field."""

from __future__ import annotations

import struct
from random import Random

from .raw import mutate_bytes, mutate_lines

__all__ = ["mutate_mesh"]

_HEADER, _FACET = 80, 50  # [bytes] of a binary STL
_OBJ = (
    *(
        "f 1 2 3",
        "f 1",
        "f",
        "f 0 0 0",
        "f -1 -2 -3",
        "f 1/1/1 2//2 3/",
        "f 99999999999999999999 1 2",
        "f a b c",
    ),
    *(
        "f " + "1 " * 5000,
        "v nan nan nan",
        "v 1",
        "v 1 2 3 4 5 6 7",
        "v 1e308 -1e308 1e999",
        "vn 0 0 0",
        "vt 1",
        "vt x y",
    ),
    *(
        "usemtl",
        "usemtl nothing",
        "mtllib",
        "mtllib mesh.obj",
        "mtllib ../../../../etc/passwd",
        "mtllib " + "x" * 300,
    ),
    *("g", "o \x00", "\\", "l 1 2", "vp 1", "f 1 2 3 \\", "v", "vn", "f 2147483648 -2147483649 1"),
)
_MTL = (
    *(
        "Kd 1",
        "Kd a b c",
        "Kd nan nan nan",
        "Kd 1e999 -1 2",
        "Kd",
        "map_Kd",
        "map_Kd ../../../../etc/passwd",
        "newmtl",
    ),
    *(
        "map_Kd /dev/zero",
        "map_Kd mesh.obj",
        "map_Kd " + "x" * 300,
        "map_Kd -s 1 1 1 a.png",
        "d nan",
        "newmtl a",
    ),
)


def mutate_mesh(name: str, data: bytes, random: Random) -> bytes:
    """Mutate a mesh or material file that is called `name`; Collada is XML, see `elements`."""
    if random.random() < 0.2:
        return mutate_bytes(data, random)
    if name.endswith((".obj", ".mtl")):
        return _mutate_words(data, random, _MTL if name.endswith(".mtl") else _OBJ)
    if data[:5] == b"solid":
        return mutate_lines(data.decode(errors="replace"), random).encode()
    return _mutate_stl(data, random)


def _mutate_words(data: bytes, random: Random, words: tuple[str, ...]) -> bytes:
    lines = data.decode(errors="replace").split("\n")
    for _ in range(random.choice((1, 1, 2, 4))):
        place = random.randrange(len(lines) + 1)
        lines[place : place + random.choice((0, 1))] = [random.choice(words)]
    text = "\n".join(lines)
    return (mutate_lines(text, random) if random.random() < 0.5 else text).encode(errors="replace")


def _mutate_stl(data: bytes, random: Random) -> bytes:
    stl = bytearray(data)
    if random.random() < 0.4 or len(stl) < _HEADER + 4 + _FACET:
        stl[_HEADER : _HEADER + 4] = struct.pack("<I", random.choice((0, 1, 2**31, 2**32 - 1, 10**6)))
        return bytes(stl)
    for _ in range(random.choice((1, 3))):
        place = (
            _HEADER
            + 4
            + _FACET * random.randrange((len(stl) - _HEADER - 4) // _FACET)
            + 4 * random.randrange(12)
        )
        number = random.choice((float("nan"), float("inf"), 3e38, 1e-45, 0.0, -1.0))
        stl[place : place + 4] = struct.pack("<f", number)
    return bytes(stl)
