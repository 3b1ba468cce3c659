"""Solvers by their names: unknown ones are refused, and every method of the options has its solvers."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mbocp.exceptions import InvalidValue
from mbocp.problem import SolverOptions
from mbocp.solvers import SOLVERS, FBSMGradient, FBSMNewton, SolverSettings, make_solver
from mbocp.solvers.newton_method.monolithic import GlobalisedNewton, PureNewton
from mbocp.solvers.options import BOUNDED_METHODS, METHODS
from mbocp.solvers.strategies.registry import INTERIOR_POINT

SETTINGS = SolverSettings(SolverOptions(tolerance=1e-7, max_iterations=12), control_weight=0.5)


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InvalidValue) as refused:
        make_solver("monolitic", SETTINGS)
    assert str(refused.value) == (
        'solver.method: got \'monolitic\', expected "monolithic" | "fbsm_newton" | "fbsm_bb" '
        "(did you mean 'monolithic'?)"
    )


def test_every_method_has_its_solvers() -> None:
    for method in METHODS:
        names = method.split("+")
        assert set(names) <= {*SOLVERS, *INTERIOR_POINT, "auto"}
        assert len(names) == 1 or (names[0] == "fbsm_bb" and set(names) <= set(SOLVERS))
    assert {*SOLVERS, *INTERIOR_POINT} <= set(METHODS)
    assert set(BOUNDED_METHODS) <= set(METHODS)


def test_solvers_have_the_options_of_the_problem() -> None:
    kinds = {"monolithic": GlobalisedNewton, "fbsm_newton": FBSMNewton, "fbsm_bb": FBSMGradient}
    for name, kind in kinds.items():
        solver = make_solver(name, SETTINGS)
        assert isinstance(solver, kind)
        assert (solver.tolerance, solver.max_iterations) == (1e-7, 12)
    pure = replace(SETTINGS, options=replace(SETTINGS.options, globalisation="none"))
    assert isinstance(make_solver("monolithic", pure), PureNewton)


def test_a_limit_of_iterations_is_for_all_phases_together() -> None:
    assert not SETTINGS.is_spent(11)
    assert SETTINGS.is_spent(12)
    assert SETTINGS.within(5).newton_iterations == 7
    assert SETTINGS.within(20).gradient_iterations == 1
    assert SETTINGS.interior_iterations(5) == 7
    free = SolverSettings(SolverOptions(), control_weight=1.0)
    assert not free.is_spent(10**6)
    assert free.within(10**6) is free
    assert free.newton_iterations == 200
