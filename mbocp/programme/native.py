"""The native modules: the kernel, of which there are two builds, and what helps interior-point solvers."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Protocol

from mbocp.exceptions import NativeMismatch
from mbocp.programme.processor import has_avx2

# The modules may be missing, and the kernel is one of two builds with the same names. Solvers take from here
# the types of what the kernel gives them.
if TYPE_CHECKING:
    from mbocp._native._kernel import (
        Care,
        Filter,
        Kind,
        Newton,
        NewtonState,
        Programme,
        RecedingHorizon,
        Sizes,
        StageFunction,
        Terminal,
    )
    from mbocp._native._kernel import Evaluation as Evaluation
    from mbocp._native._kernel import Factorisation as Factorisation
    from mbocp._native._kernel import Trial as Trial

    KernelCare = Care
    KernelFilter = Filter
    KernelNewton = Newton
    KernelNewtonState = NewtonState
    KernelHorizon = RecedingHorizon
    KernelProgramme = Programme


class Kernel(Protocol):
    """What both builds of the kernel offer."""

    @property
    def __name__(self) -> str:
        """Of the module."""

    @property
    def __file__(self) -> str | None:
        """Where it is."""

    @property
    def TAPE_FORMAT(self) -> str:
        """With which the bytes of tapes begin."""

    def write_c(self, serialised: str) -> tuple[list[str], str] | None:
        """Functions in C that may stand in different files, and what is called from outside."""

    @property
    def StageFunction(self) -> type[StageFunction]:
        """A compiled or interpreted function of a stage."""

    @property
    def Kind(self) -> type[Kind]:
        """Functions and sizes of one kind of stage."""

    @property
    def Terminal(self) -> type[Terminal]:
        """Functions of the end."""

    @property
    def Care(self) -> type[KernelCare]:
        """Rules by which a shift of the Hessian changes."""

    @property
    def Filter(self) -> type[KernelFilter]:
        """What later iterates may not be worse than."""

    @property
    def Trial(self) -> type[Trial]:
        """What a line search looks at."""

    @property
    def Newton(self) -> type[KernelNewton]:
        """Newton's method with safeguards."""

    def relative_residual(self, allowed: Sizes, primal: float, dual: float, tolerance: float) -> float:
        """The residual in units of what round-off allows of its parts."""

    @property
    def RecedingHorizon(self) -> type[KernelHorizon]:
        """The loop over a horizon that moves on."""

    @property
    def Programme(self) -> type[KernelProgramme]:
        """The programme with its iterate."""


class NlpHelpers(Protocol):
    """What helps interior-point solvers."""

    def begin_whole_lines(self) -> None:
        """Pass on what CasADi prints in whole lines only."""

    def end_whole_lines(self) -> None:
        """Pass it on as it comes again."""


@cache
def kernel() -> Kernel:
    """The kernel module: the AVX2 build where the processor has it, else the portable one."""
    try:
        from mbocp._native import _kernel
    except ImportError as error:
        raise NativeMismatch(
            f"the native kernel cannot be loaded ({error}); build it with `make` or `pip install .`"
        ) from error
    if has_avx2():
        try:
            from mbocp._native import _kernel_avx2
        except ImportError:  # other processor families are built without it
            return _kernel
        return _kernel_avx2
    return _kernel


@cache
def nlp_helpers() -> NlpHelpers:
    """The module that helps interior-point solvers."""
    try:
        from mbocp._native import _nlp
    except ImportError as error:
        raise NativeMismatch(
            f"the native part cannot be loaded ({error}); build it with `make` or `pip install .`"
        ) from error
    return _nlp
