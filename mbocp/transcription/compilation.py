"""Stage functions as machine code, compiled once per problem shape and cached on disk.

An entry is one shared library with a checksum behind it, written under a temporary name and moved into
place, so that several processes can fill the cache at once and a torn or foreign file is noticed and
rebuilt. Without a C compiler the functions run in CasADi's virtual machine.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import stat
import subprocess
import tempfile
import warnings
from collections.abc import Callable, Collection, Mapping
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path

import casadi as ca

from mbocp.exceptions import CompilationError
from mbocp.transcription.splitting import split_functions

__all__ = ["CompiledFunctions", "NoCompilerWarning", "cache_folder", "compiler", "has_avx2", "load_functions"]

_FLAGS = ("-fno-math-errno", "-fPIC", "-shared", "-w")
# All that -O2 or -O3 gain on such code, compiled in half the time or a third of it.
_OPTIMISE = ("-O1", "-fexpensive-optimizations", "-fschedule-insns2", "-fstrict-aliasing")
_FUSED = ("-mavx2", "-mfma")  # a fifth less time
_SCHEDULE = ("-fschedule-insns", "-fsched-pressure")  # of dense functions 4 % less, of others 5 % more
_DENSE = 10  # operations per number that goes in or out: joint coordinates have dozens, natural ones 5
_LARGE = 150_000  # operations of a function beyond which optimising it takes most of a minute: -O0, then
_LARGE_END = 20_000  # the same for what is called once where others are called at every step
_MAGIC = b"mbocp-stage-1:"  # then the SHA-256 of all that stands before it
_TRAILER = len(_MAGIC) + 64


class NoCompilerWarning(UserWarning):
    """No C compiler at run time: stage functions are interpreted, about fifteen times slower."""


class CompiledFunctions:
    """Where the functions of one shape are to be had: a shared library, or serialised CasADi functions.

    Attributes
    ----------
    library : Path or None
        The shared library.
    serialised : Mapping[str, str]
        CasADi's text of each function, when there is no library.
    compiled_now : bool
        Whether this call had to compile.
    """

    def __init__(self, library: Path | None, serialised: Mapping[str, str], compiled_now: bool) -> None:
        self.library, self.serialised, self.compiled_now = library, dict(serialised), compiled_now

    def function(self, name: str) -> ca.Function:
        """One of the functions, for CasADi's own solvers."""
        if self.library is not None:
            return _external(name, str(self.library))
        return ca.Function.deserialize(self.serialised[name])


@lru_cache(maxsize=256)
def _external(name: str, library: str) -> ca.Function:
    return ca.external(name, library)


@cache
def has_avx2() -> bool:
    """Whether the processor has AVX2 and fused multiplication and addition; told by Linux alone."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    line = next((line for line in text.splitlines() if line.startswith("flags")), "")
    return {"avx2", "fma"} <= set(line.split())


def compiler() -> str | None:
    """Path of the C compiler that is used: $CC, else cc, gcc or clang; None when there is none."""
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        found = shutil.which(name) if name else None
        if found:
            return found
    return None


def cache_folder() -> Path:
    """Folder of compiled stage functions: $MBOCP_CACHE_DIR, else $XDG_CACHE_HOME/mbocp, else ~/.cache/mbocp.

    The folder is created for the user alone; one that somebody else owns or may write to is not used, since
    its content is loaded as code: a private temporary folder takes its place for this process.
    """
    named = os.environ.get("MBOCP_CACHE_DIR")
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mbocp"
    folder = (Path(named) if named else base) / "stages"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        state = folder.stat()
        trusted = state.st_uid == os.getuid() and not state.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        reason = "somebody else may write to it"
    except OSError as error:
        trusted, reason = False, str(error)
    return folder if trusted else _private_folder(str(folder), reason)


@cache
def _private_folder(folder: str, reason: str) -> Path:
    warnings.warn(
        f"the cache of compiled functions {folder} is not used: {reason}; mend it (chmod 700, owner) or set "
        "MBOCP_CACHE_DIR. Compiling into a temporary folder.",
        RuntimeWarning,
        stacklevel=3,
    )
    return Path(tempfile.mkdtemp(prefix="mbocp-"))


def load_functions(
    key: str, build: Callable[[], dict[str, ca.Function]], *, of_end: bool = False
) -> CompiledFunctions:
    """Functions of the shape `key`, from the cache or compiled now.

    Parameters
    ----------
    key : str
        Text that stands for everything the functions depend on.
    build : callable
        Gives the CasADi functions by name; only called when the cache has no sound entry.
    of_end : bool
        They are called once in an evaluation, and not at every step: compiling is worth less.

    Raises
    ------
    CompilationError
        If the compiler refuses the generated code.
    """
    material = "\n".join([key, _sources_digest(), _casadi_version(), platform.machine(), " ".join(_flags())])
    digest = hashlib.sha256(material.encode()).hexdigest()[:32]
    folder = cache_folder()
    library = folder / f"{digest}.so"
    if _is_sound(library):
        return CompiledFunctions(library, {}, compiled_now=False)
    cc = compiler()
    if cc is None:
        _warn_no_compiler()
        return CompiledFunctions(
            None, {name: f.serialize() for name, f in build().items()}, compiled_now=False
        )
    _compile(cc, build(), library, _LARGE_END if of_end else _LARGE)
    return CompiledFunctions(library, {}, compiled_now=True)


@cache
def _warn_no_compiler() -> None:
    warnings.warn(
        "no C compiler found: stage functions are interpreted, about fifteen times slower; install gcc "
        "(Debian: apt install gcc) or set CC",
        NoCompilerWarning,
        stacklevel=2,
    )


@cache
def _casadi_version() -> str:
    return version("casadi")


@cache
def _flags() -> tuple[str, ...]:
    return (*_OPTIMISE, *(_FUSED if has_avx2() else ()), *_FLAGS)


@cache
def _sources_digest() -> str:
    """Digest of the modules that write the stage functions: a change in them makes old entries stale."""
    root = Path(__file__).parent.parent
    digest = hashlib.sha256()
    folders = [root / name for name in ("lie", "mechanics", "integrators", "transcription", "symbolic")]
    sources = [source for folder in folders for source in sorted(folder.glob("*.py"))]
    for source in (*sources, root / "robot" / "constraint_equations.py"):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _is_sound(library: Path) -> bool:
    try:
        state = library.stat()
    except OSError:
        return False
    return state.st_uid == os.getuid() and _has_checksum(library, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=1024)
def _has_checksum(library: Path, changed_ns: int, size: int) -> bool:
    """Whether the file ends with the checksum of the rest; looked at once for each state of the file."""
    try:
        content = library.read_bytes()
    except OSError:
        return False
    body, trailer = content[:-_TRAILER], content[-_TRAILER:]
    return trailer == _MAGIC + hashlib.sha256(body).hexdigest().encode()


def _flags_for(functions: Collection[ca.Function], most: int) -> tuple[str, ...]:
    """Flags by the largest function; `most` operations are worth optimising."""
    largest = max(functions, key=lambda function: function.n_instructions())
    operations = largest.n_instructions()
    if operations > most:
        return ("-O0", *_FLAGS)
    is_dense = operations >= _DENSE * (largest.nnz_in() + largest.nnz_out())
    return (*_flags(), *(_SCHEDULE if is_dense else ()))


def _compile(cc: str, functions: Mapping[str, ca.Function], library: Path, most: int) -> None:
    with tempfile.TemporaryDirectory(dir=library.parent, prefix="build-") as scratch:
        generator = ca.CodeGenerator("stage.c")
        for function in functions.values():
            generator.add(function)
        generator.generate(scratch + os.sep)
        source, built = Path(scratch) / "stage.c", Path(scratch) / "stage.so"
        source.write_text(split_functions(source.read_text(encoding="utf-8")), encoding="utf-8")
        command = [cc, *_flags_for(functions.values(), most), "-o", str(built), str(source), "-lm"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError as error:
            raise CompilationError(
                f"cannot run the C compiler {cc}: {error}; set CC to one that works"
            ) from error
        if done.returncode != 0:
            raise CompilationError(
                f"the C compiler {cc} failed on generated functions (exit {done.returncode}); set CC to "
                f"another compiler. It said:\n{done.stderr[-2000:]}"
            )
        body = built.read_bytes()
        built.write_bytes(body + _MAGIC + hashlib.sha256(body).hexdigest().encode())
        built.replace(library)
