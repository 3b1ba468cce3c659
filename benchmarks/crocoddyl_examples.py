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
from itertools import product
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
from mbocp.terms import OwnTerm, running_cost, terminal_cost

__all__ = [
    "GAITS",
    "PROBLEMS",
    "Solved",
    "arm",
    "gait_problem",
    "nodes_of",
    "quadrotor",
    "solved",
    "table",
]

_ROOT = Path(__file__).parents[1]
_SCHEME = {"scheme": "semi_implicit_euler", "coordinates": "joint"}


def arm() -> mbocp.Problem:
    """A Kinova reaches for a pose: `arm_manipulation_fwddyn.py`, and by inverse dynamics `..._invdyn.py`."""
    robot = mbocp.load_robot("kinova")
    q = robot.model.referenceConfigurations["arm_up"]

    def pose(at):
        return ca.sumsqr(at.pose_error("j2s6s200_end_effector", [0.6, 0.2, 0.5])) / 2

    near = {"tracking": 0.1, "target": {"q": q}}
    return mbocp.Problem.create(
        robot,
        1.0,
        100,
        start={"q": q},
        cost={"effort": 0.1, "velocity": 0.1, **near},
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


_FRICTION, _BEYOND_CONE = 0.7, 10.0  # coefficient; weight of squares of what is beyond a pyramid [1/N^2]


@dataclass(frozen=True)
class Swing:
    """Some feet swing, after `support` steps in which all stand; all of them: the robot jumps."""

    feet: tuple[int, ...]
    way: tuple[float, float, float]  # [m] of the feet
    height: float  # [m] of the feet, in a jump of the centre of mass
    steps: int
    support: int


@dataclass(frozen=True)
class Gait:
    """A gait of Crocoddyl's `SimpleQuadrupedalGaitProblem` or `SimpleBipedGaitProblem`, from standing.

    Weights are halved in the cost; those of the base are of its rotation and of its velocity.
    """

    swings: tuple[Swing, ...]
    robot: str = "anymal"
    standing: str = "standing"  # reference configuration
    feet: tuple[str, ...] = ("LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT")  # frames
    dt: float = 1e-2  # [s]
    hold: str = "point"  # or "weld"
    joint_velocity: float = 10.0
    landing: tuple[float, float, float] = (1e7, 10.0, 1e3)  # of the foot, the base's place, and the joints
    landed: int = 0  # steps after the last swing, in which the centre of mass is to be above the feet
    is_standing_at_end: bool = True
    sole: tuple[float, float] | None = None  # along x and y [m]


def _step(length: float, height: float, support: int, *feet: int) -> Swing:
    return Swing(feet, (length, 0.0, 0.0), height, 25, support)


_LF, _RF, _LH, _RH = range(4)
GAITS: Mapping[str, Gait] = {
    "walk": Gait(
        (
            _step(0.125, 0.15, 2, _RH),
            _step(0.125, 0.15, 0, _RF),
            _step(0.25, 0.15, 2, _LH),
            _step(0.25, 0.15, 0, _LF),
        )
    ),
    "trot": Gait((_step(0.075, 0.1, 2, _RF, _LH), _step(0.15, 0.1, 2, _LF, _RH))),
    "pace": Gait((_step(0.075, 0.1, 5, _RF, _RH), _step(0.15, 0.1, 5, _LF, _LH))),
    "bound": Gait((_step(0.15, 0.1, 5, _LF, _RF), _step(0.15, 0.1, 5, _LH, _RH))),
    "jump": Gait((Swing((_LF, _RF, _LH, _RH), (0.0, 0.3, 0.0), 0.15, 40, 10),), landed=9),
    "biped": Gait(
        (Swing((0,), (0.3, 0.0, 0.0), 0.1, 15, 4), Swing((1,), (0.6, 0.0, 0.0), 0.1, 15, 4)),
        robot="talos_legs",
        standing="half_sitting",
        feet=("right_sole_link", "left_sole_link"),
        dt=3e-2,
        hold="weld",
        joint_velocity=1e3,
        landing=(1e8, 10.0, 0.1),
        is_standing_at_end=False,
        sole=(0.1, 0.05),
    ),
}


@dataclass(frozen=True, eq=False)
class Planned:
    """A swing in its place: its first step, places of its feet and of the centre of mass before it [m]."""

    swing: Swing
    first: int
    feet: Mapping[str, Array]
    com: Array
    com_way: Array
    is_jump: bool  # all feet are in the air

    def feet_at(self, k: Any) -> dict[str, Any]:
        """Where the feet are to be after step `k` of the swing [m]; in a jump they go straight."""
        swing = self.swing
        up = 0 if self.is_jump else swing.height * (1 - ca.fabs(2 * k / swing.steps - 1))
        moved = ca.DM(swing.way) * (k + 1) / swing.steps + ca.vertcat(0, 0, up)
        return {foot: place + moved for foot, place in self.feet.items()}

    def com_at(self, k: Any) -> Any:
        """Where the centre of mass is to be [m]; the first half of a jump leads it up."""
        way = ca.DM(self.com_way + np.array([0, 0, 2 * self.swing.height * self.is_jump]))
        return self.com + way * (k + 1) / self.swing.steps


def plan(gait: Gait, robot: mbocp.Robot) -> list[Planned]:
    """The swings one after the other, as `createWalkingProblem` and the like plan them."""
    q, model, data = robot.model.referenceConfigurations[gait.standing], robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, q)
    places = {foot: data.oMf[robot.frame_id(foot)].translation.copy() for foot in gait.feet}
    com = np.mean([*places.values()], axis=0)
    com[2] = pin.centerOfMass(model, data, q)[2]
    found, first = [], 0
    for swing in gait.swings:
        first += swing.support
        feet = {gait.feet[k]: places[gait.feet[k]] for k in swing.feet}
        share = len(feet) / len(gait.feet)
        found.append(Planned(swing, first, feet, com, share * np.array(swing.way), share == 1.0))
        com = com + found[-1].com_way
        first += swing.steps
    return found


def gait_problem(gait: Gait) -> mbocp.Problem:
    """Costs of Crocoddyl's."""
    robot = mbocp.load_robot(gait.robot)
    q, nv = robot.model.referenceConfigurations[gait.standing], robot.nv
    planned, joints = plan(gait, robot), nv - 6
    of_q = np.array([0.0] * 3 + [2.5e6] * 3 + [1e-3] * joints)
    of_v = np.array([1e3] * 6 + [gait.joint_velocity] * joints)
    of_foot, of_base, of_joints = gait.landing
    of_landing = np.array([of_base] * 6 + [of_joints] * joints), np.full(nv, 1e3)
    last = planned[-1]
    landed = last.first + last.swing.steps  # the step that follows

    def state(at: Any, of_q: Array, of_v: Array) -> Any:
        away = at.mechanics.space.difference(ca.SX(ca.DM(q)), at.q)
        return (ca.dot(of_q, away**2) + ca.dot(of_v, at.v**2)) / 2

    def missed(at: Any, feet: Mapping[str, Any]) -> Any:
        def one(foot: str, place: Any) -> Any:
            return at.pose_error(foot, place) if gait.hold == "weld" else at.position(foot) - place

        return sum((ca.sumsqr(one(foot, place)) for foot, place in feet.items()), ca.SX(0))

    def swinging(at: Any) -> Any:
        v = at.v + gait.dt * at.a
        end = replace(at, q=at.mechanics.space.integrate(at.q, gait.dt * v), v=v)  # before an impact
        landing, com, total = state(end, *of_landing), at.centre_of_mass(), ca.SX(0)
        for one in planned:
            k, steps = at.t / gait.dt - one.first, one.swing.steps  # within the swing
            feet, length = one.feet_at(k), steps / 2 if one.is_jump else steps
            off = ca.sumsqr(com - one.com_at(k)) + (0 if one.is_jump else missed(at, feet))
            total += ca.if_else(ca.fabs(k + 0.5 - length / 2) < length / 2, 1e6 / 2 * off, 0)
            landing_there = landing + of_foot / 2 * missed(end, feet)
            total += ca.if_else(ca.fabs(k + 1 - steps) < 0.5, landing_there / gait.dt, 0)
        if gait.landed:
            total += ca.if_else(at.t / gait.dt > landed - 0.5, above_feet(at), 0)
        return total

    def above_feet(at: Any) -> Any:
        return 1e6 / 2 * ca.sumsqr(at.centre_of_mass() - last.com - last.com_way)

    def standing(at: Any) -> Any:
        if gait.landed:
            return state(at, of_q, of_v) + above_feet(at)
        return state(after_impact(at, [*last.feet]), of_q, of_v)

    weights = {"tracking_weights": np.append(of_q, np.zeros(nv)), "target": {"q": q, "p": np.zeros(nv)}}
    return mbocp.Problem.create(
        robot,
        phase=phases_of(gait),
        start={"q": q},
        cost={"effort": 0.1, "velocity": of_v, "tracking": 1.0, **weights},
        terms=[
            running_cost(swinging),
            cost_of_cones(gait),
            *([terminal_cost(standing)] if gait.is_standing_at_end else []),
        ],
        **_SCHEME,
    )


def cost_of_cones(gait: Gait) -> OwnTerm:
    """Of forces of feet beyond their cones; impacts have none."""

    def beyond_cones(at: Any) -> Any:
        rows = [row for foot in gait.feet for row in cone(at.force(foot), gait.sole)]
        return sum((ca.fmax(row, 0) ** 2 for row in rows), ca.SX(0)) / 2

    return running_cost(beyond_cones, weight=_BEYOND_CONE)


def cone(wrench: Any, sole: tuple[float, float] | None) -> list[Any]:
    """What is at most zero within a pyramid about the cone, or of a sole as in Crocoddyl's `WrenchCone`."""
    force, friction = wrench[:3], _FRICTION if sole is None else _FRICTION / 2**0.5
    rows = [side * force[k] - friction * force[2] for k in (0, 1) for side in (-1, 1)] + [-force[2]]
    if sole is None:
        return rows
    (x, y), torque, sides = np.array(sole) / 2, wrench[3:], (-1, 1)
    for one in sides:
        rows += [one * torque[0] - y * force[2], one * torque[1] - x * force[2]]
        for along, across in product(sides, sides):  # about the corners
            twist = friction * (along * torque[0] + across * torque[1]) + torque[2]
            push = along * y * force[0] + across * x * force[1] - friction * (x + y) * force[2]
            rows.append(push + one * twist)
    return rows


def after_impact(at: Any, feet: Sequence[str]) -> Any:
    """The state after these feet were stopped: at the end of a motion, where no phase follows."""
    mechanics = at.mechanics
    jacobians = [mechanics.frame_translation_jacobian(at.robot.frame_id(foot), at.q) for foot in feet]
    J = ca.vertcat(*jacobians)
    moved = mechanics.inverse_mass_matrix(at.q) @ J.T
    return replace(at, v=at.v - moved @ ca.solve(J @ moved, J @ at.v))


def phases_of(gait: Gait) -> list[dict[str, Any]]:
    """All stand, then some swing, and so on."""
    found: list[dict[str, Any]] = []

    def add(name: str, steps: int, in_air: Sequence[int] = ()) -> None:
        feet = [foot for k, foot in enumerate(gait.feet) if k not in in_air]
        held = [{"name": foot, "frame": foot, "kind": gait.hold} for foot in feet]
        phase = {"name": f"{name} {len(found) + 1}", "steps": steps, "duration": steps * gait.dt}
        found.extend([{**phase, "hold": held}] * (steps > 0))

    for swing in gait.swings:
        add("stand", swing.support)
        add("swing", swing.steps, swing.feet)
    add("stand", gait.landed)
    return found


PROBLEMS: Mapping[str, Callable[[], mbocp.Problem]] = {
    "arm_manipulation_fwddyn": arm,
    "arm_manipulation_invdyn": arm,
    "quadrotor_fwddyn": quadrotor,
    "quadrotor_invdyn": quadrotor,
    "quadrupedal_gaits_fwddyn walk": lambda: gait_problem(GAITS["walk"]),
    "quadrupedal_gaits_fwddyn trot": lambda: gait_problem(GAITS["trot"]),
    "quadrupedal_gaits_fwddyn pace": lambda: gait_problem(GAITS["pace"]),
    "quadrupedal_gaits_fwddyn bound": lambda: gait_problem(GAITS["bound"]),
    "quadrupedal_gaits_fwddyn jump": lambda: gait_problem(GAITS["jump"]),
    "bipedal_gaits_fwddyn": lambda: gait_problem(GAITS["biped"]),
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


@dataclass(frozen=True, eq=False)
class Solved:
    """What mbocp came to: motion, cost, iterations, processor times [s], and how the solver ended."""

    motion: Motion
    cost: float
    iterations: int
    seconds: list[float]
    status: str


def solved(problem: mbocp.Problem, kind: str, repeats: int) -> Solved:
    """Solve from one of the guesses; functions are built before."""
    formulation = formulate(problem)
    guess = guessed(formulation, kind)
    settings = SolverSettings.of(problem.solver, formulation.programme, has_inequalities=problem.is_bounded)
    start = Start(formulation.programme, guess)
    outcome, seconds = timed(lambda: run_strategy(settings, start), repeats, time.process_time)
    result = outcome.result
    iterations = sum(not record.is_guess for record in result.history)
    motion = formulation.motion_of(result.iterate)
    return Solved(motion, float(result.history[-1].cost), iterations, seconds, str(result.status))


def nodes_of(problem: mbocp.Problem) -> list[int]:
    """Nodes that Crocoddyl has, too: before each step and each impact, and the last; it knows no partings."""
    impacts = {phase.first for phase in problem.timeline.phases if phase.leaps}
    nodes = [0]
    for n, dt in enumerate(problem.timeline.lengths()):
        if dt > 0.0 or n in impacts:
            nodes.append(n + 1)
        elif n + 1 not in impacts:
            nodes[-1] = n + 1
    return nodes


def compared(name: str, kind: str, repeats: int, python: Path) -> dict[str, Any]:
    """What both came to, from one guess."""
    problem = PROBLEMS[name]()
    own = solved(problem, kind, repeats)
    nodes, motion = nodes_of(problem), own.motion
    with tempfile.TemporaryDirectory() as folder:
        ours = Path(folder) / "ours.npz"
        np.savez(ours, qs=motion.qs[nodes], vs=motion.vs[nodes], us=motion.us[[n - 1 for n in nodes[1:]]])
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
    return {"own": own, **json.loads(done.stdout.splitlines()[-1])}


def table(names: Sequence[str], repeats: int) -> Table:
    """From Crocoddyl's default guess, if the example has no other, and from holding the start."""
    peer, rows, versions = environment_of_crocoddyl(), [], set()
    if not peer.has("crocoddyl"):
        raise SystemExit(f"Crocoddyl: {peer.reason}")
    for name in names:
        for kind in ("hold",) if "gaits" in name else ("zero", "hold"):
            found = compared(name, kind, repeats, peer.python)
            versions.add(found["version"])
            rows.append(_row(name, kind, found))
    return Table(f"Examples of Crocoddyl {', '.join(sorted(versions))}", _COLUMNS, rows, _NOTE)


_COLUMNS = (
    "example",
    "guess",
    "mbocp: cost",
    "judged",
    "iterations",
    "time [ms]",
    "gradient",
    "Crocoddyl: cost",
    "iterations",
    "time [ms]",
    "gradient",
    "difference",
    "from mbocp's",
    "defect",
)
_NOTE = (
    "Guess zero: Crocoddyl's default, the neutral configuration and no controls; hold: at the start, "
    "gravity compensated. Judged: the cost of mbocp's motion by Crocoddyl's functions. Gradient: the "
    "largest derivative of the cost in a control, by the largest of the effort, by Crocoddyl's functions; "
    "nothing where these have equations or other steps. Difference: Crocoddyl's cost less mbocp's, by the "
    "lower. From mbocp's: the cost at which Crocoddyl's solver ends that begins at mbocp's motion. "
    "Defect: of mbocp's steps from Crocoddyl's."
)
_SAME_STEPS = 1e-9


def _row(name: str, kind: str, found: Mapping[str, Any]) -> tuple[str, ...]:
    own, ours, theirs = found["own"], found["ours"], found["theirs"]
    has_gradient = np.isfinite(theirs["gradient"])
    return (
        name,
        kind,
        f"{own.cost:.7g}" + ("" if own.status == "converged" else f" ({own.status})"),
        f"{ours['cost']:.7g}",
        str(own.iterations),
        f"{1e3 * median(own.seconds):.3g}",
        f"{ours['gradient']:.0e}" if has_gradient and ours["defect"] < _SAME_STEPS else "–",
        f"{theirs['cost']:.7g}",
        str(found["iterations"]),
        f"{1e3 * median(found['seconds']):.3g}",
        f"{theirs['gradient']:.0e}" if has_gradient else "–",
        f"{(theirs['cost'] - own.cost) / min(theirs['cost'], own.cost):+.0e}",
        f"{found['from ours']['cost']:.7g}",
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
    os.environ["MBOCP_FUNCTIONS"] = "tapes"  # compiling takes minutes here, and gives a fifth
    show(header(), markdown=options.markdown)
    show(table(options.examples, options.repeats), markdown=options.markdown)


if __name__ == "__main__":
    main()
