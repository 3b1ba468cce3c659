"""Whether two values of a problem are the same."""

import dataclasses

import numpy as np

from mbocp.robot import Robot


def same(a: object, b: object) -> None:
    """Assert that two values agree, to the round-off that normalising cos/sin pairs again leaves."""
    if isinstance(a, Robot):
        assert isinstance(b, Robot)
        assert a.fingerprint == b.fingerprint
    elif dataclasses.is_dataclass(a) and not isinstance(a, type):
        assert type(a) is type(b)
        for field in dataclasses.fields(a):
            if field.name not in ("source", "name", "document", "draft"):  # what was said, and how
                same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, tuple) and isinstance(b, tuple):
        assert len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            same(one, other)
    elif isinstance(a, tuple):
        assert isinstance(b, tuple)
        for one, other in zip(a, b, strict=True):
            same(one, other)
    elif isinstance(a, dict):
        assert isinstance(b, dict)
        assert a.keys() == b.keys()
        for key, value in a.items():
            same(value, b[key])
    elif isinstance(a, np.ndarray):
        np.testing.assert_allclose(np.asarray(a, float), np.asarray(b, float), atol=1e-15)
    else:
        assert a == b or (a != a and b != b)  # NaN: not worked out
