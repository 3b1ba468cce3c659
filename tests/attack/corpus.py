"""Files that are mutated: of robots/, examples/ and example-robot-data, and small ones in data/."""

from __future__ import annotations

import io
import struct
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import pinocchio

from tests.solution.fabricated import arm, limited, pendulum

__all__ = ["ROOT", "Entry", "entries"]

ROOT = Path(__file__).parents[2]
_DATA = Path(__file__).parent / "data"
_SHARED = Path(pinocchio.__file__).parents[4] / "share/example-robot-data/robots"
_LARGEST = 16_000  # [bytes] of a URDF that is taken
# Their problems take a tenth of a second to be made: they come less often.
_LOOPS = ("delta", "five_bar", "four_bar", "parallelogram_arm", "slider_crank", "stewart")
# Of example-robot-data: no joint, no link, or a link without mass at the end of a joint.
_REFUSED = ("bluevolta", "bravo7_gripper", "falcon", "quadrotor_base", "iris_simple", "ur3")


@dataclass(frozen=True)
class Entry:
    """Files of a folder: `main` is loaded, `mutated` are those that may be changed."""

    name: str
    main: str
    files: Mapping[str, bytes]
    mutated: tuple[str, ...]

    def __hash__(self) -> int:
        return hash((self.name, self.mutated))


@cache
def entries(kind: str) -> tuple[Entry, ...]:
    """What inputs of a kind are made from, in a fixed order."""
    return _KINDS[kind]()


def _entry(name: str, main: str, text: bytes, **others: bytes) -> Entry:
    """Entry whose main file is mutated, and no other."""
    return Entry(name, main, {main: text, **others}, (main,))


_NO_PROBLEMS = ("lattice", "robot")  # a study, robots


def _of_examples() -> tuple[Entry, ...]:
    paths = sorted((ROOT / "examples").rglob("*.toml"))
    paths = [path for path in paths if path.parent.name != "studies" and path.stem not in _NO_PROBLEMS]
    return tuple(
        _entry(path.stem, "problem.toml", path.read_bytes(), **_companions_of(path.parent)) for path in paths
    )


def _companions_of(folder: Path) -> dict[str, bytes]:
    """What examples of a folder bring along, robots, meshes, clouds, maps and scenes, by path from there."""
    suffixes = (".obj", ".stl", ".urdf", ".csv", ".xyz")
    scenes = [path for path in sorted(folder.iterdir()) if path.suffix in suffixes]
    files = (path for path in (*scenes, *sorted((folder / "robots").rglob("*"))) if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def _problems() -> tuple[Entry, ...]:
    examples = _of_examples()
    quick = [entry for entry in examples if entry.name not in _LOOPS]
    return (*examples, *quick, *_small(), *_small(), *_small())


def _small() -> tuple[Entry, ...]:
    paths = sorted(_DATA.glob("problem_*.toml"))
    beside = {"guarded.urdf": (_DATA / "guarded.urdf").read_bytes()}  # a robot that has shapes
    others = {"problem_obstacles": beside}
    return tuple(
        _entry(path.stem, "problem.toml", path.read_bytes(), **others.get(path.stem, {})) for path in paths
    )


def _solved() -> tuple[Entry, ...]:
    """Problems whose functions are made in no time."""
    names = ("elastic_pendulum", "rigid_pendulum", "cart_pendulum_rigid")
    return (*_small(), *(entry for entry in _of_examples() if entry.name in names))


def _studies() -> tuple[Entry, ...]:
    problem = (ROOT / "examples/paper/rigid_pendulum.toml").read_bytes()
    grid = (ROOT / "examples/studies/pendulum_goals.toml").read_bytes().replace(b"../paper/rigid_", b"rigid_")
    texts = {"grid": grid}
    texts |= {name: (_DATA / f"study_{name}.toml").read_bytes() for name in ("sample", "list")}
    others = {"rigid_pendulum.toml": problem}
    studies = tuple(_entry(name, "study.toml", text, **others) for name, text in texts.items())
    return (*studies, Entry("problem", "study.toml", studies[0].files, tuple(others)))


def _robots() -> tuple[Entry, ...]:
    folders = [path.parent for path in sorted((ROOT / "robots").glob("*/robot.toml"))]
    cell = _entry("cell", "robot.toml", (_DATA / "cell" / "robot.toml").read_bytes())
    alone = tuple(
        _entry(
            folder.name,
            "robot.toml",
            (folder / "robot.toml").read_bytes(),
            **{"robot.urdf": (folder / "robot.urdf").read_bytes()},
        )
        for folder in folders
    )
    return (*alone, cell)


def _yamls() -> tuple[Entry, ...]:
    found = []
    for name, robot in (("point", "five_bar"), ("weld", "five_bar"), ("universal", "four_bar")):
        urdf = (ROOT / "robots" / robot / "robot.urdf").read_bytes()
        found.append(
            _entry(name, "robot.yaml", (_DATA / f"{name}.yaml").read_bytes(), **{"robot.urdf": urdf})
        )
    return tuple(found)


def _urdfs() -> tuple[Entry, ...]:
    paths = [*sorted(_SHARED.rglob("*.urdf")), *sorted((ROOT / "robots").rglob("*.urdf"))]
    paths = [path for path in paths if path.stat().st_size <= _LARGEST and path.stem not in _REFUSED]
    paths += sorted(_DATA.glob("*.urdf"))
    mesh = (_DATA / "mesh.obj").read_bytes()
    return tuple(
        _entry(
            f"{path.parent.parent.name}/{path.stem}", "robot.urdf", path.read_bytes(), **{"mesh.obj": mesh}
        )
        for path in paths
    )


def _meshes() -> tuple[Entry, ...]:
    facets = [struct.pack("<12fH", 0, 0, 1, *np.arange(9.0) + i, 0) for i in range(4)]
    binary = bytes(80) + struct.pack("<I", len(facets)) + b"".join(facets)
    beside = {name: (_DATA / name).read_bytes() for name in ("mesh.mtl", "picture.png")}
    urdf = (_DATA / "box.urdf").read_bytes()
    obj, dae, text = ((_DATA / name).read_bytes() for name in ("mesh.obj", "mesh.dae", "ascii.stl"))
    found = []
    for title, name, data, mutated in (
        ("obj", "mesh.obj", obj, ("mesh.obj",)),
        ("mtl", "mesh.obj", obj, tuple(beside)),
        ("binary stl", "mesh.stl", binary, ("mesh.stl",)),
        ("ascii stl", "mesh.stl", text, ("mesh.stl",)),
        ("dae", "mesh.dae", dae, ("mesh.dae",)),
    ):
        files = {"robot.urdf": urdf.replace(b"mesh.obj", name.encode()), name: data, **beside}
        found.append(Entry(title, "robot.urdf", files, mutated))
    return tuple(found)


def _results() -> tuple[Entry, ...]:
    text = (ROOT / "examples/paper/rigid_pendulum.toml").read_text(encoding="utf-8")
    words = {"num_steps": 12, "robot_spec": {"name": "rigid_pendulum"}, "problem_text": text}
    solutions = {
        "pendulum": pendulum(**words),
        "without facts": pendulum(**words, facts_kept=None),
        "limited": limited(),
        "arm": arm(num_steps=5),
    }
    with tempfile.TemporaryDirectory() as folder:
        found = {name: s.save(Path(folder) / "result.h5").read_bytes() for name, s in solutions.items()}
    written = [_entry(name, "result.h5", data) for name, data in found.items()]
    return (*written, *written, *written, _entry("old", "result.h5", _without_seal(found["limited"])))


def _without_seal(data: bytes) -> bytes:
    """The same as a file of format 2, which had no seal."""
    buffer = io.BytesIO()
    with h5py.File(io.BytesIO(data), "r") as new, h5py.File(buffer, "w") as old:
        for name in new:
            new.copy(name, old)
        for name, value in new.attrs.items():
            old.attrs[name] = value
        old.attrs["format_version"] = 2
    return buffer.getvalue()


def _rows() -> tuple[Entry, ...]:
    return (_entry("rows", "rows.jsonl", (_DATA / "rows.jsonl").read_bytes()),)


_KINDS = {
    "problem": _problems,
    "solve": _solved,
    "study": _studies,
    "robot_toml": _robots,
    "robot_yaml": _yamls,
    "urdf": _urdfs,
    "mesh": _meshes,
    "result": _results,
    "rows": _rows,
}
