"""The motion as a viewer needs it: evenly spaced poses, interpolated on the configuration manifold."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp._tolerances import STAYS
from mbocp.exceptions import DimensionMismatch, InvalidValue
from mbocp.robot.large import make_working_data

_MAX_COORDINATE = 1e9  # [m, rad] of a configuration that can be drawn; as for the corners of meshes
MAX_SAMPLES = 6000  # key frames of one replay: of a long motion there are fewer a second


@dataclass(frozen=True)
class PlacementSamples:
    """Placements of all joints at evenly spaced times.

    Attributes
    ----------
    times : ndarray, shape (F,)
        Time since the start of the motion [s].
    qs : ndarray, shape (F, nq)
        Configurations.
    rotations : ndarray, shape (F, njoints, 3, 3)
        Orientation of each joint in the world.
    quaternions : ndarray, shape (F, njoints, 4)
        The same as unit quaternions xyzw.
    positions : ndarray, shape (F, njoints, 3)
        Position of each joint in the world [m].
    """

    model: pin.Model
    times: Array
    qs: Array
    rotations: Array
    quaternions: Array
    positions: Array

    @property
    def duration(self) -> float:
        """Length of the motion [s]."""
        return float(self.times[-1])

    def moves(self, joint: int) -> bool:
        """Whether the joint's frame ever leaves its first placement."""
        return bool(
            np.ptp(self.positions[:, joint], axis=0).any() or np.ptp(self.rotations[:, joint], axis=0).any()
        )

    def frame_positions(self, frame: int) -> Array:
        """Positions of a frame along the motion, shape (F, 3) [m]."""
        f = self.model.frames[frame]
        joint = f.parentJoint
        return np.asarray(self.positions[:, joint] + self.rotations[:, joint] @ f.placement.translation)


def sample_motion(
    model: pin.Model, t: ArrayLike, qs: ArrayLike, samples_per_second: float = 60.0
) -> PlacementSamples:
    """Resample a trajectory at evenly spaced times and run forward kinematics.

    Parameters
    ----------
    model : pin.Model
    t : array_like, shape (N + 1,)
        Times, increasing [s].
    qs : array_like, shape (N + 1, nq)
        Configurations [m, rad, unit quaternion xyzw].
    samples_per_second : float
        Key frames per second of motion [1/s]; the sum is bounded by `MAX_SAMPLES`.

    Raises
    ------
    DimensionMismatch
        If `t` and `qs` do not fit each other or the model.
    InvalidValue
        If a number is not finite, or time does not increase.
    """
    t, qs = _check(model, t, qs)
    duration = float(t[-1] - t[0])
    count = 1 if duration == 0.0 else min(int(np.ceil(duration * samples_per_second - 1e-9)) + 1, MAX_SAMPLES)
    times = np.linspace(0.0, duration, max(count, min(len(t), 2)))
    sampled = np.array([_configuration(model, t - t[0], qs, time) for time in times])
    return _place(model, times, sampled)


def pose_at(model: pin.Model, t: ArrayLike, qs: ArrayLike, time: float) -> Array:
    """Configuration at a time [s] from the first to the last, shape (nq,); see `sample_motion`."""
    return _configuration(model, *_check(model, t, qs), time)


def _check(model: pin.Model, t: ArrayLike, qs: ArrayLike) -> tuple[Array, Array]:
    times = frozen_array(t, shape=(None,), name="t")
    configurations = frozen_array(qs, shape=(None, model.nq), name="qs")
    if len(times) == 0 or len(times) != len(configurations):
        raise DimensionMismatch(
            "qs", configurations.shape, (len(times), model.nq), "one configuration for each time"
        )
    if not np.isfinite(configurations).all() or not np.isfinite(times).all():
        wrong = np.flatnonzero(~(np.isfinite(configurations).all(axis=1) & np.isfinite(times)))
        raise InvalidValue("qs", f"NaN or infinity at step {wrong[0]}", "finite numbers")
    if np.abs(configurations).max(initial=0.0) > _MAX_COORDINATE:
        raise InvalidValue("qs", f"{np.abs(configurations).max():.1e}", f"numbers up to {_MAX_COORDINATE:g}")
    moves = np.abs(np.diff(configurations, axis=0)).max(axis=1, initial=0.0)
    stays = (np.diff(times) == 0.0) & (moves < STAYS) & (times[-1] > times[0])  # an impact
    bad = np.flatnonzero((np.diff(times) <= 0.0) & ~stays)
    if bad.size:
        step = int(bad[0])
        raise InvalidValue(
            "t", f"{times[step]} followed by {times[step + 1]} at step {step}", "increasing times"
        )
    return times, configurations


def _configuration(model: pin.Model, t: Array, qs: Array, time: float) -> Array:
    k = int(np.searchsorted(t, time, side="right")) - 1
    if k >= len(t) - 1:
        return np.asarray(qs[-1], dtype=np.float64)
    share = (time - t[k]) / (t[k + 1] - t[k])
    return np.asarray(pin.interpolate(model, qs[k], qs[k + 1], share), dtype=np.float64)


def _place(model: pin.Model, times: Array, qs: Array) -> PlacementSamples:
    data = make_working_data(model)
    frames, joints = len(times), model.njoints
    rotations = np.empty((frames, joints, 3, 3))
    quaternions = np.empty((frames, joints, 4))
    positions = np.empty((frames, joints, 3))
    for i, q in enumerate(qs):
        pin.forwardKinematics(model, data, pin.normalize(model, q))
        for j in range(joints):
            placement = data.oMi[j]
            rotations[i, j], positions[i, j] = placement.rotation, placement.translation
            quaternions[i, j] = pin.SE3ToXYZQUAT(placement)[3:]
    return PlacementSamples(model, times, qs, rotations, quaternions, positions)
