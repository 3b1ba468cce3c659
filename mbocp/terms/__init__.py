"""What a problem is made of: terms of its cost, path constraints, end conditions; one class each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.terms.own import OwnTerm as OwnTerm
    from mbocp.terms.own import end_condition as end_condition
    from mbocp.terms.own import path_constraint as path_constraint
    from mbocp.terms.own import running_cost as running_cost
    from mbocp.terms.own import terminal_cost as terminal_cost
    from mbocp.terms.own_kinematics import Kinematics as Kinematics


__getattr__ = names_of(__name__, __file__)
