"""The sources that write stage functions: a change in them makes what was written before stale."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from mbocp import integrators, lie, mechanics, meshes, robot, symbolic, terms

_BRIDGE = "mbocp._native._bridge"  # Pinocchio's algorithms as expressions, compiled


def writing_sources() -> Iterator[Path]:
    """Files that have a part in writing stage functions: this folder, those that it builds on, the ground."""
    own = Path(__file__).parent
    for package in (integrators, lie, mechanics, meshes, robot, symbolic, terms):
        yield from sorted(Path(str(package.__file__)).parent.rglob("*.py"))
    yield from sorted(own.rglob("*.py"))
    yield from sorted(own.parent.glob("*.py"))
    bridge = find_spec(_BRIDGE)
    if bridge is not None and bridge.origin is not None:
        yield Path(bridge.origin)


@cache
def sources_digest() -> str:
    """Digest of these files."""
    digest = hashlib.sha256()
    for source in writing_sources():
        digest.update(source.name.encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()
