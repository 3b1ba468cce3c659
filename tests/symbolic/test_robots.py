"""Every robot of example-robot-data: each bridge function against numeric Pinocchio."""

from __future__ import annotations

import pytest
from example_robot_data.robots_loader import ROBOTS

from mbocp.symbolic import model_functions
from tests.symbolic.checks import (
    check_constraints,
    check_dynamics,
    check_forward_dynamics,
    check_frames,
    check_manifold,
)

LEFT_OUT = {
    "cassie": "an SDF file; the wheels of Pinocchio are built without SDF",
}
# Massless bodies beyond a moving joint: the inertia matrix is singular, and Pinocchio's own ABA gives NaN,
# too.
SINGULAR = {"bluevolta_bravo7_gripper", "bravo7_gripper", "falcon_bravo7_gripper", "romeo"}
NAMES = sorted(set(ROBOTS) - set(LEFT_OUT))
# Of many joints, of kinds that smaller robots have, too.
LARGE = {
    "alex_psyonic_hands", "centauro", "g1_with_hands", "icub", "simple_humanoid_classical", "talos",
    "talos_full", "tiago", "tiago_dual",
}  # fmt: skip


def test_enough_robots_and_reasons():
    assert len(NAMES) >= 65
    assert set(LEFT_OUT) | LARGE <= set(ROBOTS)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in LARGE else []) for name in NAMES]
)
def test_functions_agree_with_numeric_pinocchio(name, load_example, random_state):
    model = load_example(name)
    functions = model_functions(model)
    q, v, a = random_state(model)
    check_dynamics(model, functions, q, v, a)
    check_forward_dynamics(model, functions, q, v, a, singular=name in SINGULAR)
    check_manifold(model, functions, q, v)
    check_frames(model, functions, q, v)
    check_constraints(model, functions, q)
