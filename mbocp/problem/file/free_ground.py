"""The text of a ground whose contacts are found, `contact = "free"` of `[ground]`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mbocp.problem.free_contact_bounds import FreeContactBounds
from mbocp.robot import Robot
from mbocp.terms.bounded import BoundedTerm


def write_free(robot: Robot, path: Sequence[BoundedTerm]) -> tuple[dict[str, Any] | None, list[BoundedTerm]]:
    """Return the table of a ground whose contacts are found, or None, and the other path constraints."""
    feet = [one for one in path if isinstance(one, FreeContactBounds)]
    forces = [one.force for one in feet]
    rest = [one for one in path if one not in feet and one not in forces]
    if not feet:
        return None, rest
    frames = {one.force.contact.constraint: robot.frame_names[one.term.frame] for one in feet}
    said, friction = feet[0].contact, forces[0].contact.friction
    words = {"contact": "free", "height": said.height, "smoothing": said.smoothing}
    return {"feet": frames, "friction": friction, **words}, rest
