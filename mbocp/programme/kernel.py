"""The native kernel, and a kernel programme made from a stagewise programme."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import NativeMismatch
from mbocp.programme.bounds import StateBounds
from mbocp.programme.compilation import CompiledFunctions
from mbocp.programme.processor import has_avx2
from mbocp.programme.stagewise import StagewiseProgramme

# The modules may be missing, and the kernel is one of two builds with the same names. Solvers take from here
# the types of what the kernel gives them.
if TYPE_CHECKING:
    from mbocp._native._kernel import (
        Care,
        Direction,
        Kind,
        Programme,
        RecedingHorizon,
        StageFunction,
        Terminal,
    )
    from mbocp._native._kernel import Evaluation as Evaluation
    from mbocp._native._kernel import Factorisation as Factorisation
    from mbocp._native._kernel import Trial as Trial

    KernelCare = Care
    KernelDirection = Direction
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


def kernel_programme(
    programme: StagewiseProgramme, *, has_limits: bool = False, threads: int = 1, sweeps: bool = False
) -> KernelProgramme:
    """Kernel programme with the functions and parameters of `programme`; the iterate is all zeros.

    Parameters
    ----------
    programme : StagewiseProgramme
    has_limits : bool
        Whether its bounds and guards are part of it.
    threads : int
        So many share the work on its stages.
    sweeps : bool
        Whether it is there for simulations and sweeps: these then call a function of first derivatives alone,
        which may have to be compiled, and not the one of all derivatives.
    """
    native = kernel()

    def function(name: str) -> StageFunction:
        of_end = name.startswith("terminal")
        return _stage_function(native, programme.end_functions if of_end else programme.functions, name)

    of_sweeps = programme.functions.with_name("jacobian") if sweeps else programme.functions

    k = programme.kind
    kind = native.Kind(
        nx=k.nx,
        ndx=k.ndx,
        ny=k.ny,
        nu=k.nu,
        nr=k.nr,
        values=function("values"),
        jacobian=_stage_function(native, of_sweeps, "jacobian"),
        complete=function("complete"),
        scale_c=np.ascontiguousarray(k.scale_c),
        scale_y=np.ascontiguousarray(k.scale_y),
        scale_m=np.ascontiguousarray(k.scale_m),
        scale_ru=np.ascontiguousarray(k.scale_ru),
        groups=[(first, rows, list(columns)) for first, rows, columns in k.groups],
        turning=k.turning.tolist(),
    )
    terminal = native.Terminal(
        ng=programme.ng, values=function("terminal_values"), complete=function("terminal_complete")
    )
    made = native.Programme(
        programme.num_steps,
        kind,
        terminal,
        function("retract"),
        function("difference"),
        num_threads=threads,
    )
    made.set_parameters(programme.theta, programme.rho, programme.rho_terminal)
    if has_limits:
        bounds = programme.bounds
        made.set_limits(
            **sides(bounds),
            path=function("path") if bounds.nh else None,
            path_values=function("path_values") if bounds.nh else None,
            num_guards=programme.num_guards,
            guard=_stage_function(native, programme.end_functions, "guard") if programme.num_guards else None,
        )
    return made


def sides(bounds: StateBounds) -> dict[str, Array]:
    """Bounds of all nodes in a row, or of one where all are the same."""
    sides: dict[str, Array] = {}
    for what in ("x", "u", "path"):
        names = (f"{what}_lower", f"{what}_upper")
        rows = [getattr(bounds, name) for name in names]
        is_one = all((side == side[0]).all() for side in rows)
        sides |= {
            name: np.array(side[0]) if is_one else side.ravel()
            for name, side in zip(names, rows, strict=True)
        }
    return sides


def _stage_function(native: Kernel, functions: CompiledFunctions, name: str) -> StageFunction:
    if functions.library is not None:
        return _open(str(functions.library), name).copy()
    read = functions.opened.get(name)
    if read is None:
        read = functions.opened[name] = native.StageFunction.from_string(functions.serialised[name])
    return read.copy()


@lru_cache(maxsize=256)
def _open(library: str, name: str) -> StageFunction:
    """A function that is only copied: loading its library and looking into it takes ten times as long."""
    return kernel().StageFunction.from_library(library, name)
