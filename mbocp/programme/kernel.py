"""A kernel programme made from a stagewise programme."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array
from mbocp.programme.bounds import StateBounds
from mbocp.programme.native_modules import kernel
from mbocp.programme.stagewise import StagewiseProgramme

if TYPE_CHECKING:
    from mbocp._native._kernel import StageFunction
    from mbocp.programme.native_modules import KernelProgramme


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
        return (programme.end_functions if of_end else programme.functions).stage_function(name)

    of_sweeps = programme.functions.with_stage_function("jacobian") if sweeps else programme.functions

    k = programme.kind
    kind = native.Kind(
        nx=k.nx,
        ndx=k.ndx,
        ny=k.ny,
        nu=k.nu,
        nr=k.nr,
        values=function("values"),
        jacobian=of_sweeps.stage_function("jacobian"),
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
        programme.num_steps, kind, terminal, function("retract"), function("difference"), num_threads=threads
    )
    made.set_parameters(programme.theta, programme.rho, programme.rho_terminal)
    if has_limits:
        set_bounds(made, programme, sides(programme.bounds), num_guards=programme.num_guards)
    return made


def set_bounds(
    native: KernelProgramme, programme: StagewiseProgramme, sides: Mapping[str, Array], *, num_guards: int
) -> None:
    """Give a kernel programme bounds, and the functions of `programme` that they are for; slacks are zero."""
    stages, end, has_path = programme.functions, programme.end_functions, bool(programme.bounds.nh)
    native.set_limits(
        **sides,
        path=stages.stage_function("path") if has_path else None,
        path_values=stages.stage_function("path_values") if has_path else None,
        num_guards=num_guards,
        guard=end.stage_function("guard") if num_guards else None,
    )


def sides(bounds: StateBounds) -> dict[str, Array]:
    """Bounds of all nodes in a row, or of one where all are the same."""
    found: dict[str, Array] = {}
    for what in ("x", "u", "path"):
        names = (f"{what}_lower", f"{what}_upper")
        rows = [getattr(bounds, name) for name in names]
        is_one = all((side == side[0]).all() for side in rows)
        found |= {
            name: np.array(side[0]) if is_one else side.ravel()
            for name, side in zip(names, rows, strict=True)
        }
    return found
