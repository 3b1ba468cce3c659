"""Steps of Gauss and Newton at many configurations at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbocp._arrays import Array
from mbocp.robot.loops.reduction import reduce_rows, shortest_steps
from tests.robot.loops import builders as loops


def test_each_of_many_configurations_goes_its_own_way(tmp_path: Path) -> None:
    robot = loops.load(tmp_path, loops.four_bar(), loops.MOTOR + loops.OPEN_POSE + loops.POINT)
    rng, every = np.random.default_rng(0), np.ones(robot.nv, dtype=np.bool_)
    # near, far, and already there
    aside = [robot.integrate(robot.q0, size * rng.standard_normal(robot.nv)) for size in (0.01, 0.1, 0.3)]
    kept, counts = list(robot.kept_rows), list[int]()

    def residuals(qs: Array) -> Array:
        counts.append(len(qs))
        return np.array([robot.closure_residual(q)[kept] for q in qs])

    def jacobians(qs: Array) -> Array:
        return np.array([robot.closure_jacobian(q)[kept] for q in qs])

    alone = [reduce_rows(robot, q[None], every, residuals, jacobians, 1e-12)[0] for q in aside]
    counts.clear()
    together = reduce_rows(robot, np.array([*aside, alone[0]]), every, residuals, jacobians, 1e-12)
    np.testing.assert_allclose(together, [*alone, alone[0]], rtol=0.0, atol=1e-14)
    assert np.abs(residuals(together)).max() < 1e-12
    assert np.array_equal(together[3], alone[0])
    assert counts[:2] == [4, 3]  # the last one has nothing left to do
    assert counts[-2] < 3  # and those that are near end before those that are far


def test_a_component_that_is_not_free_stays(tmp_path: Path) -> None:
    robot = loops.load(tmp_path, loops.four_bar(), loops.MOTOR + loops.OPEN_POSE + loops.POINT)
    free, kept = np.array([False, True, True]), list(robot.kept_rows)
    aside = robot.q0 + np.array([[0.1, 0.05, 0.0], [-0.1, 0.0, 0.02]])
    found = reduce_rows(
        robot,
        aside,
        free,
        lambda qs: np.array([robot.closure_residual(q)[kept] for q in qs]),
        lambda qs: np.array([robot.closure_jacobian(q)[kept] for q in qs]),
    )
    assert np.array_equal(found[:, 0], aside[:, 0])
    assert max(np.abs(robot.closure_residual(q)[kept]).max() for q in found) < 1e-14


def test_steps_are_the_shortest_in_their_metric() -> None:
    rng = np.random.default_rng(1)
    roots, jacobians = rng.standard_normal((5, 6, 6)), rng.standard_normal((5, 2, 6))
    metrics, wanted = roots @ roots.transpose(0, 2, 1) + np.eye(6), rng.standard_normal((5, 2))
    steps = shortest_steps(metrics, jacobians, wanted, np.zeros(5))
    for metric, jacobian, goal, step in zip(metrics, jacobians, wanted, steps, strict=True):
        np.testing.assert_allclose(jacobian @ step, goal, atol=1e-12)
        free = np.linalg.svd(jacobian)[2][2:]  # motions that change no row
        np.testing.assert_allclose(free @ metric @ step, 0.0, atol=1e-11)
