"""A problem as data and a Pinocchio model, for every solver: from the tables of its file, without mbocp."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

__all__ = ["Array", "Task", "load_task"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Task:
    """min sum_k h/2 (|u_k|^2 + w |v_k|^2), from rest at q_0 to rest at q_T.

    Attributes
    ----------
    name : str
    model : pin.Model
    torque_map : ndarray, shape (nv, nu)
        B: generalised forces of controls.
    q0, goal : ndarray, shape (nq,)
        [m, rad, quaternion xyzw].
    duration : float
        [s].
    num_steps : int
    weight : float
        w, of velocities.
    limits : ndarray, shape (nu,)
        Of the controls, to both sides [N, N m]; infinite where there are none.
    """

    name: str
    model: Any
    torque_map: Array
    q0: Array
    goal: Array
    duration: float
    num_steps: int
    weight: float
    limits: Array

    @property
    def dt(self) -> float:
        """Length of a step [s]."""
        return self.duration / self.num_steps

    @property
    def is_limited(self) -> bool:
        """Whether controls have limits."""
        return bool(np.isfinite(self.limits).any())

    @property
    def is_arm(self) -> bool:
        """Whether configurations are plain vectors, and every joint has a motor."""
        return bool(self.model.nq == self.model.nv == self.torque_map.shape[1])

    def holding(self) -> Array:
        """Controls that hold the start, shape (nu,)."""
        gravity = pin.computeGeneralizedGravity(self.model, self.model.createData(), self.q0)
        held: Array = np.linalg.lstsq(self.torque_map, gravity, rcond=None)[0]
        return held


def load_task(path: Path) -> Task:
    """Task of a problem file's tables, written as JSON by `__main__`."""
    tables = json.loads(path.read_text())
    whole, rotors = _whole(tables["robot"])
    lock = tables["robot"].get("lock", {})
    q = pin.neutral(whole)
    for joint, place in lock.items():
        q[whole.joints[whole.getJointId(joint)].idx_q] = place
    model = pin.buildReducedModel(whole, [whole.getJointId(joint) for joint in lock], q) if lock else whole
    B = rotors if rotors is not None else np.eye(model.nv)
    limits = tables.get("limits", {}).get("effort", np.full(B.shape[1], np.inf))
    return Task(
        name=path.stem,
        model=model,
        torque_map=B,
        q0=np.array(tables.get("start", {}).get("q", pin.neutral(model)), dtype=float),
        goal=np.array(tables["goal"]["q"], dtype=float),
        duration=float(tables["horizon"]["duration"]),
        num_steps=int(tables["horizon"]["steps"]),
        weight=float(tables["cost"].get("velocity", 0.0)),
        limits=np.array(limits, dtype=float),
    )


def _whole(robot: Mapping[str, Any]) -> tuple[Any, Array | None]:
    """Model of example-robot-data, and what thrusts do where there are rotors."""
    import example_robot_data

    if "rotors" not in robot:
        return example_robot_data.load(robot["name"]).model, None
    columns = []
    for rotor in robot["rotors"]:
        force = np.array([0.0, 0.0, 1.0])
        torque = np.cross(rotor["position"], force) + rotor["torque_ratio"] * force
        columns.append(np.concatenate([force, torque]))
    return example_robot_data.load(robot["rotors_of"]).model, np.array(columns).T
