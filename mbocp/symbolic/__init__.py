"""Pinocchio's algorithms as CasADi functions, for any `pinocchio.Model`.

    import pinocchio as pin
    from mbocp.symbolic import model_functions

    model = pin.buildModelFromUrdf("robot.urdf")
    functions = model_functions(model)
    a = functions.aba(q, v, tau)  # numbers, casadi.SX or casadi.MX

The wheels of Pinocchio have no `pinocchio.casadi`; this package is its counterpart for installations by pip,
and needs nothing else of mbocp. Where an upstream `pinocchio.casadi` can be imported (conda-forge) it is left
alone: one source of the functions is one set of numbers to trust.
"""

from mbocp.symbolic.algorithms import ModelFunctions, Reference, model_functions, self_test, text_without
from mbocp.symbolic.bridge import check_versions
from mbocp.symbolic.model_numbers import (
    ModelNumber,
    all_numbers,
    inertia_numbers,
    joint_placement_numbers,
    numbers_of_model,
    placement_numbers,
    placements_of_followers,
    translation_numbers,
    values_of,
    with_values,
)

__all__ = [
    "ModelFunctions",
    "ModelNumber",
    "Reference",
    "all_numbers",
    "check_versions",
    "inertia_numbers",
    "joint_placement_numbers",
    "model_functions",
    "numbers_of_model",
    "placement_numbers",
    "placements_of_followers",
    "self_test",
    "text_without",
    "translation_numbers",
    "values_of",
    "with_values",
]
