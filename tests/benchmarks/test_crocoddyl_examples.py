"""Crocoddyl's examples end at the costs that Crocoddyl has found."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

sys.path.insert(0, str(Path(__file__).parent.parent.parent))  # not part of the package

import mbocp
from benchmarks.crocoddyl_examples import GAITS, arm, gait_problem, nodes_of, quadrotor, solved
from mbocp.formulation import Motion

pytestmark = [
    pytest.mark.filterwarnings("ignore:start.q. outside the position limits"),
    pytest.mark.filterwarnings("ignore:points are held wherever"),  # a cost says where
]


def cost_of(
    motion: Motion, model: pin.Model, frame: str, place: list[float], weights: tuple[float, ...]
) -> float:
    """As the example's file says it: of pose, x, u and of the pose at the end; weights of x by components."""
    pose, u, end, *x = weights
    data, there = model.createData(), pin.SE3(np.eye(3), np.array(place))

    def missed(q: np.ndarray) -> float:
        pin.framesForwardKinematics(model, data, q)
        return float(np.sum(pin.log6(there.actInv(data.oMf[model.getFrameId(frame)])).vector ** 2))

    total = end * missed(motion.qs[-1])
    for q, v, control, dt in zip(motion.qs, motion.vs, motion.us, motion.dts, strict=False):
        state = np.concatenate([pin.difference(model, motion.qs[0], q), v])
        total += dt * (pose * missed(q) + u * control @ control + np.array(x) @ state**2)
    return total / 2


@pytest.mark.parametrize("kind", ["zero", "hold"])
@pytest.mark.parametrize(
    ("build", "frame", "place", "weights", "expected"),
    [
        (arm, "j2s6s200_end_effector", [0.6, 0.2, 0.5], (1.0, 0.1, 1e3, *[0.1] * 12), 3.698422749),
        (
            quadrotor,
            "hector/base_link",
            [1.0, 0.0, 1.0],
            (1e-2, 1e-6, 3.0, *[1e-7] * 3, *[1e-3] * 9),
            0.0052086409216,
        ),
    ],
)
def test_costs_are_those_that_crocoddyl_has_found(
    build: Callable[[], mbocp.Problem],
    frame: str,
    place: list[float],
    weights: tuple[float, ...],
    expected: float,
    kind: str,
) -> None:
    problem = build()
    found = solved(problem, kind, 0)
    assert found.status == "converged"
    assert found.cost == pytest.approx(expected, rel=1e-8)
    assert cost_of(found.motion, problem.robot.model, frame, place, weights) == pytest.approx(
        expected, rel=1e-8
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "expected", "within", "steps"),
    [
        ("walk", 588.6368, 1.2e-3, 107),
        ("trot", 231.7925, 4e-4, 55),
        ("pace", 754.5215, 4e-3, 61),
        ("bound", 1968.508, 7e-3, 61),
        ("jump", 2950.234, 5e-3, 60),
        ("biped", 5111.964, 3e-3, 39),
    ],
)
def test_gaits_cost_what_crocoddyl_says_but_for_contacts(
    name: str, expected: float, within: float, steps: int
) -> None:
    problem = gait_problem(GAITS[name])
    found = solved(problem, "hold", 0)
    assert found.status == "converged"
    assert found.cost == pytest.approx(expected, rel=within)  # contacts hold positions here, velocities there
    assert len(nodes_of(problem)) == steps + 1  # impacts included; Crocoddyl's gaits have one after the end


@pytest.mark.slow
def test_contacts_of_crocoddyl_differ_by_the_first_order_of_the_step() -> None:
    """Crocoddyl's trot costs 228.9198 with half the step: the difference falls by half at least."""
    gait = GAITS["trot"]
    swings = tuple(replace(s, steps=2 * s.steps, support=2 * s.support) for s in gait.swings)
    fine = solved(gait_problem(replace(gait, dt=gait.dt / 2, swings=swings)), "hold", 0)
    coarse = solved(gait_problem(gait), "hold", 0)
    assert 0.0 < fine.cost - 228.91977 < 0.5 * (coarse.cost - 231.79248)
