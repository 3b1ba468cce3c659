"""Find the masses and the friction of a UR5 that differs from its file: a link is heavier, and joints rub.

Its log is simulated here, with errors in positions and torques; `mbocp identify` takes one that was recorded.
"""

from __future__ import annotations

from dataclasses import replace

import pinocchio as pin

import mbocp
from mbocp.identification import Identification, simulate_log
from mbocp.robot import JointResistance, Robot

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
HEAVIER = 3  # the forearm


def true_robot(robot: Robot) -> Robot:
    """The robot as it is: its file does not know."""
    model = pin.Model(robot.model)
    body = model.inertias[HEAVIER]
    model.inertias[HEAVIER] = pin.Inertia(1.3 * body.mass, body.lever, 1.3 * body.inertia)
    losses = (JointResistance(f"{name}_joint", k, damping=0.4, friction=0.6) for k, name in enumerate(JOINTS))
    return replace(robot, model=model, resistances=tuple(losses))


def main() -> Identification:
    robot = mbocp.load_robot("ur5")
    log = simulate_log(true_robot(robot), duration=12.0, position_noise=1e-4, torque_noise=0.1, seed=1)
    found = mbocp.identify(robot, log)
    for name, value, sd in zip(found.base.names, found.base_values, found.base_sd, strict=True):
        print(f"{value:9.4f} +- {1.96 * sd:.4f}  {name}")
    for joint, left, before in zip(found.joints, found.held_out.rms, found.held_out.rms_before, strict=True):
        print(f"{joint}: {left:.3f} N m are left of its torque, {before:.3f} with the file's numbers")
    return found


if __name__ == "__main__":
    main()
