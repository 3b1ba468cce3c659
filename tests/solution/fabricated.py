"""Solutions made up from smooth curves, for what does not depend on a solver."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbocp.solution import Column, IterationRecord, Labels, Phase, Solution, Status
from mbocp.solution.problem_facts import Facts

ARM_JOINTS = [f"panda_joint{i}" for i in range(1, 8)]


def history(iterations: int, cost: float) -> tuple[IterationRecord, ...]:
    """Newton's method as it should be: first slow, then quadratic."""
    residuals = [10.0 ** (1.5 - 0.5 * k) for k in range(iterations - 3)]
    residuals += [1e-3, 1e-6, 3e-13]
    return tuple(
        IterationRecord(
            iteration=k,
            residual=r,
            increment=float("nan") if k == 0 else 20 * r,
            cost=cost * (1 + 2.0**-k),
            step_length=1.0 if k > 3 else 0.5,
            phase="newton",
        )
        for k, r in enumerate(residuals)
    )


def fabricate(
    q: list[Column],
    v: list[Column],
    u: list[Column],
    *,
    num_steps: int = 100,
    num_constraints: int = 0,
    **others: Any,
) -> Solution:
    """Fabricate sines of several frequencies under the given column names."""
    t = np.linspace(0.0, 1.5, num_steps + 1)  # [s]

    def waves(columns: int, rows: int, amplitude: float) -> Any:
        k = np.arange(columns)
        return amplitude * np.cos(0.4 * k) * np.sin(np.outer(t[:rows], 1.0 + 0.35 * k) * 2 + k)

    nodes, nv, nu = num_steps + 1, len(v), len(u)
    p = [Column(c.name, "N m s" if "rad" in c.unit else "kg m/s") for c in v]
    fields: dict[str, Any] = {
        "status": Status.CONVERGED,
        "solver": "monolithic",
        "iterations": 9,
        "cost": 12.345678901,
        "residual": 3e-13,
        "increment": 6e-12,
        "constraint_violation": 4e-14,
        "velocity_violation": 2e-3,
        "unknowns": 2115,
        "wall_time_s": 0.75,
        "phases": (Phase("compile", 0, 0.7), Phase("newton", 9, 0.05)),
        "history": history(9, 12.345678901),
        "t": t,
        "qs": waves(len(q), nodes, 1.2),
        "vs": waves(nv, nodes, 2.5),
        "ps": waves(nv, nodes, 4.0),
        "us": waves(nu, num_steps, 30.0),
        "lams": waves(num_constraints, num_steps, 9.0),
        "mus": waves(2 * nv, nodes, 3.0),
        "zetas": waves(num_constraints, num_steps, 0.1),
        "eta": np.arange(2.0 * nv),
        "control_hamiltonians": 0.37 + 0.01 * np.sin(3 * t[:-1]),
        "control_momenta": 1.5 + 1e-14 * np.sin(40 * t)[:, None],
        "control_momentum_names": ("rotation about z",),
        "control_momentum_meanings": ("adjoint mu_q of a joint, a cyclic coordinate",),
        "problem_name": "fabricated",
        "robot_name": "wavy",
        "robot_spec": {"spec": "wavy", "lock": ["finger"]},
        "problem_text": 'robot = "wavy"  # π\n',
        "facts_kept": Facts(),
        "guess_used": "hold",
        "options": {"tolerance": 1e-9, "limit": float("inf"), "weights": np.array([1.0, float("nan")])},
        "versions": {"mbocp": "0.1.0"},
        "labels": Labels(q=tuple(q), v=tuple(v), p=tuple(p), u=tuple(u)),
    }
    return Solution(**{**fields, **others})


def pendulum(**others: Any) -> Solution:
    """Fabricate the motion of a point mass on a sphere: three translations, one rod."""
    q = [Column(c, "m") for c in ("x", "y", "z")]
    v = [Column(c.name, "m/s") for c in q]
    u = [Column(f"force_{c.name}", "N") for c in q]
    return fabricate(
        q, v, u, num_constraints=1, problem_name="rigid_pendulum", robot_name="rigid_pendulum", **others
    )


def limited(**others: Any) -> Solution:
    """Fabricate a pendulum's motion under limits of force and speed, and under two path constraints."""
    free = pendulum(num_steps=20)
    us, vs = np.clip(free.us, -20.0, 25.0), np.clip(free.vs, -2.0, 2.0)
    lam_us, lam_vs = np.zeros_like(us), np.zeros_like(vs)
    lam_us[us == 25.0], lam_us[us == -20.0], lam_vs[vs == 2.0] = 0.5, -0.3, 0.1
    lam_path = np.zeros((20, 2))
    lam_path[4:7, 0] = -1.5
    fields: dict[str, Any] = {
        "num_steps": 20,
        "us": us,
        "vs": vs,
        "limits_u": np.outer([-20.0, 25.0], np.ones(3)),
        "limits_v": np.array([[-2.0, -np.inf, -np.inf], [2.0, 2.0, np.inf]]),
        "lam_us": lam_us,
        "lam_vs": lam_vs,
        "lam_path": lam_path,
        "path_names": ("ceiling.z", "clearance"),
        "limit_violation": 1e-9,
        "manifold_drifts": np.linspace(0.0, 3e-9, 21),
        "manifold_drift_resimulated": 1e-15,
        "scheme": "rk4",
        "lie": "baumgarte",
        "rotations": "dcm",
        "substeps": 2,
    }
    return pendulum(**{**fields, **others})


def arm(**others: Any) -> Solution:
    """Fabricate the motion of an arm with seven joints."""
    q, v, u = ([Column(j, unit) for j in ARM_JOINTS] for unit in ("rad", "rad/s", "N m"))
    return fabricate(q, v, u, problem_name="panda_reach", robot_name="panda", **others)


def humanoid(**others: Any) -> Solution:
    """Fabricate the motion of twenty joints with long names on a free-flyer."""
    names = [f"{side}_{part}_joint" for side in ("leg_left", "leg_right") for part in range(1, 7)]
    names += [f"{side}_{part}_joint" for side in ("arm_left", "arm_right") for part in range(1, 5)]
    base = [Column(f"root_joint.{c}", "m") for c in "xyz"] + [Column(f"root_joint.q{c}", "") for c in "xyzw"]
    base_v = [Column(f"root_joint.v{c}", "m/s") for c in "xyz"] + [
        Column(f"root_joint.w{c}", "rad/s") for c in "xyz"
    ]
    q = base + [Column(name, "rad") for name in names]
    v = base_v + [Column(name, "rad/s") for name in names]
    u = [Column(name, "N m") for name in names]
    return fabricate(q, v, u, problem_name="humanoid_step", robot_name="humanoid", **others)
