"""Numbers of a model that functions take as an argument, so that one function serves many models.

The mass, the centre of mass and the moments of a body, and the entries of placements: what differs between a
robot with one payload and with another. Without them they are constants of the functions, and those that are
zero or one cost nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbocp.exceptions import InvalidValue

_MOMENTS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))  # in Pinocchio's order
_OF_MODEL = ("inertia", "joint_placement", "frame_placement")
_TRANSLATION = range(9, 12)  # after the rotation


class ModelNumber(NamedTuple):
    """One number of a `pinocchio.Model`.

    Attributes
    ----------
    of : {"inertia", "joint_placement", "frame_placement", "force", "payload", "motor", "resistance"}
        The last four are numbers of a robot beside its model, see `mbocp.robot.named_numbers`.
    owner : int
        Index of the joint or frame, of the force element, payload, motor or resistance.
    entry : int
        Of an inertia: 0 the mass [kg], 1 to 3 the centre of mass [m], 4 to 9 the moments of inertia about it,
        xx, xy, yy, xz, yz, zz [kg m^2]. Of a placement: 0 to 8 the rotation by columns, 9 to 11 the
        translation [m].
    """

    of: Literal["inertia", "joint_placement", "frame_placement", "force", "payload", "motor", "resistance"]
    owner: int
    entry: int


def numbers_of_model(numbers: Iterable[ModelNumber]) -> tuple[ModelNumber, ...]:
    """Those of a `pinocchio.Model` itself."""
    return tuple(number for number in numbers if number.of in _OF_MODEL)


def inertia_numbers(joint: int) -> tuple[ModelNumber, ...]:
    """All ten numbers of the body that a joint carries."""
    return tuple(ModelNumber("inertia", joint, entry) for entry in range(10))


def translation_numbers(frame: int) -> tuple[ModelNumber, ...]:
    """Translation of a frame from its joint."""
    return tuple(ModelNumber("frame_placement", frame, entry) for entry in _TRANSLATION)


def placement_numbers(frame: int) -> tuple[ModelNumber, ...]:
    """Rotation and translation of a frame from its joint."""
    return tuple(ModelNumber("frame_placement", frame, entry) for entry in range(12))


def joint_placement_numbers(joint: int) -> tuple[ModelNumber, ...]:
    """Rotation and translation of a joint from the one before it."""
    return tuple(ModelNumber("joint_placement", joint, entry) for entry in range(12))


def all_numbers(model: pin.Model) -> tuple[ModelNumber, ...]:
    """Inertias and placements of all joints and frames, in rising order."""
    bodies, frames = range(1, model.njoints), range(1, model.nframes)
    return (
        *(number for frame in frames for number in placement_numbers(frame)),
        *(number for joint in bodies for number in inertia_numbers(joint)),
        *(number for joint in bodies for number in joint_placement_numbers(joint)),
    )


def placements_of_followers(
    model: pin.Model, frames: Iterable[int], varying: Iterable[ModelNumber]
) -> tuple[ModelNumber, ...]:
    """Placements of those of the frames, in rising order, that stand on others whose placements vary."""
    moved = {number.owner for number in varying if number.of == "frame_placement"}
    found: list[ModelNumber] = []
    for frame in frames:
        if int(model.frames[frame].parentFrame) in moved:
            moved.add(frame)
            found += placement_numbers(frame)
    return tuple(found)


def values_of(model: pin.Model, numbers: Iterable[ModelNumber]) -> NDArray[np.float64]:
    """What the numbers are in a model, shape (len(numbers),) [kg, m, kg m^2]."""
    found: list[float] = []
    for _, group in groupby(numbers, key=lambda number: number[:2]):
        members = list(group)
        entries = _entries(model, members[0])
        found += [entries[number.entry] for number in members]
    return np.array(found, dtype=np.float64)


def with_values(model: pin.Model, numbers: Sequence[ModelNumber], values: Iterable[float]) -> pin.Model:
    """Copy of a model with other values of the numbers.

    Raises
    ------
    InvalidValue
        If moments of inertia are those of no body.
    """
    found = pin.Model(model)
    changed: dict[tuple[str, int], NDArray[np.float64]] = {}
    for number, value in zip(numbers, values, strict=True):
        entries = changed.setdefault((number.of, number.owner), _entries(model, number))
        entries[number.entry] = value
    for (of, index), entries in changed.items():
        if of == "inertia":
            moments = np.zeros((3, 3))
            for moment, (i, j) in zip(entries[4:], _MOMENTS, strict=True):
                moments[i, j] = moments[j, i] = moment
            try:
                found.inertias[index] = pin.Inertia(float(entries[0]), entries[1:4], moments)
            except RuntimeError as error:  # Pinocchio: a moment about some axis is negative
                name, got = f"inertia of {model.names[index]}", entries[4:].tolist()
                raise InvalidValue(name, got, "moments that are positive about all axes") from error
            continue
        placement = pin.SE3(entries[:9].reshape(3, 3, order="F"), entries[9:])
        if of == "joint_placement":
            found.jointPlacements[index] = placement
        else:
            found.frames[index].placement = placement
    return found


def _entries(model: pin.Model, number: ModelNumber) -> NDArray[np.float64]:
    """All numbers of the inertia or placement that it belongs to."""
    if number.of == "inertia":
        body = model.inertias[number.owner]
        moments = np.asarray(body.inertia)
        return np.array([body.mass, *body.lever, *(moments[i, j] for i, j in _MOMENTS)])
    places = model.jointPlacements if number.of == "joint_placement" else model.frames
    place = places[number.owner]
    placement = place if number.of == "joint_placement" else place.placement
    return np.concatenate([np.asarray(placement.rotation).ravel(order="F"), placement.translation])
