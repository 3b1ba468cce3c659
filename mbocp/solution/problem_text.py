"""What the text of a solved problem says of its integrator and its limits."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mbocp._arrays import Array
from mbocp._files import parse_toml
from mbocp._numbers import is_number
from mbocp.exceptions import DimensionMismatch, InvalidValue, MbocpError, Unreadable
from mbocp.solution.path_text import PathRow, are_pairs, rows_of_path, rows_of_term, rows_of_via
from mbocp.solution.phase_text import PhasePlace, bounds_in_phases, hold_names, phase_places
from mbocp.solution.via_text import ViaPlace, via_places
from mbocp.terms.rates import RATE_TERMS
from mbocp.terms.span import Place, Span

if TYPE_CHECKING:
    from mbocp.robot import FrameTarget
    from mbocp.robot.collision.obstacle import Obstacle
    from mbocp.terms import FrameGoal

__all__ = [
    "PathRow",
    "acceleration_before",
    "contacts_of",
    "duration_range_of",
    "goal_targets_of",
    "held_by_phases",
    "integrator_of",
    "limits_along_of",
    "limits_of",
    "lines_of",
    "other_goal_targets_of",
    "path_rows_of",
    "phase_places_of",
    "rate_bounds_of",
    "via_goals_of",
    "via_places_of",
]

_KEYS = {"limits_u": "effort", "limits_v": "velocity", "limits_q": "position"}


class _Part(BaseModel):
    """Some keys of a table; what others there are does not matter here."""

    model_config = ConfigDict(strict=True, frozen=True, defer_build=True)


class _Integrator(_Part):
    scheme: str = "se1"
    lie: str = "munthe_kaas"
    substeps: Annotated[int, Field(ge=1, lt=2**63)] = 1


class _Robot(_Part):
    rotations: str = "quaternion"


class _Horizon(_Part):
    duration: float | dict[str, float] = 0.0
    steps: Any = None


class _Problem(_Part):
    coordinates: str = "joint"
    horizon: _Horizon = _Horizon.model_construct()
    phase: list[dict[str, Any]] = []
    integrator: _Integrator = _Integrator.model_construct()
    robot: _Robot | str = _Robot.model_construct()
    start: dict[str, Any] = {}
    goal: dict[str, Any] = {}
    limits: dict[str, Any] = {}
    via: list[dict[str, Any]] = []
    path: list[dict[str, Any]] = []
    obstacle: list[dict[str, Any]] = []
    self_collision: bool | dict[str, Any] = False
    terms: list[dict[str, Any]] = []


def integrator_of(problem_text: str) -> dict[str, Any]:
    """`coordinates` and what the integrator is, of a problem file; "" and 1 if the text is not TOML.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    if problem is None:
        return {"coordinates": "", "scheme": "", "lie": "", "substeps": 1, "rotations": ""}
    robot = problem.robot if isinstance(problem.robot, _Robot) else _Robot.model_construct()
    return {
        "coordinates": problem.coordinates,
        **problem.integrator.model_dump(),
        "rotations": robot.rotations,
    }


def duration_range_of(problem_text: str) -> tuple[float, float] | None:
    """Least and greatest duration [s] of a problem whose duration is free; None where it is given.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    written = problem.horizon.duration if problem is not None else 0.0
    if not isinstance(written, dict):
        return None
    return written.get("min", 0.0), written.get("max", np.inf)


def limits_of(problem_text: str) -> dict[str, Array]:
    """`limits_u`, `limits_v` and `limits_q`, shape (2, n), as far as the text has them as lists of pairs.

    That is how `mbocp.problem.problem_to_toml` writes them; what needs a robot to be understood is left out.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    written = problem.limits if problem is not None else {}
    return {
        name: np.array(written[key], dtype=np.float64).T
        for name, key in _KEYS.items()
        if are_pairs(written.get(key))
    }


def rate_bounds_of(problem_text: str) -> dict[str, Array]:
    """Bounds of accelerations, jerks, rates of controls and powers, shape (2, n), by key in `[limits]`.

    Where they differ from phase to phase, the widest of them.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    if problem is None:
        return {}
    tables = [problem.limits, *(table.get("limits") for table in problem.phase)]
    found = {}
    for key in RATE_TERMS:
        written = [table[key] for table in tables if isinstance(table, dict) and are_pairs(table.get(key))]
        rows = [np.array(pairs, dtype=np.float64).T for pairs in written]
        if rows and all(row.shape == rows[0].shape for row in rows):
            found[key] = _widest(np.array(rows))
    return found


def acceleration_before(problem_text: str) -> Array:
    """Acceleration before the start, shape (nv,) as the text has it as a list; (0,) where it is zero.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    written = problem.start.get("a", []) if problem is not None else []
    is_list = isinstance(written, list) and all(is_number(x) for x in written)
    return np.array(written if is_list else [], dtype=np.float64)


def _widest(rows: Array) -> Array:
    """Bounds (k, 2, n) as wide as the widest finite ones among them, shape (2, n)."""
    known = np.isfinite(rows)
    lower = np.where(known[:, 0], rows[:, 0], np.inf).min(axis=0)
    upper = np.where(known[:, 1], rows[:, 1], -np.inf).max(axis=0)
    return np.array([np.where(lower < np.inf, lower, -np.inf), np.where(upper > -np.inf, upper, np.inf)])


def goal_targets_of(problem_text: str, place: int | None = None) -> tuple[FrameTarget, ...]:
    """Poses that the goal asks of frames; those that cannot be understood are left out.

    Parameters
    ----------
    problem_text : str
    place : int, optional
        Of the goal among several.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    return tuple(goal.target for goal in _frame_goals(_parsed(problem_text), place) if goal.has_pose)


def other_goal_targets_of(problem_text: str, place: int | None) -> tuple[FrameTarget, ...]:
    """The same of all goals among several but the one at `place`.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    several = problem.goal.get("any") if problem is not None else None
    others = [i for i in range(len(several) if isinstance(several, list) else 0) if i != place]
    return tuple(target for i in others for target in goal_targets_of(problem_text, i))


def _frame_goals(problem: _Problem | None, place: int | None) -> list[FrameGoal]:
    goal: Any = problem.goal if problem is not None else {}
    several = goal.get("any")
    if isinstance(several, list) and place is not None:
        goal = several[place] if place < len(several) else {}
    return _frame_goals_of(goal) if isinstance(goal, dict) else []


def _frame_goals_of(asked: dict[str, Any]) -> list[FrameGoal]:
    """Goals of frames of a goal or a via point."""
    tables = asked.get("frame", [])
    if not tables:
        return []
    from mbocp.robot.poses.target import target_from_words  # slow to import, and few results have poses
    from mbocp.terms.frame_goal import FURTHER_KEYS, FrameGoal

    found = []
    for table in tables if isinstance(tables, list) else [tables]:
        try:
            words = {key: value for key, value in table.items() if key not in FURTHER_KEYS}
            further = {key: value for key, value in table.items() if key in FURTHER_KEYS}
            found.append(FrameGoal(target=target_from_words(words), **further))
        except (MbocpError, AttributeError, TypeError, ValueError):
            continue
    return found


def _rows_of_goals(goals: list[FrameGoal]) -> dict[str, PathRow]:
    """What tolerances of the end say."""
    if not goals:
        return {}
    from mbocp.terms.frame_tolerance import tolerance_bounds  # slow to import, and few results have poses

    return {row: PathRow(*bounds, Span()) for row, bounds in tolerance_bounds(goals).items()}


def path_rows_of(problem_text: str, place: int | None = None) -> dict[str, PathRow]:
    """What each row of the path constraints says, by the row's name.

    Parameters
    ----------
    problem_text : str
    place : int, optional
        Of the goal among several.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    if problem is None:
        return {}
    nodes = {via.name: Place(via.node, via.node) for via in _places(problem).values()} | _nodes_of_phases(
        problem
    )
    found: dict[str, PathRow] = {}
    for table in problem.path:
        found |= rows_of_path(table, nodes)
    found |= _rows_of_goals(_frame_goals(problem, place))
    for table in problem.via:
        found |= rows_of_via(str(table.get("name", "")), _frame_goals_of(table))
    for table in problem.terms:
        found |= rows_of_term(table, nodes)
    return found


def via_places_of(problem_text: str) -> tuple[ViaPlace, ...]:
    """Where and when the via points of a problem are, in the order of their nodes; what is odd is left out.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    return tuple(sorted(_places(_parsed(problem_text)).values(), key=lambda place: place.node))


def via_goals_of(problem_text: str) -> tuple[tuple[int, FrameGoal], ...]:
    """Node and pose for each frame at the via points; what is odd is left out.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    tables = problem.via if problem is not None else []
    return tuple(
        (place.node, goal)
        for i, place in _places(problem).items()
        for goal in _frame_goals_of(tables[i])
        if goal.has_pose
    )


def _places(problem: _Problem | None) -> dict[int, ViaPlace]:
    if problem is None:
        return {}
    return via_places(problem.via, problem.horizon.duration, problem.horizon.steps, _nodes_of_phases(problem))


def phase_places_of(problem_text: str) -> tuple[PhasePlace, ...]:
    """The phases of a problem that have names, in their order.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    return phase_places(problem.phase, problem.horizon.steps) if problem is not None else ()


def held_by_phases(problem_text: str) -> frozenset[str]:
    """Names of what the phases of a problem hold, after which multipliers are called.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    return hold_names(problem.phase) if problem is not None else frozenset()


def contacts_of(problem_text: str) -> frozenset[str]:
    """Names of the constraints whose forces a problem bounds.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    tables = [] if problem is None else [problem.path, *(phase.get("path") for phase in problem.phase)]
    rows = (row for table in tables if isinstance(table, list) for row in table if isinstance(row, dict))
    return frozenset(str(row.get("constraint", "")) for row in rows if row.get("kind") == "contact_force")


def limits_along_of(problem_text: str, key: str, whole: Array) -> Array | None:
    """Bounds of a key of `[limits]` at the nodes 1..N, or in the steps, shape (2, N, n), where phases differ.

    Parameters
    ----------
    problem_text : str
    key : str
    whole : ndarray, shape (2, n)
        Those of the problem, infinite where there are none.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem, places = _parsed(problem_text), phase_places_of(problem_text)
    tables = problem.phase if problem is not None else []
    if not places or not any(key in (table.get("limits") or {}) for table in tables):
        return None
    return bounds_in_phases(tables, places, key, whole, at_nodes=key in ("velocity", "position"))


def _nodes_of_phases(problem: _Problem) -> dict[str, Place]:
    places = phase_places(problem.phase, problem.horizon.steps)
    return {p.name: Place(p.first + p.has_impact, p.last, int(p.has_parting)) for p in places}


def lines_of(problem_text: str) -> tuple[Array, ...]:
    """Points of each line or path that a frame is kept on, shape (k, 3) [m].

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    lines = (_line(table) for table in (problem.path if problem is not None else ()))
    return tuple(line for line in lines if line is not None)


def _line(table: dict[str, Any]) -> Array | None:
    ends, points = (table.get("a"), table.get("b")), table.get("points")
    if _triples(*ends):
        return np.array(ends, dtype=np.float64)
    if not (isinstance(points, list) and len(points) > 1 and _triples(*points)):
        return None
    through = np.array(points, dtype=np.float64)
    is_closed = table.get("closed") is True and len(points) > 2
    gaps = np.diff(np.vstack([through, through[: int(is_closed)]]), axis=0)
    from mbocp.terms.spline import curve_through  # slow to import, and few results have curves

    return curve_through(through, is_closed=is_closed).drawn if gaps.any(axis=1).all() else through


def obstacles_of(problem_text: str) -> tuple[Obstacle, ...]:
    """Obstacles as `mbocp.problem.problem_to_toml` writes them; what is odd is left out.

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    from mbocp.robot.collision.hull import hull_of  # slow to import, and wanted only for pictures
    from mbocp.robot.collision.obstacle import MESH, SIZES, Obstacle

    problem, found = _parsed(problem_text), []
    for table in problem.obstacle if problem is not None else ():
        sizes = [table.get(key) for key in SIZES.get(str(table.get("shape")), ())]
        lengths = [x for size in sizes for x in (size if isinstance(size, list) else [size])]
        known = ("name", "shape", "position", "orientation", "frame", "margin", "smoothing")
        given = {k: table[k] for k in known if k in table}
        try:
            hull = hull_of(np.array(table.get("vertices"))) if table.get("shape") == MESH else None
            found.append(Obstacle(sizes=np.array(lengths, dtype=float), hull=hull, **given))
        except (InvalidValue, DimensionMismatch, TypeError, ValueError):
            continue  # not written by mbocp: the picture is without it
    return tuple(found)


def margins_of(problem_text: str) -> dict[str, float]:
    """Margin of each obstacle by name [m]; that of self-collision, where it is asked for, by "".

    Raises
    ------
    InvalidValue
        If the text is TOML, but no problem.
    """
    problem = _parsed(problem_text)
    if problem is None:
        return {}
    tables = {str(table.get("name", "")): table.get("margin", 0.0) for table in problem.obstacle}
    own = problem.self_collision
    if isinstance(own, dict):
        tables[""] = own.get("margin", 0.0)
    return {name: float(margin) for name, margin in tables.items() if is_number(margin)}


def _triples(*points: Any) -> bool:
    return all(
        isinstance(p, list) and len(p) == 3 and all(is_number(x) and np.isfinite(x) for x in p)
        for p in points
    )


@lru_cache(maxsize=4)
def _parsed(problem_text: str) -> _Problem | None:
    try:
        document = parse_toml(problem_text)
    except Unreadable:
        return None
    try:
        return _Problem.model_validate(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(step) for step in first["loc"])
        raise InvalidValue("problem_text", f"{key}: {first['msg']}", "the text of a problem file") from error
