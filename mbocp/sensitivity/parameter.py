"""What parameters are: numbers of a problem that derivatives are taken in."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation import Formulation
from mbocp.problem import Problem
from mbocp.sensitivity.change import Change


@dataclass(frozen=True, eq=False)
class Parameter(ABC):
    """Some numbers of a problem.

    Attributes
    ----------
    formulation : Formulation
    word : str
        What it is called, as in a problem file where there is a key.
    """

    formulation: Formulation
    word: str

    scales_time: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Words of this kind that a problem has."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """What each of the numbers is."""

    @abstractmethod
    def change(self) -> Change:
        """What a unit of each makes of the programme's numbers."""

    @property
    @abstractmethod
    def value(self) -> Array:
        """What the problem has: of configurations all nq numbers, of orientations a quaternion xyzw."""

    @abstractmethod
    def put(self, problem: Problem, value: Array) -> Problem:
        """A problem with other numbers, in which ``"auto"`` stands for what it did."""

    @property
    def tangent(self) -> Array:
        """Derivatives of `value` in the numbers that have names, shape (value.size, k)."""
        return np.eye(len(self.names))

    @property
    def problem(self) -> Problem:
        """That of the formulation."""
        return self.formulation.problem

    @property
    def _none(self) -> Change:
        return Change.none(self.formulation.programme, len(self.names))
