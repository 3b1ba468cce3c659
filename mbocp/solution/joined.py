"""A motion that goes over into another one, as into its stop."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mbocp.exceptions import InvalidValue
from mbocp.solution.solution_data import SolutionData


def join_motions(first: SolutionData, node: int, second: SolutionData) -> SolutionData:
    """Join a motion up to a node and one that begins there.

    Parameters
    ----------
    first : Solution
    node : int
        Of the first motion, from 1 to N.
    second : Solution
        With the same controls within steps. It begins at the state of that node; its own times count from
        there.

    Returns
    -------
    SolutionData
        Times, states, momenta, controls and adjoints; limits and facts are those of the first motion, words
        and numbers about the solve, and the controls after the end, those of the second.

    Raises
    ------
    InvalidValue
        If there is no such node, or the second motion begins elsewhere.
    """
    if not 0 < node <= first.num_steps:
        raise InvalidValue("node", node, f"a node from 1 to {first.num_steps}")
    for name in ("qs", "vs"):
        begin, there = getattr(second, name)[0], getattr(first, name)[node]
        if begin.shape != there.shape or not np.allclose(begin, there, rtol=0.0, atol=1e-6):
            raise InvalidValue("second", "another state", f"one that begins at that of node {node}")
    later = first.t[node] + second.t[1:] - second.t[0]
    nodes: dict[str, Any] = {
        name: np.concatenate([getattr(first, name)[: node + 1], getattr(second, name)[1:]])
        for name in ("qs", "vs", "ps", "mus")
    }
    steps: dict[str, Any] = {
        name: np.concatenate([getattr(first, name)[:node], getattr(second, name)])
        for name in ("us", "lams", "zetas", *(("u_values",) if first.u_shares.size else ()))
    }
    facts, of_end = first.facts_kept, second.facts
    if facts is not None:
        facts = replace(facts, u_goal=of_end.u_goal, q_goal=of_end.q_goal, ends_held=of_end.ends_held)
    return SolutionData(
        status=second.status,
        solver=second.solver,
        iterations=second.iterations,
        cost=second.cost,
        residual=second.residual,
        unknowns=second.unknowns,
        t=np.concatenate([first.t[: node + 1], later]),
        **nodes,
        **steps,
        u_shares=first.u_shares,
        limits_u=first.limits_u,
        limits_v=first.limits_v,
        limits_q=first.limits_q,
        robot_name=first.robot_name,
        problem_name=first.problem_name,
        facts_kept=facts,
        labels=first.labels,
    )
