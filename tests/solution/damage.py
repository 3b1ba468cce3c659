"""Result files that are not as mbocp wrote them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py

from mbocp.storage.seal import SEAL_SIZE, seal

_WRITABLE = 1  # H5LT_FILE_IMAGE_OPEN_RW


def edited_image(image: bytes, change: Callable[[h5py.File], object]) -> bytes:
    """Change an HDF5 image as any program could."""
    with h5py.File(h5py.h5f.open_file_image(image, flags=_WRITABLE)) as file:
        change(file)
        file.flush()
        edited: bytes = file.id.get_file_image()
    return edited


def edit(path: Path, change: Callable[[h5py.File], object]) -> None:
    """Change the content of a result file, and give it the digest that belongs to it."""
    path.write_bytes(seal(edited_image(path.read_bytes()[SEAL_SIZE:], change)))


def make_old(path: Path, change: Callable[[h5py.File], object] = lambda _: None) -> None:
    """Turn a result file into one of format 2, without digest; what `change` does on the way may hurt."""

    def as_format_2(file: h5py.File) -> None:
        file.attrs["format_version"] = 2
        change(file)

    path.write_bytes(edited_image(path.read_bytes()[SEAL_SIZE:], as_format_2))
