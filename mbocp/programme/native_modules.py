"""Native modules for the processor that there is: two builds of the kernel, and what helps other solvers."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Protocol

from mbocp._environment import number_from
from mbocp._processes import signals_wait
from mbocp.exceptions import InvalidValue, NativeMismatch

_NEEDED = {4: frozenset({"avx2", "fma"}), 8: frozenset({"avx2", "fma", "avx512f", "avx512dq", "avx512vl"})}
_ARM = ("aarch64", "arm64")  # NEON is in all of them
_WIDTHS = (1, 4, 8)  # doubles of a vector register that functions are written for


def _features() -> frozenset[str]:
    """Names of what the processor has; told by Linux alone."""
    return _features_of(platform.machine())


@cache
def _features_of(machine: str) -> frozenset[str]:
    if machine not in ("x86_64", "AMD64"):  # an emulated program reads of the processor beneath it
        return frozenset()
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        return frozenset()
    return frozenset(next((line for line in text.splitlines() if line.startswith("flags")), "").split())


def has_avx2() -> bool:
    """Whether the processor has AVX2 and fused multiplication and addition."""
    return _features() >= _NEEDED[4]


def has_lanes() -> bool:
    """Whether functions are written for several stages at once: for AVX2 and NEON."""
    return has_avx2() or platform.machine() in _ARM


def number_of_lanes() -> int:
    """At how many stages functions are called at once: 8 with AVX-512, 4 with AVX2 or NEON, else 1.

    $MBOCP_LANES takes another of these numbers; without such vectors it is always 1.

    Raises
    ------
    InvalidValue
        If that is set to another number.
    """
    expected = f"one of the numbers {', '.join(map(str, _WIDTHS))}"
    named = number_from("MBOCP_LANES", expected)
    if named is not None and named not in _WIDTHS:
        raise InvalidValue("MBOCP_LANES", str(named), expected)
    if not has_lanes():
        return 1
    return int(named) if named is not None else 8 if _features() >= _NEEDED[8] else 4


def instruction_flags() -> tuple[str, ...]:
    """Options of a C compiler for the instructions that the processor has: a fifth less time, and lanes."""
    if not has_avx2():
        return ()
    wide = ("-mavx512f", "-mavx512dq", "-mavx512vl", "-mprefer-vector-width=512")
    return ("-mavx2", "-mfma", *(wide if number_of_lanes() == 8 and _features() >= _NEEDED[8] else ()))


# The modules may be missing, and the kernel is one of two builds with the same names. Solvers take from here
# the types of what the kernel gives them.
if TYPE_CHECKING:
    from mbocp._native import _kernel as built

    Evaluation = built.Evaluation
    Factorisation = built.Factorisation
    KernelFilter = built.Filter
    KernelFlow = built.Flow
    KernelNewton = built.Newton
    KernelNewtonState = built.NewtonState
    KernelHorizon = built.RecedingHorizon
    KernelProgramme = built.Programme


class Kernel(Protocol):
    """What both builds of the kernel offer."""

    __name__: str  # of the module
    __file__: str | None  # where it is
    TAPE_FORMAT: str  # with which the bytes of tapes begin
    StageFunction: type[built.StageFunction]  # a compiled or interpreted function of a stage
    Flow: type[KernelFlow]  # of a robot under the controls of steps
    Kind: type[built.Kind]  # functions and sizes of one kind of stage
    Terminal: type[built.Terminal]  # functions of the end
    Care: type[built.Care]  # rules by which a shift of the Hessian changes
    Filter: type[KernelFilter]  # what later iterates may not be worse than
    Trial: type[built.Trial]  # what a line search looks at
    Newton: type[KernelNewton]  # Newton's method with safeguards
    RecedingHorizon: type[KernelHorizon]  # the loop over a horizon that moves on
    Programme: type[KernelProgramme]  # the programme with its iterate

    def write_c(self, function: object) -> tuple[list[str], str] | None:
        """C of a `casadi.Function`: parts that may stand in different files, and what others call."""

    def relative_residual(self, allowed: built.Sizes, primal: float, dual: float, tolerance: float) -> float:
        """The residual in units of what round-off allows of its parts."""


@cache
def kernel() -> Kernel:
    """The kernel module: the AVX2 build where the processor has it, else the portable one."""
    with explain_native_loading("kernel"):
        if has_avx2():
            from mbocp._native import _kernel_avx2

            return _kernel_avx2
        from mbocp._native import _kernel
    return _kernel


def nlp_helpers() -> ModuleType:
    """The module that helps interior-point solvers."""
    with explain_native_loading():
        from mbocp._native import _nlp
    return _nlp


@contextmanager
def explain_native_loading(what: str = "part") -> Iterator[None]:
    """Around imports of native modules: an error that says how to build what cannot be loaded."""
    try:
        with signals_wait():  # what begins a module aborts where an exception breaks it off
            yield
    except ImportError as error:
        raise NativeMismatch(
            f"the native {what} cannot be loaded ({error}); build it with `make` or `pip install .`"
        ) from error
