"""Functions as a shared library: written in C, compiled, kept under the key of all that they depend on.

A library is found by two keys. The first is of all that functions depend on: the signature of the problem,
and the sources that write them. It is known before anything is built, so that what was solved before is
solved at once. The second is of the C code and of how it is translated, and is the name of the library. A
small file for each first key holds the second. So a change of the sources that changes no function translates
nothing anew, and signatures with the same functions share a library.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import math
import os
import platform
import re
from collections.abc import Collection, Mapping
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca

from mbocp._arrays import dataclass
from mbocp._environment import available_threads
from mbocp.exceptions import CompilationError
from mbocp.programme.cache import (
    cache_folder,
    find_entry,
    folders,
    is_private,
    own_content,
    private_folder,
    scratch_folder,
    seal,
    trim_after,
)
from mbocp.programme.compiler import check_deadline, run_compiler
from mbocp.programme.native_modules import instruction_flags, kernel, number_of_lanes

if TYPE_CHECKING:
    from mbocp.programme.c_files import CText

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


# Without contraction: products within sums are said to be such, and round alike in tapes.
_FLAGS = ("-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared", "-w")
# All that -O2 or -O3 gain on such code, compiled in half the time or a third of it; schedulers gain nothing.
_OPTIMISE = ("-O1", "-fexpensive-optimizations", "-fstrict-aliasing")
# Passes of GCC that find nothing in functions that say everything once: a fifth of the time.
_LEFT_OUT = (
    *("-fno-tree-fre", "-fno-tree-sink", "-fno-tree-sra", "-fno-tree-ccp", "-fno-tree-copy-prop"),
    *("-fno-tree-dominator-opts", "-fno-tree-dse", "-fno-tree-dce", "-fno-dse", "-fno-cprop-registers"),
    *("-fno-ipa-modref", "-fno-ipa-pure-const", "-fno-ipa-reference"),
)
_MOST_FILES = 4
# What turns functions into tapes and C, beside this module; the kernel's part is `TAPE_FORMAT`.
_SOURCES = ("tapes.py", "c_files.py", "native_modules.py", "lanes.h", "functions.h")
# Lines of CasADi's, whose functions are whole: to optimise more takes minutes. Those of the kernel are in
# pieces, so that time grows with their number; as -O0 leaves them, a tape is four times quicker.
_LONG = 150_000


def library_key(key: str, cc: tuple[str, ...] | None) -> str:
    """Return the key of the library of functions that depend on `key`."""
    written_by = (str(number_of_lanes()), sources_digest(), ca.CasadiMeta.version(), kernel().TAPE_FORMAT)
    return key_of(key, *written_by, *_translation(cc, _flags()))


def make_library(
    functions: Mapping[str, ca.Function],
    cc: tuple[str, ...],
    depends_on: str,
    *,
    deadline: float = math.inf,
    folder: Path | None = None,
) -> tuple[Path, bool]:
    """Compile functions, unless there is a library of the same C code.

    Parameters
    ----------
    functions : mapping of str to casadi.Function
    cc : tuple of str
        The compiler.
    depends_on : str
        Under this key the library is found again.
    deadline : float
        Time of `time.perf_counter` at which compiling is given up.
    folder : Path, optional
        Where it is kept; else in the folder that is used.

    Returns
    -------
    library : Path
    is_new : bool
        Whether it was compiled now.

    Raises
    ------
    CompilationError
        If the compiler refuses the generated code, or nothing can be written.
    CompilationTimeout
        If the deadline passes before the library is there.
    """
    from mbocp.programme.c_files import CText  # what is compiled already needs none of it

    text = CText.of(functions.values())
    unit = _Unit(cc, _flags_for(cc, text), number_of_lanes(), text)
    check_deadline(deadline, "the functions were written in C")
    library = find_entry(unit.name)
    is_new = library is None
    if library is None:
        given = None if folder is None else folder / unit.name
        library = _compile_into_folder(unit, deadline) if given is None else _compile(unit, given, deadline)
    remember(depends_on, library)
    return library, is_new


def _flags() -> tuple[str, ...]:
    return (*_OPTIMISE, *instruction_flags(), *_FLAGS)


@cache
def sources_digest() -> str:
    """Digest of what turns functions into tapes and C: a change there makes old entries stale."""
    own = Path(__file__)
    sources = (own, *(own.with_name(name) for name in _SOURCES))
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()


def _translation(cc: tuple[str, ...] | None, flags: Collection[str]) -> tuple[str, ...]:
    """What C is translated for and how; options of the compiler may change what is computed."""
    return (platform.machine(), " ".join((*flags, *(cc[1:] if cc is not None else ()))))


def _flags_for(cc: tuple[str, ...], text: CText) -> tuple[str, ...]:
    """Flags by how much of it CasADi has written."""
    if sum(written.count("\n") for written in text.others) > _LONG:
        return ("-O0", *instruction_flags(), *_FLAGS)
    return _flags() if _is_clang(cc) else (*_flags(), *_LEFT_OUT)


def _is_clang(cc: tuple[str, ...]) -> bool:
    """Whether the compiler, or what a wrapper calls, is named Clang: it refuses options of GCC's."""
    names = (Path(word).resolve().name for word in cc if not word.startswith("-"))
    return any("clang" in name or "ziglang" in name for name in names)


@dataclass(frozen=True)
class _Unit:
    """What is compiled together: by which compiler, with which flags."""

    cc: tuple[str, ...]
    flags: tuple[str, ...]
    lanes: int
    text: CText

    @property
    def name(self) -> str:
        """Of the library."""
        written = (str(self.lanes), *self.text.texts)
        return f"{key_of(*written, *_translation(self.cc, self.flags))}.so"

    @cached_property
    def files(self) -> list[str]:
        """Of the source, for the cores that there are; one where this process is a worker among others."""
        return self.text.files(self.lanes, min(available_threads(), _MOST_FILES))


def _compile_into_folder(unit: _Unit, deadline: float) -> Path:
    """Compile into the folder that is used; where it cannot be written, into a temporary one."""
    folder = cache_folder()
    try:
        if not is_private(folder):
            try:
                return _compile(unit, folder / unit.name, deadline)
            except OSError as error:
                folder = private_folder(folder, str(error))
        return _compile(unit, folder / unit.name, deadline)
    except OSError as error:
        raise CompilationError(
            f"compiled functions cannot be written: {error}; make room, or set MBOCP_CACHE_DIR to a folder "
            "that can be written to"
        ) from error


def _compile(unit: _Unit, library: Path, deadline: float) -> Path:
    if library.is_dir():  # nothing could be moved into its place
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(library))
    with scratch_folder(library.parent) as scratch:
        built = scratch / "stage.so"
        files = [scratch / f"stage{i}.c" for i in range(len(unit.files))]
        for file, text in zip(files, unit.files, strict=True):
            file.write_text(text, encoding="utf-8")
        compile_one = [*unit.cc, *unit.flags]
        if len(files) == 1:
            run_compiler([*compile_one, "-o", str(built), str(files[0]), "-lm"], scratch, deadline)
        else:
            objects = [str(file.with_suffix(".o")) for file in files]
            parts = [[*compile_one, "-c", "-o", o, str(file)] for o, file in zip(objects, files, strict=True)]
            run_compiler([*compile_one, "-o", str(built), *objects, "-lm"], scratch, deadline, before=parts)
        body = built.read_bytes() if built.is_file() else b""
        if not body:
            raise CompilationError(
                f"the C compiler {unit.cc[0]} reports no error, but has made no library; set CC to one that "
                "works"
            )
        built.write_bytes(seal(body))
        built.replace(library)
    trim_after(library.parent, len(body))
    return library
