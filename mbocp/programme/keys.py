"""From what functions depend on to their library, by two keys.

The first key is of all that functions depend on: the signature of the problem, and the sources that write
them. It is known before anything is built, so that what was solved before is solved at once. The second is of
the C code and of how it is translated, and is the name of the library. A small file for each first key holds
the second. So a change of the sources that changes no function translates nothing anew, and signatures with
the same functions share a library.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from pathlib import Path

from mbocp.programme.cache import find_entry, folders, own_content, scratch_folder

_MOST = 4000  # of these files, each a block of the disk; without its file a library is found by its code
_LIBRARY = re.compile(rb"[0-9a-f]{32}\.so")


def key_of(*material: str) -> str:
    """Return the key of texts that stand for all that something depends on."""
    return hashlib.sha256("\n".join(material).encode()).hexdigest()[:32]


def library_of(key: str) -> Path | None:
    """Sound library of a first key, if its file names one."""
    for folder in folders():
        name = own_content(_file(folder, key))
        if name is not None and _LIBRARY.fullmatch(name):
            library = find_entry(name.decode())
            if library is not None:
                return library
    return None


def remember(key: str, library: Path) -> None:
    """Write the file of a first key, beside the library; where nothing can be written, its code finds it."""
    folder = library.parent
    with contextlib.suppress(OSError), scratch_folder(folder) as scratch:
        file = scratch / "key"
        file.write_bytes(library.name.encode())
        file.replace(_file(folder, key))
        _forget(folder)


def _file(folder: Path, key: str) -> Path:
    return folder / f"{key}.key"


def _forget(folder: Path) -> None:
    """Remove the oldest files, if there are too many."""
    files = list(folder.glob("*.key"))
    if len(files) > _MOST:
        for file in sorted(files, key=lambda path: path.lstat().st_mtime_ns)[: len(files) - _MOST]:
            file.unlink()
