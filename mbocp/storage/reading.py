"""Bytes of a result file, checked before HDF5 sees them."""

from __future__ import annotations

from pathlib import Path

from mbocp._files import path_of, read_bytes
from mbocp.exceptions import ResultFileError, Unreadable
from mbocp.storage.guarded import renew
from mbocp.storage.seal import HDF5_SIGNATURE, LARGEST, SEAL_SIZE, is_sealed, unseal


def read_image(path: str | Path) -> memoryview:
    """The HDF5 part of a result file, as it was written.

    Raises
    ------
    ResultFileError
        If there is no such file, it is no result of mbocp, too large or damaged, or a newer mbocp wrote it.
    """
    try:
        content = read_bytes(path_of(path), expected="a result file", limit=LARGEST)
        if not is_sealed(content) and content.startswith(HDF5_SIGNATURE):
            content = renew(path, content)
    except Unreadable as error:
        raise ResultFileError(path, error.reason) from error
    except MemoryError as error:
        raise ResultFileError(path, "needs more memory to be read than there is") from error
    if not is_sealed(content):
        raise ResultFileError(path, _foreign(content))
    return unseal(path, content)


def _foreign(content: bytes) -> str:
    if content[SEAL_SIZE:].startswith(HDF5_SIGNATURE):
        return "is damaged in its first bytes, or no result file of mbocp; solve again, or take a copy of it"
    return "is not a result file of mbocp (not even HDF5); give a file that `mbocp solve -o` wrote"
