"""solo12 trots in a control loop: a plant of rigid contacts, a speed that changes, and a push from the side.

    python solo12_trot.py [--seconds 2.4] [--iterations 2] [--replay solo12_trot.html]

The plant goes on in steps of 1 ms; feet stand in it when the gait says so, and hit the ground inelastically.
"""

import argparse
from collections import Counter
from pathlib import Path

import numpy as np
import pinocchio as pin

import mbocp
from mbocp.view.replay import write_replay

AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
SIMULATED = 1e-3  # [s], steps of the plant
PUSH = 0.15  # [m/s], of the base to the left, at half time
STIFFNESS, DAMPING = 3.0, 0.1  # [N m/rad, N m s/rad] of the joints about the prediction within a step


class Plant:
    """The robot with feet that stand for a while, which nothing moves."""

    def __init__(self, robot, q, v):
        self.model, self.q, self.v, self.feet = robot.model, q, v, []
        self.data = robot.model.createData()

    def push(self, speed):
        """Push the base to the left."""
        self.v = self.v + speed * np.eye(len(self.v))[1]

    def land(self, feet):
        """Let other feet stand: velocities leap to what the ground allows."""
        if feet == self.feet:
            return
        self.feet = feet
        pin.crba(self.model, self.data, self.q)
        pin.forwardKinematics(self.model, self.data, self.q, self.v, 0.0 * self.v)
        J, _ = self.rows()
        self.v = self.solve(self.data.M @ self.v, J, np.zeros(len(J)))[0]

    def rows(self):
        """Derivatives of the places of the feet, and how these fall away or slip, as accelerations."""
        pin.computeJointJacobians(self.model, self.data)
        pin.updateFramePlacements(self.model, self.data)
        at = [(self.model, self.data, self.model.getFrameId(foot), AXES) for foot in self.feet]
        J = np.vstack([pin.getFrameJacobian(*each)[:3] for each in at])
        drift = [pin.getFrameClassicalAcceleration(*each).linear for each in at]
        return J, np.concatenate(drift) + J @ self.v / (20 * SIMULATED)

    def solve(self, momentum, J, leap):
        """x with M x = momentum + J'f and J x = leap, and f."""
        MJ = np.linalg.solve(self.data.M, np.column_stack([momentum, J.T]))
        f = np.linalg.solve(J @ MJ[:, 1:], leap - J @ MJ[:, 0])
        return MJ[:, 0] + MJ[:, 1:] @ f, f

    def go_on(self, torque):
        """One step; forces on the feet that stand [N], in the axes of the world, shape (feet, 3)."""
        model, data, q, v = self.model, self.data, self.q, self.v
        free = np.concatenate([np.zeros(6), torque]) - pin.nonLinearEffects(model, data, q, v)
        pin.crba(model, data, q)
        pin.forwardKinematics(model, data, q, v, 0.0 * v)
        J, drift = self.rows()
        a, forces = self.solve(free, J, -drift)
        self.v = v + SIMULATED * a
        self.q = pin.integrate(model, q, SIMULATED * self.v)
        return forces.reshape(-1, 3)


def trot(horizon, seconds, speed_at, push=PUSH, plant=None):
    """Close the loop; states at the steps, forces of feet, and what became of the steps of the horizon."""
    problem = horizon.problem
    robot, dt = problem.robot, problem.dt
    plant = plant or Plant(robot, np.array(problem.q_start), np.array(problem.v_start))
    states, forces, told = [], [], []
    for k in range(round(seconds / dt)):
        if k == round(seconds / dt) // 2:
            plant.push(push)
        found = horizon.step(plant.q, plant.v, speed=speed_at(k * dt), dt=None if k else 0.0)
        told.append(found.status)
        stands = [f"{name}_FOOT" for name, force in horizon.contact_forces().items() if force[0].any()]
        plant.land(stands)
        u, q, v = (np.array(of) for of in (found.u, found.q[:2], found.v[:2]))
        for n in range(count := round(dt / SIMULATED)):
            share = n / count
            wanted = q[0, 7:] + share * (q[1, 7:] - q[0, 7:]), v[0, 6:] + share * (v[1, 6:] - v[0, 6:])
            torque = u + STIFFNESS * (wanted[0] - plant.q[7:]) + DAMPING * (wanted[1] - plant.v[6:])
            forces.append(plant.go_on(np.clip(torque, problem.limits.u_lower, problem.limits.u_upper)))
        states.append((plant.q, plant.v))
    return states, np.vstack(forces), told


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=2.4)
    parser.add_argument("--iterations", type=int, default=2)
    parser.add_argument("--replay", default="solo12_trot.html")
    asked = parser.parse_args()

    horizon = mbocp.RecedingHorizon(Path(__file__).with_suffix(".toml"), iterations=asked.iterations)
    states, forces, told = trot(horizon, asked.seconds, lambda t: [min(t, 0.4), 0.0, 0.0])
    qs, last = np.array([q for q, _ in states]), states[-24:]
    speed = (last[-1][0][0] - last[0][0][0]) / (len(last) - 1) / horizon.problem.dt
    slip = np.linalg.norm(forces[:, :2], axis=1) / np.maximum(forces[:, 2], 1e-9)
    print("steps:", ", ".join(f"{n} {state}" for state, n in Counter(s.state for s in told).items()))
    print(f"in the kernel: {1e3 * np.median([s.seconds for s in told]):.1f} ms, median")
    print(f"at the end: {speed:.2f} m/s; heights of the base: {qs[:, 2].min():.3f} to {qs[:, 2].max():.3f} m")
    print(f"|f_t| / f_n above 0.7 in {100 * np.mean(slip > 0.7):.1f} % of the steps of the plant")
    times = horizon.problem.dt * np.arange(len(qs))
    print("replay:", write_replay(horizon.problem.robot, times, qs, asked.replay, title="solo12 trots"))
