"""Timelines as plain numbers, which can be compared."""

from __future__ import annotations

from typing import Any

from mbocp.problem.timeline.timeline import Timeline

__all__ = ["numbers_of"]


def numbers_of(timeline: Timeline) -> list[tuple[Any, ...]]:
    """Phases, then junctions: where they are, and bounds of durations and times."""
    phases = [(timeline.name_of(p), p.first, p.last, p.steps, p.duration, p.sides) for p in timeline.phases]
    return [*phases, *((j.node, j.leaps, j.earliest, j.latest) for j in timeline.junctions)]
