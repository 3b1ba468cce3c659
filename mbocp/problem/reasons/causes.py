"""Why a problem cannot be solved, as far as arithmetic tells it before the first iteration.

Each cause is one line: what is asked, what there is, and what would do. A certain one is a proof: no motion
meets it, with however many steps. Others are estimates: of what motors can accelerate, of poses that they
cannot hold.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.integrators import SCHEMES
from mbocp.problem.first_motion import find_holding_controls
from mbocp.problem.integration import stiffest_joint
from mbocp.problem.problem import Problem
from mbocp.problem.reasons.cause import Cause
from mbocp.problem.reasons.least_time import least_time
from mbocp.problem.reasons.momentum_causes import momentum_causes
from mbocp.problem.reasons.place_causes import fall_causes, place_causes
from mbocp.robot import Robot
from mbocp.robot.joints import joint_kind

_MARGIN = 1e-6  # relative: what differs by less is the same
_SURE = 2.0  # of an estimate, before it is told
_COARSE = 1.0  # [rad] that a joint turns in a step at most
_STIFF = 100.0  # times in a step that damping lets a velocity fall to 1/e, at which schemes have failed
_SAMPLES = 5  # poses of a way at which accelerations are estimated


@dataclass(frozen=True, eq=False)
class _Leg:
    """From one place whose configuration is given to the next.

    `known` says which velocity directions have given positions at both ends; rates are NaN where free.
    """

    name: str
    begins: float
    ends: float
    q0: Array
    q1: Array
    known: BoolArray
    rates: tuple[Array, Array]

    @property
    def time(self) -> float:
        return self.ends - self.begins


def causes_of(problem: Problem) -> tuple[Cause, ...]:
    """What makes a problem impossible, or seems to: certain causes first, then the worst.

    Parameters
    ----------
    problem : Problem
        Of several goals the first that is in reach is looked at.
    """
    member = problem.members[0][1]
    found = [cause for leg in _legs(member) for cause in _of_leg(member, leg)]
    found += [*_weights(member), *_find_damping(member), *fall_causes(member)]
    found += [*momentum_causes(member), *place_causes(member)]
    worst: dict[tuple[str, str], Cause] = {}
    for cause in sorted(found, key=lambda c: (not c.is_certain, -c.excess)):
        worst.setdefault((cause.kind, cause.where), cause)
    return tuple(worst.values())


def why_in_vain(problem: Problem, status: str) -> Cause | None:
    """Say why no guess and no strategy can solve a problem; None where nothing says so.

    Parameters
    ----------
    problem : Problem
        With several goals another one may be met.
    status : str
        How a solve has ended. Conditions that hold by themselves are why where that is "singular"; and
        whatever it is, as round-off has it, unless explicit schemes leave them out.
    """
    if problem.goals:
        return None
    is_why = status == "singular" or SCHEMES[problem.scheme].solves_constraints
    for cause in causes_of(problem):
        if cause.is_certain or (cause.kind == "momentum" and is_why):
            return cause
    return None


def _of_leg(problem: Problem, leg: _Leg) -> Iterator[Cause]:
    rates = [*_rates(problem, leg)]
    yield from rates
    yield from _frame_speeds(problem, leg)
    if not rates:
        yield from _torques(problem, leg)
        yield from _steps(problem, leg)


def _legs(problem: Problem) -> list[_Leg]:
    """Start, via points with given times, and the goal, as far as they say where joints are."""
    times, nv = problem.timeline.times(), problem.robot.nv
    if problem.duration_range is not None:
        times = times * (problem.duration_range[1] / problem.duration)
    every = np.ones(nv, dtype=np.bool_)
    if problem.start_free is not None or not np.isfinite(times[-1]):
        return []
    places = [("the start", 0.0, problem.q_start, every, problem.v_start)]
    if not problem.timeline.has_free_times:
        for point in problem.timeline.waypoints:
            goal = point.via.goal
            rate = np.where(goal.rate_active & (goal.rate == "v"), goal.value, np.nan)
            places.append((f"via {point.name!r}", float(times[point.node]), goal.q, goal.q_active, rate))
    goal = problem.goal
    if goal.is_exact and goal.periodic is None:
        is_rest = goal.rate == "v" or (goal.rate_active.all() and not goal.value.any())
        rate = np.where(goal.rate_active & is_rest, goal.value, np.nan)
        places.append(("the goal", float(times[-1]), goal.q, goal.q_active, rate))
    return [_Leg(b[0], a[1], b[1], a[2], b[2], a[3] & b[3], (a[4], b[4])) for a, b in pairwise(places)]


def _rates(problem: Problem, leg: _Leg) -> Iterator[Cause]:
    """Joints that need more time than there is, for their speeds, accelerations and jerks."""
    limits, robot = problem.widest_limits, problem.robot
    for name, i, distance, unit, is_circle in _ways(robot, leg):
        sign = 1.0 if distance >= 0.0 else -1.0
        sides = limits.v_upper[i], -limits.v_lower[i]
        v = max(sides) if is_circle else sides[sign < 0.0]
        a = max(limits.a_upper[i], -limits.a_lower[i])
        j = max(limits.j_upper[i], -limits.j_lower[i])
        v0, v1 = (sign * float(rate[i]) for rate in leg.rates)
        if math.isnan(v0):
            v0, a, j = 0.0, math.inf, math.inf
        to = None if math.isnan(v1) else v1
        d = abs(distance)
        for kind, needed, words in (
            ("speed", least_time(d, v), f"at its {v:.4g} {unit}/s"),
            (
                "acceleration",
                least_time(d, v, a, from_rate=v0, to_rate=to, is_circle=is_circle),
                f"with its {a:.4g} {unit}/s^2" + (f" and {v:.4g} {unit}/s" if v < math.inf else ""),
            ),
            ("jerk", least_time(d, jerk=j, from_rate=v0, to_rate=to), f"with its {j:.4g} {unit}/s^3"),
        ):
            if needed > leg.time + problem.dt:
                line = f"{name} needs {needed:.3g} s for {d:.3g} {unit} to {leg.name} {words}; {_has(leg)}"
                yield Cause(kind, name, line, True, needed / leg.time)
                break


def _has(leg: _Leg) -> str:
    if leg.begins == 0.0 and leg.name == "the goal":
        return f"the horizon is {leg.time:.4g} s"
    return f"there are {leg.time:.4g} s"


def _ways(robot: Robot, leg: _Leg) -> Iterator[tuple[str, int, float, str, bool]]:
    """Joints of one velocity: name, place in v, least distance, unit, whether it goes round."""
    away = robot.difference(leg.q0, leg.q1)
    for joint in range(1, robot.model.njoints):
        j, kind = robot.model.joints[joint], joint_kind(robot.model, joint)
        if j.nv == 1 and leg.known[j.idx_v]:
            yield robot.model.names[joint], j.idx_v, float(away[j.idx_v]), kind.v[0][1], j.nq == 2


def _frame_speeds(problem: Problem, leg: _Leg) -> Iterator[Cause]:
    """Frames that are to go farther than their speed allows."""
    if not leg.known.all() or leg.time <= 0.0:
        return
    for path in problem.frame_constraints:
        if path.kind != "speed" or path.span.has_end(problem.num_steps, problem.dt) is False:
            continue
        name = problem.robot.model.frames[path.frame].name
        ends = [problem.robot.frame_placement(name, q).translation for q in (leg.q0, leg.q1)]
        distance, most = float(np.linalg.norm(ends[1] - ends[0])), float(path.upper[0])
        needed = distance / most
        if path.span.has_start and needed > (leg.time + problem.dt) * (1.0 + _MARGIN):
            line = f"{name} needs {needed:.3g} s for {distance:.3g} m to {leg.name} at {most:.4g} m/s"
            yield Cause(
                "frame_speed", path.name, f"{line} (path {path.name!r}); {_has(leg)}", True, needed / leg.time
            )


def _torques(problem: Problem, leg: _Leg) -> Iterator[Cause]:
    """Motors that would have to be much stronger for the straight way, in the mean of its poses.

    From rest to rest half the time is for gaining speed, so that 4 d/T^2 is the least acceleration. Other
    ways may take less, so that this is an estimate.
    """
    robot, limits = problem.robot, problem.widest_limits
    rates = np.array(leg.rates)
    is_single = not robot.nc and not robot.drives and robot.nu == robot.nv and leg.known.all()
    if not is_single or not np.isfinite(limits.u_upper).any() or np.abs(rates[0]).max() > _MARGIN:
        return
    away = robot.difference(leg.q0, leg.q1)
    bend = np.where(np.isnan(rates[1]), 2.0, 4.0) * away / leg.time**2
    needed = []
    for s in np.linspace(0.0, 1.0, _SAMPLES):
        q = np.array(robot.integrate(leg.q0, s * away))
        u = [find_holding_controls(robot, q, sign * bend) for sign in (1.0, -1.0)]
        needed.append(np.min([np.abs(one) if one is not None else np.zeros(robot.nu) for one in u], axis=0))
    least = np.mean(needed, axis=0)
    size = np.fmax(limits.u_upper, -limits.u_lower)
    for i in np.flatnonzero(np.isfinite(size) & (least > _SURE * size)):
        label = robot.u_labels[i]
        line = (
            f"{label.name} would need about {least[i]:.3g} {label.unit} on the straight way to {leg.name} in "
            f"{leg.time:.4g} s, and has {size[i]:.4g} {label.unit}"
        )
        yield Cause("torque", label.name, line, False, float(least[i] / size[i]))


def _weights(problem: Problem) -> Iterator[Cause]:
    """Poses at rest that the motors cannot hold."""
    robot, limits = problem.robot, problem.limits_along()["u"]
    if robot.drives or robot.nu != robot.nv - robot.nc:  # else others than the smallest controls may hold it
        return
    for where, q, step in _poses_at_rest(problem):
        u = find_holding_controls(robot, np.array(q))
        if u is None:
            continue
        lower, upper = (side[step] for side in limits)
        over = np.where(
            u > 0.0, u / np.where(upper > 0.0, upper, 1e-12), u / np.where(lower < 0.0, lower, -1e-12)
        )
        for i in np.flatnonzero(over > 1.0 + _MARGIN):
            label, has = robot.u_labels[i], upper[i] if u[i] > 0.0 else -lower[i]
            line = (
                f"{label.name} would need {abs(u[i]):.4g} {label.unit} to hold the {where} at rest, and has "
                f"{max(has, 0.0):.4g} {label.unit}"
            )
            yield Cause("weight", label.name, line, False, float(over[i]))


def _poses_at_rest(problem: Problem) -> Iterator[tuple[str, Array, int]]:
    """Start and goal where they are given and at rest, with the step beside them."""
    goal = problem.goal
    if problem.start_free is None and not problem.v_start.any():
        yield "start", problem.q_start, 0
    if goal.is_exact and goal.q_active.all() and goal.rate_active.all() and not goal.value.any():
        yield "goal", goal.q, -1


def _find_damping(problem: Problem) -> Iterator[Cause]:
    """Joints whose velocities settle much faster than a step, under a scheme that lets them ring."""
    if SCHEMES[problem.scheme].settles or problem.robot.nc:
        return
    name, times = stiffest_joint(problem.robot, problem.dt)
    if times > _STIFF:
        line = (
            f"the damping of {name} stops it in {problem.dt / times:.2g} s, which steps of "
            f'{problem.dt:.2g} s by "{problem.scheme}" do not resolve; '
            'take integrator.scheme = "radau2" or "se1", or less damping'
        )
        yield Cause("damping", name, line, False, times)


def _steps(problem: Problem, leg: _Leg) -> Iterator[Cause]:
    """Joints that turn by more than a radian in a step."""
    steps = max(round(leg.time / problem.dt), 1)
    for name, _, distance, unit, _ in _ways(problem.robot, leg):
        if unit == "rad" and abs(distance) / steps > _COARSE:
            least = math.ceil(abs(distance) / 0.2)
            line = (
                f"{name} turns by {abs(distance) / steps:.2g} rad in each of {steps} "
                f"step{'s' * (steps != 1)} to {leg.name}; take horizon.steps of {least} at least"
            )
            yield Cause("steps", name, line, False, abs(distance) / steps)
