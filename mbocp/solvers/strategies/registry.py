"""The solvers by their names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from mbocp.exceptions import InvalidValue
from mbocp.solvers.added import find_added_solvers, make_added_solver
from mbocp.solvers.newton_method.monolithic import GlobalisedNewton, PureNewton
from mbocp.solvers.options import SolverSettings, Switch
from mbocp.solvers.protocol import Solver

INTERIOR_POINT = ("ipopt", "fatrop")  # solvers of others, see `mbocp.solvers.nlp`; they run as a whole

Maker = Callable[[SolverSettings, Switch | None], Solver[Any]]


def _monolithic(settings: SolverSettings, switch: Switch | None) -> Solver[Any]:
    options = settings.options
    if options.globalisation == "none":
        return PureNewton(options.tolerance, settings.newton_iterations, threads=settings.threads)
    words = "barrier, " if settings.has_inequalities else ""
    return GlobalisedNewton(
        options.tolerance,
        settings.newton_iterations,
        control_weight=settings.control_weight,
        is_careful=settings.is_careful,
        rough=settings.rough,
        threads=settings.threads,
        name=f"monolithic (Newton, {words}inertia correction, filter line search)",
    )


def _fbsm_newton(settings: SolverSettings, switch: Switch | None) -> Solver[Any]:
    from mbocp.solvers.staggered.fbsm_newton import FBSMNewton

    options = settings.options
    is_global = options.globalisation == "default"
    return FBSMNewton(
        options.tolerance,
        settings.newton_iterations,
        control_weight=settings.control_weight,
        globalised=is_global,
        hessian=options.hessian,
        auxiliary=options.adjoint == "auxiliary",
        loop=options.loop if is_global else "open",
    )


def _fbsm_bb(settings: SolverSettings, switch: Switch | None) -> Solver[Any]:
    from mbocp.solvers.staggered.fbsm_gradient import FBSMGradient

    options = settings.options
    return FBSMGradient(
        options.tolerance,
        settings.gradient_iterations,
        theta_max=options.theta_max,
        auxiliary=options.adjoint == "auxiliary",
        loop=options.loop,
        switch=switch,
    )


SOLVERS: Mapping[str, Maker] = MappingProxyType(
    {"monolithic": _monolithic, "fbsm_newton": _fbsm_newton, "fbsm_bb": _fbsm_bb}
)


def make_solver(name: str, settings: SolverSettings, switch: Switch | None = None) -> Solver[Any]:
    """Solver of one phase.

    Parameters
    ----------
    name : str
        Of `SOLVERS`, or of a solver that another package adds.
    settings : SolverSettings
    switch : Switch, optional
        Of the gradient phase of a hybrid.

    Raises
    ------
    InvalidValue
        If there is no solver of that name, with a list of those that there are; or if the package that adds
        it does not load.
    """
    if name in SOLVERS:
        return SOLVERS[name](settings, switch)
    if name in find_added_solvers().names:
        return make_added_solver(name, settings)
    raise InvalidValue.of_choice("solver.method", name, (*SOLVERS, *sorted(find_added_solvers().names)))
