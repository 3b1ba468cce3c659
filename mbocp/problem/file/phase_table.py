"""Times as people write them: `[horizon]` and `[[phase]]`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from mbocp._keys import Key, Table
from mbocp.exceptions import ProblemError
from mbocp.integrators import CONTROLS
from mbocp.problem._checks import choice, whole
from mbocp.problem.file.cost_table import PhaseCostTable
from mbocp.problem.file.limits_table import LimitsTable, read_limits, write_limits
from mbocp.problem.file.path_table import PathTable
from mbocp.problem.file.start_tables import ViaTable
from mbocp.problem.file.value_kinds import RELEASED, SEVERAL, Duration
from mbocp.problem.timeline.hold import Hold
from mbocp.problem.timeline.phase import Phase, PhaseHold, PhaseRelease, check_phase
from mbocp.problem.timeline.phase_values import in_phase
from mbocp.problem.timeline.sequence import Horizon, horizon_of, in_order
from mbocp.problem.timeline.step_counts import FIRST_STEPS
from mbocp.problem.timeline.times import duration_from, write_duration
from mbocp.problem.weights import weights_by_key
from mbocp.robot import Robot
from mbocp.robot.kinematics import WORLD
from mbocp.terms.cost import CostTableReader, shortest
from mbocp.terms.span import SPAN, AtVia, Share
from mbocp.terms.written import Finite, Positive, Triple


class HorizonTable(Table):
    """How long, and in how many steps."""

    duration: Annotated[
        Duration, Key("T; with a table it is [free](#free-duration)", "s", "required without `[[phase]]`")
    ] = None
    steps: Annotated[
        int | None,
        whole(1),
        Key("N, as [memory](#how-many-steps) allows", "", "required without `[[phase]]`"),
    ] = None
    accuracy: Annotated[
        Finite | None,
        Key(
            "in place of `steps`, which [are found](#accuracy-in-place-of-steps); also a part of the cost",
            "rad, m",
            takes="number from 1e-10 to 0.1",
        ),
    ] = None
    lengths: Annotated[
        list[Positive] | None,
        Key("in place of `steps`: the length of each", "s", takes="list of numbers > 0"),
    ] = None
    controls: Annotated[
        str, choice(CONTROLS), Key("how controls vary [within a step](#controls-within-a-step)")
    ] = "constant"


class HoldTable(Table):
    """A frame that is held throughout a phase."""

    name: Annotated[str | None, Key("of the hold, and of its forces", "", "`frame` at `to`")] = None
    frame: Annotated[str, Key("the frame that is held")]
    to: Annotated[str, Key("the frame that holds it")] = WORLD
    kind: Annotated[
        str,
        Key(
            '[what is held](phases.md#what-is-held): `"weld"`, `"point"`, `"hinge"`, `"plane"`, `"line"`, '
            '`"screw"`'
        ),
    ] = "weld"
    at: Annotated[str, Key('where it is when the hold begins, or where both frames `"coincide"`')] = (
        "where_it_is"
    )
    axis: Annotated[
        Triple,
        Key("of a hinge or screw, in `frame`; of a plane (its normal) or line, in `to`", "", "`[0, 0, 1]`"),
    ] = None
    pitch: Annotated[Finite | None, Key("of a screw: way along the axis in a turn", "m")] = None
    meeting: Annotated[str, Key('how it begins: with an `"impact"`, or `"soft"`')] = "impact"


class ReleaseTable(Table):
    """A constraint of the robot that does not hold in a phase."""

    name: Annotated[str, Key("the constraint that does not hold")]
    meeting: Annotated[str, Key("how it is taken on again")] = "impact"


class PhaseTable(Table):
    """A run of steps, and what differs in it."""

    name: Annotated[str, Key("its name")]
    steps: Annotated[int, whole(1), Key("its number of steps")]
    duration: Annotated[Duration, Key("how long it takes", "s")]
    contacts: Annotated[
        list[str] | None, Key("feet that [stand](contact.md#legs)", "", "none", "list of names")
    ] = None
    limits: Annotated[LimitsTable, Key("keys of `[limits]`", "", "those of the problem")] = (
        LimitsTable.model_construct()
    )
    cost: Annotated[
        PhaseCostTable,  # type: ignore[valid-type]  # made of its terms
        Key(
            f"weights in it: {', '.join(f'`{key}`' for key in PhaseCostTable.model_fields)}",
            "",
            "that of the problem",
        ),
    ] = PhaseCostTable.model_construct()
    hold: Annotated[list[HoldTable], SEVERAL, Key("[frames that are held](phases.md#what-is-held)")] = Field(
        default_factory=list
    )
    release: Annotated[list[ReleaseTable], RELEASED, Key("constraints of the robot that do not hold")] = (
        Field(default_factory=list)
    )
    path: Annotated[
        list[PathTable],  # type: ignore[valid-type]
        Key("path constraints in it: keys of `[[path]]`; `from` and `until` are parts of the phase"),
    ] = Field(default_factory=list)
    via: Annotated[
        list[ViaTable], Key("via points at its end, or a `share` of it: keys of `[[via]]` but `time`")
    ] = Field(default_factory=list)


def phases_from(robot: Robot, phases_on_ground: Sequence[PhaseTable]) -> tuple[Phase, ...]:
    """Make the phases from the tables of `[[phase]]`, but for their weights.

    Raises
    ------
    ProblemError, InvalidValue, DimensionMismatch, UnknownJoint
        If a value cannot be right, or does not fit the robot.
    """
    found = []
    for table in phases_on_ground:
        key = f"phase {table.name!r}"
        with in_phase(table.name):
            if table.limits.profile:
                raise ProblemError("limits.profile: phases have keys of their own; it belongs into [limits]")
            limits = read_limits(robot, table.limits)
        duration = duration_from(table.duration, key=f"{key}: duration")
        with in_phase(table.name):
            holds = tuple(_hold(robot, held) for held in table.hold)
            releases = tuple(PhaseRelease(one.name, one.meeting) for one in table.release)  # type: ignore[arg-type]
        own: dict[str, Any] = {"limits": limits, "holds": holds, "releases": releases, **duration}
        found.append(check_phase(Phase(name=table.name, steps=table.steps, **own)))
    return in_order(found)


def _hold(robot: Robot, table: HoldTable) -> PhaseHold:
    name = table.name or f"{table.frame} at {table.to}"
    words: Any = {"kind": table.kind, "at": table.at}
    words |= {} if table.axis is None else {"axis": tuple(table.axis)}
    words |= {} if table.pitch is None else {"pitch": table.pitch}
    hold = Hold(name=name, frame=table.frame, to=table.to, **words)
    if table.axis is not None and "axis" not in hold.keys:
        raise ProblemError(f"hold {name!r}: axis: one of kind {table.kind!r} has none; leave it out")
    hold.constraint(robot)
    return PhaseHold(hold, table.meeting)  # type: ignore[arg-type]  # checked by the class


def weigh_phases(
    phases_on_ground: Sequence[PhaseTable], phases_unweighted: Sequence[Phase], cost_reader: CostTableReader
) -> tuple[Phase, ...]:
    """Return the phases with the weights that they have, by the key of their term."""
    found = []
    for table, phase in zip(phases_on_ground, phases_unweighted, strict=True):
        weights: dict[str, Any] = {}
        written: Any = table.cost
        with in_phase(table.name):
            for key, term in weights_by_key().items():
                if key in written.model_fields_set:
                    weights |= term.read(written, cost_reader)
        found.append(check_phase(replace(phase, weights=weights)))
    return tuple(found)


def horizon_from(table: HorizonTable, phases: Sequence[Phase]) -> Horizon:
    """Steps and duration of the whole: what is written, or what the phases come to.

    Raises
    ------
    ProblemError
        If a key is missing, and there are no phases to say it.
    """
    own = horizon_of(phases) if phases else None
    table = _complete(table, has_phases=bool(phases))
    missing = [key for key in ("duration", "steps") if getattr(table, key) is None]
    if own is None and missing:
        key = "horizon" if len(missing) == 2 else f"horizon.{missing[0]}"
        raise ProblemError(f"{key}: this key is missing")
    steps: Any = table.steps if own is None or table.steps is not None else own.steps
    if table.duration is None and own is not None:
        return Horizon(steps, own.duration, own.duration_range)
    written = table.duration
    if own is not None and isinstance(written, Mapping) and {"min", "max"} <= set(written):
        guess = min(max(own.duration, written["min"]), written["max"])
        written = {"guess": guess, **written}
    fields = duration_from(written)
    return Horizon(steps, fields["duration"], fields["duration_range"])


def _complete(table: HorizonTable, *, has_phases: bool) -> HorizonTable:
    """The table with the number of steps, and the duration, that other keys say."""
    says = [key for key in ("steps", "accuracy", "lengths") if getattr(table, key) is not None]
    if len(says) > 1:
        raise ProblemError(f"horizon: {' and '.join(says)} both say which steps there are; give one of them")
    if table.accuracy is not None:
        return table if has_phases else table.model_copy(update={"steps": FIRST_STEPS})
    if table.lengths is None:
        return table
    duration = sum(table.lengths) if table.duration is None else table.duration
    return table.model_copy(update={"steps": len(table.lengths), "duration": duration})


def with_via(via: Iterable[Any], tables: Sequence[PhaseTable]) -> list[tuple[str, Any]]:
    """Keys and tables of via points, and of those of the phases: at their ends unless they say a part."""
    found = [(f"via.{i}", point) for i, point in enumerate(via)]
    for k, table in enumerate(tables):
        for i, point in enumerate(table.via):
            key = f"phase {table.name!r}: via"
            if point.time is not None:
                raise ProblemError(
                    f"{key}: time: it is at the end of the phase; leave it out, or give share, a part of the "
                    "phase"
                )
            share = 1.0 if point.share is None else point.share
            part = "end" if share == 1.0 else f"{share:g}"  # a phase may have several without a name
            name = point.name or f"{part} of {table.name}"
            time = {"phase": table.name, "share": share}
            whole = point.model_copy(update={"name": name, "time": time, "share": None})
            found.append((f"phase.{k}.via.{i}", whole))
    return found


def paths_of_phases(tables: Sequence[PhaseTable]) -> Iterator[tuple[str, Any]]:
    """Keys and tables of the path constraints of phases, which hold in their phase or in a part of it."""
    for k, table in enumerate(tables):
        own: list[Any] = list(table.path)
        for i, constraint in enumerate(own):
            ends = {key: _within(getattr(constraint, key), key, table.name) for key in SPAN}
            what = constraint.frame or getattr(constraint, "constraint", None)
            name = constraint.name or f"{constraint.kind} of {what} in {table.name}"
            yield f"phase.{k}.path.{i}", constraint.model_copy(update={"name": name, **ends})


def _within(end: Any, key: str, phase: str) -> Any:
    if end is None:
        return AtVia(phase)
    if isinstance(end, Share):
        return AtVia(phase, share=end.value)
    if isinstance(end, AtVia):
        return end
    raise ProblemError(
        f"phase {phase!r}: path: {key}: got {end:g}; leave it out for the whole phase, or give "
        "{ share = number }, a part of the phase"
    )


def write_phase(phase: Phase) -> dict[str, Any]:
    """Return the table that reads back as the same phase."""
    releases = [{"name": one.constraint, "meeting": one.meeting} for one in phase.releases]
    weights = {key: shortest(np.asarray(value)) for key, value in phase.weights.items()}
    limits = write_limits(phase.limits)
    return {
        "name": phase.name,
        "steps": phase.steps,
        "duration": write_duration(phase.duration, phase.duration_range),
        **({"limits": limits} if limits else {}),
        **({"cost": weights} if weights else {}),
        **({"hold": [_hold_table(held) for held in phase.holds]} if phase.holds else {}),
        **({"release": releases} if releases else {}),
    }


def _hold_table(held: PhaseHold) -> dict[str, Any]:
    hold = held.hold
    found = {"name": hold.name, "frame": hold.frame, "to": hold.to, "kind": hold.kind, "at": hold.at}
    return {**found, **{key: getattr(hold, key) for key in hold.keys}, "meeting": held.meeting}
