"""What path constraints share that bound some of three coordinates of something."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbocp._arrays import dataclass
from mbocp.exceptions import ProblemError
from mbocp.robot import Label, Robot
from mbocp.terms.path_term import PathNumbers, PathTerm

_AXES = "xyz"


@dataclass(frozen=True)
class CoordinateRows(PathTerm):
    """A row for each of the coordinates x, y and z that has bounds."""

    axes: tuple[int, ...]

    @classmethod
    def of(cls, given: PathNumbers) -> CoordinateRows:
        """With its rows."""
        return cls(given.frame, given.axes)

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Rows and bounds."""
        axes = tuple(i for i, axis in enumerate(_AXES) if axis in given)
        if not axes:
            raise ProblemError(f"{key}: bounds nothing; give x, y or z as [lower, upper]")
        lower, upper = np.array([given[_AXES[i]] for i in axes]).T
        return {"axes": axes, "lower": lower, "upper": upper}

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """A pair for each row."""
        sides = zip(given.axes, given.lower, given.upper, strict=True)
        return {_AXES[i]: [low, high] for i, low, high in sides}

    @property
    def rows(self) -> int:
        """One for each axis."""
        return len(self.axes)

    @classmethod
    def labels(cls, given: PathNumbers) -> tuple[Label, ...]:
        """The axis behind the name."""
        return tuple(Label(f"{given.name}.{_AXES[i]}", cls.unit) for i in given.axes)
