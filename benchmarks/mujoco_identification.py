"""Identification of the same logs by MuJoCo: `python -m benchmarks.mujoco_identification`.

Its toolbox (`pip install 'mujoco[sysid]'`) fits pseudo-inertias of all bodies, damping and dry friction, so
that simulations under the measured torques follow the measured positions: 15 iterations of Gauss and Newton's
method, derivatives by differences of whole simulations. As an arm drifts away from its log, the log is cut
into pieces, each simulated from its smoothed state. Dry friction is F sign(v) there, in logs
F tanh(v / 0.01). The measures are the torque that is wrong along another motion without noise, and errors of
base parameters by the standard deviations that mbocp states.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from io import StringIO
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from benchmarks.figaroh_log import clean_motion
from benchmarks.machine import header, one_core
from benchmarks.tables import Table, show
from mbocp import identify, load_robot
from mbocp._arrays import Array
from mbocp.identification import Log, simulate_log
from mbocp.identification.dynamics import InverseDynamics
from mbocp.identification.likelihood import knots_for, smooth
from mbocp.identification.of_log import measure_log
from mbocp.robot import Robot
from tests.identification.logs import changed

if TYPE_CHECKING:
    import mujoco
    from mujoco import sysid

RATE = 100.0  # [1/s]
STEP = 0.01  # [s] of Runge and Kutta's method
PIECES = (20, 50)  # samples
ROTOR = 0.05  # [kg m^2] of each joint, known: such steps are too long for damped wrists without
COLUMNS = (
    *("friction", "by", "pieces [s]", "torque wrong [N m]", "error by deviation, median", "largest"),
    "CPU time [s]",
)


def spec_of(robot: Robot) -> mujoco.MjSpec:
    """An arm of hinges, with the bodies and axes of its Pinocchio model."""
    import mujoco

    model, data, spec = robot.model, robot.model.createData(), mujoco.MjSpec()
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    pin.computeJointJacobians(model, data, robot.q0)
    bodies = [spec.worldbody]
    for joint in range(1, model.njoints):
        place, inertia = model.jointPlacements[joint], model.inertias[joint]
        body = bodies[model.parents[joint]].add_body(name=model.names[joint], pos=place.translation)
        body.quat = np.roll(pin.SE3ToXYZQUAT(place)[3:], 1)
        body.explicitinertial = True
        put_inertia(body, inertia.mass, inertia.lever, inertia.inertia)
        axis = pin.getJointJacobian(model, data, joint, pin.LOCAL)[3:, model.idx_vs[joint]]
        hinge = body.add_joint(name=model.names[joint], type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
        hinge.armature = model.armature[model.idx_vs[joint]]
        motor = spec.add_actuator(name=hinge.name, target=hinge.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        bodies.append(body)
    return spec


def put_inertia(body: Any, mass: float, centre: Array, about: Array) -> None:
    """Give a body its mass, centre of mass, and moments of inertia about that."""
    body.mass, body.ipos, body.iquat, body.inertia = mass, centre, (1.0, 0.0, 0.0, 0.0), np.zeros(3)
    body.fullinertia = about[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]


def put_theta(spec: Any, p: Any, name: str) -> None:
    """As `sysid.apply_body_inertia` does, which MuJoCo 4.0.0 refuses for bodies without geometry."""
    from mujoco import sysid

    mass, *numbers = sysid.model_modifier.pi_from_theta(p.value)
    centre, about = np.array(numbers[:3]) / mass, np.array(numbers[3:]).reshape(3, 3)
    put_inertia(spec.body(name), mass, centre, about + mass * pin.skewSquare(centre, centre))


def put_damping(spec: Any, p: Any, name: str) -> None:
    spec.joint(name).damping = [p.value[0], 0.0, 0.0]


def put_friction(spec: Any, p: Any, name: str) -> None:
    spec.joint(name).frictionloss = p.value[0]


def unknowns_of(spec: mujoco.MjSpec, friction: str) -> sysid.ParameterDict:
    """Ten numbers of each body, and losses of each joint."""
    from mujoco import sysid

    model, found = spec.compile(), sysid.ParameterDict()
    for joint in (model.joint(k).name for k in range(model.njnt)):
        put = partial(put_theta, name=joint)
        kind, wide = sysid.InertiaType.Pseudo, np.array([0.05, 20.0])  # robots drawn leave its own bounds
        found.add(sysid.body_inertia_param(spec, model, joint, kind, stretch_bound_mult=wide, modifier=put))
        found.add(
            sysid.Parameter(f"{joint}.damping", 0.5, 0.0, 20.0, modifier=partial(put_damping, name=joint))
        )
        if friction == "both":
            put = partial(put_friction, name=joint)
            found.add(sysid.Parameter(f"{joint}.friction", 0.5, 0.0, 20.0, modifier=put))
    return found


def by_mujoco(robot: Robot, log: Log, friction: str, samples: int) -> Array:
    """All parameters, as `InverseDynamics` has them, by pieces of so many samples."""
    from mujoco import sysid

    spec, dynamics = spec_of(robot), InverseDynamics(robot)
    model, data = spec.compile(), measure_log(log, dynamics, {}, [])
    y, yd, _, _ = smooth(data, knots_for(data))
    torques, pieces, times = sysid.TimeSeries(data.t, data.u), [], np.arange(samples + 1) / RATE
    steps = np.arange(round(times[-1] / STEP) + 1) * STEP
    for k in range(0, len(data.t) - samples, samples):
        # A step holds its torque: that in its middle.
        control = sysid.TimeSeries(steps, torques.interpolate(data.t[k] + steps + STEP / 2))
        q = sysid.TimeSeries(times, data.motion[0][k : k + samples + 1])
        state = sysid.create_initial_state(model, y[k], yd[k])
        pieces.append(sysid.SystemTrajectory(model, control, q, state, None))

    def off(params: Any, predicted: Any, q: Any, model: Any, _: bool, state: Array) -> tuple[Any, Any, Any]:
        there = sysid.TimeSeries(state[:, 0], state[:, 1 : 1 + model.nq]).resample(q.times[1:])
        return there.data - q.data[1:], there, there

    def residual(x: Array, params: Any) -> tuple[list[Array], None, None]:
        build = lambda p: sysid.apply_param_modifiers(p, spec)  # noqa: E731
        found = sysid.model_residual(x, params, build, pieces, off, n_threads=1)[0]
        return [found if x.ndim == 1 else found.T.reshape(x.shape[1], -1).T], None, None

    params = unknowns_of(spec, friction)
    with redirect_stdout(StringIO()):  # it prints each iteration
        params, _ = sysid.optimize(params, residual, verbose=False, max_iters=15)
    found = sysid.apply_param_modifiers(params, spec)
    values = []
    for body in range(1, found.nbody):
        turn = pin.Quaternion(*np.roll(found.body_iquat[body], -1)).matrix()
        about = turn @ np.diag(found.body_inertia[body]) @ turn.T
        values.append(pin.Inertia(found.body_mass[body], found.body_ipos[body], about).toDynamicParameters())
    return np.concatenate([*values, found.dof_armature, found.dof_damping, found.dof_frictionloss])


def with_rotors(robot: Robot) -> Robot:
    model = pin.Model(robot.model)
    model.armature = np.full(robot.nv, ROTOR)
    return replace(robot, model=model)


def run(robot: Robot, seed: int, friction: str) -> list[tuple[float, ...]]:
    """Numbers of the last four columns, by mbocp and by MuJoCo with each length of pieces."""
    truth = changed(robot, seed, speed=0.01)
    if friction == "viscous":
        truth = replace(truth, resistances=tuple(replace(loss, friction=0.0) for loss in truth.resistances))
    log = simulate_log(truth, duration=12.0, rate=RATE, seed=seed)
    true = InverseDynamics(truth)
    other = clean_motion(true, seed + 1000)
    rows = true.regressor(other)
    begun = time.process_time()
    found = identify(robot, log, friction=friction)
    everything = found.unknowns.known + found.unknowns.shares @ found.values
    ways = [(everything, time.process_time() - begun)]
    for samples in PIECES:
        begun = time.process_time()
        ways.append((by_mujoco(robot, log, friction, samples), time.process_time() - begun))
    numbers = []
    for values, seconds in ways:
        wrong = float(np.sqrt(np.mean((rows @ (values - true.values)) ** 2)))
        shares = np.linalg.lstsq(found.unknowns.shares, values - true.values, rcond=None)[0]
        off = np.abs(found.base.combinations @ shares) / found.base_sd
        numbers.append((wrong, float(np.median(off)), float(off.max()), seconds))
    return numbers


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=2)
    asked = parser.parse_args(arguments)
    one_core()
    show(header())
    robot, rows = with_rotors(load_robot("ur5")), []
    for friction in ("viscous", "both"):
        found = np.median([run(robot, seed, friction) for seed in range(asked.runs)], axis=0)
        by = [("mbocp", ""), *(("MuJoCo", f"{samples / RATE:g}") for samples in PIECES)]
        rows += [
            (friction, *who, *(f"{number:.3g}" for number in numbers))
            for who, numbers in zip(by, found, strict=True)
        ]
    title = f"UR5, 12 s, medians of {asked.runs} logs, MuJoCo {version('mujoco')}"
    show(Table(title, COLUMNS, rows))


if __name__ == "__main__":
    main()
