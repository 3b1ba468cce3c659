"""Features of problem files, each a few keys, and the problem that several of them make together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import mbocp
from tests.campaign.guarded import guarded_arm

__all__ = ["FEATURES", "ROBOTS", "Feature", "Scene", "pairs", "tables_of"]

Tables = dict[str, Any]


@dataclass(frozen=True)
class Scene:
    """A robot, two configurations [rad] that its motion joins, and a frame at its end.

    Attributes
    ----------
    torque : float
        That its joints may have [N m].
    room : float
        Of its frame from the obstacle [m].
    """

    source: str
    start: tuple[float, ...]
    goal: tuple[float, ...]
    frame: str
    inner: str
    torque: float
    room: float = 1.0

    @property
    def middle(self) -> list[float]:
        """Half way."""
        return [(a + b) / 2 for a, b in zip(self.start, self.goal, strict=True)]

    def place(self, q: Sequence[float]) -> list[float]:
        """Origin of the frame [m]."""
        return [float(x) for x in _loaded(self.source).frame_placement(self.frame, list(q)).translation]


@cache
def _loaded(source: str) -> mbocp.Robot:
    return mbocp.load_robot(source)


def _small(folder: Path) -> Scene:
    file = folder / "guarded" / "robot.toml"
    if not file.exists():
        guarded_arm(folder)
    return Scene(str(file), (0.2, 0.5, 0.7), (0.6, 0.8, 0.4), "link_2", "link_1", 60.0)


def _ur5(_: Path) -> Scene:
    start, goal = (0.0, -1.2, 1.6, -1.97, -1.57, 0.0), (0.4, -1.0, 1.4, -1.8, -1.4, 0.2)
    return Scene("ur5", start, goal, "tool0", "forearm_link", 300.0)


ROBOTS: Mapping[str, Callable[[Path], Scene]] = {"small": _small, "ur5": _ur5}


@dataclass(frozen=True)
class Feature:
    """What a problem may ask for.

    Attributes
    ----------
    factor : str
        Features of the same factor exclude each other.
    tables : callable
        Keyword arguments of `mbocp.Problem.create` for a scene; tables are merged and lists joined.
    """

    name: str
    factor: str
    tables: Callable[[Scene], Tables]


def _f(name: str, tables: Callable[[Scene], Tables], factor: str = "") -> Feature:
    return Feature(name, factor or name, tables)


def _path(**keys: Any) -> Callable[[Scene], Tables]:
    return lambda s: {"path": [{"frame": s.frame, **keys}]}


def _scheme(scheme: str, **others: Any) -> Callable[[Scene], Tables]:
    return lambda _: {"integrator": {"scheme": scheme}, **others}


def _limit(**limits: Any) -> Callable[[Scene], Tables]:
    return lambda _: {"limits": limits}


def _goal_frame(**tolerance: float) -> Callable[[Scene], Tables]:
    return lambda s: {"goal": {"frame": [{"name": s.frame, "position": s.place(s.goal), **tolerance}]}}


def _via(**keys: Any) -> Callable[[Scene], Tables]:
    return lambda s: {"via": [{"name": "via", "q": s.middle, **keys}]}


def _via_frame(**keys: Any) -> Callable[[Scene], Tables]:
    def tables(s: Scene) -> Tables:
        frame = {"name": s.frame, "position": s.place(s.middle), **keys}
        return {"via": [{"name": "pose", "share": 0.5, "frame": [frame]}]}

    return tables


def _box(**keys: Any) -> Callable[[Scene], Tables]:
    def tables(s: Scene) -> Tables:
        x, y, z = s.place(s.middle)
        box = {"shape": "box", "size": [0.2, 0.2, 0.2], "position": [x, y, z + s.room], "margin": 0.02}
        return {"obstacle": [{"name": "box", **box, **keys}]}

    return tables


def _phases(first: Tables, second: Tables) -> Callable[[Scene], Tables]:
    return lambda _: {
        "phase": [
            {"name": "first", "steps": 3, "duration": 0.5, **first},
            {"name": "second", "steps": 3, "duration": 0.5, **second},
        ]
    }


def _held(s: Scene) -> Tables:
    hold = {"frame": s.frame, "kind": "plane", "axis": [1, 0, 0], "meeting": "soft", "name": "wall"}
    return _phases({}, {"hold": [hold]})(s)


def _struck(s: Scene) -> Tables:
    hold = {"frame": s.frame, "kind": "plane", "axis": [1, 0, 0], "name": "wall"}
    return _phases({}, {"hold": [hold]})(s)


def _pushed(s: Scene) -> Tables:
    push = {"kind": "contact_force", "constraint": "wall", "max": 1e4}
    return _struck(s) | {"path": [push]}


def _periodic(_: Scene) -> Tables:
    return {"goal": {"periodic": True}, "start": {"free": True}}


def _payload(s: Scene) -> Tables:
    return {"robot": {"payload": [{"name": "crate", "frame": s.frame, "mass": 1.0, "box": [0.1, 0.1, 0.1]}]}}


def _any_goal(s: Scene) -> Tables:
    turned = [*s.goal[:-1], s.goal[-1] + 0.1]  # about the axis through its frame, whose origin stays on lines
    return {"goal": {"any": [{"q": list(s.goal)}, {"q": turned}]}}


def _line(s: Scene) -> Tables:
    return {"path": [{"kind": "line", "frame": s.frame, "a": s.place(s.start), "b": s.place(s.goal)}]}


def _follow(s: Scene) -> Tables:
    points = [s.place(s.start), s.place(s.middle), s.place(s.goal)]
    return {"path": [{"kind": "follow", "frame": s.frame, "points": points, "tolerance": 0.1}]}


_FREE = {"min": 0.4, "max": 4.0, "guess": 1.0}
FEATURES: dict[str, Feature] = {
    feature.name: feature
    for feature in (
        _f("effort", lambda s: {"limits": {"effort": s.torque}}),
        _f("velocity", _limit(velocity=3.0)),
        _f("position", lambda s: {"limits": {"position": [[-3.0, 3.0]] * len(s.start)}}),
        _f("power", _limit(power=900.0)),
        _f("acceleration", _limit(acceleration=60.0)),
        _f("jerk", _limit(jerk=900.0)),
        _f("effort_rate", _limit(effort_rate=5000.0)),
        _f("fuel", lambda s: {"cost": {"fuel": 1e-3}, "limits": {"effort": s.torque}}),
        _f("control_rate", lambda _: {"cost": {"control_rate": 1e-4}}),
        _f("acceleration_cost", lambda _: {"cost": {"acceleration": 1e-3}}),
        _f("tracking", lambda s: {"cost": {"tracking": 0.1, "target": {"q": s.middle}}}),
        _f("via_q", _via(share=0.5), "via"),
        _f("via_time_free", _via(time="free", share=0.5), "via"),
        _f("via_frame", _via_frame(), "via"),
        _f("via_box", _via_frame(position_tolerance=0.05), "via"),
        _f("path_position", lambda s: _path(kind="position", z=[-2.0, 2.0])(s)),
        _f("path_distance", _path(kind="distance", point=[0.0, 0.0, -1.0], min=0.1)),
        _f("path_speed", _path(kind="speed", max=5.0)),
        _f("path_spin", _path(kind="angular_speed", max=20.0)),
        _f("path_centre", lambda _: {"path": [{"kind": "centre_of_mass", "z": [-9.0, 9.0]}]}),
        _f("path_orientation", _path(kind="orientation", axis=[1, 0, 0], max=3.1)),
        _f("path_kept", _path(kind="orientation_kept", tolerance=1.5)),
        _f("path_line", _line, "line"),
        _f("path_follow", _follow, "line"),
        _f("goal_frame", _goal_frame(), "goal"),
        _f("goal_box", _goal_frame(position_tolerance=0.02), "goal"),
        _f("goal_any", _any_goal, "goal"),
        _f("periodic", _periodic, "goal"),
        _f("penalty", lambda _: {"goal": {"enforce": "both"}, "cost": {"terminal": 1.0}}),
        _f("obstacle", _box(), "obstacle"),
        _f("movable", _box(movable=True), "obstacle"),
        _f("carried", lambda s: _box(frame=s.inner, position=[0.0, 0.0, 1.5], movable=True)(s), "obstacle"),
        _f("self_collision", lambda _: {"self_collision": True}),
        _f("payload", _payload),
        _f("lock", lambda s: {"lock": True}),
        _f("free_start", lambda _: {"start": {"free": "v"}}),
        _f("free_duration", lambda _: {"duration": _FREE, "cost": {"time": 0.1}}, "horizon"),
        _f("phase_limits", _phases({"limits": {"velocity": 2.5}}, {"cost": {"effort": 0.02}}), "horizon"),
        _f("free_phases", _phases({"duration": _FREE}, {"duration": _FREE}), "horizon"),
        _f("hold_soft", _held, "horizon"),
        _f("hold_impact", _struck, "horizon"),
        _f("contact_force", _pushed, "horizon"),
        _f("linear", _scheme("gauss2", controls="linear"), "scheme"),
        _f("stages", _scheme("gauss2", controls="stages"), "scheme"),
        _f("se1", _scheme("se1"), "scheme"),
        _f("se2", _scheme("se2"), "scheme"),
        _f("semi_implicit", _scheme("semi_implicit_euler"), "scheme"),
        _f("midpoint", _scheme("midpoint"), "scheme"),
        _f("gauss2", _scheme("gauss2"), "scheme"),
        _f("lobatto2", _scheme("lobatto2"), "scheme"),
        _f("heun", _scheme("heun"), "scheme"),
        _f("natural", lambda _: {"coordinates": "natural"}),
        _f("ipopt", lambda _: {"solver": {"method": "ipopt"}}),
        _f("receding", lambda _: {"solver": {"max_iterations": 100}}),  # what it is for: `tests.pairs.run`
        _f("threads", lambda _: {"solver": {"threads": 2}}),
    )
}


def pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of features of different factors."""
    return [(a, b) for a, b in combinations(sorted(names), 2) if FEATURES[a].factor != FEATURES[b].factor]


def tables_of(scene: Scene, names: Sequence[str]) -> Tables:
    """Keyword arguments of `mbocp.Problem.create`: six steps, at most ten iterations."""
    tables: Tables = {"robot": {"name": scene.source}, "start": {"q": list(scene.start)}}
    tables |= {"goal": {"v": 0}, "cost": {"effort": 1e-2}, "guess": {"kind": "line"}}
    tables |= {"solver": {"max_iterations": 10}, "duration": 1.0, "steps": 6}
    for name in sorted(names):
        tables = _merged(tables, FEATURES[name].tables(scene))
    if not {"frame", "any", "periodic"} & tables["goal"].keys():
        tables["goal"]["q"] = list(scene.goal)
    if "periodic" in tables["goal"]:
        del tables["goal"]["v"]
    if "phase" in tables:
        del tables["duration"], tables["steps"]
        for via in tables.get("via", []):
            if "time" not in via:
                del via["share"]
                via["time"] = "first"
    if tables.pop("lock", False):
        _lock(tables, scene)
    return tables


def _lock(tables: Tables, scene: Scene) -> None:
    """Make the last joint rigid where it begins, and take it out of all lists of joints."""
    joint = _loaded(scene.source).joint_names[-1]
    tables["robot"]["lock"] = {joint: scene.start[-1]}
    goals = [tables["goal"], *tables["goal"].get("any", [])]
    for table in (tables["start"], tables["cost"].get("target", {}), *goals, *tables.get("via", [])):
        if "q" in table:
            table["q"] = table["q"][:-1]
    if "position" in tables.get("limits", {}):
        tables["limits"]["position"] = tables["limits"]["position"][:-1]


def _merged(a: Any, b: Any) -> Any:
    """Of two tables; lists of tables one after the other."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a | {key: _merged(a[key], b[key]) if key in a else b[key] for key in b}
    if isinstance(a, list) and isinstance(b, list):
        return [*a, *b]
    return b
