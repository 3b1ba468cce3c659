"""Start and goal of a constrained system, and how many end conditions it can meet."""

from collections.abc import Callable

import numpy as np
import pytest

from mbocp.exceptions import InconsistentStart, OverdeterminedGoal
from mbocp.problem import Problem

Maker = Callable[..., Problem]


def test_start_off_the_sphere(swing: Maker) -> None:
    with pytest.raises(
        InconsistentStart, match=r"start\.q: violates constraint '\w+' of robot .* by -4\.5 m\^2"
    ):
        swing(start={"q": [4, 0, 0]})


def test_start_leaving_the_sphere(swing: Maker) -> None:
    with pytest.raises(InconsistentStart, match=r"start: violates constraint .* by 5 m\^2/s .*tangential"):
        swing(start={"q": [5, 0, 0], "v": [1, 0, 0]})


def test_nine_digits_are_near_enough(swing: Maker) -> None:
    swing(start={"q": [5 + 1e-9, 0, 0]})
    with pytest.raises(InconsistentStart, match="allowed: 1e-08"):
        swing(start={"q": [5 + 1e-8, 0, 0]})


def test_exact_goal_off_the_sphere(swing: Maker) -> None:
    with pytest.raises(InconsistentStart, match=r"goal\.q: violates"):
        swing(goal={"q": [0, 0, -4], "p": [0, 0, 0]})


def test_exact_goal_leaving_the_sphere(swing: Maker) -> None:
    with pytest.raises(InconsistentStart, match=r"goal\.p: no motion on the constraints .* differs by 1 N s"):
        swing(goal={"q": [0, 0, -5], "p": [0, 0, 1]})
    names = swing().robot.joint_names
    with pytest.raises(InconsistentStart, match=r"goal\.v: no motion"):
        swing(goal={"q": [0, 0, -5], "v": {names[2]: 1.0}})
    swing(goal={"q": [0, 0, -5], "v": {names[0]: 1.0}})


def test_a_penalised_or_tracked_goal_may_be_out_of_reach(swing: Maker) -> None:
    swing(goal={"q": [0, 0, -4], "p": [0, 0, 1], "enforce": "penalty"}, cost={"terminal": 1.0})
    swing(goal={"q": [0, 0, -4], "p": [0, 0, 1], "enforce": "none"}, cost={"tracking": 1.0})


def test_start_by_momentum_is_start_by_velocity(swing: Maker) -> None:
    by_p = swing(start={"q": [5, 0, 0], "p": [0, 10, 0]})
    np.testing.assert_allclose(by_p.p_start, [0, 10, 0], atol=1e-14)
    by_v = swing(start={"q": [5, 0, 0], "v": by_p.v_start})
    np.testing.assert_array_equal(by_v.v_start, by_p.v_start)


def test_a_partial_goal_is_completed_on_the_sphere(swing: Maker) -> None:
    names = swing().robot.joint_names
    goal = swing(goal={"q": {names[0]: 3.0}}).goal
    assert goal.q[0] == 3.0
    assert np.linalg.norm(goal.q) == pytest.approx(5.0, abs=1e-14)
    np.testing.assert_array_equal(goal.q_active, [True, False, False])
    with pytest.raises(InconsistentStart, match=r"goal\.q: no configuration .* 'rod' is stretched out"):
        swing(goal={"q": {names[0]: 5.1}})


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ({"q": [0, 0, -5], "p": [0, 0, 0]}, 4),  # six rows on a system with two degrees of freedom
        ({"q": [0, 0, -5], "v": [0, 0, 0]}, 4),
        ({"q": [0, 0, -5]}, 2),
        ({"p": [0, 0, 0]}, 2),
        ({"q": [0, 0, -5], "p": [0, 0, 0], "enforce": "none"}, 0),
    ],
)
@pytest.mark.filterwarnings("ignore:the problem asks for nothing")
def test_redundant_conditions_do_not_count(swing: Maker, goal: dict[str, object], expected: int) -> None:
    assert swing(goal=goal).num_end_conditions == expected


def test_more_conditions_than_controls(swing: Maker) -> None:
    swing(steps=2)
    with pytest.raises(
        OverdeterminedGoal, match=r"4 independent exact end conditions, but 1 step with 3 controls"
    ):
        swing(steps=1)


def test_a_goal_of_the_position_only_leaves_the_velocity_free(swing: Maker) -> None:
    goal = swing(goal={"q": [0, 0, -5]}).goal
    assert goal.enforce == "exact"
    assert goal.q_active.all()
    assert not goal.rate_active.any()
