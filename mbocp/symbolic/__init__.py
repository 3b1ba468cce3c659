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

from mbocp.symbolic.algorithms import ModelFunctions, Reference, model_functions, self_test
from mbocp.symbolic.bridge import check_versions
from mbocp.symbolic.model_numbers import ModelNumber

__all__ = ["ModelFunctions", "ModelNumber", "Reference", "check_versions", "model_functions", "self_test"]
