"""`[integrator]`: its keys, from what is written to a scheme and its options, and back."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import Annotated, Any

from mbocp._keys import Key, Table
from mbocp.integrators import LIE_METHODS, SCHEMES
from mbocp.problem._checks import choice, whole
from mbocp.problem.integration import AUTO_SCHEME, Stabilisation
from mbocp.problem.problem_data import ProblemData
from mbocp.terms.written import NonNegative


class IntegratorTable(Table):
    """How time is discretised."""

    scheme: Annotated[
        str,
        choice((AUTO_SCHEME, *SCHEMES)),
        Key(
            '`"auto"`: [what suits](#the-scheme-that-suits); '
            "[tau family](mathematics.md#one-step-the-tau-family): "
            '`"se1"`, `"se2"`, `"midpoint"`, `"semi_implicit_euler"`; '
            "[of higher order](mathematics.md#symplectic-methods-of-higher-order): "
            '`"lobatto2"`, `"lobatto3"`, without loops `"gauss1"`, `"gauss2"`, `"gauss3"`, '
            '`"radau2"`, `"radau3"`; [explicit](#explicit-schemes): `"euler"`, `"heun"`, `"rk4"`, `"rkf5"`',
            takes="string",
        ),
    ] = AUTO_SCHEME
    lie: Annotated[str, choice(LIE_METHODS), Key("how [rotations stay rotations](#explicit-schemes)")] = (
        "munthe_kaas"
    )
    substeps: Annotated[int, whole(1), Key("explicit schemes: their steps within one of the N")] = 1
    gamma_quaternion: Annotated[
        NonNegative, Key('`"baumgarte"`: of quaternions, eq. (46) of [Manara2017]', "1/s")
    ] = Stabilisation.gamma_quaternion
    gamma_dcm: Annotated[NonNegative, Key('`"baumgarte"`: of rotation matrices, eq. (47)', "1/s")] = (
        Stabilisation.gamma_dcm
    )
    gamma_constraint: Annotated[
        NonNegative, Key("explicit schemes: Baumgarte's rate for constraints", "1/s")
    ] = Stabilisation.gamma_constraint


def read_integrator(integrator_table: IntegratorTable) -> tuple[str, str, int, Stabilisation]:
    """Return scheme, method for rotations, steps within a step, and rates."""
    table = integrator_table
    rates = Stabilisation(**{field.name: getattr(table, field.name) for field in fields(Stabilisation)})
    return table.scheme, table.lie, table.substeps, rates


def write_integrator(problem: ProblemData) -> dict[str, Any]:
    """Return the table that reads back as the same."""
    options = {"lie": problem.lie, "substeps": problem.substeps, **asdict(problem.stabilisation)}
    taken = {key: v for key, v in options.items() if SCHEMES[problem.scheme].takes(f"integrator.{key}")}
    return {"scheme": problem.scheme, **taken}
