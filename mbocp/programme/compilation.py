"""Stage functions as the kernel calls them: tapes at once, machine code where it pays; both cached on disk.

An entry has two keys, what the functions depend on and their C code, see `mbocp.programme.library`. It is one
shared library with a checksum behind it, written under a temporary name and moved into place, so that
several processes can fill the cache at once and a torn or foreign file is noticed and rebuilt. Where the
folder cannot be written, a temporary one takes its place. Until there is a library, the kernel executes the
instructions of the functions, for many stages at a time; see `mbocp.programme.tapes`. Once that has taken as
long as a compiler would, one runs beside the solves, and the next one takes its library.
"""

from __future__ import annotations

import atexit
import contextlib
import math
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import field
from functools import cache, cached_property, lru_cache
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import casadi as ca

from mbocp._arrays import dataclass
from mbocp._text import warn_caller
from mbocp.exceptions import CompilationTimeout
from mbocp.programme.background import BackgroundCompiler
from mbocp.programme.cache import environment, is_sound, is_trusted
from mbocp.programme.compiler import check_deadline, compiler
from mbocp.programme.library import key_of, library_key, library_of, make_library, sources_digest
from mbocp.programme.native_modules import kernel, number_of_lanes
from mbocp.programme.tapes import COMPILED, TAPES, Tapes, function_policy, is_tape, open_tape

if TYPE_CHECKING:
    from mbocp._native._kernel import StageFunction

_SAFETY = 4.0  # of the estimate of a compiler's time, where a solve that has a deadline need not wait for it


class NoCompilerWarning(UserWarning):
    """No C compiler at run time: stage functions are interpreted, two to four times slower."""


class BackgroundCompilerWarning(UserWarning):
    """Functions could not be compiled beside the solves: they stay tapes in this process."""


class CompiledFunctions:
    """Where the functions of one shape are to be had: a shared library, or tapes.

    Attributes
    ----------
    library : Path or None
        The shared library.
    tapes : Tapes or None
        When there is no library.
    compiled_now : bool
        Whether this call had to compile.
    later : LateFunctions, optional
        Further functions of the shape.
    opened : dict of str to StageFunction
        Tapes that the kernel has read, which are only copied, as reading takes long.
    compile_now : callable, optional
        Gives the same functions as a library.
    """

    opened: dict[str, StageFunction]
    compile_now: Callable[[], CompiledFunctions] | None = None

    def __init__(
        self,
        library: Path | None,
        tapes: Tapes | None,
        compiled_now: bool,
        later: LateFunctions | None = None,
    ) -> None:
        self.library, self.tapes, self.compiled_now = library, tapes, compiled_now
        self.later, self.opened = later, {}

    @classmethod
    def interpret(cls, functions: Mapping[str, ca.Function]) -> CompiledFunctions:
        """Functions that no compiler is asked for: the kernel executes their instructions."""
        return cls(None, Tapes.of(functions), compiled_now=False)

    @property
    def identity(self) -> str:
        """The same for the same functions, in this process."""
        held = {} if self.tapes is None else self.tapes.held
        return str(self.library or hash(tuple(sorted(held.items()))))

    def with_later(self, later: LateFunctions) -> CompiledFunctions:
        """These functions and further ones."""
        both = CompiledFunctions(self.library, self.tapes, self.compiled_now, later)
        both.opened, both.compile_now = self.opened, self.compile_now
        return both

    def with_name(self, name: str) -> CompiledFunctions:
        """Where a function is: among those that come later, if it is there."""
        return self.later.functions_beside(self) if self.later and name in self.later.names else self

    def with_stage_function(self, name: str) -> CompiledFunctions:
        """Where the kernel finds a function: here, too, if what stands for a later one is a tape.

        A tape holds the instructions alone that its own outputs need, as that of the later function does.
        """
        here = None if self.tapes is None else self.tapes.held.get(name)
        return self if here is not None and is_tape(here) else self.with_name(name)

    def compile(self) -> CompiledFunctions:
        """The same functions, compiled first if they are tapes and there is a compiler.

        Raises
        ------
        CompilationError
            If the compiler refuses the generated code, or nothing can be written.
        """
        if self.library is not None or self.compile_now is None:
            return self
        found = self.compile_now()
        return found if self.later is None else found.with_later(self.later)

    def function(self, name: str) -> ca.Function:
        """One of the functions, for CasADi's own solvers."""
        home = self.with_name(name)
        if home.tapes is None:
            return _external(name, str(home.library))
        return home.tapes.functions[name]

    def stage_function(self, name: str) -> StageFunction:
        """One of the functions, for the kernel."""
        if self.tapes is None:
            return _open(name, str(self.library)).copy()
        if name not in self.opened:
            self.opened[name] = open_tape(self.tapes.held[name])
        return self.opened[name].copy()

    def __getstate__(self) -> dict[str, Any]:
        """For another process, which reads tapes anew and does not know how functions are made."""
        return {**self.__dict__, "opened": {}, "compile_now": None}


class LateFunctions:
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


@lru_cache(maxsize=256)
def _open(name: str, library: str) -> StageFunction:
    """A function that is only copied: loading its library and looking into it takes ten times as long."""
    return kernel().StageFunction.from_library(library, name)


def load_functions(
    key: str,
    build: Callable[[], dict[str, ca.Function]],
    *,
    deadline: float = math.inf,
    at_once: bool = False,
) -> CompiledFunctions:
    """Functions of the shape `key`: as a library if there is one, else as tapes, or compiled now.

    Parameters
    ----------
    key : str
        Text that stands for everything the functions depend on, the sources that write them included.
    build : callable
        Gives the CasADi functions by name; only called when the cache has no sound entry of this key.
    deadline : float
        Time of `time.perf_counter` at which compiling is given up.
    at_once : bool
        Whether they are compiled now unless $MBOCP_FUNCTIONS forbids it: CasADi's solvers know no tapes.

    Raises
    ------
    CompilationError
        If the compiler refuses the generated code, or nothing can be written.
    CompilationTimeout
        If the deadline passes before the functions are there.
    """
    policy = function_policy()
    place = _place(f"{key}{sources_digest()}{number_of_lanes()}", environment())
    asked = _Request(key, build, place, deadline)
    if policy == TAPES:
        return asked.as_tapes()
    if place.is_sound:
        return asked.as_library()
    compiles = at_once or policy == COMPILED
    if place.tapes is not None and not compiles and not asked.is_compiled_meanwhile():
        return asked.as_tapes()
    cc = compiler()
    place.library = library_of(library_key(key, cc))
    if place.library is not None:
        return asked.as_library()
    if cc is None:
        if compiles:
            _warn_no_compiler()
        return asked.as_tapes()
    if not compiles and not (asked.tapes.pay_compiling() and asked.has_time_to_compile):
        return asked.as_tapes()
    return asked.compile(cc)


@dataclass(eq=False)
class _Place:
    """Where this process has found functions before."""

    library: Path | None = None
    tapes: Tapes | None = None
    opened: dict[str, StageFunction] = field(default_factory=dict)
    beside: BackgroundCompiler | None = None

    @property
    def num_instructions(self) -> int:
        """Instructions of tapes that the kernel has executed so far."""
        return sum(tape.num_executed for tape in self.opened.values())

    def count_instructions(self) -> None:
        """Tell later processes, at the end of this one, unless there is a library."""
        if self.tapes is not None:
            self.tapes.count_instructions(self.num_instructions)

    @property
    def is_sound(self) -> bool:
        """Whether the library is still what was found."""
        try:
            return self.library is not None and is_trusted(self.library.parent) and is_sound(self.library)
        except OSError:  # the folder has gone
            return False


@dataclass(frozen=True)
class _Request:
    """What `load_functions` was asked for, and where this process has found it before."""

    key: str
    build: Callable[[], dict[str, ca.Function]]
    place: _Place
    deadline: float

    @cached_property
    def functions(self) -> dict[str, ca.Function]:
        check_deadline(self.deadline, "the functions were to be built")
        built = self.build()
        check_deadline(self.deadline, "the functions were built")
        return built

    @property
    def tapes(self) -> Tapes:
        """What this process has read before, what is in the cache, or written now."""
        place = self.place
        if place.tapes is None:
            key = key_of(self.key, sources_digest(), ca.CasadiMeta.version(), kernel().TAPE_FORMAT)
            place.tapes = Tapes.read(key) or Tapes.of(self.functions).keep(key)
            atexit.register(place.count_instructions)
        return place.tapes

    def as_tapes(self) -> CompiledFunctions:
        found = CompiledFunctions(None, self.tapes, compiled_now=False)
        found.opened, found.compile_now = self.place.opened, self._compile_now
        return found

    def as_library(self, *, is_new: bool = False) -> CompiledFunctions:
        self.place.tapes = None  # it is not needed any more
        return CompiledFunctions(self.place.library, None, is_new)

    def compile(self, cc: tuple[str, ...]) -> CompiledFunctions:
        self.place.library, is_new = make_library(
            self._sources(), cc, library_key(self.key, cc), deadline=self.deadline
        )
        return self.as_library(is_new=is_new)

    def _sources(self) -> Mapping[str, ca.Function]:
        """The functions as they were built: to read them from a file takes a fraction of the time."""
        if self.place.tapes is not None:
            with contextlib.suppress(OSError):
                return self.place.tapes.functions
        return self.functions

    @property
    def has_time_to_compile(self) -> bool:
        """Whether a compiler would end long before the deadline, by a rough estimate."""
        return time.perf_counter() + _SAFETY * self.tapes.compiler_time < self.deadline

    def is_compiled_meanwhile(self) -> bool:
        """Whether a compiler has run beside the solves; one is started as soon as that pays."""
        beside = self.place.beside
        if beside is None:
            if self.tapes.pay_compiling(self.place.num_instructions):
                self._begin_compiling()
            return False
        if beside.is_running:
            return False
        if beside.failure:
            _warn_failure(beside.failure)
        return not beside.failure

    def _begin_compiling(self) -> None:
        cc, file = compiler(), self.tapes.file
        if cc is None:
            _warn_no_compiler()
        elif file is not None:
            self.place.beside = BackgroundCompiler(file, library_key(self.key, cc))

    def _compile_now(self) -> CompiledFunctions:
        return load_functions(self.key, self.build, at_once=True)


@lru_cache(maxsize=256)
def _place(key: str, set_by_user: tuple[str | None, ...]) -> _Place:
    """Of functions that depend on `key`: nothing is hashed, and no folder is searched, a second time."""
    return _Place()


@cache
def _warn_no_compiler() -> None:
    warn_caller(
        "no C compiler found: stage functions are interpreted, two to four times slower; pip install "
        "mbocp[compiler], or install gcc (Debian: apt install gcc), or set CC",
        NoCompilerWarning,
    )


@cache
def _warn_failure(reason: str) -> None:
    warn_caller(
        f"functions cannot be compiled beside the solves ({reason}); they stay tapes in this process: "
        "`mbocp doctor` says whether the C compiler works, MBOCP_FUNCTIONS=compiled what it says",
        BackgroundCompilerWarning,
    )
