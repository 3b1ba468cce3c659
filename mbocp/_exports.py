"""Public names of a package that are imported when they are first asked for.

A package such as `mbocp.robot` shows names of many modules: whoever wants one of them need not wait for all.
Its `__init__.py` imports them for type checkers alone, to which `as` says that they are public. The same
lines say where each name is::

    if TYPE_CHECKING:
        from mbocp.robot.robot import Robot as Robot

    __getattr__ = names_of(__name__, __file__)

Modules of the package, as ``mbocp.identification``, are imported when they are first asked for, too.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any


def names_of(package: str, source: str) -> Callable[[str], Any]:
    """A `__getattr__` (PEP 562) for a package, which has `__all__`, too.

    Parameters
    ----------
    package, source : str
        Its `__name__` and `__file__`.
    """
    homes: dict[str, tuple[str, str]] = {}

    def find(name: str) -> Any:
        if not homes:
            homes.update(homes_in(Path(source).read_text(encoding="utf-8")))
        if name == "__all__":
            return list(homes)
        if name not in homes:
            if _is_module(Path(source).parent, name):
                return import_module(f"{package}.{name}")
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, there = homes[name]
        found = getattr(import_module(module), there)
        setattr(sys.modules[package], name, found)  # asked once
        return found

    return find


def _is_module(folder: Path, name: str) -> bool:
    """Whether a package has a public module of this name."""
    places = (folder / name / "__init__.py", folder / f"{name}.py")
    return not name.startswith("_") and any(place.is_file() for place in places)


def homes_in(source: str) -> dict[str, tuple[str, str]]:
    """Module of each name, and its name there, as the imports under `if TYPE_CHECKING:` say."""
    return {alias.asname or alias.name: (module, alias.name) for module, alias in _imports(source)}


def _imports(source: str) -> Iterator[tuple[str, ast.alias]]:
    for block in ast.parse(source).body:
        if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING":
            for node in block.body:
                if isinstance(node, ast.ImportFrom) and node.module is not None:
                    yield from ((node.module, alias) for alias in node.names)
