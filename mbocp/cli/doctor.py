"""`mbocp doctor`: what works on this machine, and what to do about what does not."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import typer

from mbocp.cli import signals
from mbocp.cli.app import Json
from mbocp.exceptions import MbocpError

Verdict = Literal["ok", "warn", "fail"]

_COLORS = {"ok": "green", "warn": "yellow", "fail": "red"}
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "firefox")
_MINIMUM = (3, 10)
PACKAGES = ("numpy", "scipy", "pydantic", "coal", "h5py", "matplotlib")  # beside those of the native part
EXTRAS = {
    "compiler": "ziglang",
    "dask": "distributed",
    "bench": "toppra",
    "live": "viser",
    "mcap": "mcap",
    "parquet": "pyarrow",
    "rerun": "rerun-sdk",
    "scenes": "coacd",
    "jax": "jax",
    "torch": "torch",
    "xacro": "xacro",
    "xarray": "xarray",
}
_AGREEMENT = (
    1e-9  # relative; two libraries that fit agree to 1e-13, a mismatched pair was wrong in the first digit
)


@dataclass(frozen=True)
class Diagnosis:
    """One thing that was looked at."""

    name: str
    verdict: Verdict
    found: str
    advice: str = ""


def doctor(as_json: Json = False) -> None:
    """Say what works on this machine, and how to mend what does not.

    Exit status: 0 if everything needed works, 1 if not.
    """
    signals.leave_in_order()  # it compiles something
    checks = report()
    works = all(check.verdict != "fail" for check in checks)
    if as_json:
        typer.echo(json.dumps({"works": works, "checks": [asdict(check) for check in checks]}, indent=2))
    else:
        _print(checks)
    raise typer.Exit(0 if works else 1)


def _print(checks: Sequence[Diagnosis]) -> None:
    width = max(len(check.name) for check in checks)
    for check in checks:
        mark = typer.style(check.verdict.rjust(4), fg=_COLORS[check.verdict], bold=True)
        typer.echo(f"{mark}  {check.name.ljust(width)}  {check.found}")
        if check.advice:
            typer.echo(f"{'':4}  {'':{width}}  -> {check.advice}")


def report() -> list[Diagnosis]:
    """Look at everything."""
    return [_safely(name, look) for name, look in _CHECKS.items()]


def _safely(name: str, look: Callable[[], tuple[Verdict, str, str]]) -> Diagnosis:
    """Run a check; one that fails in a way nobody foresaw is a finding, too."""
    try:
        return Diagnosis(name, *look())
    except MbocpError as error:
        return Diagnosis(name, "fail", str(error))
    except Exception as error:
        return Diagnosis(name, "fail", f"{type(error).__name__}: {error}", "run `make setup` again")


def _system() -> tuple[Verdict, str, str]:
    from mbocp import __version__

    return "ok", f"mbocp {__version__} on {platform.platform()}", ""


def _python() -> tuple[Verdict, str, str]:
    found = f"{platform.python_version()} ({sys.executable})"
    if sys.version_info < _MINIMUM:
        return "fail", found, f"mbocp needs Python {'.'.join(map(str, _MINIMUM))} or newer"
    return "ok", found, ""


def _native() -> tuple[Verdict, str, str]:
    """Compare the compiled bridge with numeric Pinocchio on a sample arm."""
    from importlib.metadata import version

    import numpy as np
    import pinocchio as pin

    from mbocp.symbolic import model_functions

    model = pin.buildSampleModelManipulator()
    q, v, tau = pin.neutral(model), np.linspace(-1.0, 1.0, model.nv), np.linspace(1.0, 2.0, model.nv)
    expected = pin.aba(model, model.createData(), q, v, tau)
    got = np.asarray(model_functions(model).aba(q, v, tau)).ravel()
    error = float(np.abs(got - expected).max() / np.abs(expected).max())
    found = f"Pinocchio {version('pin')}, CasADi {version('casadi')}, accelerations agree to {error:.0e}"
    if error > _AGREEMENT:
        return "fail", found, "the compiled part does not fit the installed Pinocchio: run `make clean setup`"
    return "ok", found, ""


def _kernel() -> tuple[Verdict, str, str]:
    from mbocp.programme.native_modules import instruction_flags, kernel

    module = kernel()
    classes = (module.Programme, module.Kind)  # what is missing from a broken build is an AttributeError
    instructions = [flag.removeprefix("-m") for flag in instruction_flags() if "=" not in flag]
    found = f"{module.__name__.rpartition('.')[2]}, with {' and '.join(c.__name__ for c in classes)}"
    return "ok", f"{found}; instructions {', '.join(instructions) or 'of any processor'}", ""


def _packages() -> tuple[Verdict, str, str]:
    from importlib.metadata import version

    return "ok", ", ".join(f"{name} {version(name)}" for name in PACKAGES), ""


def _extras() -> tuple[Verdict, str, str]:
    """Optional packages; what needs one of them says so."""
    from importlib.metadata import PackageNotFoundError, version

    there, missing = [], []
    for extra, name in EXTRAS.items():
        try:
            there.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(f"{name} (mbocp[{extra}])")
    return "ok", f"{', '.join(there) or 'none'}; not installed: {', '.join(missing) or 'none'}", ""


def _compiler() -> tuple[Verdict, str, str]:
    from mbocp.programme.compiler import compiler

    command = compiler()
    if command is None:
        advice = (
            "pip install mbocp[compiler], or install gcc (Debian: apt install gcc), or set CC; until then "
            "loops of many solves take up to twice as long"
        )
        return "warn", "none found", advice
    path = " ".join(command)
    said = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False, timeout=10)
    if said.returncode != 0:
        return "warn", f"{path} does not run", "set CC to a C compiler that works"
    return "ok", f"{path}: {(said.stdout.splitlines() or [''])[0]}", ""


def _cache() -> tuple[Verdict, str, str]:
    from mbocp.programme.cache import cache_folder, cache_limit, entries, is_private, scratch_folder

    folder = cache_folder()
    held = entries(folder)
    size = sum(state.st_size for _, state in held) / 1e6  # [MB]
    found = f"{folder}: {len(held)} libraries and tapes, {size:.1f} of {cache_limit() / 1e6:.0f} MB"
    advice = "every run compiles anew; set MBOCP_CACHE_DIR to a folder of yours"
    if is_private(folder):
        return "warn", found, f"temporary: {advice}"
    try:
        with scratch_folder(folder):
            return "ok", found, ""
    except OSError as error:
        return "warn", found, f"cannot be written ({error}): {advice}"


def _robots() -> tuple[Verdict, str, str]:
    from mbocp.robot import list_robots, load_robot

    count = len(list_robots())
    meshes = load_robot("ur5").visual_model.ngeoms
    found = f"{count} robots by name; ur5 loads with {meshes} meshes"
    if not meshes:
        return "warn", found, "replays show skeletons only: reinstall example-robot-data-loaders"
    return "ok", found, ""


def _browser() -> tuple[Verdict, str, str]:
    found = next((path for path in map(shutil.which, _BROWSERS) if path), None)
    if found is None:
        advice = "not needed here: a replay page is one file that any browser on any machine opens"
        return "warn", "no browser found", advice
    return "ok", found, ""


def _threads() -> tuple[Verdict, str, str]:
    cores = os.cpu_count() or 1
    limits = [
        f"{name}={os.environ[name]}"
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
        if name in os.environ
    ]
    return (
        "ok",
        f"{cores} cores; one problem uses one of them{'; ' + ', '.join(limits) if limits else ''}",
        "",
    )


_CHECKS: dict[str, Callable[[], tuple[Verdict, str, str]]] = {
    "system": _system,
    "Python": _python,
    "packages": _packages,
    "extras": _extras,
    "native part": _native,
    "kernel": _kernel,
    "C compiler": _compiler,
    "stage cache": _cache,
    "robots": _robots,
    "browser": _browser,
    "threads": _threads,
}
