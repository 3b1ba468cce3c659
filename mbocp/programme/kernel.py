"""The native kernel, and a kernel programme made from a stagewise programme."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from mbocp.exceptions import NativeMismatch
from mbocp.programme.compilation import CompiledFunctions, has_avx2
from mbocp.programme.stagewise import StagewiseProgramme

__all__ = ["kernel", "kernel_programme", "nlp_helpers"]


@cache
def kernel() -> Any:
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
def nlp_helpers() -> Any:
    """The module that helps interior-point solvers."""
    try:
        from mbocp._native import _nlp
    except ImportError as error:
        raise NativeMismatch(
            f"the native part cannot be loaded ({error}); build it with `make` or `pip install .`"
        ) from error
    return _nlp


def kernel_programme(programme: StagewiseProgramme, *, has_limits: bool = False) -> Any:
    """Kernel programme with the functions and parameters of `programme`; the iterate is all zeros.

    Its bounds and guards are part of it with `has_limits`, and have room between them then.
    """
    native = kernel()

    def function(name: str) -> Any:
        of_end = name.startswith("terminal")
        return _stage_function(native, programme.end_functions if of_end else programme.functions, name)

    kinds = [
        native.Kind(
            nx=k.nx,
            ndx=k.ndx,
            ny=k.ny,
            nu=k.nu,
            nr=k.nr,
            values=function("values"),
            jacobian=function("jacobian"),
            complete=function("complete"),
            scale_c=np.ascontiguousarray(k.scale_c),
            scale_y=np.ascontiguousarray(k.scale_y),
            scale_m=np.ascontiguousarray(k.scale_m),
            scale_ru=np.ascontiguousarray(k.scale_ru),
            groups=[(first, rows, list(columns)) for first, rows, columns in k.groups],
        )
        for k in programme.kinds
    ]
    terminal = native.Terminal(
        ng=programme.ng, values=function("terminal_values"), complete=function("terminal_complete")
    )
    made = native.Programme(
        kinds, list(programme.stage_kind), terminal, function("retract"), function("difference")
    )
    made.set_parameters(programme.theta, programme.rho, programme.rho_terminal)
    if has_limits:
        bounds = programme.bounds
        made.set_limits(
            x_lower=bounds.x_lower,
            x_upper=bounds.x_upper,
            u_lower=bounds.u_lower,
            u_upper=bounds.u_upper,
            path_lower=bounds.path_lower,
            path_upper=bounds.path_upper,
            path=function("path") if bounds.nh else None,
            num_guards=programme.num_guards,
            guard=_stage_function(native, programme.end_functions, "guard") if programme.num_guards else None,
        )
    return made


def _stage_function(native: Any, functions: CompiledFunctions, name: str) -> Any:
    if functions.library is not None:
        return native.StageFunction.from_library(str(functions.library), name)
    return native.StageFunction.from_string(functions.serialised[name])
