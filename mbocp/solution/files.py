"""The result file: HDF5 behind a seal, see `mbocp.storage`.

Its first 512 bytes hold a digest over all of it, which is checked before HDF5 opens it: what differs in a
single bit from what was written is an error and never a wrong number. The digest finds accidents; it is no
signature, and whoever means harm can make a new one. Files of formats 1 and 2 have none; a process of their
own reads them, so that libhdf5 cannot take this one with it, but numbers in them may be wrong.
"""

from __future__ import annotations

from pathlib import Path

from mbocp.exceptions import ResultFileError
from mbocp.solution.atomic import replace_file
from mbocp.storage.content import FileContent
from mbocp.storage.seal import LARGEST, read_image, seal


def write_content(path: str | Path, content: FileContent) -> Path:
    """Write a result file; an interrupted write leaves the old file whole.

    Raises
    ------
    ResultFileError
        If the file cannot be written, or would be too large to be read.
    """
    from mbocp.storage.hdf5 import image_of  # HDF5 only for those who save

    whole = seal(image_of(content))
    if len(whole) > LARGEST:
        raise ResultFileError(path, f"would have {len(whole)} bytes; a result file has {LARGEST} at most")
    return replace_file(path, whole)


def read_content(path: str | Path) -> FileContent:
    """Read a result file.

    Raises
    ------
    ResultFileError
        If there is no such file, it is not a result of mbocp, it is damaged, or a newer mbocp wrote it.
    """
    from mbocp.storage.hdf5 import content_of  # HDF5 only for those who load

    return content_of(path, read_image(path))
