"""`python -m benchmarks.explain`: two hundred problems that cannot be solved, and whether it is said why.

Each is made impossible in one known way, on one of eight robots, from random poses. What `mbocp explain
--no-search` says first counts: *named* where it is the way and the joint, frame or constraint that was
planted, *misnamed* where it is another, *silent* where it says nothing. Where the problem itself is refused,
the words count, which have to name that joint, frame or constraint.
"""

from __future__ import annotations

import argparse
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from benchmarks.machine import header
from benchmarks.tables import Table, show
from mbocp._arrays import Array
from mbocp.exceptions import MbocpError
from mbocp.explaining import explain
from mbocp.problem import Problem
from mbocp.robot import Robot, load_robot

__all__ = ["KINDS", "ROBOTS", "Planted", "Verdict", "planted", "table", "verdict"]

ROBOTS = ("ur5", "ur10", "panda", "z1", "xarm7", "talos_arm", "double_pendulum", "finger_edu")
_REPEATED = 25  # problems for each robot
_STEPS = 40
_REST = 1.0  # [s] of a motion that has time enough


@dataclass(frozen=True, eq=False)
class Planted:
    """A problem that cannot be solved.

    Attributes
    ----------
    robot, kind : str
    words : dict
        Arguments of `Problem.create`.
    causes : tuple of str
        Kinds of causes that name it.
    where : str
        Joint, frame or constraint that the words have to name.
    """

    robot: str
    kind: str
    words: dict[str, Any]
    causes: tuple[str, ...]
    where: str


@dataclass(frozen=True)
class Verdict:
    """What was said: "named", "misnamed" or "silent", and the words."""

    outcome: str
    said: str


@dataclass(frozen=True, eq=False)
class _Setting:
    """A robot with two poses, and what is drawn at random."""

    robot: Robot
    rng: np.random.Generator
    start: Array
    goal: Array
    joint: int  # place in v of the joint that is meant

    @property
    def name(self) -> str:
        return self.robot.v_labels[self.joint].name

    @property
    def way(self) -> Array:
        return np.asarray(self.robot.difference(self.start, self.goal))

    @property
    def tool(self) -> str:
        return self.robot.trace_frames[-1]

    def words(self, **changes: Any) -> dict[str, Any]:
        """A problem from rest to rest, with changes."""
        q0, q1 = self.start.tolist(), self.goal.tolist()
        common = {"duration": _REST, "steps": _STEPS, "start": {"q": q0}, "goal": {"q": q1, "v": 0}}
        return {**common, **changes}

    def of_joint(self, value: float, others: float = 1e4) -> list[float]:
        """A limit of one joint, and of the others."""
        return [value if i == self.joint else others for i in range(self.robot.nv)]

    def tool_at(self, q: Array) -> Array:
        return np.asarray(self.robot.frame_placement(self.tool, q).translation)


_Plan: TypeAlias = tuple[dict[str, Any], tuple[str, ...], str]


def _speed(s: _Setting) -> _Plan:
    limit = 0.6 * abs(s.way[s.joint]) / _REST
    return s.words(limits={"velocity": s.of_joint(limit)}), ("speed",), s.name


def _speed_of_free_time(s: _Setting) -> _Plan:
    limit = 0.6 * abs(s.way[s.joint]) / _REST
    return (
        s.words(duration={"min": 0.5 * _REST, "max": _REST}, limits={"velocity": s.of_joint(limit)}),
        ("speed",),
        s.name,
    )


def _acceleration(s: _Setting) -> _Plan:
    limit = 0.6 * 4 * abs(s.way[s.joint]) / _REST**2
    return s.words(limits={"acceleration": s.of_joint(limit)}), ("acceleration",), s.name


def _jerk(s: _Setting) -> _Plan:
    limit = 0.6 * 12 * abs(s.way[s.joint]) / _REST**3  # accelerations at the ends are free
    return s.words(limits={"jerk": s.of_joint(limit, 1e7)}), ("jerk",), s.name


def _held_goal(s: _Setting) -> _Plan:
    return _too_heavy(s, s.goal)


def _held_start(s: _Setting) -> _Plan:
    return _too_heavy(s, s.start)


def _too_heavy(s: _Setting, q: Array) -> _Plan:
    weight = np.abs(_gravity(s.robot, q))
    i = int(np.argmax(weight))
    limit = [0.5 * w if k == i else 1e5 for k, w in enumerate(weight)]
    return s.words(limits={"effort": limit}), ("weight",), s.robot.u_labels[i].name


def _weak_and_fast(s: _Setting) -> _Plan:
    """Motors that hold every pose and are far too weak for the time."""
    weights = [np.abs(_gravity(s.robot, q)) for q in (s.start, s.goal)]
    limit = 1.2 * np.max(weights, axis=0) + 0.05
    return s.words(duration=0.05, limits={"effort": limit.tolist()}), ("torque",), ""


def _goal_rate(s: _Setting) -> _Plan:
    rate = [2.0 if i == s.joint else 0.0 for i in range(s.robot.nv)]
    goal = {"q": s.goal.tolist(), "v": rate}
    return s.words(duration=20.0, goal=goal, limits={"velocity": s.of_joint(1.0)}), ("goal",), s.name


def _start_rate(s: _Setting) -> _Plan:
    rate = [2.0 if i == s.joint else 0.0 for i in range(s.robot.nv)]
    start = {"q": s.start.tolist(), "v": rate}
    return s.words(duration=20.0, start=start, limits={"velocity": s.of_joint(1.0)}), ("start",), s.name


def _goal_position(s: _Setting) -> _Plan:
    i = s.joint
    bounds = [[-50.0, 50.0] for _ in range(s.robot.nv)]
    middle = float(s.start[i] + s.goal[i]) / 2
    bounds[i] = [-50.0, middle] if s.way[i] > 0 else [middle, 50.0]
    return s.words(limits={"position": bounds}), ("goal",), s.name


def _start_position(s: _Setting) -> _Plan:
    i = s.joint
    bounds = [[-50.0, 50.0] for _ in range(s.robot.nv)]
    middle = float(s.start[i] + s.goal[i]) / 2
    bounds[i] = [middle, 50.0] if s.way[i] > 0 else [-50.0, middle]
    return s.words(limits={"position": bounds}), ("start",), s.name


def _reach(s: _Setting) -> _Plan:
    far = (s.tool_at(s.robot.q0) + 20.0 * _direction(s)).tolist()
    return s.words(goal={"frame": {"name": s.tool, "position": far}, "v": 0}), ("reach",), s.tool


def _via_reach(s: _Setting) -> _Plan:
    far = (s.tool_at(s.robot.q0) + 20.0 * _direction(s)).tolist()
    via = {"name": "gate", "time": _REST / 2, "frame": {"name": s.tool, "position": far}}
    return s.words(via=[via]), ("reach",), s.tool


def _gravity(robot: Robot, q: Array) -> Array:
    """Efforts that hold a pose [N, N m], shape (nv,)."""
    model = robot.model
    return np.asarray(pin.computeGeneralizedGravity(model, model.createData(), np.array(q)))


def _direction(s: _Setting) -> Array:
    direction = s.rng.normal(size=3)
    return np.asarray(direction / np.linalg.norm(direction))


def _frame_speed(s: _Setting) -> _Plan:
    distance = float(np.linalg.norm(s.tool_at(s.goal) - s.tool_at(s.start)))
    path = {"name": "slowly", "kind": "speed", "frame": s.tool, "max": max(0.5 * distance, 1e-3)}
    return s.words(path=[path]), ("frame_speed",), "slowly"


def _wall_before_goal(s: _Setting) -> _Plan:
    return _wall(s, s.goal, s.start, "goal")


def _wall_behind_start(s: _Setting) -> _Plan:
    return _wall(s, s.start, s.goal, "start")


def _wall(s: _Setting, excluded: Array, other: Array, kind: str) -> _Plan:
    """A bound on the tool's position along the axis in which the two poses differ most."""
    a, b = s.tool_at(excluded), s.tool_at(other)
    axis = int(np.argmax(np.abs(a - b)))
    middle = float(a[axis] + b[axis]) / 2
    bound = [-100.0, middle] if a[axis] > middle else [middle, 100.0]
    path = {"name": "wall", "kind": "position", "frame": s.tool, "xyz"[axis]: bound}
    return s.words(path=[path]), (kind,), "wall"


def _contradiction(s: _Setting) -> _Plan:
    """Two walls that leave no place between them, on the way but not at its ends."""
    x = float(s.tool_at(s.goal)[0])
    span = {"from": 0.3 * _REST, "until": 0.6 * _REST}
    paths = [
        {"name": "left", "kind": "position", "frame": s.tool, "x": [-100.0, x - 0.1], **span},
        {"name": "right", "kind": "position", "frame": s.tool, "x": [x + 0.1, 100.0], **span},
    ]
    return s.words(path=paths), ("contradiction",), "left"


def _blocked_goal(s: _Setting) -> _Plan:
    return _blocked(s, s.goal, "goal")


def _blocked_start(s: _Setting) -> _Plan:
    return _blocked(s, s.start, "start")


def _blocked(s: _Setting, q: Array, kind: str) -> _Plan:
    """A ball in the last link."""
    links = s.robot.collision_spheres
    link = links[-1] if links else None
    at = s.tool_at(q)
    if link is not None:
        placed = s.robot.frame_placement(s.robot.model.frames[link.frame].name, q)
        at = placed.act(np.array(link.centers[0]))
    ball = {"name": "ball", "shape": "sphere", "position": np.asarray(at).tolist(), "radius": 0.05}
    return s.words(obstacle=[ball]), (kind,), "ball"


def _goal_against_itself(s: _Setting) -> _Plan:
    """All joints, and the tool at a place that it has in another pose."""
    there = s.tool_at(s.start).tolist()
    goal = {"q": s.goal.tolist(), "v": 0, "frame": {"name": s.tool, "position": there}}
    return s.words(goal=goal), ("contradiction",), s.tool


def _via_behind_wall(s: _Setting) -> _Plan:
    """A wall that both ends respect, and the via point does not."""
    via = np.array(s.robot.integrate(s.start, -s.way))
    i, ends = _most_apart(s, via)
    bound = sorted([float(s.tool_at(via)[i] + ends) / 2, float(np.sign(ends - s.tool_at(via)[i])) * 100.0])
    path = {"name": "wall", "kind": "position", "frame": s.tool, "xyz"[i]: bound}
    return (
        s.words(path=[path], via=[{"name": "gate", "time": _REST / 2, "q": via.tolist()}]),
        ("via",),
        "wall",
    )


def _most_apart(s: _Setting, q: Array) -> tuple[int, float]:
    """Axis along which a pose's tool is most beyond those of both ends, and the nearest of these."""
    at, ends = s.tool_at(q), np.array([s.tool_at(s.start), s.tool_at(s.goal)])
    beyond = np.fmax(at - ends.max(axis=0), ends.min(axis=0) - at)
    i = int(np.argmax(beyond))
    if beyond[i] <= 0.0:  # not beyond: the wall is then one of the ends'
        i = int(np.argmax(np.abs(at - ends[0])))
    return i, float(ends[np.argmin(np.abs(ends[:, i] - at[i])), i])


def _blocked_via(s: _Setting) -> _Plan:
    """A ball in the last link at a via point."""
    via = np.array(s.robot.integrate(s.start, -s.way))
    words, _, where = _blocked(s, via, "via")
    return {**words, "via": [{"name": "gate", "time": _REST / 2, "q": via.tolist()}]}, ("via",), where


def _wall_out_of_reach(s: _Setting) -> _Plan:
    """The tool is to be where it cannot be for a while."""
    path = {"name": "far", "kind": "position", "frame": s.tool, "x": [30.0, 40.0], "from": 0.4, "until": 0.6}
    return s.words(path=[path]), ("reach",), "far"


def _via_too_soon(s: _Setting) -> _Plan:
    limit = 5.0 * abs(s.way[s.joint])
    via = {"name": "gate", "time": 0.1 * _REST, "q": s.goal.tolist()}
    return s.words(via=[via], limits={"velocity": s.of_joint(limit)}), ("speed",), s.name


KINDS: dict[str, Callable[[_Setting], _Plan]] = {
    "too short for a joint's speed": _speed,
    "the same, where time is free": _speed_of_free_time,
    "too short for an acceleration": _acceleration,
    "too short for a jerk": _jerk,
    "via point too soon for a speed": _via_too_soon,
    "goal too heavy to be held": _held_goal,
    "start too heavy to be held": _held_start,
    "motors too weak for the time": _weak_and_fast,
    "goal faster than its limit": _goal_rate,
    "start faster than its limit": _start_rate,
    "goal outside of joint limits": _goal_position,
    "start outside of joint limits": _start_position,
    "goal out of reach": _reach,
    "via point out of reach": _via_reach,
    "too far for a frame's speed": _frame_speed,
    "wall before the goal": _wall_before_goal,
    "wall behind the start": _wall_behind_start,
    "walls that contradict each other": _contradiction,
    "wall out of reach": _wall_out_of_reach,
    "via point behind a wall": _via_behind_wall,
    "goal against itself": _goal_against_itself,
    "obstacle at a via point": _blocked_via,
    "obstacle at the goal": _blocked_goal,
    "obstacle at the start": _blocked_start,
}


def planted(robots: Sequence[str] = ROBOTS, seed: int = 1) -> Iterator[Planted]:
    """The problems: every kind for each robot, the first of them twice."""
    for name in robots:
        robot = load_robot(name, **_options(name))
        rng = np.random.default_rng([seed, *name.encode()])
        kinds = list(KINDS)
        for k in range(_REPEATED):
            kind = kinds[k % len(kinds)]
            setting = _setting(robot, rng)
            words, causes, where = KINDS[kind](setting)
            yield Planted(name, kind, {"robot": robot, **words}, causes, where)


def _options(name: str) -> dict[str, Any]:
    return {"lock": ["panda_finger_joint1", "panda_finger_joint2"]} if name == "panda" else {}


def _setting(robot: Robot, rng: np.random.Generator) -> _Setting:
    """Two poses within the limits, half a radian apart at least in the joint that is meant."""
    while True:
        ends = [_pose(robot, rng) for _ in range(2)]
        way = np.abs(robot.difference(*ends))
        joint = int(rng.integers(robot.nv))
        if way[joint] > 0.5:
            return _Setting(robot, rng, *ends, joint)


def _pose(robot: Robot, rng: np.random.Generator) -> Array:
    v = rng.uniform(-1.2, 1.2, robot.nv)
    q = np.array(robot.integrate(robot.q0, v))
    lower, upper = robot.limits.position_lower, robot.limits.position_upper
    room = np.where(np.isfinite(upper - lower), 0.05 * (upper - lower), 0.0)
    return np.asarray(np.clip(q, lower + room, upper - room))


def verdict(one: Planted) -> Verdict:
    """What is said of a planted problem, and whether it is right."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            problem = Problem.create(**one.words)
    except MbocpError as error:
        said = str(error)
        return Verdict("named" if one.where in said else "misnamed", f"refused: {said}")
    causes = explain(problem, search=False).causes
    if not causes:
        return Verdict("silent", "")
    first = causes[0]
    is_right = first.kind in one.causes and one.where in f"{first.where} {first.words}"
    return Verdict("named" if is_right else "misnamed", first.words)


def sound(robots: Sequence[str] = ROBOTS, seed: int = 1, count: int = 5) -> Iterator[Planted]:
    """Problems of the same random poses with nothing against them, `count` for each robot."""
    for name in robots:
        robot = load_robot(name, **_options(name))
        rng = np.random.default_rng([seed, 7, *name.encode()])
        for _ in range(count):
            setting = _setting(robot, rng)
            yield Planted(name, "nothing", {"robot": robot, **setting.words(duration=3.0)}, (), "")


def table(problems: Sequence[Planted], verdicts: Sequence[Verdict], note: str = "") -> Table:
    """How many of each kind were named, misnamed or met in silence."""
    counts = Counter((one.kind, found.outcome) for one, found in zip(problems, verdicts, strict=True))
    outcomes = ("named", "misnamed", "silent")
    rows = [(kind, *(str(counts[kind, outcome]) for outcome in outcomes)) for kind in KINDS]
    totals = [sum(counts[kind, outcome] for kind in KINDS) for outcome in outcomes]
    rows.append((f"all: {100 * totals[0] / max(sum(totals), 1):.1f} % named", *map(str, totals)))
    return Table("What makes it impossible", ("planted", *outcomes), rows, note)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, and with `--wrong` what was not named."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.explain", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--wrong", action="store_true", help="list what was not named")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    problems = list(planted(seed=options.seed))
    verdicts = [verdict(one) for one in problems]
    controls = [verdict(one) for one in sound(seed=options.seed)]
    accused = sum(one.outcome != "silent" for one in controls)
    note = f"Of {len(controls)} sound problems of such poses {accused} are said to be impossible."
    show(header(), markdown=options.markdown)
    show(table(problems, verdicts, note), markdown=options.markdown)
    if options.wrong:
        for one, found in zip(problems, verdicts, strict=True):
            if found.outcome != "named":
                print(f"{one.robot}, {one.kind} ({one.where}): {found.outcome}: {found.said}")


if __name__ == "__main__":
    main()
