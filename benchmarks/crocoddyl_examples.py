"""Crocoddyl's published examples by the same equations: python -m benchmarks.crocoddyl_examples.

The same robots, costs, semi-implicit steps and guesses; `peers/tools/crocoddyl_examples.py` has theirs.
Crocoddyl's own functions judge both motions. Processor times of solves, the median of repeats, one thread.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.peers.environments import environment_of_crocoddyl
from benchmarks.peers.tools.runs import timed
from benchmarks.tables import Table, show
from mbocp._arrays import Array
from mbocp.formulation import Formulation, Motion, formulate
from mbocp.guesses import make_guess
from mbocp.programme import Iterate
from mbocp.solvers import SolverSettings, Start, run_strategy
from mbocp.terms import running_cost, terminal_cost

__all__ = ["PROBLEMS", "arm", "quadrotor", "solved", "table"]

_ROOT = Path(__file__).parents[1]
_SCHEME = {"scheme": "semi_implicit_euler", "coordinates": "joint"}


def arm() -> mbocp.Problem:
    """A Kinova reaches for a pose: `arm_manipulation_fwddyn.py`, and by inverse dynamics `..._invdyn.py`."""
    robot = mbocp.load_robot("kinova")
    q, nv = robot.model.referenceConfigurations["arm_up"], robot.nv

    def pose(at):
        return ca.sumsqr(at.pose_error("j2s6s200_end_effector", [0.6, 0.2, 0.5])) / 2

    at_start = {
        "tracking": 0.1,
        "tracking_weights": [1] * nv + [0] * nv,
        "target": {"q": q, "p": np.zeros(nv)},
    }
    return mbocp.Problem.create(
        robot,
        1.0,
        100,
        start={"q": q},
        cost={"effort": 0.1, "velocity": 0.1, **at_start},
        terms=[running_cost(pose), terminal_cost(pose, weight=1e3, name="pose at the end")],
        **_SCHEME,
    )


def quadrotor() -> mbocp.Problem:
    """Hector flies to a pose: `quadrotor_fwddyn.py`, and by inverse dynamics `quadrotor_invdyn.py`."""
    robot = mbocp.load_robot(_ROOT / "benchmarks/peers/robots/hector")
    nv = robot.nv

    def pose(at):
        return ca.sumsqr(at.pose_error("hector/base_link", [1.0, 0.0, 1.0])) / 2

    weights = [1e-7] * 3 + [1e-3] * 3 + [0] * nv
    upright = {
        "tracking": 1.0,
        "tracking_weights": weights,
        "target": {"q": robot.neutral(), "p": np.zeros(nv)},
    }
    return mbocp.Problem.create(
        robot,
        0.99,
        33,
        start={"q": robot.neutral()},
        cost={"effort": 1e-6, "velocity": 1e-3, **upright},
        terms=[running_cost(pose, weight=1e-2), terminal_cost(pose, weight=3.0, name="pose at the end")],
        **_SCHEME,
    )


@dataclass(frozen=True)
class Gait:
    """A walk of Crocoddyl's `SimpleQuadrupedalGaitProblem` and `SimpleBipedGaitProblem`.

    Weights are halved in the cost; those of the base are of its rotation and of its velocity.
    """

    robot: str
    standing: str  # reference configuration
    feet: tuple[str, ...]  # frames
    swings: tuple[tuple[int, float, bool], ...]  # foot, length [m], whether all stand before it
    height: float  # [m]
    steps: int  # of a swing
    support: int  # steps in which all stand
    dt: float  # [s]
    hold: str  # "point" or "weld"
    joint_velocity: float
    landing: tuple[float, float, float]  # of the foot, the base's place, and the joints
    is_standing_at_end: bool


WALK = Gait(
    robot="anymal",
    standing="standing",
    feet=("LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT"),
    swings=((3, 0.125, True), (1, 0.125, False), (2, 0.25, True), (0, 0.25, False)),
    height=0.15,
    steps=25,
    support=2,
    dt=1e-2,
    hold="point",
    joint_velocity=10.0,
    landing=(1e7, 10.0, 1e3),
    is_standing_at_end=True,
)
BIPED = Gait(
    robot="talos_legs",
    standing="half_sitting",
    feet=("right_sole_link", "left_sole_link"),
    swings=((0, 0.3, True), (1, 0.6, True)),
    height=0.1,
    steps=15,
    support=4,
    dt=3e-2,
    hold="weld",
    joint_velocity=1e3,
    landing=(1e8, 10.0, 0.1),
    is_standing_at_end=False,
)


@dataclass(frozen=True)
class Swing:
    """One foot in the air: the frame, its place and that of the centre of mass before, its first step."""

    foot: str
    place: Array
    com: Array
    length: float
    first: int
    is_first: bool  # after a phase in which all stand


def swings_of(gait: Gait, robot: mbocp.Robot) -> list[Swing]:
    """The swings one after the other, as `createWalkingProblem` plans them."""
    q, model, data = robot.model.referenceConfigurations[gait.standing], robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, q)
    places = [data.oMf[robot.frame_id(foot)].translation.copy() for foot in gait.feet]
    com = np.mean(places, axis=0)
    com[2] = pin.centerOfMass(model, data, q)[2]
    found, first = [], 0
    for foot, length, stands in gait.swings:
        first += gait.support * stands
        found.append(Swing(gait.feet[foot], places[foot], com.copy(), length, first, stands))
        com[0] += length / len(gait.feet)
        first += gait.steps
    return found


def cone(gait: Gait) -> Array:
    """Rows of forces, and of torques for flat feet, in the world's axes that the ground keeps below zero."""
    mu, half_length, half_width = 0.7, 0.05, 0.025  # Crocoddyl's: friction, and of the sole [m]
    rows = [[1, 0, -mu, 0, 0, 0], [-1, 0, -mu, 0, 0, 0], [0, 1, -mu, 0, 0, 0], [0, -1, -mu, 0, 0, 0]]
    rows += [[0, 0, -1, 0, 0, 0]]
    if gait.hold == "point":
        return np.array(rows)[:, :3]
    for sign in (1, -1):
        rows += [[0, 0, -half_width, sign, 0, 0], [0, 0, -half_length, 0, sign, 0]]
        for x in (1, -1):
            for y in (1, -1):
                torques = (-sign * x * mu, -sign * y * mu, -sign)
                rows += [[x * half_width, y * half_length, -mu * (half_length + half_width), *torques]]
    return np.array(rows)


def force_on(at: Any, foot: str, size: int) -> Any:
    """Force of the ground on a foot, and its torque where `size` is 6: what the motors of the leg leave."""
    robot = at.robot
    joint = robot.model.frames[robot.frame_id(foot)].parentJoint
    leg = [robot.model.joints[j].idx_v for j in robot.model.supports[joint] if j > 1]  # 1: the base
    left = at.mechanics.inverse_dynamics(at.q, at.v, at.a)[leg] - at.u[[i - 6 for i in leg]]
    return ca.solve(at.jacobian(foot)[:size, leg].T, left)


def gait_problem(gait: Gait) -> mbocp.Problem:
    """Costs of Crocoddyl's; contacts and impacts are mbocp's."""
    robot = mbocp.load_robot(gait.robot)
    q, nv = robot.model.referenceConfigurations[gait.standing], robot.nv
    swings, joints = swings_of(gait, robot), nv - 6
    of_q = np.array([0.0] * 3 + [2.5e6] * 3 + [1e-3] * joints)
    of_v = np.array([1e3] * 6 + [gait.joint_velocity] * joints)
    of_foot, of_base, of_joints = gait.landing
    landed_q = np.array([of_base] * 6 + [of_joints] * joints)

    def missed(at: Any, foot: str, place: Any) -> Any:
        error = at.pose_error(foot, place)
        return ca.sumsqr(error if gait.hold == "weld" else error[:3])

    def state(at: Any, of_q: Array, of_v: Array) -> Any:
        away = at.mechanics.space.difference(ca.SX(ca.DM(q)), at.q)
        return (ca.dot(of_q, away**2) + ca.dot(of_v, at.v**2)) / 2

    def landing(at: Any, swing: Swing) -> Any:
        """Cost before an impact, at the end of a step: no step with a duration begins there."""
        v = at.v + gait.dt * at.a
        at = replace(at, q=at.mechanics.space.integrate(at.q, gait.dt * v), v=v)
        place = swing.place + np.array([swing.length, 0.0, 2 * gait.height / gait.steps])
        return of_foot / 2 * missed(at, swing.foot, place) + state(at, landed_q, np.full(nv, 1e3))

    def contact(at: Any) -> Any:
        total, step = ca.SX(0), at.t / gait.dt
        for foot in gait.feet:
            beyond = ca.fmax(cone(gait) @ force_on(at, foot, 3 if gait.hold == "point" else 6), 0)
            firsts = [swing.first for swing in swings if swing.foot == foot]
            is_in_air = sum(ca.logic_and(step > n - 0.5, step < n + gait.steps - 0.5) for n in firsts)
            total += ca.if_else(is_in_air > 0, 0, 10 / 2 * ca.sumsqr(beyond))
        return total

    def swinging(at: Any) -> Any:
        total, step = ca.SX(0), at.t / gait.dt
        for swing in swings:
            k = step - swing.first  # within the swing
            along, up = swing.length * (k + 1) / gait.steps, gait.height * (1 - ca.fabs(2 * k / gait.steps - 1))
            place = ca.vertcat(swing.place[0] + along, swing.place[1], swing.place[2] + up)
            com = ca.vertcat(swing.com[0] + along / len(gait.feet), *swing.com[1:])
            missing = missed(at, swing.foot, place) + ca.sumsqr(at.centre_of_mass() - com)
            is_in = ca.logic_and(k > -0.5, k < gait.steps - 0.5)
            total += ca.if_else(is_in, 1e6 / 2 * missing, 0)
            is_last = ca.logic_and(k > gait.steps - 1.5, k < gait.steps - 0.5)
            total += ca.if_else(is_last, landing(at, swing) / gait.dt, 0)
        return total

    def end(at: Any) -> Any:
        return state(at, of_q, of_v)

    weights = {"tracking_weights": np.append(of_q, np.zeros(nv)), "target": {"q": q, "p": np.zeros(nv)}}
    return mbocp.Problem.create(
        robot,
        phase=[phase for swing in swings for phase in phases_of(gait, swing)],
        start={"q": q},
        cost={"effort": 0.1, "velocity": of_v, "tracking": 1.0, **weights},
        terms=[running_cost(contact), running_cost(swinging), *([terminal_cost(end)] if gait.is_standing_at_end else [])],
        **_SCHEME,
    )


def phases_of(gait: Gait, swing: Swing) -> list[dict[str, Any]]:
    """All stand, then one swings."""

    def phase(name: str, steps: int, feet: Sequence[str]) -> dict[str, Any]:
        held = [{"name": foot, "frame": foot, "kind": gait.hold} for foot in feet]
        return {"name": name, "steps": steps, "duration": steps * gait.dt, "hold": held}

    standing = [foot for foot in gait.feet if foot != swing.foot]
    swinging = phase(f"swing of {swing.foot}", gait.steps, standing)
    return [*([phase(f"stand before {swing.foot}", gait.support, gait.feet)] * swing.is_first), swinging]


PROBLEMS: Mapping[str, Callable[[], mbocp.Problem]] = {
    "arm_manipulation_fwddyn": arm,
    "arm_manipulation_invdyn": arm,
    "quadrotor_fwddyn": quadrotor,
    "quadrotor_invdyn": quadrotor,
    "quadrupedal_gaits_fwddyn": lambda: gait_problem(WALK),
    "bipedal_gaits_fwddyn": lambda: gait_problem(BIPED),
}


def guessed(formulation: Formulation, kind: str) -> Iterate:
    """The first iterate: "hold", or "zero", Crocoddyl's default: the neutral configuration, no controls."""
    if kind == "hold":
        return make_guess(kind, formulation)[0]
    problem, N = formulation.problem, formulation.problem.num_steps
    robot = problem.robot
    still = Motion(
        np.tile(robot.neutral(), (N + 1, 1)),
        np.zeros((N + 1, robot.nv)),
        np.zeros((N, robot.nu)),
        problem.timeline.lengths(),
    )
    return formulation.iterate_of(still, np.zeros((N, 0)))


def solved(problem: mbocp.Problem, kind: str, repeats: int) -> tuple[Motion, int, list[float], str]:
    """Motion, iterations, processor times [s], and how the solver ended."""
    formulation = formulate(problem)
    guess = guessed(formulation, kind)
    settings = SolverSettings.of(problem.solver, formulation.programme, has_inequalities=problem.is_bounded)
    start = Start(formulation.programme, guess)
    outcome, seconds = timed(lambda: run_strategy(settings, start), repeats, time.process_time)
    result = outcome.result
    iterations = sum(not record.is_guess for record in result.history)
    return formulation.motion_of(result.iterate), iterations, seconds, str(result.status)


def compared(name: str, kind: str, repeats: int, python: Path) -> dict[str, Any]:
    """What both came to, from one guess."""
    motion, iterations, seconds, status = solved(PROBLEMS[name](), kind, repeats)
    with tempfile.TemporaryDirectory() as folder:
        ours = Path(folder) / "ours.npz"
        np.savez(ours, qs=motion.qs, vs=motion.vs, us=motion.us)
        script = "benchmarks.peers.tools.crocoddyl_examples"
        done = subprocess.run(
            [str(python), "-m", script, name, kind, str(repeats), str(ours)],
            cwd=_ROOT,
            env={**os.environ, "PYTHONPATH": str(_ROOT), "OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode:
        raise SystemExit(done.stderr)
    theirs = json.loads(done.stdout.splitlines()[-1])
    return {"status": status, "own iterations": iterations, "own seconds": seconds, **theirs}


def table(names: Sequence[str], repeats: int) -> Table:
    """Two rows an example: from Crocoddyl's default guess, and from holding the start."""
    peer, rows, versions = environment_of_crocoddyl(), [], set()
    if not peer.has("crocoddyl"):
        raise SystemExit(f"Crocoddyl: {peer.reason}")
    for name in names:
        for kind in ("zero", "hold"):
            found = compared(name, kind, repeats, peer.python)
            versions.add(found["version"])
            rows.append(_row(name, kind, found))
    note = (
        f"Crocoddyl {', '.join(sorted(versions))}. Guess zero: its default, the neutral configuration and no "
        "controls; hold: at the start, gravity compensated. From mbocp's: the cost at which Crocoddyl's solver "
        "ends that begins at mbocp's motion. Difference: of the costs, by the lower. Gradient: the largest "
        "derivative of the cost in a control, by the largest of the effort. Defect: of mbocp's steps."
    )
    columns = ("example", "guess", *(f"{who}: {what}" for who in ("mbocp", "Crocoddyl") for what in _WHAT))
    return Table("Crocoddyl's examples", (*columns, "from mbocp's", "difference", "defect"), rows, note)


_WHAT = ("cost", "iterations", "time [ms]", "gradient")


def _row(name: str, kind: str, found: Mapping[str, Any]) -> tuple[str, ...]:
    ours, theirs = found["ours"], found["theirs"]
    less = min(ours["cost"], theirs["cost"])
    said = "" if found["status"] == "converged" else f" ({found['status']})"
    return (
        name,
        kind,
        f"{ours['cost']:.7g}{said}",
        str(found["own iterations"]),
        f"{1e3 * median(found['own seconds']):.3g}",
        f"{ours['gradient']:.0e}",
        f"{theirs['cost']:.7g}",
        str(found["iterations"]),
        f"{1e3 * median(found['seconds']):.3g}",
        f"{theirs['gradient']:.0e}",
        f"{found['from ours']['cost']:.7g}",
        f"{(theirs['cost'] - ours['cost']) / less:+.0e}",
        f"{ours['defect']:.0e}",
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.crocoddyl_examples", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--examples", nargs="+", choices=PROBLEMS, default=list(PROBLEMS))
    parser.add_argument("--repeats", type=int, default=9, help="solves of which the median is taken")
    options = parser.parse_args(arguments)
    one_core()
    show(header(), markdown=options.markdown)
    show(table(options.examples, options.repeats), markdown=options.markdown)


if __name__ == "__main__":
    main()
