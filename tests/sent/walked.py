"""A trot under the feedback gains of its optimum, in MuJoCo: `python -m tests.sent.walked`.

solo12 repeats the middle of three cycles. Its torques are those of the optimum and what the gains answer to
the state at 1 kHz, beside a PD controller of the joints, within its limits. MuJoCo knows the ground as a
plane with friction, and feet as spheres; it is told nothing of the phases.
"""

from __future__ import annotations

import argparse
import re
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

import mbocp
from mbocp import Problem, Robot, Solution
from mbocp._arrays import Array

FEET = ("FL", "FR", "HL", "HR")
SWING, STEPS, CYCLES, LIMIT, FRICTION = 0.2, 24, 3, 2.7, 0.7  # [s], 1, 1, [N m], 1
CONTROL, PARTS = 1e-3, 5  # [s], and steps of the simulator to it
STIFFNESS, DAMPING = 5.0, 0.3  # of the PD controller [N m/rad, N m s/rad]
RADIUS = 0.0191028  # of the feet: their frames are as high when solo12 stands [m]


def trot(speed: float) -> Problem:
    """Three cycles, which end as they begin, on bent legs: straight ones are singular."""
    still = ["root_joint.vx", "root_joint.vy", "root_joint.vz", "root_joint.wz"]
    return Problem.create(
        "solo12",
        gait={"swings": "trot", "cycles": CYCLES, "duration": SWING, "steps": STEPS},
        ground={
            "feet": {foot: f"{foot}_FOOT" for foot in FEET},
            "friction": FRICTION,
            "lift": 0.03,
            "meeting": "soft",
        },
        start={
            "q": {"root_joint": [0, 0, 0.235, 0, 0, 0, 1]},
            "free": {"v": True, "q": {"except": still}},
        },
        goal={"periodic": {"moved": {"root_joint": {"x": 2 * CYCLES * SWING * speed}}}},
        cost={"effort": 1.0, "velocity": 0.1},
        limits={"effort": LIMIT, "position": True},
        scheme="se1",
    )


@dataclass(frozen=True, eq=False)
class Simulator:
    """solo12 on a plane."""

    robot: Robot
    model: Any
    data: Any
    at_q: Array
    at_v: Array

    @classmethod
    def of(cls, robot: Robot) -> Simulator:
        assert robot.source is not None
        text = robot.source.read_text()
        for tag in ("visual", "collision", "transmission", "gazebo"):
            text = re.sub(rf"<{tag}\b.*?</{tag}>", "", text, flags=re.DOTALL)
        spec = mujoco.MjSpec.from_string(text)
        spec.worldbody.first_body().add_freejoint()
        bodies = {joint.name: body for body in spec.bodies for joint in body.joints}
        for foot in FEET:
            frame = robot.model.frames[robot.frame_id(f"{foot}_FOOT")]
            sole = bodies[robot.model.names[frame.parentJoint]].add_geom()
            sole.type, sole.size, sole.mass = mujoco.mjtGeom.mjGEOM_SPHERE, [RADIUS, 0, 0], 0.0
            sole.pos, sole.contype, sole.conaffinity = frame.placement.translation, 1, 2
            sole.friction[0] = FRICTION
        plane = spec.worldbody.add_geom()
        plane.type, plane.size = mujoco.mjtGeom.mjGEOM_PLANE, [0, 0, 1]
        plane.contype, plane.conaffinity, plane.friction[0] = 2, 1, FRICTION
        model = spec.compile()
        model.opt.timestep, model.opt.impratio = CONTROL / PARTS, 10.0
        model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        names = robot.joint_names[1:]
        at_v = np.array([model.joint(name).dofadr[0] for name in names])
        model.dof_damping[:], model.dof_frictionloss[:] = 0.0, 0.0
        model.dof_armature[at_v] = robot.model.armature[6:]
        at_q = np.array([model.joint(name).qposadr[0] for name in names])
        return cls(robot, model, mujoco.MjData(model), at_q, at_v)

    def put(self, q: Array, v: Array) -> None:
        """Begin from a state of Pinocchio's."""
        rotation = pin.Quaternion(q[3:7]).matrix()
        self.data.qpos[:3], self.data.qpos[3:7], self.data.qpos[self.at_q] = q[:3], q[[6, 3, 4, 5]], q[7:]
        self.data.qvel[:3], self.data.qvel[3:6], self.data.qvel[self.at_v] = rotation @ v[:3], v[3:6], v[6:]

    @property
    def state(self) -> tuple[Array, Array]:
        """As Pinocchio has it."""
        qpos, qvel = self.data.qpos, self.data.qvel
        q = np.concatenate([qpos[:3], qpos[[4, 5, 6, 3]], qpos[self.at_q]])
        rotation = pin.Quaternion(q[3:7]).matrix()
        return q, np.concatenate([rotation.T @ qvel[:3], qvel[3:6], qvel[self.at_v]])

    def step(self, torques: Array) -> None:
        """Go on for a millisecond."""
        self.data.qfrc_applied[self.at_v] = np.clip(torques, -LIMIT, LIMIT)
        mujoco.mj_step(self.model, self.data, PARTS)


def follow(
    solution: Solution, speed: float, cycles: int, *, has_gains: bool
) -> Iterator[tuple[Array, Array]]:
    """Where the base is after each cycle, and where it should be, until it falls."""
    simulator = Simulator.of(solution.load_robot())
    robot, period = simulator.robot, 2 * SWING
    t, first = np.asarray(solution.t), (CYCLES // 2) * period
    steps = np.flatnonzero((np.diff(t) > 1e-9) & (t[:-1] > first - 1e-9) & (t[:-1] < first + period - 1e-9))
    begin = solution.qs[steps[0]].copy()
    simulator.put(begin, solution.vs[steps[0]])
    for cycle in range(cycles):
        further = np.zeros(robot.nq)
        further[0] = cycle * period * speed
        for n in steps:
            q, v = solution.qs[n] + further, solution.vs
            way, count = (
                robot.difference(solution.qs[n], solution.qs[n + 1]),
                round((t[n + 1] - t[n]) / CONTROL),
            )
            for k in range(count):
                share, (q_is, v_is) = k / count, simulator.state
                away = robot.difference(robot.integrate(q, share * way), q_is)
                faster = v_is - ((1.0 - share) * v[n] + share * v[n + 1])
                u = solution.us[n] - STIFFNESS * away[6:] - DAMPING * faster[6:]
                simulator.step(u + solution.gains[n] @ np.concatenate([away, faster]) if has_gains else u)
        q_is, _ = simulator.state
        yield q_is[:7], solution.qs[steps[-1] + 1][:7] + further[:7]
        if pin.Quaternion(q_is[3:7]).matrix()[2, 2] < 0.7 or q_is[2] < RADIUS + 0.1:
            return


def main() -> int:
    """Print how long it trots, with the gains and without."""
    parser = argparse.ArgumentParser(prog="python -m tests.sent.walked", description=__doc__)
    parser.add_argument("--cycles", type=int, default=20)
    parser.add_argument("--speed", type=float, default=0.3, help="[m/s]")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    solution = mbocp.solve(trot(options.speed), gains=True)
    print(f"{solution.status} after {solution.iterations} iterations")
    lasts = []
    for has_gains in (True, False):
        places = list(follow(solution, options.speed, options.cycles, has_gains=has_gains))
        away = np.array([is_at[:2] - wanted[:2] for is_at, wanted in places])
        lasts.append(len(places))
        print(
            f"{'with' if has_gains else 'without'} gains: {len(places)} of {options.cycles} cycles, "
            f"the base off by {np.abs(away).max(axis=0)} m at most"
        )
    return 0 if lasts[0] == options.cycles else 1


if __name__ == "__main__":
    sys.exit(main())
