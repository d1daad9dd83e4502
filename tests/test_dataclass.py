"""Data classes of the package beside those of the library, which they have to be like."""

import copy
import dataclasses
import inspect
import pickle
from dataclasses import FrozenInstanceError, field
from functools import cached_property

import pytest

from camcal.dataclass import dataclass


def defined(decorator):
    """Return classes that a decorator makes: a frozen one, one below it, one that may change, one without equality."""

    @decorator(frozen=True)
    class Point:
        """A point."""

        x: float
        y: float = 0.0
        tags: list = field(default_factory=list, compare=False)

    @decorator(frozen=True)
    class Named(Point):
        name: str = field(default="", repr=False)
        own: str = field(default="p", kw_only=True)

        def __post_init__(self):
            object.__setattr__(self, "name", self.name.upper())

        @cached_property
        def length(self):
            return abs(self.x) + abs(self.y)

    @decorator
    class Count:
        total: int = 0

    @decorator(frozen=True, eq=False)
    class Array:
        values: tuple

    return Point, Named, Count, Array


OURS, LIBRARYS = defined(dataclass), defined(dataclasses.dataclass)


@dataclass(frozen=True)
class Stored:
    value: int = 1


@pytest.mark.parametrize(("one", "other"), [*zip(OURS, LIBRARYS, strict=True)])
def test_a_class_shows_what_one_of_the_library_shows(one, other):
    assert str(inspect.signature(one)) == str(inspect.signature(other))
    assert one.__init__.__qualname__ == other.__init__.__qualname__
    assert one.__init__.__annotations__ == other.__init__.__annotations__
    assert one.__match_args__ == other.__match_args__
    assert dataclasses.is_dataclass(one)
    assert [str(each) for each in dataclasses.fields(one)] == [str(each) for each in dataclasses.fields(other)]
    assert (one.__hash__ is None) == (other.__hash__ is None)


@pytest.mark.parametrize("arguments", [(1.0,), (1.0, 2.0), (1.0, 2.0, ["a"]), (1.0, 2.0, ["a"], "n")])
def test_objects_are_those_that_the_library_makes(arguments):
    for place in (0, 1) if len(arguments) < 4 else (1,):
        one, other = OURS[place](*arguments), LIBRARYS[place](*arguments)
        assert repr(one) == repr(other)
        assert dataclasses.asdict(one) == dataclasses.asdict(other)
        assert hash(one) == hash(other)
        assert vars(one) == vars(other)


def test_objects_are_equal_if_they_are_of_one_class_and_all_that_is_compared_is():
    point, named, count, array = OURS
    assert point(1.0, tags=["a"]) == point(1.0, tags=["b"])
    assert point(1.0) != point(2.0)
    assert point(1.0) != named(1.0)
    assert count(1) == count(1)
    assert array((1,)) != array((1,))
    assert len({point(1.0), point(1.0), point(2.0)}) == 2


@pytest.mark.parametrize("decorator", [dataclass, dataclasses.dataclass])
def test_a_hash_leaves_out_what_is_not_hashed_though_it_is_compared(decorator):
    @decorator(frozen=True)
    class Weighed:
        name: str
        weights: list = field(default_factory=list, hash=False)

    assert hash(Weighed("a", [1])) == hash(Weighed("a", [2]))
    assert Weighed("a", [1]) != Weighed("a", [2])


def test_defaults_are_made_anew_for_each_object():
    point = OURS[0]
    assert point(1.0).tags is not point(1.0).tags


@pytest.mark.parametrize("arguments", [{}, {"x": 1.0, "z": 1.0}, {"x": 1.0, "own": 2}])
def test_arguments_that_a_class_has_not_are_refused_in_the_words_of_the_library(arguments):
    with pytest.raises(TypeError) as ours:
        OURS[0](**arguments)
    with pytest.raises(TypeError) as librarys:
        LIBRARYS[0](**arguments)
    assert str(ours.value) == str(librarys.value)


def test_what_is_frozen_neither_changes_nor_loses_a_field():
    for cls in (OURS[0], OURS[1], OURS[3]):
        made = cls(1.0)
        name = dataclasses.fields(cls)[0].name
        with pytest.raises(FrozenInstanceError, match=f"cannot assign to field '{name}'"):
            setattr(made, name, 2.0)
        with pytest.raises(FrozenInstanceError, match="cannot assign to field 'other'"):
            made.other = 2.0
        with pytest.raises(FrozenInstanceError, match=f"cannot delete field '{name}'"):
            delattr(made, name)
        assert getattr(made, name) == 1.0
    count = OURS[2]()
    count.total += 3
    del count.total
    assert count == OURS[2](0)


def test_a_class_below_a_frozen_one_has_attributes_of_its_own_but_the_fields_stay():
    class Below(OURS[0]):
        def __init__(self, x):
            super().__init__(x)
            self.seen = True

    made = Below(1.0)
    assert made.seen
    with pytest.raises(FrozenInstanceError):
        made.x = 2.0


def test_classes_of_the_library_may_stand_below_ours_and_ours_below_them():
    @dataclasses.dataclass(frozen=True)
    class Library(OURS[0]):
        z: float = 1.0

    @dataclass(frozen=True)
    class Ours(Library):
        w: float = 2.0

    assert repr(Ours(1.0, 2.0)).endswith("Ours(x=1.0, y=2.0, tags=[], z=1.0, w=2.0)")
    for cls in (Library, Ours):
        with pytest.raises(FrozenInstanceError):
            cls(1.0).z = 3.0
    with pytest.raises(TypeError, match="cannot inherit non-frozen dataclass from a frozen one"):

        @dataclasses.dataclass
        class Thawed(OURS[0]):
            pass


def test_objects_are_copied_replaced_and_stored():
    named = OURS[1](1.0, name="a", own="q")
    assert named.length == 1.0
    assert dataclasses.replace(named, y=2.0).length == 3.0
    assert copy.deepcopy(named) == named
    assert pickle.loads(pickle.dumps(Stored(3))) == Stored(3)


def test_a_repr_of_what_contains_itself_ends():
    made = OURS[0](1.0)
    made.tags.append(made)
    other = LIBRARYS[0](1.0)
    other.tags.append(other)
    assert repr(made) == repr(other)


def test_a_class_is_defined_without_writing_a_method():
    point = defined(dataclass)[0]
    written = [name for name, method in vars(point).items() if getattr(method, "__module__", "") == __name__]
    assert written == []
    point(1.0)
    assert inspect.isfunction(vars(point)["__init__"])
