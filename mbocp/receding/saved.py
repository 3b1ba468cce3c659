"""A receding horizon in a folder, for C++ programs without Python: `mbocp/receding_horizon.hpp` opens it.

The folder holds the compiled functions of the stages and of the end, the library that steps the horizon, and
a text file with all numbers, in which each has the bits that it has here.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import NativeMismatch, ProblemError, ResultFileError
from mbocp.formulation import Formulation
from mbocp.programme import StagewiseProgramme
from mbocp.programme.kernel import sides
from mbocp.programme.native_modules import kernel
from mbocp.solution.atomic import replace_text
from mbocp.solvers.receding import RecedingSettings

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelHorizon, KernelProgramme

HEADERS = Path(__file__).parents[1] / "_native" / "include"  # for a C++ compiler: -I
_VERSION = 1  # of the text file and of the library's functions
_NUMBERS, _LIBRARY = "controller.txt", "libmbocp_receding.so"
_LOOKED_AT = 5  # configurations


def check_savable(formulation: Formulation, *, is_plain: bool, belongs_to_times: bool) -> None:
    """Refuse a horizon that C++ cannot step without Python.

    Parameters
    ----------
    formulation : Formulation
    is_plain : bool
        Whether the programme's states are (q, v).
    belongs_to_times : bool
        Whether parameters move with the time, as `ParameterUpdates.move_on` moves them.

    Raises
    ------
    ProblemError
        If states or goals are stored otherwise than as configurations and velocities, parameters move, or
        functions are interpreted.
    """
    robot, programme = formulation.problem.robot, formulation.programme
    if not is_plain or not _keeps_configurations(formulation):
        raise ProblemError(
            f"receding horizon: robot {robot.name!r}: states of the solver are not (q, v), which C++ cannot "
            'make of what is measured; take coordinates = "joint", rotations = "quaternion" and no drives'
        )
    if belongs_to_times:
        raise ProblemError(
            "receding horizon: cost: a target is a trajectory, or a term depends on the time itself, and C++ "
            "moves neither; give one row, and others in each step, and write the term without t"
        )
    if programme.functions.library is None or programme.end_functions.library is None:
        raise ProblemError(
            "receding horizon: there is no C compiler, or MBOCP_FUNCTIONS forbids one, so that there is "
            "nothing to save"
        )


def _keeps_configurations(formulation: Formulation) -> bool:
    """Whether goals are stored as configurations."""
    robot, rng = formulation.problem.robot, np.random.default_rng(0)
    moves = rng.standard_normal((_LOOKED_AT, robot.nv))
    qs = np.array([robot.integrate(formulation.problem.q_start, move) for move in moves])
    return bool(np.array_equal(formulation.pieces.joints.coordinates(qs), qs))


def write_horizon(
    folder: str | Path,
    formulation: Formulation,
    horizon: KernelHorizon,
    native: KernelProgramme,
    settings: RecedingSettings,
    places: Mapping[str, slice],
    numbers: Mapping[str, Array],
) -> Path:
    """Write a folder that a C++ program goes on from, as the horizon here would.

    Parameters
    ----------
    folder : str or Path
        Made where there is none.
    formulation : Formulation
    horizon : KernelHorizon
    native : KernelProgramme
        The programme that it steps.
    settings : RecedingSettings
    places : mapping of str to slice
        Of parameters that a step may change, see `ParameterUpdates.places`.
    numbers : mapping of str to ndarray
        Further ones: parameters, the state, Newton steps.

    Raises
    ------
    ResultFileError
        If something cannot be written.
    """
    folder, programme = Path(folder), formulation.programme
    stages, end = programme.functions.library, programme.end_functions.library
    if stages is None or end is None:
        raise ProblemError("receding horizon: there are no compiled functions to save")
    table = {
        "version": [_VERSION],
        **_of_programme(programme, native),
        **{name: [getattr(formulation.problem.robot, name)] for name in ("nq", "nv", "nu")},
        "dt": [formulation.problem.dt],
        "tolerance": [settings.tolerance],
        "barrier_share": [settings.barrier],
        "shift_unit": [programme.control_weight],
        "turning": programme.kind.turning,
        "memory": horizon.memory,
        "prediction_x": horizon.x,
        "prediction_u": horizon.u,
        "gains": horizon.gains,
        **{name: [place.start, place.stop] if place.stop > 0 else [] for name, place in places.items()},
        **numbers,
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for source, name in ((stages, "stages.so"), (end, "end.so"), (_library(), _LIBRARY)):
            part = folder / f".{name}"
            shutil.copyfile(source, part)
            part.replace(folder / name)  # what a program has open stays as it was
        lines = [_line(name, np.asarray(values, dtype=np.float64)) for name, values in table.items()]
        replace_text(folder / _NUMBERS, "\n".join(lines) + "\n")
    except OSError as error:
        raise ResultFileError(folder, f"cannot be written: {error}") from error
    return folder


def _line(name: str, values: Array) -> str:
    return " ".join([name, str(values.size), *(float(value).hex() for value in values.ravel())])


def _library() -> Path:
    """The library that steps horizons, of the same build as the kernel."""
    module = kernel()
    name = "libmbocp_receding_avx2.so" if module.__name__.endswith("avx2") else "libmbocp_receding.so"
    library = Path(str(module.__file__)).with_name(name)
    if not library.is_file():
        raise NativeMismatch(
            f"{library}: {os.strerror(errno.ENOENT)}; build it with `make` or `pip install .`"
        )
    return library


def _of_programme(programme: StagewiseProgramme, native: KernelProgramme) -> dict[str, object]:
    """Sizes, scaling, iterate and limits."""
    kind, bounds = programme.kind, programme.bounds
    found: dict[str, object] = {
        "num_steps": [programme.num_steps],
        "ng": [programme.ng],
        **{name: [getattr(kind, name)] for name in ("nx", "ndx", "ny", "nr")},
        "nu_all": [kind.nu],
        **{name: getattr(kind, name) for name in ("scale_c", "scale_y", "scale_m", "scale_ru")},
        **{name: getattr(native, name) for name in ("x", "y", "u", "m", "eta")},
        "has_limits": [int(native.slack.size > 0)],
    }
    if native.slack.size:
        found |= sides(bounds)
        found |= {
            "num_guards": [programme.num_guards],
            "has_path": [int(bounds.nh > 0)],
            "barrier": [native.barrier],
            **{name: getattr(native, name) for name in ("slack", "z_lower", "z_upper")},
        }
    return found
