"""Written motions under a controller at 1 kHz, in MuJoCo: `python -m tests.sent.simulated`.

Torques are those of the file, those of a PD controller about its positions and velocities, or both.
"""

from __future__ import annotations

import argparse
import csv
import re
import sys
import tempfile
import warnings
from pathlib import Path

import mujoco
import numpy as np

import mbocp
from tests.sent.cases import problem_of

RATE, PARTS = 1000.0, 10  # samples a second; steps of the simulator to a sample
STIFFNESS, RATIO = 20.0, 1.0  # of the PD controller: its frequency for each joint [rad/s], and its damping


def simulate(urdf: Path, file: Path, *, has_torques: bool) -> float:
    """The largest distance of a joint from the written motion [rad]."""
    with file.open() as lines:
        header, *rows = csv.reader(lines)
    table = np.array(rows, dtype=float)
    names, q, v, u = _columns(header, table)
    model = mujoco.MjModel.from_xml_string(_without_shapes(urdf.read_text()))
    data = mujoco.MjData(model)
    model.opt.timestep = 1.0 / (RATE * PARTS)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    where = [model.joint(name).qposadr[0] for name in names]
    dofs = [model.joint(name).dofadr[0] for name in names]
    model.dof_damping[:], model.dof_frictionloss[:] = 0.0, 0.0
    data.qpos[where], data.qvel[dofs] = q[0], v[0]
    mujoco.mj_forward(model, data)
    inertia, worst = np.zeros((model.nv, model.nv)), 0.0
    for n in range(len(q) - 1):
        mujoco.mj_fullM(model, data, inertia)
        size = np.diag(inertia)[dofs]
        torque = size * (
            STIFFNESS**2 * (q[n] - data.qpos[where]) + 2 * RATIO * STIFFNESS * (v[n] - data.qvel[dofs])
        )
        data.qfrc_applied[dofs] = torque + (u[n] if has_torques else 0.0)
        mujoco.mj_step(model, data, PARTS)
        worst = max(worst, float(np.abs(data.qpos[where] - q[n + 1]).max()))
    return worst


def _columns(header: list[str], table: np.ndarray) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray]:
    found = {kind: [k for k, name in enumerate(header) if name.startswith(f"{kind}:")] for kind in "qvu"}
    names = [header[k][2:].partition(" [")[0] for k in found["q"]]
    return names, table[:, found["q"]], table[:, found["v"]], table[:, found["u"]]


def _without_shapes(text: str) -> str:
    """The URDF without what is drawn and touched, whose files are elsewhere."""
    for tag in ("visual", "collision", "transmission", "gazebo"):
        text = re.sub(rf"<{tag}\b.*?</{tag}>", "", text, flags=re.DOTALL)
    return text


def main() -> int:
    """Print the errors of some motions."""
    parser = argparse.ArgumentParser(prog="python -m tests.sent.simulated", description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    options = parser.parse_args()
    errors = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.count):
            problem = problem_of("ur5e", seed, with_torques=True)
            solution = mbocp.solve(problem)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                file = solution.export(Path(folder) / "motion.csv", rate=RATE, check=False)
            assert problem.robot.source is not None
            both = [simulate(problem.robot.source, file, has_torques=has) for has in (True, False)]
            errors.append(both)
            print(
                f"{seed}: {solution.status}, {1e3 * both[0]:.3f} mrad with torques, {1e3 * both[1]:.3f} not",
                flush=True,
            )
    print(f"median {1e3 * np.median(errors, axis=0)} mrad, most {1e3 * np.max(errors, axis=0)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
