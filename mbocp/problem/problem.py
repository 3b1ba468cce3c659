"""The optimal control problem as one immutable value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.problem.document import Document, make_document, read_document
from mbocp.problem.file.changes import change_document
from mbocp.problem.file.messages import in_file
from mbocp.problem.file.tables import write_tables
from mbocp.problem.found_parameter import with_values
from mbocp.problem.goals.goal import Goal, reachable_members
from mbocp.problem.pipeline import run_steps
from mbocp.problem.problem_data import ProblemData
from mbocp.problem.resolve import RESOLVE
from mbocp.robot import Robot
from mbocp.terms import OwnTerm

_FIELDS = [
    field.name
    for field in fields(ProblemData)
    if field.name not in ("source", "name", "limits_within", "tube")
]


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem(ProblemData):
    """Optimal control of a multibody system.

    `mbocp.problem.problem_data.ProblemData` has its mathematics and fields.

    `Problem.create` makes one from the words of a problem file, `with_` makes another one from it.

    Attributes
    ----------
    document : Document
        What was said, of which all fields follow.
    draft : mapping
        What followed on the way: `with_` works out again what changes alone.
    members_in_reach : tuple of (int, Problem)
        Of several goals, place and problem of each that is not out of reach.
    """

    document: Document = field(repr=False)
    draft: Mapping[str, Any] = field(repr=False)
    members_in_reach: tuple[tuple[int, Problem], ...] = field(repr=False, default=())

    def __getstate__(self) -> dict[str, Any]:
        said = {field.name: getattr(self, field.name) for field in fields(self)}
        return {**said, "draft": {}}  # where it goes all else is worked out anew

    @property
    def members(self) -> tuple[tuple[int, Problem], ...]:
        """Place among `goals` and problem of each that is in reach; of one goal the problem itself."""
        return self.members_in_reach or ((0, self),)

    def member(self, place: int | None) -> Problem:
        """The problem of one of several goals by its place among `goals`; None: of the first in reach."""
        return dict(self.members_in_reach).get(place, self) if place is not None else self

    def __repr__(self) -> str:
        return (
            f"<Problem {self.name}: {self.robot.name}, {self.timeline.duration:g} s in {self.num_steps} "
            f"steps of {self.scheme}>"
        )

    @classmethod
    def create(
        cls,
        robot: Robot | str | Path | Mapping[str, Any],
        duration: float | Mapping[str, float] | None = None,
        steps: int | None = None,
        *,
        accuracy: float | None = None,
        controls: str | None = None,
        phase: Sequence[Mapping[str, Any]] | None = None,
        ground: Mapping[str, Any] | None = None,
        gait: Mapping[str, Any] | None = None,
        start: Mapping[str, Any] | None = None,
        goal: Mapping[str, Any] | None = None,
        cost: Mapping[str, Any] | None = None,
        limits: Mapping[str, Any] | None = None,
        robust: Mapping[str, Any] | None = None,
        via: Sequence[Mapping[str, Any]] | None = None,
        obstacle: Sequence[Mapping[str, Any]] | None = None,
        self_collision: bool | Mapping[str, Any] | None = None,
        path: Sequence[Mapping[str, Any]] | None = None,
        parameter: Sequence[Mapping[str, Any]] | None = None,
        terms: Sequence[OwnTerm] = (),
        guess: Mapping[str, Any] | None = None,
        integrator: Mapping[str, Any] | None = None,
        solver: Mapping[str, Any] | None = None,
        coordinates: str = "joint",
        scheme: str = "",
        name: str = "problem",
    ) -> Problem:
        """Make a problem from the words of a problem file.

        Parameters
        ----------
        robot : Robot, str, Path or mapping
            A loaded robot, or what the key `robot` of a file takes.
        duration : float or mapping
            [s]; with `min`, `max` and, if you like, `guess`: free between the two. Left out with `phase`:
            what phases sum up to.
        steps : int
            Left out with `phase`, and with `accuracy`.
        accuracy : float, optional
            Of the motion, in place of the number of steps.
        controls : {"constant", "linear", "stages"}, optional
            How controls vary within a step; constant by default.
        phase : sequence of mapping, optional
            The tables `[[phase]]`.
        ground, gait, start, goal, cost, limits, robust, guess, integrator, solver : mapping, optional
            The tables of a problem file; arrays may be NumPy's.
        via, obstacle, path, parameter : sequence of mapping, optional
            The tables `[[via]]`, `[[obstacle]]`, `[[path]]` and `[[parameter]]`.
        self_collision : bool or mapping, optional
            The key or table `self_collision`.
        terms : sequence of OwnTerm
            Terms of one's own, see `mbocp.terms.own`.
        scheme : str
            Short for the key `scheme` of `integrator`; what suits the problem where neither is given.

        Examples
        --------
        >>> goal = {"q": [0.5, -1, 1, 0, 0.5, 0], "v": [0] * 6}
        >>> problem = Problem.create("ur5", 1.0, 100, goal=goal)  # doctest: +SKIP
        """
        horizon = {"duration": duration, "steps": steps, "accuracy": accuracy, "controls": controls}
        tables = {
            "phase": phase,
            "ground": ground,
            "gait": gait,
            "start": start,
            "goal": goal,
            "cost": cost,
            "limits": limits,
            "robust": robust,
            "via": via,
            "obstacle": obstacle,
            "self_collision": self_collision,
            "path": path,
            "parameter": parameter,
            "guess": guess,
            "solver": solver,
        }
        given = {
            "horizon": {key: value for key, value in horizon.items() if value is not None},
            "coordinates": coordinates,
            "integrator": {**(integrator or {}), **({"scheme": scheme} if scheme else {})},
            **{key: table for key, table in tables.items() if table is not None},
        }
        document = make_document(given, robot=robot, name=name, terms=tuple(terms))
        with in_file(document.label):
            return cls.of(document)

    def with_(self, **changes: Any) -> Problem:
        """Return a copy with some fields changed, validated again.

        Parameters
        ----------
        **changes
            Fields of this class, or words of `create`: of a table only the keys that are given change
            (``cost={"velocity": 1.0}``), `guess`, `via` and `path` are replaced as a whole, so are `limits`
            that give a `profile`, whose rows of `path` come and go with it. A `frame` takes the place of a
            `q` of the goal that gives every joint. A `cost` where there was none is as a file writes it:
            velocities have no weight unless it gives one.

        Raises
        ------
        ProblemError
            If there is no such field or word, or a value is of the wrong kind.
        """
        written = partial(write_tables, self)
        said = self.draft or read_document(self.document, None)
        names = [row.name for row in said["path_of_others"]]
        paths = said["own_path"], [row for row in self.path if row.name in names]
        document, has_tables = change_document(self.document, changes, self.timeline, written, paths)
        with in_file(document.label) if has_tables else nullcontext():
            return type(self).of(document, self)

    def with_found(self, values: Mapping[str, float]) -> Problem:
        """Return the problem with the robot that was found, by `Solution.parameters`; itself without any."""
        if not self.parameter:
            return self
        found = [values.get(one.name, one.start) for one in self.parameter]
        pairs = zip(self.parameter, found, strict=True)
        parameter = tuple(replace(one, start=value) for one, value in pairs)
        return replace(self, robot=with_values(self.robot, self.parameter, found), parameter=parameter)

    def with_steps_at(self, ts: Array) -> Problem:
        """Return the problem with the steps of a motion whose nodes are at times `ts`, shape (N + 1,) [s].

        Itself, unless `accuracy` asks for steps that are found. Those of phases it has already.
        """
        if self.accuracy is None:
            return self
        dts = np.diff(ts)
        is_even = self.timeline.has_free_lengths or np.allclose(dts, dts[0])
        lengths = {} if is_even else {"lengths": dts}
        steps = {} if self.timeline.named_phases else {"num_steps": len(dts), **lengths}
        return self.with_(accuracy=None, **steps)

    @classmethod
    def of(cls, document: Document, before: Problem | None = None) -> Problem:
        """Make the problem that a document says.

        Parameters
        ----------
        document : Document
        before : Problem, optional
            Made of another document: what is the same in both is not worked out again.
        """
        then = None if before is None or not before.draft else (before.document, before.draft)
        said = read_document(document, then)
        if not said["goals"]:
            return cls._of_one(document, run_steps(RESOLVE, said, then[1] if then else None))

        def resolve(goal: Goal) -> Problem:
            own = document.with_values({"said_goal": goal, "goals": ()})
            return cls._of_one(own, run_steps(RESOLVE, {**said, **own.values}))

        members = reachable_members(said["goals"], resolve)
        first = members[0][1]
        return replace(first, document=document, draft=said, goals=said["goals"], members_in_reach=members)

    @classmethod
    def _of_one(cls, document: Document, draft: dict[str, Any]) -> Problem:
        values: dict[str, Any] = {name: draft[name] for name in _FIELDS}
        return cls(**values, document=document, draft=draft, source=document.source, name=document.name)


def problem_from_tables(
    document: Mapping[str, Any],
    *,
    robot: Robot | str | Path | Mapping[str, Any] | None = None,
    source: Path | None = None,
    label: str = "problem",
    name: str = "",
    terms: Sequence[OwnTerm] = (),
) -> Problem:
    """Validate the tables and make the problem, see `mbocp.problem.document.make_document`."""
    made = make_document(document, robot=robot, source=source, label=label, name=name, terms=tuple(terms))
    with in_file(label):
        return Problem.of(made)
