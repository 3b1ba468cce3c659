"""The first 512 bytes of a result file: a digest over all the others, and over themselves.

HDF5 leaves the beginning of a file to its users (a "user block"); any HDF5 tool skips it. Here it reads

    mbocp-solution
    sha256 0123456789abcdef...
    format 3, 69491 bytes

The digest is of the whole file without the digest's own 64 digits. It is checked before HDF5 sees a byte:
libhdf5 crashes, or never comes back, on files in which one bit is wrong.
"""

from __future__ import annotations

import hashlib
import hmac
import re
from pathlib import Path

from mbocp._files import path_of, read_bytes
from mbocp.exceptions import ResultFileError, Unreadable
from mbocp.storage.guarded import renew

FORMAT_VERSION = 3
LARGEST = 2 << 30  # [bytes] of a result file; a million steps of an arm with limits are 0.8 GB
SEAL_SIZE = 512  # the smallest user block of HDF5
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"

_MAGIC = b"mbocp-solution\nsha256 "
_DIGEST = slice(len(_MAGIC), len(_MAGIC) + 64)
_FACTS = re.compile(rb"\nformat ([0-9]{1,9}), ([0-9]{1,18}) bytes\n")
_NOTE = b"HDF5 begins at byte 512. The digest is of all bytes of this file but its own 64 digits.\n"


def seal(image: bytes) -> bytes:
    """Put the seal in front of an HDF5 image that was made with a user block of 512 bytes."""
    facts = b"\nformat %d, %d bytes\n" % (FORMAT_VERSION, SEAL_SIZE + len(image))
    block = (_MAGIC + 64 * b"0" + facts + _NOTE).ljust(SEAL_SIZE - 1) + b"\n"
    return block[: _DIGEST.start] + _digest(block, image) + block[_DIGEST.stop :] + image


def is_sealed(content: bytes) -> bool:
    """Whether a file's content begins as that of a result file with a seal."""
    return content.startswith(_MAGIC)


def unseal(path: str | Path, content: bytes) -> memoryview:
    """The HDF5 image of a result file with a seal, every bit as it was written.

    Raises
    ------
    ResultFileError
        If the file is incomplete, differs from what was written, or a newer mbocp wrote it.
    """
    whole = memoryview(content)
    block, image = content[:SEAL_SIZE], whole[SEAL_SIZE:]
    facts = _FACTS.match(block, _DIGEST.stop)
    if len(block) < SEAL_SIZE or not hmac.compare_digest(_digest(block, image), block[_DIGEST]):
        raise ResultFileError(path, f"is {_damage(facts, len(content))}; solve again, or take a copy of it")
    if facts is None or int(facts[1]) != FORMAT_VERSION:
        raise ResultFileError(path, newer_words(int(facts[1]) if facts else "unknown"))
    return image


def newer_words(version: int | str) -> str:
    """Why a file of a later format cannot be read."""
    return f"has format {version}, written by a newer mbocp; this one reads up to {FORMAT_VERSION}: upgrade"


def _damage(facts: re.Match[bytes] | None, size: int) -> str:
    if size < SEAL_SIZE:
        return f"damaged or incomplete: it has {size} bytes"
    if facts is not None and int(facts[2]) > size:
        return f"damaged or incomplete: {int(facts[2])} bytes were written, {size} are there"
    return "damaged, or was changed after mbocp wrote it: its content does not match its digest (SHA-256)"


def _digest(block: bytes, image: bytes | memoryview) -> bytes:
    digest = hashlib.sha256(block[: _DIGEST.start])
    digest.update(block[_DIGEST.stop :])
    digest.update(image)
    return digest.hexdigest().encode()


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
