"""Sources that write stage functions: all that the writers import as they run is among them."""

from __future__ import annotations

from pathlib import Path

import mbocp
from mbocp.formulation.signature import writing_sources
from tests.test_architecture import PACKAGE, SOURCES, imported_modules, module_name, reached

IMPORTED = Path(mbocp.__file__).resolve().parent  # where the package is taken from: maybe a copy of this one
WRITERS = ("mbocp.formulation.stage", "mbocp.integrators.runge_kutta")


def test_whatever_the_writers_import_is_among_the_sources() -> None:
    names = {module_name(path): path for path in SOURCES}
    graph = {name: imported_modules(path, set(names), for_types=False) for name, path in names.items()}
    sources = (path.resolve() for path in writing_sources() if path.suffix == ".py")
    known = {path.relative_to(IMPORTED) for path in sources}
    for writer in WRITERS:
        used = {writer, *reached(graph, writer)}
        assert len(used) > 10
        missing = {name for name in used if names[name].relative_to(PACKAGE) not in known}
        assert missing <= {"mbocp._native"}, missing  # empty: what is compiled is among the sources itself


def test_the_compiled_bridge_is_among_the_sources() -> None:
    found = list(writing_sources())
    assert len(set(found)) == len(found)
    assert [path.name.split(".")[0] for path in found if path.suffix != ".py"] == ["_bridge"]
    assert (IMPORTED / "terms" / "running.py") in [path.resolve() for path in found]
