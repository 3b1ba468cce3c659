"""meshcat, imported quietly: its server module still imports a deprecated part of pyzmq.

Pinocchio imports all its viewers with one of them. Viser, and what it brings, takes a while
and is not for this. Nor is IPython, of which meshcat wants the name of one class, for cells of notebooks:
where IPython runs it has been imported before.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType


@contextmanager
def _without(*names: str) -> Iterator[None]:
    """Let modules that have not been imported seem to be missing."""
    hidden = [name for name in names if name not in sys.modules]
    sys.modules.update(dict.fromkeys(hidden))  # type: ignore[arg-type]  # None stands for a module that cannot be imported
    try:
        yield
    finally:
        for name in hidden:
            sys.modules.pop(name, None)


@contextmanager
def _without_ipython() -> Iterator[None]:
    """Let the class that meshcat asks IPython for be plain text, unless IPython has been imported."""
    if "IPython" in sys.modules:
        yield
        return
    display = ModuleType("IPython.display")
    display.HTML = str  # type: ignore[attr-defined]
    names = {"IPython": ModuleType("IPython"), "IPython.display": display}
    sys.modules.update(names)
    try:
        yield
    finally:
        for name in names:
            del sys.modules[name]


with warnings.catch_warnings(), _without("viser", "trimesh"), _without_ipython():
    warnings.simplefilter("ignore", DeprecationWarning)
    import meshcat
    from meshcat import geometry as mg
    from meshcat.commands import SetObject
    from pinocchio.visualize import meshcat_visualizer

load_mesh = meshcat_visualizer.loadMesh
load_primitive = meshcat_visualizer.loadPrimitive
pack_array = mg.pack_numpy_array
Ext = mg.umsgpack.Ext  # binary data in a message

__all__ = ["Ext", "SetObject", "load_mesh", "load_primitive", "meshcat", "mg", "pack_array"]
