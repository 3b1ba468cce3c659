"""Where a frame is along a motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from tests.campaign.robots import Loaded
from tests.campaign.witness import Witness
from tests.checker.system import Array, System
from tests.checker.task import Task

__all__ = ["inner", "last_frame", "moving", "placements"]


def last_frame(loaded: Loaded) -> str:
    """Frame of the tool, or of the last link."""
    model = loaded.system.model
    return "tool0" if model.existFrame("tool0") else str(model.frames[model.nframes - 1].name)


def placements(system: System, frame: str, witness: Witness) -> list[Any]:
    """Placement of a frame along the motion."""
    index, found = system.model.getFrameId(frame), []
    for q in witness.qs:
        system.place(q)
        found.append(pin.SE3(system.data.oMf[index]))
    return found


def inner(task: Task, rng: np.random.Generator) -> int:
    """A node between start and end."""
    return int(rng.integers(task.num_steps // 4, task.num_steps - task.num_steps // 4))


def moving(places: list[Any]) -> Array:
    """Coordinates that change on the way."""
    span = np.ptp(np.array([place.translation for place in places]), axis=0)
    return np.asarray(span > 1e-3 * max(float(span.max()), 1e-9))
