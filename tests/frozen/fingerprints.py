"""Fingerprints of problems: their text, their programme, and the programme's functions at an iterate."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import mbocp
from mbocp._files import parse_toml
from mbocp.formulation import Formulation, formulate
from mbocp.guesses.make import guess_candidates, plain_guess
from mbocp.problem.file.tables import problem_to_toml
from mbocp.problem.problem import problem_from_tables
from mbocp.programme import StagewiseProgramme
from mbocp.solvers.newton_method.newton import start

EXAMPLES = Path(__file__).parents[2] / "examples"
RECORD = Path(__file__).parent / "problems.json"
_SOLVED = ("joint", "solution")  # guesses that take another solve
_NO_PROBLEMS = ("robot.toml", "lattice.toml", "pendulum_goals.toml")  # robots and studies

PENDULUM = {
    "robot": "double_pendulum",
    "horizon": {"duration": 1.5, "steps": 20},
    "goal": {"q": [2.0, -1.0], "v": 0},
    "cost": {"velocity": 0.01},
}
# Of each: the tables of a pendulum's file that differ. Schemes, coordinates and features that no example has.
VARIATIONS: dict[str, dict[str, Any]] = {
    **{
        f"pendulum, {scheme}": {"integrator": {"scheme": scheme}}
        for scheme in ("se1", "se2", "semi_implicit_euler", "midpoint", "gauss1", "gauss2", "gauss3",
                       "lobatto2", "lobatto3", "euler", "heun", "rk4", "rkf5")
    },
    "pendulum, natural coordinates": {"coordinates": "natural", "integrator": {"scheme": "se1"}},
    "pendulum, linear controls": {
        "horizon": {"duration": 1.5, "steps": 20, "controls": "linear"},
        "limits": {"effort": 3.0, "velocity": 6.0},
    },
    "pendulum, controls at the stages": {
        "horizon": {"duration": 1.5, "steps": 20, "controls": "stages"},
        "limits": {"effort": 3.0},
    },
    "pendulum, penalty and tracking": {
        "goal": {"q": [2.0, -1.0], "v": 0, "enforce": "penalty"},
        "cost": {"terminal": 1e3, "tracking": 0.1},
    },
    "pendulum, rates": {"limits": {"acceleration": 30.0, "jerk": 900.0, "effort_rate": 50.0}},
    "pendulum, least time": {
        "horizon": {"duration": {"min": 0.2, "max": 3.0}, "steps": 20},
        "cost": {"time": 1.0},
        "limits": {"effort": 20.0},
    },
    "pendulum, via": {"via": [{"q": [1.0, 0.5], "share": 0.5}]},
}  # fmt: skip


def problem_names() -> list[str]:
    """Names of all problems: files of examples, then variations."""
    files = sorted(p for p in EXAMPLES.rglob("*.toml") if p.name not in _NO_PROBLEMS)
    return [*(str(p.relative_to(EXAMPLES)) for p in files), *VARIATIONS]


def make_problem(name: str) -> mbocp.Problem:
    """The problem of that name."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if name in VARIATIONS:
            return problem_from_tables({**PENDULUM, **VARIATIONS[name]}, label=name)
        return mbocp.load_problem(EXAMPLES / name)


def fingerprint(problem: mbocp.Problem) -> dict[str, Any]:
    """What a problem comes to, as plain numbers and words."""
    formulation = formulate(problem)
    return {
        "text": text_of(problem),
        "formulation": type(formulation).__name__,
        "programme": _programme(formulation.programme),
        "functions": _functions(formulation),
    }


def text_of(problem: mbocp.Problem) -> dict[str, Any]:
    """Tables of a problem's text; files of the checkout by their place in it."""
    found: dict[str, Any] = parse_toml(problem_to_toml(problem).replace(f"{EXAMPLES.parent}/", ""))
    return found


def _programme(programme: StagewiseProgramme) -> dict[str, Any]:
    k = programme.kind
    sizes = [k.nx, k.ndx, k.ny, k.nu, k.nr]
    arrays = {
        "theta": programme.theta, "rho": programme.rho, "rho_terminal": programme.rho_terminal,
        "x_start": programme.x_start,
        "x_lower": programme.bounds.x_lower, "x_upper": programme.bounds.x_upper,
        "u_lower": programme.bounds.u_lower, "u_upper": programme.bounds.u_upper,
        "path_lower": programme.bounds.path_lower, "path_upper": programme.bounds.path_upper,
    }  # fmt: skip
    rows = [(0, row) for row in range(k.ndx + k.ny)] + [(-1, row) for row in range(programme.ng)]
    return {
        "steps": programme.num_steps,
        "kinds": [sizes],
        "unknowns": programme.num_unknowns,
        "end rows": [programme.ng, programme.num_guards],
        "path": list(programme.path_names),
        "words": hashlib.sha256("\n".join(programme.describe_row(*row) for row in rows).encode()).hexdigest(),
        "arrays": {name: _digest(np.asarray(values, dtype=float)) for name, values in arrays.items()},
    }


def _digest(values: np.ndarray) -> list[float]:
    """Size, number of finite entries, and two sums that depend on all of these and on their places."""
    flat = values.ravel()
    finite = np.isfinite(flat)
    shown = np.where(finite, flat, 0.0)
    places = np.cos(np.arange(flat.size))
    return [flat.size, int(finite.sum()), float(np.abs(shown).sum()), float(shown @ places)]


def _functions(formulation: Formulation) -> list[float]:
    """Cost, violation and residuals of the programme at a guess with random multipliers."""
    kinds = (kind for kind in guess_candidates(formulation.problem) if kind not in _SOLVED)
    iterate, _ = plain_guess(next(kinds), formulation)
    rng = np.random.default_rng(0)
    changed = replace(
        iterate,
        ms=rng.standard_normal(iterate.ms.shape),
        us=iterate.us + rng.standard_normal(iterate.us.shape),
        eta=rng.standard_normal(iterate.eta.shape),
    )
    at = start(formulation.programme, changed).evaluation
    return [at.cost, at.violation, at.primal, at.dual]


def equals(now: Any, then: Any, rtol: float = 1e-9) -> bool:
    """Whether two fingerprints are the same."""
    if isinstance(then, Mapping):
        return now.keys() == then.keys() and all(equals(now[key], then[key], rtol) for key in then)
    if isinstance(then, list):
        return len(now) == len(then) and all(equals(*pair, rtol) for pair in zip(now, then, strict=True))
    if isinstance(then, float):
        return bool(np.isclose(now, then, rtol=rtol, atol=1e-12, equal_nan=True))
    return bool(now == then)
