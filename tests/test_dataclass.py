"""Frozen dataclasses do what those of the standard library do."""

import copy
import dataclasses
import pickle
from dataclasses import FrozenInstanceError, field, replace

import pytest

from mbocp import _arrays


def classes(decorator):
    """A class of each kind that the package has, by one decorator."""

    @decorator(frozen=True)
    class Point:
        x: float
        y: float = 2.0
        tags: tuple = field(default=(), compare=False)
        note: dict = field(default_factory=dict, hash=False, repr=False)
        sum: float = field(init=False)

        def __post_init__(self):
            object.__setattr__(self, "sum", self.x + self.y)

    @decorator(frozen=True, kw_only=True)
    class Named(Point):
        name: str

        def __repr__(self):
            return f"<{self.name}>"

    @decorator(frozen=True, eq=False)
    class Same:
        x: object

    @decorator(frozen=True)
    class Own:
        x: int

        def __eq__(self, other):
            return True

    @decorator(frozen=True, eq=False, repr=False)
    class Plain:
        x: int

    return Point, Named, Same, Own, Plain


OURS, THEIRS = classes(_arrays.dataclass), classes(dataclasses.dataclass)
EXAMPLES = [(0, (1.0,)), (0, (1.0, 3.0)), (0, (1.0, 3.0, ("a",))), (2, (4,)), (3, (5,))]


@pytest.mark.parametrize(("kind", "values"), EXAMPLES)
def test_it_shows_compares_and_hashes_as_the_standard_library_does(kind, values):
    ours, theirs = OURS[kind], THEIRS[kind]
    a, b = ours(*values), theirs(*values)
    assert repr(a) == repr(b)
    assert dataclasses.asdict(a) == dataclasses.asdict(b)
    assert (a == ours(*values)) == (b == theirs(*values))
    assert (hash(a) == hash(ours(*values))) == (hash(b) == hash(theirs(*values)))


def test_fields_left_out_of_a_comparison_do_not_count():
    point = OURS[0]
    assert point(1.0, tags=("a",)) == point(1.0, tags=("b",))
    assert hash(point(1.0, note={"a": 1})) == hash(point(1.0, note={"b": 1}))
    assert point(1.0, note={"a": 1}) != point(1.0, note={"b": 1})


def test_a_class_keeps_what_it_defines_itself():
    named = OURS[1](x=1.0, name="n")
    assert repr(named) == "<n>"
    assert OURS[3](1) == OURS[3](2)
    assert "object at" in repr(OURS[4](1))


@pytest.mark.parametrize("name", ["x", "sum", "other"])
def test_a_value_does_not_change(name):
    for point in (OURS[0](1.0), THEIRS[0](1.0), OURS[1](x=1.0, name="n")):
        with pytest.raises(FrozenInstanceError, match=f"assign to field '{name}'"):
            setattr(point, name, 3.0)
        with pytest.raises(FrozenInstanceError, match=f"delete field '{name}'"):
            delattr(point, name)
        assert (point.x, point.sum) == (1.0, 3.0)


def test_a_value_is_replaced_copied_and_held_by_itself():
    point = OURS[0](1.0, note={})
    assert replace(point, x=2.0).sum == 4.0
    assert copy.copy(point) == point == copy.deepcopy(point)
    holder = OURS[2]([])
    holder.x.append(holder)
    assert repr(holder).endswith("Same(x=[...])")


@_arrays.dataclass(frozen=True)
class Stored:
    x: int


def test_a_value_is_pickled():
    assert pickle.loads(pickle.dumps(Stored(1))) == Stored(1)


def test_other_dataclasses_are_those_of_the_standard_library():
    @_arrays.dataclass
    class Counter:
        n: int = 0

    @_arrays.dataclass(frozen=True, slots=True)
    class Small:
        n: int

    counter = Counter()
    counter.n += 1
    assert counter == Counter(1)
    assert Small.__slots__ == ("n",)


def test_a_frozen_class_of_the_standard_library_inherits_from_ours():
    @dataclasses.dataclass(frozen=True)
    class More(Stored):
        y: int = 2

    more = More(1)
    assert repr(more).endswith("More(x=1, y=2)")
    for name in ("x", "y"):
        with pytest.raises(FrozenInstanceError):
            setattr(more, name, 3)
    with pytest.raises(TypeError, match="non-frozen"):
        dataclasses.dataclass(type("Loose", (Stored,), {}))
