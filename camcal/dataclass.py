"""Data classes whose methods are written when they are first needed.

`dataclasses.dataclass` writes and compiles the methods of a class where that is defined, which takes 0.6 ms: for the
classes that a command imports a third of the time that it takes to start. Of most of them few methods are ever called.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import field, replace
from functools import partial
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any

__all__ = ["dataclass", "field", "replace"]

if TYPE_CHECKING:  # to a type checker, and to who reads, they are the same
    from dataclasses import dataclass
else:

    def dataclass(cls: Any = None, /, *, frozen: bool = False, eq: bool = True, kw_only: bool = False) -> Any:
        """Return the class as the library would, as one of its own; every field is an argument: no init=False."""
        if cls is None:
            return partial(dataclass, frozen=frozen, eq=eq, kw_only=kw_only)
        own = {*vars(cls)}
        _collect_fields(cls, kw_only=kw_only)
        cls.__dataclass_params__.frozen, cls.__dataclass_params__.eq = frozen, eq
        methods = {"__init__": _Initialiser(cls), "__repr__": _describe}
        if eq:
            methods |= {"__eq__": _are_equal, "__hash__": _hash if frozen else None}
        if frozen:
            methods |= {"__setattr__": _refuse_to_set, "__delattr__": _refuse_to_delete}
        for name, method in methods.items():
            if name not in own:
                setattr(cls, name, method)
        return cls


def _collect_fields(cls: type, *, kw_only: bool) -> None:
    """Let the library collect the fields of a class, and do nothing else."""
    # of classes above that are frozen it would ask that it freezes those below
    above = [vars(each)["__dataclass_params__"] for each in cls.__mro__[1:] if "__dataclass_params__" in vars(each)]
    frozen = [params.frozen for params in above]
    documented = cls.__doc__
    cls.__doc__ = documented or cls.__name__  # or it would describe the arguments, for which methods would be written
    for params in above:
        params.frozen = False
    try:
        dataclasses.dataclass(init=False, repr=False, eq=False, kw_only=kw_only)(cls)
    finally:
        cls.__doc__ = documented
        for params, was in zip(above, frozen, strict=True):
            params.frozen = was


class _Initialiser:
    """The `__init__` of a class, which takes its place when it is first asked for."""

    def __init__(self, owner: type) -> None:
        self.owner = owner

    def __get__(self, instance: Any, owner: Any = None) -> Callable[..., None]:
        if vars(self.owner)["__init__"] is self:
            self.owner.__init__ = _write_init(self.owner)
        found: Callable[..., None] = vars(self.owner)["__init__"]
        return found if instance is None else partial(found, instance)


class _NotGiven:
    """What stands for a value that is made anew for every object, in signatures as in those of the library."""

    def __repr__(self) -> str:
        return "<factory>"


_NOT_GIVEN = _NotGiven()


def _write_init(cls: Any) -> Callable[..., None]:
    """Return the function that sets the fields of a new object to its arguments or to their defaults."""
    scope: dict[str, Any] = {"_NOT_GIVEN": _NOT_GIVEN}
    arguments, keywords, values = ["self"], list[str](), list[str]()
    for own in dataclasses.fields(cls):
        name, default, value = own.name, "", own.name
        if own.default_factory is not dataclasses.MISSING:
            scope[f"_make_{name}"], default = own.default_factory, "=_NOT_GIVEN"
            value = f"_make_{name}() if {name} is _NOT_GIVEN else {name}"
        elif own.default is not dataclasses.MISSING:
            scope[f"_default_{name}"], default = own.default, f"=_default_{name}"
        values.append(f"{name!r}: {value}")
        (keywords if own.kw_only else arguments).append(name + default)
    signature = ", ".join([*arguments, *(["*", *keywords] if keywords else [])])
    # past __setattr__, which may refuse
    body = [f"self.__dict__.update({{{', '.join(values)}}})"]
    if hasattr(cls, "__post_init__"):
        body.append("self.__post_init__()")
    text = "\n    ".join([f"def __init__({signature}):", *body])
    exec(compile(text, f"<{cls.__qualname__}.__init__>", "exec"), scope)  # noqa: S102 - names of fields alone
    made: Callable[..., None] = scope["__init__"]
    made.__qualname__ = f"{cls.__qualname__}.__init__"
    made.__module__ = cls.__module__
    made.__annotations__ = {own.name: own.type for own in dataclasses.fields(cls)} | {"return": None}
    return made


def _values(record: Any) -> tuple[Any, ...]:
    """Return what counts where objects are compared."""
    return tuple(getattr(record, own.name) for own in dataclasses.fields(record) if own.compare)


def _are_equal(self: Any, other: object) -> bool:
    return _values(self) == _values(other) if type(self) is type(other) else NotImplemented


def _hash(self: Any) -> int:
    counted = (own for own in dataclasses.fields(self) if (own.compare if own.hash is None else own.hash))
    return hash(tuple(getattr(self, own.name) for own in counted))


@recursive_repr()
def _describe(self: Any) -> str:
    shown = [f"{own.name}={getattr(self, own.name)!r}" for own in dataclasses.fields(self) if own.repr]
    return f"{type(self).__qualname__}({', '.join(shown)})"


def _refuse_to_set(self: Any, name: str, value: object) -> None:
    if _is_fixed(self, name):
        raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
    object.__setattr__(self, name, value)


def _refuse_to_delete(self: Any, name: str) -> None:
    if _is_fixed(self, name):
        raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
    object.__delattr__(self, name)


def _is_fixed(record: Any, name: str) -> bool:
    """Return whether an attribute is a field, or one that the class itself would not have: one below it may."""
    return "__dataclass_params__" in vars(type(record)) or name in {own.name for own in dataclasses.fields(record)}
