"""From a solver's iterate to trajectories in the paper's scaling, and what they tell of themselves.

That is also whether the steps of a motion resolve it, and the least time that it takes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.base import Formulation
from mbocp.formulation.features.changing_constraints import violation_within
from mbocp.formulation.inequalities import inequalities, limit_violation
from mbocp.formulation.motion import Motion
from mbocp.integrators import root_mean_squares
from mbocp.mechanics.diagnostics import largest_turn
from mbocp.problem import Problem
from mbocp.problem.step_powers import StepPowers
from mbocp.programme import Iterate
from mbocp.programme.kernel import kernel_programme
from mbocp.robot import Robot
from mbocp.robot.kinematics import momenta_of
from mbocp.robot.wheels import WHEEL_RANGE
from mbocp.terms.kinds import Energy

_SWEEP_TOLERANCE = 1e-12  # of a step's residual; a Newton step below that is round-off
_SWEEP_ITERATIONS = 50
_ROUND_OFF = 1e-12  # relative: a sum of lengths that is the duration


@dataclass(frozen=True)
class Trajectory:
    """Trajectories of a solution; see `mbocp.solution.Solution` for shapes and units."""

    t: Array
    qs: Array
    vs: Array
    ps: Array
    us: Array
    u_values: Array
    u_shares: Array
    lams: Array
    mus: Array
    zetas: Array
    eta: Array
    control_hamiltonians: Array
    control_momenta: Array
    control_momentum_names: tuple[str, ...]
    constraint_violation: float
    velocity_violation: float
    violation_within: float
    manifold_drifts: Array
    manifold_drift: float
    manifold_drift_resimulated: float
    lam_us: Array
    lam_qs: Array
    lam_vs: Array
    lam_path: Array
    path_names: tuple[str, ...]
    limit_violation: float
    positive_work: float
    drawn_energy: float

    def fields(self) -> dict[str, Any]:
        """Fields by name, not copied."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


def read_trajectory(formulation: Formulation, iterate: Iterate) -> Trajectory:
    """Trajectories, multipliers, control Hamiltonian and control momentum of an iterate.

    Multipliers of a solve that did not converge may be infinite; what follows from them is NaN then.
    """
    problem = formulation.problem
    motion = formulation.motion_of(iterate)
    with np.errstate(invalid="ignore", over="ignore"):
        duals = formulation.duals_of(iterate, motion)
        momenta, names = formulation.control_momenta(iterate, motion, duals)
        hamiltonians = formulation.hamiltonians(iterate, motion, duals)
    work, drawn = _energies(problem, motion)
    drifts, violation = formulation.drifts(iterate.xs), formulation.violation(iterate, motion)
    return Trajectory(
        t=times_of(problem, motion.dts),
        qs=motion.qs,
        vs=motion.vs,
        ps=momenta_of(problem.robot.model, motion.qs, motion.vs),
        us=motion.us,
        u_values=motion.values,
        u_shares=np.array(motion.shares),
        lams=duals.lams,
        mus=duals.mus,
        zetas=duals.zetas,
        eta=iterate.eta,
        control_hamiltonians=hamiltonians,
        control_momenta=momenta,
        control_momentum_names=names,
        constraint_violation=violation.position,
        velocity_violation=violation.velocity,
        violation_within=violation_within(problem, motion.qs),
        manifold_drifts=drifts,
        manifold_drift=_largest(drifts),
        manifold_drift_resimulated=_drift_of_simulation(formulation, iterate),
        **inequalities(formulation, iterate, motion),
        positive_work=work,
        drawn_energy=drawn,
    )


def measures_of(formulation: Formulation, iterate: Iterate, motion: Motion) -> dict[str, Callable[[], Any]]:
    """What gives single numbers of a `Trajectory`, without all else of it."""
    return {
        "constraint_violation": lambda: float(formulation.violation(iterate, motion).position),
        "limit_violation": lambda: limit_violation(formulation, iterate, motion),
        "manifold_drift": lambda: _largest(formulation.drifts(iterate.xs)),
        "manifold_drift_resimulated": lambda: _drift_of_simulation(formulation, iterate),
    }


def _energies(problem: Problem, motion: Motion) -> tuple[float, float]:
    """Work of the controls, where they brake left out, and what motors draw [J]; NaN without dynamics."""
    robot = problem.robot
    units = {label.unit for label in robot.u_labels[: robot.nu - len(robot.drives)]}
    if units and not units & {"N", "N m"}:
        return np.nan, np.nan
    with np.errstate(invalid="ignore", over="ignore"):  # of numbers that diverged
        t = np.append(0.0, np.cumsum(motion.dts))
        work, braked = StepPowers.of(robot, problem.scheme, t, motion.qs, motion.vs, motion.us_at).works
        rms = root_mean_squares(motion.dts, motion.us, motion.values, motion.shares)
        drawn = Energy.compute_drawn_energy(problem.cost, work, braked, motion.dts.sum() * rms**2)
    return float(work.sum()), drawn


def _largest(drifts: Array) -> float:
    return float(drifts.max(initial=0.0))


def times_of(problem: Problem, dts: Array) -> Array:
    """Times of the nodes [s]."""
    if problem.timeline.has_free_lengths or problem.timeline.impacts:
        times = np.append(0.0, np.cumsum(dts))
        if (
            problem.duration_range is None
            and abs(times[-1] - problem.duration) <= _ROUND_OFF * problem.duration
        ):
            times[-1] = problem.duration
        return times
    return problem.timeline.times()


def _drift_of_simulation(formulation: Formulation, iterate: Iterate) -> float:
    """Largest drift of the forward simulation with the iterate's controls; NaN if it cannot be made."""
    if not formulation.can_drift:
        return 0.0
    native = kernel_programme(formulation.programme, sweeps=True)
    iterate.load_into(native)
    sweep = native.simulate(_SWEEP_TOLERANCE, _SWEEP_ITERATIONS)
    if not sweep.ok:
        return math.nan
    return _largest(formulation.drifts(native.x.reshape(iterate.xs.shape)))


_LARGEST_TURN = 1.0  # [rad] in one step; a symplectic Euler step of that size has lost all accuracy
_MOSTLY = 0.9  # of a cost: what makes it one of time
_HARDLY = 1e-3  # of a cost: what does not; an effort of the kind c / T^3 leaves time three quarters of it
_LIGHT = 1e-3  # of the largest inertia; that of a UR5 is 3e-3 at least, of a Panda 2e-3
_TAKES_PART = 0.3  # of a direction of length 1
_IDLE = 1e-12  # of the largest multiplier: where nothing depends on a number, its own are zero
_SENSITIVE = 5.0  # times as large as the change of all limits of controls: 0.5 is usual, as for a mass


def describe_coarse_turn(formulation: Formulation, motion: Motion) -> str | None:
    """Say which joint turns too far in one step for a motion of the robot, and how far; None if none does."""
    problem = formulation.problem
    longest = float(motion.dts.max())
    robot = problem.robot
    name, turn = largest_turn(robot, motion.qs, motion.vs, longest, problem.substeps)
    if not turn > _LARGEST_TURN:
        return None
    wheels = [label.name for label, is_wheel in zip(robot.v_labels, robot.wheels, strict=True) if is_wheel]
    may = (
        f' (unless it is "revolute" in its file, within {WHEEL_RANGE:.3g} rad or more)'
        if name in wheels
        else ""
    )
    return f"{name} turns by {turn:.1f} rad in one step, which is no motion any more{may}"


def describe_light_joints(robot: Robot, q: Array, name: str) -> str | None:
    """Say which joints together turn next to nothing at a configuration; None if the named one turns more.

    Where a URDF leaves rotors out, wrists whose axes are in line turn against each other with the inertia of
    a small link alone, and a torque that a step holds takes them anywhere.

    Parameters
    ----------
    robot : Robot
    q : ndarray, shape (nq,)
    name : str
        Of an entry of the velocity.
    """
    turns = [i for i, label in enumerate(robot.v_labels) if label.unit == "rad/s"]
    names = [robot.v_labels[i].name for i in turns]
    if robot.nc or name not in names:
        return None
    inertias, ways = np.linalg.eigh(robot.mass_matrix(q)[np.ix_(turns, turns)])
    shares = np.abs(ways[:, 0])
    if inertias[0] > _LIGHT * inertias[-1] or shares[names.index(name)] < _TAKES_PART:
        return None
    light = " and ".join(one for one, share in zip(names, shares, strict=True) if share >= _TAKES_PART)
    return f"the inertia that {light} turn{'' if ' and ' in light else 's'} there is {inertias[0]:.2g} kg m^2"


def describe_sensitive_time(
    formulation: Formulation, iterate: Iterate, motion: Motion, cost: float
) -> str | None:
    r"""Say that a least time stands and falls with the limits of the controls; None if it does not.

    With multipliers :math:`\lambda` of the limits of the controls u,

    .. math:: S = \frac{1}{T} \sum_{n, i} |\lambda_{n, i}\, u_{n, i}|

    is by how many times a relative change of all limits changes the time T, 1/2 for a mass that is moved from
    rest to rest. Where it grows without bound as steps become shorter, the least time has no derivative: what
    steps are wrong by, a little of a control that leaps, costs as much as a whole step.
    """
    problem, bounds = formulation.problem, iterate.bounds
    of_time = float(problem.cost.weight("time") * motion.dts.sum())
    is_least_time = problem.duration_range is not None and of_time >= _MOSTLY * cost > 0.0
    if not is_least_time or bounds is None:
        return None
    own = slice(0, formulation.layout.num_own)
    times = float(np.abs(bounds.us[:, own] * iterate.us[:, own]).sum() / of_time)
    if not times > _SENSITIVE:
        return None
    return (
        f"the least time hangs on the limits of the controls: a small change of these changes it by "
        f"{times:.2g} times as much (0.5 is usual), and steps may make it longer by one of them, "
        f"{motion.dts.max():.2g} s: compare with more steps"
    )


def describe_light_time(problem: Problem, duration: float, cost: float) -> str | None:
    """Say that the weight of time decides next to nothing of a free duration; None if it does."""
    of_time = float(problem.cost.weight("time")) * duration
    if problem.duration_range is None or not 0.0 < of_time < _HARDLY * cost:
        return None
    return (
        f"time is {of_time / cost:.1g} of the cost, the other terms choose the duration: for the least time "
        "lower their weights, cost.effort among them, which is 1 where nothing is said"
    )


def describe_idle_parameters(formulation: Formulation, iterate: Iterate) -> str | None:
    """Name the parameters on which nothing after the first step depends; None if there are none.

    Their values are then those in the middle of their bounds, or those that cost least.
    """
    problem = formulation.problem
    if not problem.parameter:
        return None
    pulls = np.abs(iterate.ms[:, formulation.layout.rows["found"]]).max(axis=0)
    is_idle = pulls < _IDLE * np.abs(iterate.ms).max()
    names = [one.name for one, idle in zip(problem.parameter, is_idle, strict=True) if idle]
    return f"the motion does not depend on {', '.join(names)}: take [[parameter]] out" if names else None
