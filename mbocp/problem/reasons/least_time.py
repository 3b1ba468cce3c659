"""The least time in which one coordinate gets from one rate to another over a distance, within bounds."""

from __future__ import annotations

import math
from typing import Any

_SAME = 1e-9  # relative: on both sides of a way the least time may leap
_TURN = 2.0 * math.pi
# d / (j T^3) of bang-bang jerks from rest to rest, by how many of the accelerations at the ends are zero.
_JERKS = {0: 1.0 / 12.0, 1: (1.0 + 2.0 * math.sqrt(2.0) / 3.0) / (2.0 + math.sqrt(2.0)) ** 3, 2: 1.0 / 32.0}


def least_time(
    distance: float,
    speed: float = math.inf,
    acceleration: float = math.inf,
    jerk: float = math.inf,
    *,
    from_rate: float = 0.0,
    to_rate: float | None = None,
    still_ends: int = 0,
    is_circle: bool = False,
) -> float:
    r"""Lower bound of the time that a motion takes, whatever else holds [s].

    .. math:: x(T) - x(0) = d, \qquad |\dot x| \le v, \quad |\ddot x| \le a, \quad |\dddot x| \le j

    With bounds on speed and acceleration it is the time of bang-coast-bang control; with all three, from rest
    to rest and without accelerations at both ends, that of the motion in seven segments. Where jerks are
    bounded and accelerations at the ends are free, it is the larger of the time without bounds on speeds and
    accelerations and that without a bound on jerks.

    Parameters
    ----------
    distance : float
        d [m, rad]
    speed, acceleration, jerk : float
        v, a, j [m/s, m/s^2, m/s^3; rad ...]; infinite where there is none.
    from_rate, to_rate : float, optional
        Rates at both ends; the latter is free where it is None.
    still_ends : int
        At how many ends, 0 to 2, the acceleration is zero.
    is_circle : bool
        Whether it is an angle that may go round: full turns are added where that is faster.

    Examples
    --------
    >>> least_time(2.2, 3.15)  # doctest: +ELLIPSIS
    0.698...
    >>> least_time(1.0, acceleration=4.0, to_rate=0.0)
    1.0
    >>> least_time(2.0, 1.0, 2.0, 4.0, to_rate=0.0, still_ends=2)
    3.0
    """
    if is_circle:
        given: dict[str, Any] = {"from_rate": from_rate, "to_rate": to_rate, "still_ends": still_ends}
        near = (_direct(acceleration, from_rate, to_rate), 0.0)  # the way that takes least, and the shortest
        ways = [at + (distance - at) % _TURN - back for at in near for back in (0.0, _TURN)]
        return min(least_time(way, speed, acceleration, jerk, **given) for way in ways)
    if distance < 0.0:
        to = None if to_rate is None else -to_rate
        flipped: dict[str, Any] = {"from_rate": -from_rate, "to_rate": to, "still_ends": still_ends}
        return least_time(-distance, speed, acceleration, jerk, **flipped)
    bounds = [distance / speed if math.isfinite(speed) else 0.0]
    if math.isfinite(acceleration) and acceleration > 0.0:
        bounds.append(_by_acceleration(distance, speed, acceleration, from_rate, to_rate))
    if math.isfinite(jerk) and jerk > 0.0 and from_rate == 0.0 and to_rate == 0.0:
        bounds.append((distance / (_JERKS[still_ends] * jerk)) ** (1.0 / 3.0))
        if still_ends == 2:
            bounds.append(_in_segments(distance, speed, acceleration, jerk))
    return max(bounds)


def _direct(a: float, v0: float, v1: float | None) -> float:
    """How far it comes while its rate changes as fast as it may."""
    return 0.0 if v1 is None or a <= 0.0 else (v0 + v1) * abs(v1 - v0) / (2.0 * a)


def _by_acceleration(d: float, v: float, a: float, v0: float, v1: float | None) -> float:
    """Least time of a double integrator; a motion that has to turn back may be as fast as it likes there."""
    if v1 is None:
        peak = math.sqrt(v0**2 + 2.0 * a * d)
        if peak <= v or v0 > v:
            return (peak - v0) / a
        return (v - v0) / a + (d - (v**2 - v0**2) / (2.0 * a)) / v
    beyond = d - _direct(a, v0, v1)
    if abs(beyond) <= _SAME * (1.0 + abs(d)):  # just on the way from one rate to the other
        return abs(v1 - v0) / a
    if beyond < 0.0:  # too fast to stop there: first back, then on
        d, v, v0, v1 = -d, math.inf, -v0, -v1
    peak = math.sqrt(max(a * d + (v0**2 + v1**2) / 2.0, 0.0))
    if peak <= v or max(v0, v1) > v:
        return max((2.0 * peak - v0 - v1) / a, abs(v1 - v0) / a)
    there = (2.0 * v**2 - v0**2 - v1**2) / (2.0 * a)
    return (2.0 * v - v0 - v1) / a + (d - there) / v


def _in_segments(d: float, v: float, a: float, j: float) -> float:
    """Least time from rest to rest with no acceleration at both ends: seven segments of one jerk each."""

    def rise(peak: float) -> float:
        return peak / a + a / j if peak * j >= a**2 else 2.0 * math.sqrt(peak / j)

    if d >= v * rise(v):
        return d / v + rise(v)
    if d * j**2 <= 2.0 * a**3:
        return float((32.0 * d / j) ** (1.0 / 3.0))
    return a / j + math.sqrt((a / j) ** 2 + 4.0 * d / a)
