"""Free starts as controls of the first step: derivatives on the group and in coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbocp import Problem
from mbocp.formulation import formulate

Vector = NDArray[np.float64]


@pytest.mark.parametrize("limits", [{}, {"velocity": 50.0}], ids=["group", "flat"])
@pytest.mark.parametrize("scheme", ["midpoint", "rk4"])
def test_derivatives_in_the_moves(scheme: str, limits: dict[str, float]) -> None:
    """Columns and curvature of the moves, on the group and in coordinates, against differences."""
    spec = {"name": "hector", "actuated": ["root_joint"]}
    words: dict[str, Any] = {"limits": limits, "scheme": scheme, "solver": "monolithic"}
    problem = Problem.create(
        spec,
        1.0,
        4,
        start={"free": True},
        goal={"periodic": True},
        **{"integrator": {"scheme": "se1"}, **words},
    )
    formulation = formulate(problem)
    programme, at, rng = formulation.programme, formulation.layout, np.random.default_rng(4)
    assert at.is_flat == bool(limits)
    x0, kind = programme.x_start, programme.kind
    x1 = x0 + 0.01 * rng.standard_normal(kind.nx)
    x1[3:7] /= np.linalg.norm(x1[3:7])
    u, m = 0.2 * rng.standard_normal(kind.nu), rng.standard_normal(kind.ndx)
    rho = programme.rho.reshape(programme.num_steps, -1)[0]
    values, complete = (programme.functions.function(name) for name in ("values", "complete"))

    def rows(u: Vector) -> Vector:
        return np.asarray(values(x0, x1, [], u, programme.theta, rho)[0]).ravel()

    def slopes(u: Vector) -> tuple[Vector, Vector, Vector]:
        _, _, dc, dl, H = (np.asarray(o) for o in complete(x0, x1, [], u, m, programme.theta, rho))
        return dc, dl.ravel(), np.triu(H) + np.triu(H, 1).T

    dc, _, H = slopes(u)
    step, first = 1e-5, 2 * kind.ndx
    for i in range(kind.nu):
        d = step * np.eye(kind.nu)[i]
        assert np.allclose((rows(u + d) - rows(u - d)) / (2 * step), dc[:, first + i], atol=1e-6)
        (ahead, l1, _), (behind, l0, _) = slopes(u + d), slopes(u - d)
        bend = (l1 - l0 + m @ (ahead - behind)) / (2 * step)
        assert np.allclose(bend, H[:, first + i], atol=1e-5 * (1 + np.abs(H).max()))
