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
def _replace_missing(modules: dict[str, ModuleType | None]) -> Iterator[None]:
    """Put others in the place of modules that have not been imported; None: it cannot be."""
    new = {name: module for name, module in modules.items() if name not in sys.modules}
    sys.modules.update(new)  # type: ignore[arg-type]  # None: it cannot be imported
    try:
        yield
    finally:
        for name in new:
            sys.modules.pop(name, None)


def _ipython() -> dict[str, ModuleType | None]:
    """IPython whose class that meshcat asks for is plain text; nothing where it has been imported."""
    if "IPython" in sys.modules:
        return {}
    display = ModuleType("IPython.display")
    display.HTML = str  # type: ignore[attr-defined]
    return {"IPython": ModuleType("IPython"), "IPython.display": display}


with warnings.catch_warnings(), _replace_missing({"viser": None, "trimesh": None, **_ipython()}):
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
