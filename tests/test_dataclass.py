"""Our dataclasses against those of the standard library: the same classes, made by both, behave alike."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mbocp._dataclass as ours

OPTIONS = [
    {"frozen": frozen, "eq": eq, "repr": shown, "kw_only": by_keyword}
    for frozen in (False, True)
    for eq in (False, True)
    for shown in (False, True)
    for by_keyword in (False, True)
]
MAKERS = [dataclasses.dataclass, ours.dataclass]


def pair(define: Callable[[Any], type], **options: bool) -> tuple[type, type]:
    """One class by the standard decorator, and one by ours."""
    standard, own = (define(maker(**options)) for maker in MAKERS)
    return standard, own


def plain(decorate: Any) -> type:
    @decorate
    class Plain:
        a: int
        b: str = "b"
        c: list[int] = dataclasses.field(default_factory=list, compare=False)
        d: float = dataclasses.field(default=1.5, repr=False)
        kind: ClassVar[str] = "plain"

    return Plain


def checked(decorate: Any) -> type:
    @decorate
    class Checked:
        a: int
        root: int = dataclasses.field(init=False)
        made: list[int] = dataclasses.field(init=False, default_factory=lambda: [1])

        def __post_init__(self) -> None:
            object.__setattr__(self, "root", self.a + 1)

    return Checked


def own_methods(decorate: Any) -> type:
    @decorate
    class Own:
        a: int

        def __eq__(self, other: object) -> bool:
            return isinstance(other, type(self)) and abs(other.a) == abs(self.a)

        def __hash__(self) -> int:
            return 7

        def __repr__(self) -> str:
            return "own"

    return Own


def child(decorate: Any) -> type:
    @decorate
    class Parent:
        a: int

        def __post_init__(self) -> None:
            object.__setattr__(self, "seen", True)

    @decorate
    class Child(Parent):
        b: int = 3

    return Child


def empty(decorate: Any) -> type:
    @decorate
    class Empty:
        pass

    return Empty


def mixed(decorate: Any) -> type:
    @decorate
    class Mixed:
        a: int = 1
        _: dataclasses.KW_ONLY
        b: int
        c: int = 2

    return Mixed


def outcome(work: Callable[[], Any]) -> Any:
    """What it gives, or which error."""
    try:
        return work()
    except Exception as error:
        return type(error).__name__, str(error).replace(".<locals>", "")


@pytest.mark.parametrize("define", [plain, checked, own_methods, child, empty, mixed])
@pytest.mark.parametrize("options", OPTIONS, ids=str)
@settings(max_examples=15)
@given(words=st.dictionaries(st.sampled_from("abcd"), st.integers(-2, 2)), others=st.integers(-2, 2))
def test_both_behave_alike(
    define: Callable[[Any], type], options: dict[str, bool], words: dict[str, int], others: int
) -> None:
    standard, own = pair(define, **options)
    assert [f.name for f in dataclasses.fields(standard)] == [f.name for f in dataclasses.fields(own)]
    told = [outcome(partial(made, **words)) for made in (standard, own)]
    if isinstance(told[0], tuple):
        assert told[0] == told[1]
        return
    a, b = told
    assert vars(a) == vars(b)
    if options["repr"] or define is own_methods:
        assert repr(a) == repr(b)
    for change in ({"a": others}, {"b": others}, {"nothing": others}, {"root": others}):
        new_a, new_b = (outcome(partial(dataclasses.replace, x, **change)) for x in (a, b))
        if isinstance(new_a, tuple):
            assert new_a == new_b
        else:
            assert vars(new_a) == vars(new_b)
            assert (new_a == a) == (new_b == b)
    assert (copy.copy(a) == a) == (copy.copy(b) == b)
    assert (a == object()) == (b == object())
    if options["eq"] or define is own_methods:
        assert outcome(lambda: hash(a)) == outcome(lambda: hash(b))
    for name in ("a", "root", "stranger"):
        assert outcome(partial(setattr, a, name, 9)) == outcome(partial(setattr, b, name, 9))
        assert outcome(partial(delattr, a, name)) == outcome(partial(delattr, b, name))
    assert vars(a) == vars(b)


@pytest.mark.parametrize("define", [plain, checked, own_methods, child, empty, mixed])
@pytest.mark.parametrize("by_keyword", [False, True])
def test_both_have_the_same_signature(define: Callable[[Any], type], by_keyword: bool) -> None:
    told = [inspect.signature(made) for made in pair(define, frozen=True, kw_only=by_keyword)]
    for a, b in zip(*(signature.parameters.values() for signature in told), strict=True):
        assert (a.name, a.kind, a.annotation) == (b.name, b.kind, b.annotation)
        assert (a.default is a.empty) == (b.default is b.empty)


def test_positions_are_in_the_order_of_fields() -> None:
    for made in pair(plain, frozen=True):
        assert vars(made(1, "x", [2], 3.0)) == {"a": 1, "b": "x", "c": [2], "d": 3.0}
        with pytest.raises(TypeError, match="positional"):
            made(1, "x", [2], 3.0, 5)


def test_each_instance_has_a_new_default() -> None:
    _, own = pair(plain)
    assert own(a=1).c is not own(a=1).c


def test_a_plain_child_of_a_frozen_class_has_attributes_of_its_own() -> None:
    for parent in pair(plain, frozen=True):
        child = type("Child", (parent,), {})(a=1)
        child.note = "kept"
        del child.note
        with pytest.raises(dataclasses.FrozenInstanceError, match="'a'"):
            child.a = 2


def test_parents_init_can_be_called_before_the_childs() -> None:
    @ours.dataclass(frozen=True)
    class Parent:
        a: int

    class Child(Parent):
        def __init__(self, a: int) -> None:
            super().__init__(a + 1)

    assert Child(1).a == 2
    assert Child(2) != Parent(3)


@ours.dataclass(frozen=True)
class Sent:
    """A class at the top of a module, as pickle asks for."""

    a: int
    b: tuple[int, ...] = ()


def test_values_are_pickled_and_match() -> None:
    there = pickle.loads(pickle.dumps(Sent(1, (2,))))
    assert there == Sent(1, (2,))
    match there:
        case Sent(a, b):
            assert (a, b) == (1, (2,))


def test_nothing_is_compiled_before_there_is_an_instance() -> None:
    _, own = pair(plain)
    assert not inspect.isfunction(vars(own)["__init__"])
    own(a=1)
    assert inspect.isfunction(vars(own)["__init__"])
