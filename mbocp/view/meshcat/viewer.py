"""meshcat, imported quietly: its server module still imports a deprecated part of pyzmq."""

from __future__ import annotations

import warnings

with warnings.catch_warnings():
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
