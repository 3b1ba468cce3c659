"""What a formulation chooses, and a programme is made of, also unknowns beside states and controls."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.formulation.end_rows import EndRows, EndTarget
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.parameter_layout import ParameterLayout, parameter_layout
from mbocp.formulation.signature import FunctionSignature
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import Space
from mbocp.problem import Problem
from mbocp.robot import Label
from mbocp.terms.point import Sizes


@dataclass(frozen=True, eq=False)
class Algebraic:
    """Factors from the programme's rows and unknowns to the reported ones, see `StageKind`.

    Attributes
    ----------
    scale_c, scale_y, scale_m : ndarray, shape (ny,)
        Of the rows that belong to these unknowns, of the unknowns, of the rows' multipliers.
    is_force : ndarray of bool, shape (ny,)
        Unknowns that count in the unit of force.
    is_balance : ndarray of bool, shape (ny,)
        Rows that count in it.
    """

    scale_c: Array
    scale_y: Array
    scale_m: Array
    is_force: BoolArray
    is_balance: BoolArray

    @property
    def size(self) -> int:
        """Number of unknowns, and of rows."""
        return len(self.scale_y)


def impulses(size: int, dt: float) -> Algebraic:
    """Impulses of constraints, whose rows are Phi / dt."""
    return Algebraic(
        scale_c=np.full(size, dt),
        scale_y=np.full(size, 1 / dt),
        scale_m=np.full(size, 1 / dt),
        is_force=np.ones(size, dtype=np.bool_),
        is_balance=np.zeros(size, dtype=np.bool_),
    )


@dataclass(frozen=True)
class RowLabels:
    """Names of what the rows of a step speak of.

    Attributes
    ----------
    positions : tuple of Label
        Of the kinematic rows, where these are as many as tangent directions.
    balance : str
        What the rows after them are: a balance of momenta, or rates.
    speeds : tuple of Label
        Of these rows.
    constraints : tuple of Label
        Of the constraints' rows.
    of_stages : tuple of str
        What the rows before those are, where a step has stages.
    """

    positions: tuple[Label, ...]
    balance: str
    speeds: tuple[Label, ...]
    constraints: tuple[Label, ...] = ()
    of_stages: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Pieces:
    """What a formulation chooses, and a programme is made of.

    Attributes
    ----------
    problem : Problem
    joints : ConfigurationSpace
        Of the joints, which costs and goals speak of.
    space : Space
        Of the states.
    signature : FunctionSignature
        What the stage functions depend on.
    layout : StateLayout
    algebraic : Algebraic
        Unknowns of a step beside states and controls: multipliers of constraints, and those of stages.
    groups : tuple of (int, int, tuple of int)
        See `StageKind`.
    end_rows : EndRows
        Projections of the end condition, of the joints.
    end : EndTarget
        The end condition in the states' coordinates.
    turning : ndarray, shape (ndx,)
        See `StageKind`.
    x_start : ndarray, shape (nx,)
    speed_bounds : tuple of ndarray, shapes (ns,), (1, ns) or (N, ns)
        Lower and upper ones.
    labels : RowLabels
        Names for messages.
    """

    problem: Problem
    joints: ConfigurationSpace
    space: Space
    signature: FunctionSignature
    layout: StateLayout
    algebraic: Algebraic
    groups: tuple[tuple[int, int, tuple[int, ...]], ...]
    end_rows: EndRows
    end: EndTarget
    turning: Array
    x_start: Array
    speed_bounds: tuple[Array, Array]
    labels: RowLabels

    @cached_property
    def parameters(self) -> ParameterLayout:
        """Pieces of the programme's parameters."""
        space, joints, robot = self.space, self.joints, self.problem.robot
        return parameter_layout(self.signature, Sizes(space.nz, space.nv, robot.nu, joints.nz, robot.nv))
