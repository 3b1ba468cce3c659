"""What a robot and its surroundings say of a motion as it is sent: torques, path constraints, obstacles.

What follows a motion exactly has to apply these torques; links on springs follow their motors.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np

from mbocp._arrays import Array
from mbocp.problem import Problem
from mbocp.solution.sent import EFFORT_RATE, Excess, Sent, differences, find_excesses
from mbocp.solution.sent_path import TOLERANCES, path_excesses
from mbocp.solution.sent_states import Follower
from mbocp.terms import RATE_TERMS

_PARTS = 4  # of a step at whose ends they are looked at
_TOLERANCE = 0.01  # relative, of a limit: polynomials between nodes are no closer to the dynamics


def check_sent(sent: Sent, problem: Problem) -> tuple[tuple[Excess, ...], tuple[str, ...]]:
    """Look at the torques that a motion takes as it is sent, and at path constraints and obstacles.

    Parameters
    ----------
    sent : Sent
    problem : Problem
        What the motion is a solution of; terms of one's own may be missing.

    Returns
    -------
    excesses : tuple of Excess
        Of torques, their rates, powers and root mean squares, and links on springs, the worst first; of path
        constraints.
    unknown : tuple of str
        What was not looked at: efforts, links on springs, and path constraints by name.
    """
    follower = Follower.of(sent, problem.robot)
    excesses, unseen = path_excesses(follower, problem)
    rows = {label.name for constraint in problem.path for label in constraint.labels}
    unknown = [*unseen, *(row.name for row in sent.solution.facts.path if row.name not in rows)]
    if follower.has_controls:
        return (*joint_excesses(follower), *excesses), tuple(unknown)
    facts = sent.solution.facts
    if np.isfinite(sent.solution.limits_u).any() or facts.limits_more_of_controls:
        unknown.insert(0, "efforts")
    return excesses, (*(joint.name for joint in problem.robot.elastic), *unknown)


_Along: TypeAlias = tuple[Array, Array, Array, Array]


def controls_along(follower: Follower) -> _Along:
    """Times [s], configurations, velocities and controls along a motion that says these."""
    times, (positions, velocities, accelerations, _) = follower.sent.curves.places(_PARTS)
    qs, vs = follower.states(times, positions, velocities)
    return times, qs, vs, follower.controls(qs, vs, accelerations)


def joint_excesses(follower: Follower) -> tuple[Excess, ...]:
    """Limits that controls, and links on springs, leave by more than a hundredth, the worst first.

    Positions of links are left by more than 0.5 mm or 5 mrad.
    """
    along = controls_along(follower)
    found = (*_of_controls(follower, along), *_of_links(follower, along))
    return tuple(sorted(found, key=lambda excess: -excess.ratio))


def _of_controls(follower: Follower, along: _Along) -> Iterator[Excess]:
    """Controls, their rates, powers and root mean squares."""
    solution, (times, _, vs, controls) = follower.sent.solution, along
    facts, columns = solution.facts, solution.labels.u
    speeds = vs @ follower.robot.actuation_matrix(follower.robot.q0)
    bounds = {"effort": solution.limits_u}
    if "power" in facts.rates:
        bounds["power"] = facts.bounds_of_rate("power")
    for kind, values in (("effort", controls), ("power", controls * speeds)):
        for k, column in enumerate(columns if kind in bounds else ()):
            unit = column.unit if kind == "effort" else "W"
            yield from find_excesses(
                kind, column.name, values[:, k], bounds[kind][:, k], times, unit, _TOLERANCE
            )
    if "effort_rate" in facts.rates:
        rates, middles = _effort_rates(follower, along)
        bounds["effort_rate"] = facts.bounds_of_rate("effort_rate")
        for k, column in enumerate(columns):
            unit, sides = RATE_TERMS["effort_rate"].unit(column.unit), bounds["effort_rate"][:, k]
            yield from find_excesses(EFFORT_RATE, column.name, rates[:, k], sides, middles, unit, _TOLERANCE)
    if facts.effort_rms:
        squares = controls**2
        means = np.sqrt(np.diff(times) @ (squares[1:] + squares[:-1]) / (2.0 * times[-1]))
        for column, mean, limit in zip(columns, means, facts.effort_rms, strict=True):
            sides = np.array([-np.inf, limit])
            yield from find_excesses(
                "root mean square", column.name, mean[None], sides, times[-1:], column.unit, _TOLERANCE
            )


def _effort_rates(follower: Follower, along: _Along) -> tuple[Array, Array]:
    """Rates of controls, shape (n, nu), and their times [s]: where accelerations leap those of samples.

    Not within the first and the last step, whose controls no limit ties to those at rest.
    """
    sent, (times, _, _, controls) = follower.sent, along
    if sent.curves.accelerations is None:
        accelerations, times = differences(sent.curves.at(sent.times)[1], sent.times)
        qs, vs = follower.states(times, *sent.curves.at(times)[:2])
        controls = follower.controls(qs, vs, accelerations)
    rates, middles = differences(controls, times)
    first, last = sent.slower * np.maximum(np.diff(sent.solution.t)[[0, -1]], sent.mean)
    is_within = (middles > first) & (middles < sent.curves.nodes[-1] - last)
    return rates[is_within], middles[is_within]


def _of_links(follower: Follower, along: _Along) -> Iterator[Excess]:
    """Positions and speeds of links on springs."""
    solution, (times, qs, vs, _) = follower.sent.solution, along
    for joint in follower.robot.elastic:
        (at_q, _), (at_v, _) = joint.at_q, joint.at_v
        unit, bounds = solution.labels.q[at_q].unit, solution.limits_q[:, at_q]
        size = float(np.abs(bounds[np.isfinite(bounds)]).max(initial=0.0))
        yield from find_excesses(
            "position", joint.name, qs[:, at_q], bounds, times, unit, TOLERANCES[unit] / (size or 1.0)
        )
        unit = solution.labels.v[at_v].unit
        yield from find_excesses(
            "speed", joint.name, vs[:, at_v], solution.limits_v[:, at_v], times, unit, _TOLERANCE
        )
