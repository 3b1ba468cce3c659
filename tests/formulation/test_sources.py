"""Sources that write stage functions: all that the writers import as they run is among them."""

from __future__ import annotations

from pathlib import Path

import mbocp
from mbocp.formulation.signature import source_files
from tests.test_architecture import PACKAGE, SOURCES, imported_modules, module_name, reached

IMPORTED = Path(mbocp.__file__).resolve().parent  # where the package is taken from: maybe a copy of this one
WRITERS = ("mbocp.formulation.stage", "mbocp.integrators.runge_kutta")


class _Imports(dict[str, set[str]]):
    """What modules import as they run, read as far as somebody asks."""

    def __init__(self, paths: dict[str, Path]) -> None:
        super().__init__()
        self.paths = paths

    def __missing__(self, name: str) -> set[str]:
        self[name] = imported_modules(self.paths[name], set(self.paths), for_types=False)
        return self[name]


def test_whatever_the_writers_import_is_among_the_sources() -> None:
    names = {module_name(path): path for path in SOURCES}
    graph = _Imports(names)
    sources = (path.resolve() for path in source_files() if path.suffix == ".py")
    known = {path.relative_to(IMPORTED) for path in sources}
    for writer in WRITERS:
        used = {writer, *reached(graph, writer)}
        assert len(used) > 10
        missing = {name for name in used if names[name].relative_to(PACKAGE) not in known}
        assert missing <= {"mbocp._native"}, missing  # empty: what is compiled is among the sources itself


def test_the_compiled_bridge_is_among_the_sources() -> None:
    found = list(source_files())
    assert len(set(found)) == len(found)
    assert [path.name.split(".")[0] for path in found if path.suffix != ".py"] == ["_bridge"]
    assert (IMPORTED / "terms" / "running.py") in [path.resolve() for path in found]
