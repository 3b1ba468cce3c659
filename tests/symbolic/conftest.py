"""Models to test the bridge with: all robots of example-robot-data, and trees with every kind of joint."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout

import numpy as np
import pinocchio as pin
import pytest
from example_robot_data import robots_loader


@contextmanager
def _quiet() -> Iterator[None]:
    """Swallow what loaders print: Python's print and the C++ parsers' stderr."""
    saved, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(null)


@pytest.fixture
def load_example(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], pin.Model]:
    """Load a robot of example-robot-data without its meshes, which take most of the time."""
    monkeypatch.setattr(pin.shortcuts.pin, "buildGeomFromUrdf", lambda *args, **kwargs: pin.GeometryModel())

    def load(name: str) -> pin.Model:
        # Upstream's table sends "ur3" to the UR5.
        loader = robots_loader.UR3Loader if name == "ur3" else robots_loader.ROBOTS[name]
        with _quiet():
            return loader().robot.model

    return load


@pytest.fixture
def random_state() -> Callable[[pin.Model, int], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return (q, v, a) on the model's manifold."""

    def state(model: pin.Model, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rng = np.random.default_rng(seed)
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-2.0, 2.0, model.nv))
        v, a = rng.standard_normal((2, model.nv))
        return q, v, a

    return state
