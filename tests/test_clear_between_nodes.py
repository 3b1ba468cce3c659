"""Motions that touch an obstacle between nodes are solved again with larger margins, or said to do so."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from time import sleep

import coal
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp import clearing
from mbocp.exceptions import CompilationTimeout
from mbocp.formulation.state_bounds import sides_of_path
from mbocp.guesses.around import around, near_the_way
from mbocp.guesses.ways import straight
from mbocp.job import Job
from mbocp.problem import Problem
from mbocp.problem.obstacles.approach import Approach, touches_along
from mbocp.problem.obstacles.reserves import (
    find_missing_pairs,
    largest_reserve,
    rows_of,
    with_pairs,
    with_room,
    with_rows_and_room,
)
from mbocp.solution import Status
from mbocp.solution.later import retold
from mbocp.strategies import BestInTime
from tests.robot.urdfs import link, robot, write
from tests.test_determinism import digest, digest_of

BALL = '<collision><origin xyz="{x} 0 0"/><geometry><sphere radius="0.1"/></geometry></collision>'
HINGE = (
    '<joint name="j{k}" type="revolute"><origin xyz="{x} 0 0"/><parent link="{a}"/><child link="{b}"/>'
    '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="50" velocity="9"/></joint>'
)
POST = {"name": "post", "shape": "cylinder", "radius": 0.06, "length": 1.0, "position": [1.45, 0.55, 0.0]}


@pytest.fixture
def around_a_post(tmp_path: Path):
    """A planar arm whose collision shapes are its spheres, so that they keep nothing back between nodes."""
    names = ["base", "l1", "l2", "l3"]
    links = [link(n, extra=BALL.format(x=0.0 if n == "base" else 0.5)) for n in names]
    joints = [
        HINGE.format(k=k, x=0.5 * (k > 1), a=a, b=b) for k, (a, b) in enumerate(pairwise(names), start=1)
    ]
    made = mbocp.load_robot(write(tmp_path, robot(*links, *joints)))

    def problem(steps: int) -> Problem:
        return Problem.create(
            made,
            1.0,
            steps,
            start={"q": [-0.3, 0.1, 0.1]},
            goal={"q": [1.4, 0.1, 0.1], "v": 0},
            cost={"effort": 1e-3, "velocity": 0.1},
            obstacle=[POST],
            solver={"method": "monolithic"},
            scheme="se1",
        )

    return problem


def smallest(problem: Problem, t: np.ndarray, qs: np.ndarray) -> float:
    """Distance of all shapes from the post at two thousand poses."""
    model, shapes = problem.robot.model, problem.robot.collision_model.geometryObjects
    data, best = model.createData(), np.inf
    there = coal.Transform3s(np.eye(3), np.array(POST["position"]))
    for time in np.linspace(t[0], t[-1], 2000):
        k = min(int(np.searchsorted(t, time, side="right")) - 1, len(t) - 2)
        share = (time - t[k]) / (t[k + 1] - t[k])
        pin.forwardKinematics(model, data, pin.interpolate(model, qs[k], qs[k + 1], share))
        for shape in shapes:
            at = data.oMi[shape.parentJoint] * shape.placement
            here = coal.Transform3s(at.rotation, at.translation)
            asked, found = coal.DistanceRequest(), coal.DistanceResult()
            post = coal.Cylinder(POST["radius"], POST["length"])
            best = min(best, coal.distance(shape.geometry, here, post, there, asked, found))
    return best


def test_margins_grow_until_the_motion_is_clear(around_a_post):
    problem = around_a_post(30)
    solution = mbocp.solve(problem)
    assert solution.converged
    assert "margins at nodes were raised by" in solution.advice
    assert 0.0 <= solution.clearance < 0.03
    assert solution.clearance == pytest.approx(smallest(problem, solution.t, solution.qs), abs=1e-4)
    nodes = problem.clearance.values_along(problem.robot, solution.qs, solution.vs, solution.us)
    assert nodes.min() > solution.clearance
    assert "post" in solution.problem_text
    assert mbocp.problem.parse_problem(solution.problem_text).obstacle[0].margin == 0.0
    assert "smaller margins" in [phase.name for phase in solution.phases]


def test_a_jump_over_an_obstacle_is_no_solution(around_a_post):
    """With a dozen steps the arm is before the post at one node and behind it at the next."""
    problem = around_a_post(12)
    solution = mbocp.solve(problem)
    assert solution.status is Status.UNDER_RESOLVED
    assert "l3 is" in solution.advice
    assert "inside post" in solution.advice
    assert "take more steps" in solution.advice
    assert solution.clearance < -0.03
    assert solution.clearance == pytest.approx(smallest(problem, solution.t, solution.qs), abs=5e-3)


def test_rows_at_their_bound_say_their_margin(around_a_post):
    problem = around_a_post(30).with_(obstacle=[{**POST, "margin": 0.02}])
    solution = mbocp.solve(problem)
    rows = [limit for limit in solution.active_limits if limit.kind == "path"]
    assert rows
    assert {(row.bound, row.unit, row.side) for row in rows} == {(0.02, "m", "lower")}


def test_rows_that_are_missing_are_added(around_a_post, monkeypatch):
    """Without any row at first, the motion is as good as that of all rows."""
    problem, asked = around_a_post(30), []

    def missing(*arguments):
        asked.append(find_missing_pairs(*arguments))
        return asked[-1]

    expected = mbocp.solve(problem)
    monkeypatch.setattr("mbocp.guesses.around.MANY", 1)
    monkeypatch.setattr("mbocp.guesses.around.near_pairs", lambda clearance, ts, qs: ())
    monkeypatch.setattr("mbocp.guesses.around.with_first_reserve", lambda problem, ts, qs: problem)
    monkeypatch.setattr("mbocp.problem.obstacles.reserves.find_missing_pairs", missing)
    solution = mbocp.solve(problem)
    assert solution.converged
    assert any(asked)
    assert not asked[-1]
    assert solution.clearance >= 0.0
    assert solution.cost <= 1.01 * expected.cost  # they jump over the post at different nodes


def test_what_has_had_no_row_has_room_for_the_corners_alone(around_a_post):
    """It is 3 cm in the post at the nodes, too, where its row will keep it out: 7 mm are between them."""
    problem = around_a_post(30).with_(obstacle=[{**POST, "position": [1.515, 0.575, 0.0]}])
    t, q1 = np.linspace(0.0, 1.0, 31), np.asarray(problem.goal.q)
    qs = problem.q_start + t[:, None] * (q1 - problem.q_start)
    vs = np.tile(q1 - problem.q_start, (31, 1))
    touches = touches_along(problem.clearance, t, qs, vs)
    deepest = max(-touch.distance for touch in touches.values())
    assert deepest > 0.025
    larger, has_more_rows = with_rows_and_room(with_pairs(problem, []), t, qs, vs, touches)
    assert has_more_rows
    assert 1e-3 < largest_reserve(larger) < 0.012
    has_all, has_more_rows = with_rows_and_room(problem, t, qs, vs, touches)  # rows have not kept them out
    assert not has_more_rows
    assert largest_reserve(has_all) > deepest


def beside_itself(goal: np.ndarray) -> Problem:
    """A UR5, of which some spheres may be in each other, as shapes decide there."""
    return Problem.create(
        mbocp.load_robot("ur5"),
        1.0,
        20,
        start={"q": [0.0, -1.2, 1.0, -1.0, -1.57, 0.0]},
        goal={"q": goal, "v": 0},
        cost={"effort": 1e-3},
        self_collision=True,
        scheme="se1",
    )


@pytest.mark.parametrize(
    "q", [[-2.527, 0.874, 2.623, -2.441, 1.455, -1.52], [1.264, 0.354, -2.406, 1.915, -0.459, -0.602]]
)
def test_rows_that_let_shapes_meet_keep_out_where_they_do(q):
    """One row is short there of more than shapes are deep in each other."""
    problem, t, qs = beside_itself(np.full(6, -0.5)), np.array([0.0, 0.1]), np.tile(q, (2, 1))
    values = problem.clearance.values(problem.robot, np.array(q), np.zeros(6))
    assert (values >= problem.clearance.lower).all()
    touches = touches_along(problem.clearance, t, qs)
    assert len(touches) == 1
    larger, has_more_rows = with_rows_and_room(problem, t, qs, np.zeros_like(qs), touches)
    assert not has_more_rows
    lower = rows_of(larger).lower
    kept_out = np.flatnonzero(values < lower)
    assert len(kept_out) == 1
    (touch,) = touches.values()
    assert lower[kept_out] - values[kept_out] == pytest.approx(2e-3 - touch.distance, abs=1e-6)


def test_room_at_nodes_falls_to_that_of_the_goal():
    """Before the last tenth of the steps it is all that is asked for, and no goal is kept out."""
    problem = beside_itself(np.array([0.0, -2.0, 2.4, -1.0, -1.57, 0.0]))
    clearance = problem.clearance
    at_goal = clearance.values(problem.robot, np.asarray(problem.goal.q), np.zeros(6))
    qs = np.linspace(problem.q_start, problem.goal.q, 21)
    wider = with_room(problem, np.full(clearance.num_pairs, 0.05), np.linspace(0.0, 1.0, 21), qs)
    lower, _ = sides_of_path(wider)
    assert lower[:18] == pytest.approx(np.broadcast_to(clearance.lower + 0.05, (18, len(at_goal))))
    assert (lower[17] > at_goal).any()
    assert (lower[-1] <= at_goal).all()
    assert lower[18] == pytest.approx((lower[17] + lower[19]) / 2.0)
    has_all = at_goal > clearance.lower + 0.06
    assert lower[-1, has_all] == pytest.approx(lower[0, has_all])


def test_rough_motions_say_how_much_room_there_has_to_be(around_a_post, monkeypatch):
    """Then one motion is solved to the end."""
    asked = []

    def attempt(job):
        asked.append(job.rough)
        return clearing_attempt(job)

    clearing_attempt = clearing.attempt
    monkeypatch.setattr("mbocp.guesses.around.MANY", 1)
    for module in ("clearing", "guesses.around"):
        monkeypatch.setattr(f"mbocp.{module}.with_first_reserve", lambda problem, ts, qs: problem)
    monkeypatch.setattr("mbocp.clearing.attempt", attempt)
    solution = mbocp.solve(around_a_post(30))
    assert solution.converged
    assert solution.clearance >= 0.0
    assert asked == [*[clearing._ROUGH] * (len(asked) - 1), 0.0]
    assert "margins at nodes were raised by" in solution.advice


@pytest.mark.parametrize(
    ("most", "is_rough", "status"),
    [(1, False, Status.UNDER_RESOLVED), (1, True, Status.TIME_LIMIT), (0, False, None)],
)
def test_a_motion_is_not_lost_where_the_next_is_not_compiled_in_time(
    most, is_rough, status, around_a_post, monkeypatch
):
    """What comes after it may have other rows, and so other functions."""
    made = []

    def attempt(job):
        if len(made) == most:
            raise CompilationTimeout("the functions were to be built")
        made.append(clearing_attempt(job))
        return made[-1]

    clearing_attempt = clearing.attempt
    monkeypatch.setattr("mbocp.clearing.attempt", attempt)
    if is_rough:
        monkeypatch.setattr("mbocp.guesses.around.MANY", 1)
    if status is None:
        with pytest.raises(CompilationTimeout):
            mbocp.solve(around_a_post(30), time_limit=60)
        return
    solution = mbocp.solve(around_a_post(30), time_limit=60)
    assert solution.status is status
    assert "the time limit passed while the functions were to be built" in solution.advice
    assert solution.iterations == made[0].outcome.iterations > 0
    motion = made[0].formulation.motion_of(made[0].outcome.result.iterate)
    np.testing.assert_array_equal(solution.qs, motion.qs)


@pytest.mark.parametrize(("accuracy", "status"), [(None, Status.CONVERGED), (1e-3, Status.UNDER_RESOLVED)])
def test_the_best_motion_by_then_is_no_more_than_that(accuracy, status, around_a_post):
    """Nobody knows how exact it is, where that was asked for."""
    problem = around_a_post(30)
    good = mbocp.solve(problem)
    touching = retold(good, status=Status.UNDER_RESOLVED, clearance=-0.1)

    class Late:
        def run(self, job):
            job.found.extend([touching, good, touching])
            raise CompilationTimeout("the functions were to be built")

    found = BestInTime(Late()).run(Job.of(problem.with_(accuracy=accuracy), time_limit=60))
    assert found.status is status
    assert found.advice.startswith("what horizon.accuracy asks for was not reached") == (accuracy is not None)
    assert found.clearance == good.clearance


def test_a_first_reserve_is_what_the_way_cuts_off(around_a_post, monkeypatch):
    """Where shapes are spheres and pairs are chosen; and the advice says so."""
    problem = around_a_post(60)
    assert largest_reserve(near_the_way(problem)) == 0.0
    monkeypatch.setattr("mbocp.guesses.around.MANY", 1)
    assert 1e-3 <= largest_reserve(near_the_way(problem)) <= 5e-3
    solution = mbocp.solve(problem)
    assert solution.converged
    assert solution.clearance >= 0.0
    assert "margins at nodes were raised by" in solution.advice


def test_other_ways_are_tried_where_the_first_comes_to_nothing(around_a_post, monkeypatch):
    """The first solve ends inside the post; the second, on another way, does not."""
    problem, seeds = around_a_post(30), []
    way = straight(problem)

    def other(problem, seed=0):
        if seed:
            seeds.append(seed)
        return way if seed else None

    def touching(self, job):
        found = solved(self, job)
        is_first = job.problem.guess.q is None
        return replace(found, status=Status.UNDER_RESOLVED, clearance=-0.1) if is_first else found

    solved = clearing.ClearOfObstacles.run
    monkeypatch.setattr("mbocp.clearing.around", other)
    monkeypatch.setattr("mbocp.clearing.ClearOfObstacles.run", touching)
    solution = mbocp.solve(problem)
    assert seeds == [1]
    assert solution.converged
    assert solution.guess_used.startswith("way 2 around obstacles")
    assert "other ways" in [phase.name for phase in solution.phases]
    assert mbocp.solve(problem.with_(guess={"kind": "line"})).status is Status.UNDER_RESOLVED


@pytest.mark.parametrize("good", [1, 2, 3, 9])
def test_the_first_way_that_leads_somewhere_is_taken_whoever_ends_first(good, around_a_post, monkeypatch):
    """All ways after the first good one are good, too, and quicker."""
    monkeypatch.setattr("mbocp.problem.solver.available_threads", lambda: 4)

    def other(problem, seed=0):
        line = straight(problem)
        bump = np.array([0.1 * seed, 0.0, 0.0])
        return None if not seed else lambda q, s: line(q, s) + np.sin(np.pi * s)[:, None] * bump

    def touching(self, job):
        near = job.problem
        given, middle = near.guess.q, straight(near)(near.q_start, np.array([30 / 59]))[0]
        seed = 0 if given is None else round(10.0 * float(given[29][0] - middle[0]))
        if seed == good:
            sleep(0.05)
        found = solved(self, job)
        return found if seed >= good else replace(found, status=Status.UNDER_RESOLVED, clearance=-0.1)

    solved = clearing.ClearOfObstacles.run
    monkeypatch.setattr("mbocp.clearing.around", other)
    monkeypatch.setattr("mbocp.clearing.ClearOfObstacles.run", touching)
    alone, *others = (
        mbocp.solve(around_a_post(30).with_(solver={"method": "monolithic", "threads": n})) for n in (1, 2, 3)
    )
    assert alone.guess_used.startswith(f"way {1 + good} around") == (good <= 3)
    for found in others:
        assert digest_of(found, alone) == digest(alone)


def test_other_ways_are_tried_where_a_given_one_comes_to_nothing(around_a_post, monkeypatch):
    """Ours first."""
    problem, seeds = around_a_post(30), []
    middle = np.asarray(straight(problem)(problem.q_start, np.array([0.5])))
    given = problem.with_(guess={"kind": "way", "q": middle.tolist()})

    def other(problem, seed=0):
        seeds.append(seed)
        return around(problem, seed)

    def touching(self, job):
        found = solved(self, job)
        is_given = len(job.problem.guess.q) == len(middle)
        return replace(found, status=Status.UNDER_RESOLVED, clearance=-0.1) if is_given else found

    solved = clearing.ClearOfObstacles.run
    monkeypatch.setattr("mbocp.clearing.around", other)
    monkeypatch.setattr("mbocp.clearing.ClearOfObstacles.run", touching)
    solution = mbocp.solve(given)
    assert set(seeds) == {0}
    assert solution.converged
    assert solution.guess_used.startswith("way 2 around obstacles")


def test_each_way_is_tried_briefly_before_the_first_at_length(around_a_post, monkeypatch):
    """A way that is hopeless costs no more than a few hundred iterations as long as there are others."""
    problem, briefs = around_a_post(30), []
    way, found = straight(problem), mbocp.solve(problem)

    def hopeless(self, job):
        briefs.append(job.brief)
        return retold(found, status=Status.STAGNATED)

    monkeypatch.setattr("mbocp.clearing.around", lambda problem, seed=0: way)
    monkeypatch.setattr("mbocp.clearing.ClearOfObstacles.run", hopeless)
    assert mbocp.solve(problem.with_(solver={"method": "auto"})).status is Status.STAGNATED
    assert all(briefs[:-1])
    assert len(briefs) > 2
    assert briefs[-1] == 0


@pytest.mark.parametrize(("excess", "count"), [(0.2, 1), (0.0, 4)])
def test_other_ways_are_for_what_touches_something_or_leaps_past_it(
    excess, count, around_a_post, monkeypatch
):
    """A motion that is clear, but leaves its limits between nodes, would do so on another way, too."""
    problem, tried = around_a_post(30), []

    def coarse(self, job):
        tried.append(job)
        return retold(solved(self, job), status=Status.UNDER_RESOLVED, limit_excess=excess)

    solved = clearing.ClearOfObstacles.run
    monkeypatch.setattr("mbocp.clearing.ClearOfObstacles.run", coarse)
    assert mbocp.solve(problem).status is Status.UNDER_RESOLVED
    assert len(tried) == count


def test_a_round_that_fails_from_where_it_is_begins_at_the_guess(around_a_post, monkeypatch):
    """With all the room that is known by then."""
    begun = []

    def attempt(job):
        begun.append((job.start is None, largest_reserve(job.problem)))
        found = clearing_attempt(job)
        if job.start is None:
            return found
        result = replace(found.outcome.result, status=Status.STAGNATED)
        return replace(found, outcome=replace(found.outcome, result=result))

    clearing_attempt = clearing.attempt
    monkeypatch.setattr("mbocp.clearing.attempt", attempt)
    solution = mbocp.solve(around_a_post(30))
    assert solution.converged
    assert solution.clearance >= 0.0
    at_guess, room = zip(*begun, strict=True)
    assert at_guess == (True, False, True)
    assert 0.0 == room[0] < room[1] == room[2]


def test_room_may_grow_in_vain_for_a_while(around_a_post, monkeypatch):
    """The best of all rounds counts, and three that are no better are the last."""
    problem, depths = around_a_post(30), iter([2e-4, 1e-4, 3e-4, 2e-4, 1.5e-4, 0.0])

    def touching(self, attempt):
        depth = next(depths)
        words = {"clearance_between": "l3 and post", "clearance_time": 0.5}
        status = Status.UNDER_RESOLVED if depth else Status.CONVERGED
        return retold(read(self, attempt), status=status, clearance=-depth, **words)

    read = Job.read
    monkeypatch.setattr(Job, "read", touching)
    touch = {"l3 and post": Approach(-1e-4, 0.0, "l3", "post", 0.5)}
    monkeypatch.setattr("mbocp.clearing.touches_along", lambda *motion: touch)
    solution = mbocp.solve(problem.with_(guess={"kind": "line"}))
    assert solution.clearance == -1e-4
    assert list(depths) == [0.0]
