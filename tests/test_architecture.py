"""Imports go one way along the layers, and every public name exists."""

from __future__ import annotations

import ast
import importlib
import importlib.util
from collections.abc import Iterator
from functools import cache
from itertools import groupby
from pathlib import Path
from types import ModuleType

import pytest

from mbocp._exports import homes_in

PACKAGE = Path(__file__).parents[1] / "mbocp"

# A layer imports itself and those before it. What composes the layers comes last.
LAYERS = (
    "_exports",
    "_text",
    "_tolerances",
    "_quantities",
    "exceptions",
    "_arrays",
    "_measured",
    "_json_schema",
    "_keys",
    "_merged",
    "_environment",
    "_processes",
    "_threads",
    "_files",
    "_memory",
    "_native",
    "programme",
    "solvers",
    "symbolic",
    "lie",
    "meshes",
    "robot",
    "mechanics",
    "mechanisms",
    "integrators",
    "terms",
    "storage",
    "problem",
    "formulation",
    "solution",
    "bounds",
    "sensitivity",
    "job",
    "accuracy",
    "view",
    "guesses",
    "clearing",
    "identification",
    "robust",
    "strategies",
    "menus",
    "solving",
    "stopping",
    "many",
    "autodiff",
    "receding",
    "interactive",
    "explaining",
    "study",
    "cli",
)
SCRIPTS = {"__main__.py", "locate.py"}  # run, not imported
SOURCES = sorted(
    path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py" and path.name not in SCRIPTS
)
ALONE = {
    "symbolic": {"exceptions", "_arrays", "_native", "_processes"},
    "meshes": {"_text", "exceptions", "_files", "_arrays"},
    "storage": {"exceptions", "_arrays", "_files", "_processes"},
    "_native": set(),
    "programme": {"_text", "exceptions", "_exports", "_arrays", "_environment", "_native", "_processes"},
    "solvers": {"exceptions", "_exports", "_arrays", "_processes", "programme"},
    "exceptions": {"_text"},
}


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(tree: ast.AST, for_types: bool = True) -> Iterator[tuple[int, str]]:
    """Line and dotted name of each import, wherever it stands, those for types alone only if asked for."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.expr):
            continue
        if not for_types and isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in line {node.lineno}"
            yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)
        yield from imported(node, for_types)


def layers_used(path: Path) -> Iterator[tuple[int, str]]:
    """Line and layer of each import of mbocp; of mbocp itself only `__version__` belongs to no layer."""
    for line, name in imports_of(path):
        package, *rest = name.split(".")
        if package == "mbocp" and rest and rest[0] != "__version__":
            yield line, rest[0]


def clients(layer: str) -> set[str]:
    """Other layers that import this one."""
    users = [path for path in SOURCES if any(used == layer for _, used in layers_used(path))]
    return {layer_of(path) for path in users} - {layer}


def layer_of(path: Path) -> str:
    return module_name(path).split(".")[1]


OF_LAYER = {layer: list(paths) for layer, paths in groupby(sorted(SOURCES, key=layer_of), layer_of)}


@pytest.mark.parametrize("layer", OF_LAYER)
def test_imports_go_one_way(layer):
    assert layer in LAYERS, f"mbocp.{layer} has no place among the layers"
    allowed = set(LAYERS[: LAYERS.index(layer) + 1])
    if layer in ALONE:
        allowed = ALONE[layer] | {layer}
    wrong = [
        f"{path.name}:{line} imports mbocp.{used}"
        for path in OF_LAYER[layer]
        for line, used in layers_used(path)
        if used not in allowed
    ]
    assert not wrong, "; ".join(wrong)


@pytest.mark.parametrize("client", ["mbocp_papers", "mbocp_ros"])
def test_nothing_of_the_package_knows_its_clients(client):
    assert not [path for path in SOURCES if client in path.read_text(encoding="utf-8")]


def test_no_circles_of_imports():
    """Neither between folders nor within one, not for types either."""
    names = {module_name(path) for path in SOURCES}
    graph = {module_name(path): imported_modules(path, names) for path in SOURCES}
    circles = [sorted(circle) for circle in circles_of(graph)]
    assert not circles, f"these import each other: {circles}"


def imported_modules(path: Path, modules: set[str], for_types: bool = True) -> set[str]:
    return {found for _, name in imports_of(path, for_types) for found in within(name, modules)}


@cache
def imports_of(path: Path, for_types: bool = True) -> tuple[tuple[int, str], ...]:
    return tuple(imported(ast.parse(path.read_text(encoding="utf-8")), for_types))


def within(name: str, modules: set[str]) -> Iterator[str]:
    """Module that a dotted name belongs to, if it is one of ours."""
    while name:
        if name in modules:
            yield name
            return
        name = name.rpartition(".")[0]


def circles_of(graph: dict[str, set[str]]) -> Iterator[set[str]]:
    """Modules that can be reached from each other."""
    reach = {name: reached(graph, name) for name in graph}
    seen: set[str] = set()
    for name in graph:
        if name in reach[name] and name not in seen:
            circle = {other for other in reach[name] if name in reach[other]}
            seen |= circle
            yield circle


def reached(graph: dict[str, set[str]], name: str) -> set[str]:
    """Where the imports of a module lead, by one or more steps; itself only if they come back."""
    found: set[str] = set()
    waiting = list(graph[name] - {name})
    while waiting:
        module = waiting.pop()
        if module not in found:
            found.add(module)
            waiting += graph[module]
    return found


def test_circles_are_found():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": {"d"}, "e": {"a"}}
    assert list(circles_of(graph)) == [{"b", "c"}]


def modules_at(paths: list[Path]) -> Iterator[ModuleType]:
    """Modules, without those for libraries that are not installed."""
    for path in paths:
        is_optional = path in (PACKAGE / "autodiff/jax.py", PACKAGE / "autodiff/torch.py")
        if not is_optional or importlib.util.find_spec(path.stem):
            yield importlib.import_module(module_name(path))


@pytest.mark.parametrize("layer", [None, *OF_LAYER])
def test_public_names_exist(layer):
    for module in modules_at(OF_LAYER.get(layer, [PACKAGE / "__init__.py"])):
        public = getattr(module, "__all__", [])
        assert len(set(public)) == len(public), module
        missing = [name for name in public if not hasattr(module, name)]
        assert not missing, module


@pytest.mark.parametrize("layer", OF_LAYER)
def test_modules_list_names_only_to_show_those_of_others(layer):
    """A leading underscore says what is private; a list of all other names would say it twice."""
    for module in modules_at([path for path in OF_LAYER[layer] if path.name != "__init__.py"]):
        shown = [getattr(module, name) for name in getattr(module, "__all__", [])]
        assert not [thing for thing in shown if getattr(thing, "__module__", None) == module.__name__], module


LATE = [path for path in SOURCES if path.name == "__init__.py" and "names_of(__name__" in path.read_text()]


@pytest.mark.parametrize("path", LATE, ids=module_name)
def test_names_that_are_imported_late_are_public_for_type_checkers(path):
    """And none is that of a module: once that is imported, it would stand in the name's place."""
    homes = homes_in(path.read_text())
    hidden = [name for name in homes if f" as {name}" not in path.read_text()]
    assert not hidden
    assert set(homes) == set(importlib.import_module(module_name(path)).__all__)
    assert not set(homes) & {module.stem for module in path.parent.iterdir()}


def test_terms_add_themselves_in_one_order():
    """Modules whose terms stand in lists are imported by `kinds` alone, in the order of the documentation."""
    listed = {
        f"mbocp.terms.{name}" for name in ("running", "energy", "end", "frame_path", "kept_poses", "follow")
    }
    names = {module_name(path) for path in SOURCES}
    users = {module_name(path) for path in SOURCES if imported_modules(path, names) & listed}
    assert users == {"mbocp.terms.kinds"}
