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
        Flow,
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
    KernelFlow = Flow
    KernelNewton = Newton
    KernelNewtonState = NewtonState
    KernelHorizon = RecedingHorizon
    KernelProgramme = Programme


class Kernel(Protocol):
    """What both builds of the kernel offer."""

    __name__: str  # of the module
    __file__: str | None  # where it is
    TAPE_FORMAT: str  # with which the bytes of tapes begin
    StageFunction: type[StageFunction]  # a compiled or interpreted function of a stage
    Flow: type[KernelFlow]  # of a robot under the controls of steps
    Kind: type[Kind]  # functions and sizes of one kind of stage
    Terminal: type[Terminal]  # functions of the end
    Care: type[KernelCare]  # rules by which a shift of the Hessian changes
    Filter: type[KernelFilter]  # what later iterates may not be worse than
    Trial: type[Trial]  # what a line search looks at
    Newton: type[KernelNewton]  # Newton's method with safeguards
    RecedingHorizon: type[KernelHorizon]  # the loop over a horizon that moves on
    Programme: type[KernelProgramme]  # the programme with its iterate

    def write_c(self, function: object) -> tuple[list[str], str] | None:
        """C of a `casadi.Function`: parts that may stand in different files, and what others call."""

    def relative_residual(self, allowed: Sizes, primal: float, dual: float, tolerance: float) -> float:
        """The residual in units of what round-off allows of its parts."""


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
        if has_avx2():
            from mbocp._native import _kernel_avx2

            return _kernel_avx2
        from mbocp._native import _kernel
    except ImportError as error:
        raise NativeMismatch(
            f"the native kernel cannot be loaded ({error}); build it with `make` or `pip install .`"
        ) from error
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
