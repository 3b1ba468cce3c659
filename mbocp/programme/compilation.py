"""Stage functions as machine code, compiled once and cached on disk.

An entry has two keys, what the functions depend on and their C code, see `mbocp.programme.keys`. It is one
shared library with a checksum behind it, written under a temporary name and moved into place, so that
several processes can fill the cache at once and a torn or foreign file is noticed and rebuilt. Where the
folder cannot be written, a temporary one takes its place. Without a C compiler the kernel executes the
instructions of the functions, for many stages at a time.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import math
import os
import platform
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from importlib.metadata import version
from pathlib import Path
from threading import Lock

import casadi as ca

from mbocp._environment import available_threads
from mbocp._warn import warn_caller
from mbocp.exceptions import CompilationError, CompilationTimeout
from mbocp.programme.cache import (
    cache_folder,
    cached,
    environment,
    is_private,
    is_sound,
    is_trusted,
    private_folder,
    scratch_folder,
    sealed,
    trim,
)
from mbocp.programme.compiler import check_deadline, compiler, run_compiler
from mbocp.programme.keys import key_of, library_of, remember
from mbocp.programme.lanes import Lanes
from mbocp.programme.processor import instruction_flags, number_of_lanes

_FLAGS = ("-fno-math-errno", "-fPIC", "-shared", "-w")
# All that -O2 or -O3 gain on such code, compiled in half the time or a third of it.
_OPTIMISE = ("-O1", "-fexpensive-optimizations", "-fschedule-insns2", "-fstrict-aliasing")
# Passes of GCC that find nothing in functions in lanes, which say everything once: a fifth of the time.
_LEFT_OUT = (
    *("-fno-tree-fre", "-fno-tree-sink", "-fno-tree-sra", "-fno-tree-ccp", "-fno-tree-copy-prop"),
    *("-fno-tree-dominator-opts", "-fno-tree-dse", "-fno-tree-dce", "-fno-dse", "-fno-cprop-registers"),
    *("-fno-ipa-modref", "-fno-ipa-pure-const", "-fno-ipa-reference"),
)
# Before registers are chosen: of dense functions 4 % less, and after it nothing more; of others 5 % more.
_SCHEDULE = ("-fschedule-insns", "-fsched-pressure", "-fno-schedule-insns2")
_DENSE = 10  # operations per number that goes in or out: joint coordinates have dozens, natural ones 5
_MOST_FILES = 4
# What turns functions into C, beside this module; imported when there is something to compile.
_SOURCES = (
    *("splitting.py", "pieces.py", "generated.py", "rewriting.py", "composed.py", "lanes.py", "processor.py"),
    *("composed.h", "lanes.h"),
)
_LARGE = 150_000  # operations of a function beyond which optimising it takes most of a minute: -O0, then
_LARGE_END = 20_000  # the same for what is called once where others are called at every step
_LONGEST = 4_000_000  # instructions of a function that is interpreted


class NoCompilerWarning(UserWarning):
    """No C compiler at run time: stage functions are interpreted, two to four times slower."""


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
    later : Later, optional
        Further functions of the shape.
    """

    def __init__(
        self,
        library: Path | None,
        serialised: Mapping[str, str],
        compiled_now: bool,
        later: Later | None = None,
    ) -> None:
        self.library, self.serialised, self.compiled_now = library, dict(serialised), compiled_now
        self.later = later

    @classmethod
    def interpreted(cls, functions: Mapping[str, ca.Function]) -> CompiledFunctions:
        """Functions that no compiler is asked for: the kernel executes their instructions."""
        texts = {name: _as_operations(function).serialize() for name, function in functions.items()}
        return cls(None, texts, compiled_now=False)

    def with_later(self, later: Later) -> CompiledFunctions:
        """These functions and further ones."""
        return CompiledFunctions(self.library, self.serialised, self.compiled_now, later)

    def with_name(self, name: str) -> CompiledFunctions:
        """Where a function is: among those that come later, if it is there."""
        return self.later.functions_beside(self) if self.later and name in self.later.names else self

    def function(self, name: str) -> ca.Function:
        """One of the functions, for CasADi's own solvers."""
        home = self.with_name(name)
        if home.library is not None:
            return _external(name, str(home.library))
        return ca.Function.deserialize(home.serialised[name])


class Later:
    """Functions of a shape that most solves do not ask for: compiled when one of them is asked for first.

    Parameters
    ----------
    names : collection of str
    load : callable
        Loads them.
    """

    def __init__(self, names: Collection[str], load: Callable[[], CompiledFunctions]) -> None:
        self.names = frozenset(names)
        self._load: Callable[[], CompiledFunctions] | None = load
        self._found: CompiledFunctions | None = None
        self._lock = Lock()

    def functions_beside(self, others: CompiledFunctions) -> CompiledFunctions:
        """The functions; where the time for a solve is over before they are compiled, those of the others."""
        try:
            return self._functions()
        except CompilationTimeout:
            return others

    def _functions(self) -> CompiledFunctions:
        with self._lock:
            if self._found is None and self._load is not None:
                self._found = self._load()
            if self._found is None:
                raise CompilationTimeout("functions were to be compiled")
            return self._found

    def __getstate__(self) -> tuple[frozenset[str], CompiledFunctions | None]:
        """For another process, which is to call the same functions, and does not know how they are made."""
        with contextlib.suppress(CompilationTimeout):
            self._functions()
        return self.names, self._found

    def __setstate__(self, state: tuple[frozenset[str], CompiledFunctions | None]) -> None:
        self.names, self._found = state
        self._load, self._lock = None, Lock()


@lru_cache(maxsize=256)
def _external(name: str, library: str) -> ca.Function:
    return ca.external(name, library)


def load_functions(
    key: str,
    build: Callable[[], dict[str, ca.Function]],
    *,
    of_end: bool = False,
    in_lanes: Collection[str] = (),
    deadline: float = math.inf,
) -> CompiledFunctions:
    """Functions of the shape `key`, from the cache or compiled now.

    Parameters
    ----------
    key : str
        Text that stands for everything the functions depend on, the sources that write them included.
    build : callable
        Gives the CasADi functions by name; only called when the cache has no sound entry of this key.
    of_end : bool
        They are called once in an evaluation, and not at every step: compiling is worth less.
    in_lanes : collection of str
        Names of those that are called at many steps at once.
    deadline : float
        Time of `time.perf_counter` at which compiling is given up.

    Raises
    ------
    CompilationError
        If the compiler refuses the generated code, or nothing can be written.
    CompilationTimeout
        If the deadline passes before the functions are there.
    """
    wide = Lanes(number_of_lanes(), frozenset(in_lanes))
    place = _place(f"{key}{_sources_digest()}", wide, environment())
    if place.is_sound:
        return CompiledFunctions(place.library, {}, compiled_now=False)
    cc = compiler()
    if cc is None and place.serialised:
        return CompiledFunctions(None, place.serialised, compiled_now=False)
    depends_on = key_of(key, str(wide), _sources_digest(), _casadi_version(), *_translation(cc, _flags()))
    place.library = library_of(depends_on)
    if place.library is not None:
        return CompiledFunctions(place.library, {}, compiled_now=False)
    check_deadline(deadline, "the functions were to be built")
    functions = build()
    check_deadline(deadline, "the functions were built")
    if cc is None:
        _warn_no_compiler()
        interpreted = CompiledFunctions.interpreted(functions)
        place.serialised = interpreted.serialised
        return interpreted
    functions = {name: _merged(function) for name, function in functions.items()}
    check_deadline(deadline, "equal parts of the functions were merged")
    flags = _flags_for(cc, functions.values(), _LARGE_END if of_end else _LARGE, has_lanes=bool(in_lanes))
    unit = _Unit(cc, flags, _source(functions, wide))
    check_deadline(deadline, "the functions were written in C")
    known = cached(unit.name)
    library = _compiled(unit, deadline) if known is None else known
    remember(depends_on, library)
    place.library = library
    return CompiledFunctions(library, {}, compiled_now=known is None)


@dataclass(eq=False)
class _Place:
    """Where this process has found functions before."""

    library: Path | None = None
    serialised: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_sound(self) -> bool:
        """Whether the library is still what was found."""
        try:
            return self.library is not None and is_trusted(self.library.parent) and is_sound(self.library)
        except OSError:  # the folder has gone
            return False


@lru_cache(maxsize=1024)
def _place(key: str, wide: Lanes, set_by_user: tuple[str | None, ...]) -> _Place:
    """Of functions that depend on `key`: nothing is hashed, and no folder is searched, a second time."""
    return _Place()


@cache
def _warn_no_compiler() -> None:
    warn_caller(
        "no C compiler found: stage functions are interpreted, two to four times slower; pip install "
        "mbocp[compiler], or install gcc (Debian: apt install gcc), or set CC",
        NoCompilerWarning,
    )


def _as_operations(function: ca.Function) -> ca.Function:
    """Return a function of the same values whose instructions are operations on numbers, if there is one.

    One that calls another library, or would become too long, is returned as it is.
    """
    if function.is_a("SXFunction") or _operations(function) * _most_calls(function) > _LONGEST:
        return function
    inputs = [ca.SX.sym(function.name_in(i), function.sparsity_in(i)) for i in range(function.n_in())]
    try:
        outputs = function.call(inputs, True, False)
    except RuntimeError:  # CasADi: what it calls has numbers alone
        return function
    return ca.Function(function.name(), inputs, outputs, function.name_in(), function.name_out())


def _merged(function: ca.Function) -> ca.Function:
    """Return a function that works out equal subexpressions once; tapes do so by themselves, and faster."""
    if not function.is_a("SXFunction"):
        return function
    inputs = [ca.SX.sym(function.name_in(i), function.sparsity_in(i)) for i in range(function.n_in())]
    outputs = ca.cse(function.call(inputs))
    return ca.Function(function.name(), inputs, outputs, function.name_in(), function.name_out())


def _most_calls(function: ca.Function) -> int:
    """Return a bound of how often a function is called within another one."""
    calls = sum(function.instruction_id(k) == ca.OP_CALL for k in range(function.n_instructions()))
    maps = [inner.size2_in(0) for inner in function.find_functions() if inner.is_a("Map")]
    return max(calls, 1) * max(maps, default=1)


@cache
def _casadi_version() -> str:
    return version("casadi")


def _flags() -> tuple[str, ...]:
    return (*_OPTIMISE, *instruction_flags(), *_FLAGS)


@cache
def _sources_digest() -> str:
    """Digest of what turns functions into C: a change there makes old entries stale."""
    own = Path(__file__)
    sources = (own, *(own.with_name(name) for name in _SOURCES))
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()


def _translation(cc: tuple[str, ...] | None, flags: Collection[str]) -> tuple[str, ...]:
    """What C is translated for and how; options of the compiler may change what is computed."""
    return (platform.machine(), " ".join((*flags, *(cc[1:] if cc is not None else ()))))


def _flags_for(
    cc: tuple[str, ...], functions: Collection[ca.Function], most: int, *, has_lanes: bool
) -> tuple[str, ...]:
    """Flags by the largest function; `most` operations are worth optimising."""
    largest = max(functions, key=_operations)
    operations = _operations(largest)
    if operations > most:
        return ("-O0", *instruction_flags(), *_FLAGS)
    if _is_clang(cc):
        return _flags()
    is_dense = operations >= _DENSE * (largest.nnz_in() + largest.nnz_out())
    return (*_flags(), *(_LEFT_OUT if has_lanes else ()), *(_SCHEDULE if is_dense else ()))


def _operations(function: ca.Function) -> int:
    """Of a function and of what it calls, each once."""
    called = {inner.__hash__(): inner for inner in function.find_functions()}.values()
    inside = sum(inner.n_instructions() for inner in called if inner.is_a("SXFunction"))
    return int(function.n_instructions() + inside)


def _is_clang(cc: tuple[str, ...]) -> bool:
    """Whether the compiler, or what a wrapper calls, is named Clang: it refuses options of GCC's."""
    names = (Path(word).resolve().name for word in cc if not word.startswith("-"))
    return any("clang" in name or "ziglang" in name for name in names)


def _source(functions: Mapping[str, ca.Function], wide: Lanes) -> str:
    """Functions in C, some of them in lanes."""
    from mbocp.programme.splitting import split_functions  # what is compiled already needs none of it

    generator = ca.CodeGenerator("stage.c")
    for function in functions.values():
        generator.add(function)
    return split_functions(generator.dump(), of_lanes=wide if wide.number > 1 and wide.functions else None)


@dataclass(frozen=True)
class _Unit:
    """What is compiled together: by which compiler, with which flags."""

    cc: tuple[str, ...]
    flags: tuple[str, ...]
    source: str

    @cached_property
    def name(self) -> str:
        """Of the library."""
        return f"{key_of(self.source, *_translation(self.cc, self.flags))}.so"

    @cached_property
    def files(self) -> list[str]:
        """Of the source, for the cores that there are; one where this process is a worker among others."""
        from mbocp.programme.files import spread

        return spread(self.source, min(available_threads(), _MOST_FILES))


def _compiled(unit: _Unit, deadline: float) -> Path:
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
        built.write_bytes(sealed(body))
        built.replace(library)
    trim(library.parent)
    return library
