"""The least time in which one coordinate gets from one rate to another over a distance, within bounds."""

from __future__ import annotations

import math


def least_time(
    distance: float,
    speed: float = math.inf,
    acceleration: float = math.inf,
    jerk: float = math.inf,
    *,
    from_rate: float = 0.0,
    to_rate: float | None = None,
) -> float:
    r"""Lower bound of the time that a motion takes, whatever else holds [s].

    .. math:: x(T) - x(0) = d, \qquad |\dot x| \le v, \quad |\ddot x| \le a, \quad |\dddot x| \le j

    With bounds on speed and acceleration it is the time of bang-coast-bang control. With a bound on jerk
    alone it is :math:`(12\,d/j)^{1/3}` from rest to rest, with accelerations that are free at both ends.

    Parameters
    ----------
    distance : float
        d [m, rad]
    speed, acceleration, jerk : float
        v, a, j [m/s, m/s^2, m/s^3; rad ...]; infinite where there is none.
    from_rate, to_rate : float, optional
        Rates at both ends; the latter is free where it is None.

    Examples
    --------
    >>> least_time(2.2, 3.15)  # doctest: +ELLIPSIS
    0.698...
    >>> least_time(1.0, acceleration=4.0, to_rate=0.0)
    1.0
    """
    if distance < 0.0:
        to = None if to_rate is None else -to_rate
        return least_time(-distance, speed, acceleration, jerk, from_rate=-from_rate, to_rate=to)
    bounds = [distance / speed if math.isfinite(speed) else 0.0]
    if math.isfinite(acceleration) and acceleration > 0.0:
        bounds.append(_by_acceleration(distance, speed, acceleration, from_rate, to_rate))
    if math.isfinite(jerk) and jerk > 0.0 and from_rate == 0.0 and to_rate == 0.0:
        bounds.append((12.0 * distance / jerk) ** (1.0 / 3.0))
    return max(bounds)


def _by_acceleration(d: float, v: float, a: float, v0: float, v1: float | None) -> float:
    """Least time of a double integrator that need not turn back; 0 where that is not so."""
    change = 0.0 if v1 is None else abs(v1 - v0) / a
    peak = math.sqrt(v0**2 + 2.0 * a * d if v1 is None else a * d + (v0**2 + v1**2) / 2.0)
    last = peak if v1 is None else v1
    if peak < max(v0, last) or min(v0, last) < 0.0:
        return change  # it starts too fast, or the wrong way: that takes no less
    if peak <= v:
        return (2.0 * peak - v0 - last) / a
    if v1 is None:
        return (v - v0) / a + (d - (v**2 - v0**2) / (2.0 * a)) / v
    there = (2.0 * v**2 - v0**2 - v1**2) / (2.0 * a)
    return (2.0 * v - v0 - v1) / a + (d - there) / v
