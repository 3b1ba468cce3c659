"""Derivatives of random optima against differences of optima that are solved again, and taken to round-off.

Solves end at a barrier, which keeps optima by 1e-7 and more from limits that hardly pull: for differences
over short steps that is much. Run it by `python -m benchmarks.sensitivities --count 200`. Robot, scheme,
coordinates, weights, limits, starts and the parameter are drawn, until so many are compared. Counted are
optima that agree and that differ, those that are degenerate, so that derivatives of both sides differ, those
whose neighbours are other optima, those that are refused, and solves without optimum. What no file may say,
such as a scheme that does not take some coordinates, is drawn again.
"""

from __future__ import annotations

import argparse
import itertools
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import mbocp
from mbocp.autodiff.solution_map import SolutionMap
from mbocp.exceptions import MbocpError, NotConverged, ProblemFileError
from mbocp.robot.named_numbers import OF_ROBOT, list_named_numbers
from mbocp.sensitivity.optimum import formulate_again
from mbocp.sensitivity.parameters import PARAMETERS

EXAMPLES = Path(__file__).parents[1] / "examples"
BASES = (
    "arms/accurate_lift.toml",
    "arms/cup.toml",
    "arms/past_a_belt.toml",
    "arms/ur5_limits.toml",
    "arms/ur5_reach.toml",
    "arms/kinova_reach.toml",
    "arms/payload.toml",
    "arms/pick_and_place.toml",
    "arms/smooth_torques.toml",
    "arms/via_points.toml",
    "design/gear_ratio.toml",
    "design/five_bar_lengths.toml",
    "loops/four_bar.toml",
    "free_flyer/drone_flip.toml",
    "so3/unicycle_pendulum.toml",
)
SCHEMES = ("", "se1", "midpoint", "gauss2", "rk4")
COORDINATES = ("joint", "natural")
TOLERANCE = 1e-6  # relative
STEPS = (2e-4, 2e-5, 2e-3, 2e-2)  # the second where other limits become active, the others where little moves
TIME_LIMIT = 60.0  # of a solve [s]
POINTS = ((1.0, 8.0 / 12.0), (-1.0, -8.0 / 12.0), (2.0, -1.0 / 12.0), (-2.0, 1.0 / 12.0))


def drawn(rng: np.random.Generator) -> tuple[str, mbocp.Problem]:
    """A random problem and what it is."""
    base, scheme = rng.choice(BASES), rng.choice(SCHEMES)
    coordinates = rng.choice(COORDINATES, p=(0.8, 0.2))
    problem, steps = mbocp.load_problem(EXAMPLES / str(base)), int(rng.integers(12, 40))
    changes: dict[str, Any] = {"solver": {"tolerance": 1e-12, "time_limit": TIME_LIMIT}}
    if len(problem.timeline.phases) == 1:
        changes["steps"] = steps
    if scheme:
        changes["integrator"] = {"scheme": str(scheme)}
    if coordinates != "joint":
        changes["coordinates"] = str(coordinates)
    problem = problem.with_(**changes)
    cost = problem.cost.with_weights({"effort": problem.cost.effort * rng.uniform(0.5, 2.0)})
    problem = replace(problem, cost=cost)
    if not problem.robot.nc:
        away = 0.05 * rng.normal(size=problem.robot.nv)
        problem = replace(problem, q_start=problem.robot.integrate(problem.q_start, away))
    limited = ""
    if problem.robot.is_vector_space and rng.random() < 0.5:  # a share of the fastest speeds without limits
        fastest = 0.9 * np.abs(mbocp.solve(problem, check=True).vs).max(axis=0)
        fastest = np.maximum(fastest, np.abs(problem.v_start) + 0.1)
        problem = replace(problem, limits=replace(problem.limits, v_lower=-fastest, v_upper=fastest))
        limited = " limited"
    return f"{base} {scheme or 'own scheme'} {coordinates}{limited}", problem


def possible(rng: np.random.Generator) -> tuple[str, mbocp.Problem]:
    """One that files may say."""
    while True:
        with suppress(ProblemFileError):
            return drawn(rng)


def random_word(solution: mbocp.Solution, rng: np.random.Generator) -> str:
    """A parameter of the problem: each kind of them as often as others, and numbers of robots by words."""
    formulation, _ = formulate_again(solution)
    numbers = [OF_ROBOT + word for word in list_named_numbers(solution.problem.robot)]
    kinds = [words for words in (*(list(kind.words(formulation)) for kind in PARAMETERS), numbers) if words]
    return str(rng.choice(kinds[rng.integers(len(kinds))]))


def verdict(problem: mbocp.Problem, word: str, rng: np.random.Generator) -> tuple[str, float]:
    """What came of a comparison in a parameter, and the relative error."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = SolutionMap.of(problem, [word])
        (value,) = found.values
        size = value if word.startswith("cost.") else 1.0  # weights may be small, and stay positive
        move = size * np.where(np.isfinite(value), rng.normal(size=value.shape), 0.0)
        exact = found.push([value], [move])
        if any("one side alone" in str(one.message) for one in told):
            return "degenerate", np.nan
        own, worst, moves = _to_round_off(found, value)["qs"], np.inf, list[float]()
        for step in STEPS:
            again = [_to_round_off(found, value + at * step * move) for at, _ in POINTS]
            worst = min(worst, max(_error(exact, again, step)))
            if worst <= TOLERANCE:
                return "agrees", worst
            moves.append(max(float(np.abs(near["qs"] - own).max()) for near in again))
    goes_on = moves[1] < 0.5 * moves[0]  # over a tenth of the step: else neighbours are other optima
    return ("differs" if goes_on else "other optima"), worst


def _to_round_off(found: SolutionMap, value: np.ndarray) -> dict[str, np.ndarray]:
    """Cost and motion of an optimum whose conditions hold to round-off."""
    solution, derivatives = found.at([value])
    motion = derivatives.motion
    return {"cost": np.array(solution.cost), "qs": motion.qs, "vs": motion.vs, "us": motion.us}


def _error(exact: dict[str, np.ndarray], again: list[dict[str, np.ndarray]], step: float) -> Iterator[float]:
    for name in ("cost", "qs", "vs", "us"):
        pairs = zip(again, POINTS, strict=True)
        expected = sum(weight * out[name] for out, (_, weight) in pairs) / step
        size = max(np.abs(expected).max(initial=0.0), 1e-3)
        yield float(np.abs(exact[name] - expected).max(initial=0.0)) / size


def main() -> None:
    """Compare as many as are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    counts: Counter[str] = Counter()
    for k in itertools.count():
        if counts["agrees"] + counts["differs"] >= asked.count:
            break
        rng = np.random.default_rng([asked.seed, k])
        name = ""
        try:
            name, problem = possible(rng)
            word = random_word(mbocp.solve(problem, check=True), rng)
            name += f", {word}"
            outcome, error = verdict(problem, word, rng)
        except NotConverged as fault:
            outcome, error = f"no optimum: {fault.solution.status}", np.nan
        except MbocpError as fault:
            outcome, error = f"refused: {type(fault).__name__}: {str(fault)[:160]}", np.nan
        print(f"{k:4d} {name}: {outcome} ({error:.1e})", flush=True)
        counts[outcome.partition(":")[0]] += 1
    print(dict(counts))


if __name__ == "__main__":
    main()
