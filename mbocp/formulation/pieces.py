"""What a formulation chooses, and a programme is made of."""

from __future__ import annotations

from dataclasses import dataclass

from mbocp._arrays import Array
from mbocp.formulation.goal import EndRows, EndTarget
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.parameters import ParameterLayout, parameter_layout
from mbocp.formulation.schemes.algebraic import Algebraic
from mbocp.formulation.signature import FunctionSignature
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import Space
from mbocp.problem import Problem
from mbocp.robot import Label
from mbocp.terms.point import Sizes


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

    @property
    def parameters(self) -> ParameterLayout:
        """Pieces of the programme's parameters."""
        space, joints, robot = self.space, self.joints, self.problem.robot
        return parameter_layout(self.signature, Sizes(space.nz, space.nv, robot.nu, joints.nz, robot.nv))
