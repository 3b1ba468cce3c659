"""Stage functions as tapes: data that the kernel executes, kept in the folder of compiled functions.

A file holds the functions of a shape twice: each as the bytes of the kernel's tape, or as CasADi's text where
it cannot be one; and all together as they were built, what they share once, which is what is compiled and
what CasADi's own solvers call. It carries a checksum, as libraries do, and is read under the same conditions.
"""

from __future__ import annotations

import contextlib
import io
import os
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca

from mbocp._arrays import dataclass
from mbocp.exceptions import InvalidValue
from mbocp.programme.cache import counter_of, find_entry, own_content, scratch_folder, unseal, write_entry
from mbocp.programme.native_modules import kernel

if TYPE_CHECKING:
    from mbocp._native._kernel import StageFunction

AUTO, COMPILED, TAPES = "auto", "compiled", "tapes"
_POLICIES = (AUTO, COMPILED, TAPES)
_LONGEST = 4_000_000  # instructions of a function that is interpreted
_TOGETHER, _OPERATIONS, _EACH = "together", "operations", "each/"  # entries of a file
# Processor time [s], measured: of an instruction of a tape for all stages of a call, while CasADi's virtual
# machine executes two for one stage; of a compiler, to begin and for an operation.
_INSTRUCTION, _COMPILER, _COMPILED_OPERATION = 5e-9, 0.1, 45e-6


def function_policy() -> str:
    """How functions are called: as $MBOCP_FUNCTIONS says, "compiled", "tapes" or "auto"; else "auto".

    Raises
    ------
    InvalidValue
        If that is set to another word.
    """
    named = os.environ.get("MBOCP_FUNCTIONS") or AUTO
    if named not in _POLICIES:
        raise InvalidValue("MBOCP_FUNCTIONS", repr(named), f"one of {', '.join(_POLICIES)}")
    return named


@dataclass(frozen=True)
class Tapes:
    """Functions of a shape as data.

    Attributes
    ----------
    held : mapping of str to bytes
        Each function, see `open_tape`.
    operations : int
        How many a compiler has to translate.
    built : mapping of str to casadi.Function
        As they were built; empty where they are in the file.
    file : Path or None
        Where they are kept.
    executed_before : int
        Instructions that processes before this one have executed.
    """

    held: Mapping[str, bytes]
    operations: int
    built: Mapping[str, ca.Function]
    file: Path | None = None
    executed_before: int = 0

    @classmethod
    def of(cls, functions: Mapping[str, ca.Function]) -> Tapes:
        """Write functions as data, in no file."""
        held = {name: _write(function) for name, function in functions.items()}
        return cls(held, sum(map(count_operations, functions.values())), functions)

    @cached_property
    def functions(self) -> Mapping[str, ca.Function]:
        """As they were built.

        Raises
        ------
        OSError
            If they are in a file that is there no more, or damaged.
        """
        return self.built if self.built or self.file is None else functions_in(self.file)

    @classmethod
    def read(cls, key: str) -> Tapes | None:
        """Read what `keep` wrote, where it is the user's and sound."""
        file = find_entry(f"{key}.tape")
        content = None if file is None else unseal(file)
        if file is None or content is None:
            return None
        try:
            with zipfile.ZipFile(io.BytesIO(content)) as held:
                names = [name for name in held.namelist() if name.startswith(_EACH)]
                each = {name.removeprefix(_EACH): held.read(name) for name in names}
                return cls(each, int(held.read(_OPERATIONS)), {}, file, _count_executed(file))
        except (zipfile.BadZipFile, zlib.error, KeyError, ValueError):
            return None

    def keep(self, key: str) -> Tapes:
        """Write them into the folder; where that fails they are in no file."""
        content, together = io.BytesIO(), ca.StringSerializer()
        together.pack(list(self.built.values()))
        with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as held:
            held.writestr(_OPERATIONS, str(self.operations))
            held.writestr(_TOGETHER, together.encode())
            for name, each in self.held.items():
                held.writestr(f"{_EACH}{name}", each)
        return replace(self, file=write_entry(f"{key}.tape", content.getvalue()))

    def pay_compiling(self, executed: int = 0) -> bool:
        """Whether so many instructions, and those before, took as long as a compiler takes for all of it."""
        return (self.executed_before + executed) * _INSTRUCTION >= self.compiler_time

    @property
    def compiler_time(self) -> float:
        """Time that a compiler takes, roughly [s]."""
        return _COMPILER + self.operations * _COMPILED_OPERATION

    def count_instructions(self, executed: int) -> None:
        """Tell later processes how many instructions this one has executed, where that can be written."""
        if self.file is None or executed == 0:
            return
        with contextlib.suppress(OSError), scratch_folder(self.file.parent) as scratch:
            written = scratch / "executed"
            written.write_text(str(_count_executed(self.file) + executed), encoding="ascii")
            written.replace(counter_of(self.file))


def _count_executed(file: Path) -> int:
    digits = own_content(counter_of(file)) or b""
    return int(digits) if digits.isdigit() else 0


def functions_in(file: Path) -> dict[str, ca.Function]:
    """Read the functions as they were built from a file of tapes.

    Raises
    ------
    OSError
        If it is not the user's, or damaged.
    """
    content = unseal(file)
    if content is None:
        raise OSError(f"{file} is damaged")
    with zipfile.ZipFile(io.BytesIO(content)) as held:
        names = [name.removeprefix(_EACH) for name in held.namelist() if name.startswith(_EACH)]
        return _unpack(held.read(_TOGETHER).decode(), names)


def _unpack(packed: str, names: Iterable[str]) -> dict[str, ca.Function]:
    return dict(zip(names, ca.StringDeserializer(packed).unpack(), strict=True))


def _write(function: ca.Function) -> bytes:
    numeric = as_operations(function)
    return kernel().StageFunction.of(numeric).as_tape() or numeric.serialize().encode()


def open_tape(held: bytes) -> StageFunction:
    """Return the kernel's function of what `Tapes` hold of one: a tape, or CasADi's text."""
    native = kernel()
    if is_tape(held):
        return native.StageFunction.from_tape(held)
    return native.StageFunction.from_string(held.decode())


def is_tape(held: bytes) -> bool:
    """Whether what `Tapes` hold of a function are the kernel's instructions."""
    return held.startswith(kernel().TAPE_FORMAT.encode())


def as_operations(function: ca.Function) -> ca.Function:
    """Return a function of the same values whose instructions are operations on numbers, if there is one.

    One that calls another library, or would become too long, is returned as it is.
    """
    if function.is_a("SXFunction") or _count_written_out(function) > _LONGEST:
        return function
    inputs = [ca.SX.sym(function.name_in(i), function.sparsity_in(i)) for i in range(function.n_in())]
    try:
        outputs = function.call(inputs, True, False)
    except RuntimeError:  # CasADi: what it calls has numbers alone
        return function
    return ca.Function(function.name(), inputs, outputs, function.name_in(), function.name_out())


def count_operations(function: ca.Function) -> int:
    """Of a function and of what it calls, each once."""
    called = {inner.__hash__(): inner for inner in function.find_functions()}.values()
    inside = sum(inner.n_instructions() for inner in called if inner.is_a("SXFunction"))
    own = function.n_instructions() if function.is_a("SXFunction") or function.is_a("MXFunction") else 0
    return int(own + inside)


def _count_written_out(function: ca.Function) -> int:
    """Of a function with all of its calls written out, where operations on arrays count once."""
    if function.is_a("Map"):
        return int(function.info()["n"] * _count_written_out(function.info()["f"]))
    if not function.is_a("MXFunction"):
        return int(function.n_instructions()) if function.is_a("SXFunction") else 1
    count = function.n_instructions()
    called = (k for k in range(count) if function.instruction_id(k) == ca.OP_CALL)
    return int(count + sum(_count_written_out(function.instruction_MX(k).which_function()) for k in called))
