"""Arrows of forces in replays: what they are, where, and at which scale."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import mbocp
from mbocp.robot import Label
from mbocp.solution.problem_facts import Facts
from mbocp.view.marks import ForceMark, forces_of, in_time
from mbocp.view.meshcat.arrows import force_arrows
from mbocp.view.motion_samples import sample_motion


def still(newtons: np.ndarray):
    """A pendulum at rest, and forces on its last frame from the world."""
    robot = mbocp.load_robot("ur5")
    t = np.linspace(0.0, 1.0, len(newtons) + 1)
    motion = sample_motion(robot.model, t, np.tile(robot.q0, (len(t), 1)))
    frame = robot.frame_id("tool0")
    return motion, ForceMark("it", frame, 0, False, t, newtons)


@pytest.mark.parametrize("force", [0.03, 1.0, 47.0, 3e4])
def test_arrows_have_the_length_of_their_scale(force: float) -> None:
    """Shaft and head together, along the force, from the frame on which it acts."""
    motion, mark = still(np.array([[0.0, 0.0, force], [0.0, force / 2, 0.0]]))
    found = force_arrows([mark], motion, "/forces", 2.0)
    scale = float(found.words.removeprefix("1 cm = ").removesuffix(" N"))
    tracks = {(track.path.rpartition("/")[2], track.name): track.values for track in found.tracks}
    tip = tracks["head", "position"] + 0.0
    heads = tracks["shaft", "scale"][:, 2]
    for k, (size, axis) in ((0, (force, 2)), (-1, (force / 2, 1))):
        away = tip[k] - motion.frame_positions(mark.frame)[k]
        assert away[axis] == pytest.approx(np.linalg.norm(away))
        assert away[axis] == pytest.approx(heads[k], rel=1e-6)
        assert away[axis] + min(0.06, 0.01 * size / scale / 2) == pytest.approx(0.01 * size / scale, rel=1e-6)
    assert 0.1 < 0.01 * force / scale <= 0.5 + 1e-9


def test_nothing_is_drawn_where_nothing_pushes() -> None:
    motion, mark = still(np.zeros((3, 3)))
    assert force_arrows([mark], motion, "/forces", 2.0).words == ""
    assert force_arrows([], motion, "/forces", 2.0).commands == []


def test_impulses_are_no_forces() -> None:
    found = in_time(np.array([[1.0], [900.0], [2.0]]), np.array([0.1, 0.0, 0.1]))
    np.testing.assert_array_equal(found, [[1.0], [1.0], [2.0]])


def test_forces_of_a_loop_are_those_on_its_first_frame() -> None:
    """By the multipliers: the force on frame a is less the multiplier in the axes of b."""
    robot = mbocp.load_robot("four_bar")
    (constraint,) = robot.constraints
    rng = np.random.default_rng(0)
    names = [constraint.rows[k].name for k in range(len(constraint.rows))]
    lams = rng.normal(size=(4, len(names)))
    labels = SimpleNamespace(lam=tuple(Label(name, "J/m") for name in names))
    made = SimpleNamespace(labels=labels, lams=lams, t=np.linspace(0.0, 1.0, 5), facts=Facts())
    (mark,) = forces_of(made, robot)
    assert (mark.frame, mark.other) == (constraint.frame_a, constraint.frame_b)
    np.testing.assert_allclose(mark.forces[:, 0], -lams[:, 0])
