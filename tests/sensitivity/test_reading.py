"""Derivatives of a motion in the unknowns of its programme, against differences of motions that are read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.formulation import formulate
from mbocp.programme import zero_multipliers
from mbocp.programme.evaluation import call
from mbocp.sensitivity.kkt import Optimum, Parts
from mbocp.sensitivity.reading import OF_MOTION, Move, OptimumReader

EXAMPLES = Path(__file__).parents[2] / "examples"
POINTS = ((1.0, 8.0 / 12.0), (-1.0, -8.0 / 12.0), (2.0, -1.0 / 12.0), (-2.0, 1.0 / 12.0))
STEP = 2.0**-9
CASES = {
    "a vector": ("arms/ur5_reach.toml", {}),
    "controls that go on": ("arms/ur5_reach.toml", {"horizon.controls": "linear"}),
    "free lengths of steps": ("arms/ur5_fastest.toml", {}),
    "attitudes that steps leave": (
        "free_flyer/drone_flip.toml",
        {"horizon.steps": 6, "integrator.scheme": "rk4", "integrator.lie": "plain"},
    ),
    "attitudes": ("free_flyer/drone_flip.toml", {"horizon.steps": 6}),
    "bodies": (
        "arms/kinova_reach.toml",
        {"horizon.steps": 6, "integrator.scheme": "se1", "coordinates": "natural"},
    ),
    "drives": ("so3/unicycle_pendulum.toml", {}),
    "a free start and impacts": ("walking/compass_gait.toml", {}),
}


SLOW = "attitudes that steps leave"  # whose functions take seconds to build


@pytest.fixture(params=[pytest.param(case, marks=[pytest.mark.slow] * (case == SLOW)) for case in CASES])
def reader(request):
    """Of a random motion, which no constraint keeps in its space."""
    path, changes = CASES[request.param]
    formulation = formulate(mbocp.load_problem(EXAMPLES / path, changes))
    programme, rng = formulation.programme, np.random.default_rng(0)
    kind, N = programme.kind, programme.num_steps
    moves = 0.05 * rng.normal(size=(N + 1, kind.ndx))
    xs = call(programme.functions, "retract", N + 1, [programme.x_start, moves])[0].dense(kind.nx)
    us = rng.normal(size=(N, kind.nu))
    iterate = zero_multipliers(programme, xs, rng.normal(size=(N, kind.ny)), us)
    limits = np.zeros(programme.bounds.has_limit.shape)
    return OptimumReader(formulation, Optimum(programme, iterate, limits, limits > 0.0, limits))


def random_move(reader, rng):
    programme = reader.optimum.programme
    kind, still = (
        programme.kind,
        [np.zeros_like(getattr(programme, n)) for n in ("theta", "rho", "rho_terminal")],
    )
    parts = Parts(*(part[0] for part in Parts.zeros(programme, 1)))
    step = parts._replace(xs=rng.normal(size=parts.xs.shape), us=rng.normal(size=parts.us.shape))
    return Move(rng.normal(size=kind.ndx), step, *still)


def test_is_what_differences_say(reader):
    formulation, programme, at = reader.formulation, reader.optimum.programme, reader.optimum.iterate
    robot, move = formulation.problem.robot, random_move(reader, np.random.default_rng(1))
    tangents, kind = np.vstack([move.start, move.step.xs]), programme.kind

    def begins_elsewhere(size):
        problem, layout = formulation.problem, formulation.layout
        if problem.start_free is None:
            return formulation
        q_start = robot.integrate(problem.q_start, size * move.start[: layout.nw])
        v_start = problem.v_start + size * move.start[layout.ds]
        return replace(formulation, problem=replace(problem, q_start=q_start, v_start=v_start))

    def moved(size):
        xs = call(programme.functions, "retract", len(tangents), [at.xs, size * tangents])[0].dense(kind.nx)
        motion = begins_elsewhere(size).motion_of(replace(at, xs=xs, us=at.us + size * move.step.us))
        away = [robot.difference(*pair) for pair in zip(reader.motion.qs, motion.qs, strict=True)]
        return {
            "qs": np.array(away),
            "vs": motion.vs,
            "us": motion.us,
            "u_values": motion.values,
            "dts": motion.dts,
        }

    points = [(weight / STEP, moved(STEP * place)) for place, weight in POINTS]
    found = reader.along(move, OF_MOTION)
    for name in OF_MOTION:
        expected = sum(weight * read[name] for weight, read in points)
        assert np.allclose(
            found[name], expected, rtol=1e-7, atol=1e-7 * max(1.0, np.abs(expected).max(initial=0.0))
        ), name


def test_goes_back_as_it_goes_forth(reader):
    rng = np.random.default_rng(2)
    move = random_move(reader, rng)
    along = reader.along(move, OF_MOTION)
    bars = {name: rng.normal(size=read.shape) for name, read in along.items()}
    xs, us, _ = reader.pull_back(bars)
    forth = sum(float((bars[name] * read).sum()) for name, read in along.items())
    back = (xs * np.vstack([move.start, move.step.xs])).sum() + (us * move.step.us).sum()
    assert back == pytest.approx(forth, rel=1e-10)


def test_is_linear_down_to_small_moves(reader):
    """Joints that hardly move have derivatives that are as exact: logarithms of angles below 1e-8 are not."""
    small, move = 2.0**-30, random_move(reader, np.random.default_rng(3))
    step = Parts(*(small * part for part in move.step))
    found = reader.along(replace(move, start=small * move.start, step=step), OF_MOTION)
    for name, whole in reader.along(move, OF_MOTION).items():
        assert np.allclose(found[name] / small, whole, rtol=1e-12, atol=1e-12), name
