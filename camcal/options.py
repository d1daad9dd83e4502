"""Options, declared once: how the fields of an options record are given on a command line, and what they mean.

An options record is a frozen dataclass. A field annotated with an Option or an Argument is one of its command; a field
that is an options record itself lends its own. Whatever reads or shows options asks `declared`.
"""

import builtins
import dataclasses
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING
from importlib import import_module
from math import isfinite, isnan, pi
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.parsing import did_you_mean, parse_crop, parse_integer, parse_number, parse_numbers, parse_size
from camcal.records import Brief

INPUT, BOARD, LENS, RAW_FRAMES = "Input", "Board", "Lens", "Raw frames"
METHOD, CHECKS, OUTPUT, GENERAL = "Method", "Checks", "Output", "General"
_FIRST, _LAST = (INPUT, BOARD, LENS, RAW_FRAMES), (METHOD, CHECKS, OUTPUT, GENERAL)


@dataclass(frozen=True)
class ValueType:
    """How the values of an option are written.

    read: the value of a text; raises ValueError, or InvalidInput with a reason of its own. write: the text of a value.
    needed: what a text has to be, such as 'a number'.
    """

    read: Callable[[str], Any]
    write: Callable[[Any], str]
    needed: str


def in_unit(to_field: Callable[[float], float], to_user: Callable[[float], float], needed: str) -> ValueType:
    """Return the type of numbers that are given in a unit of their own, converted to that of the field and back.

    They are written with 12 significant digits where these give the very same value back, else with all.
    """

    def write(value: float) -> str:
        given = to_user(value)
        text = f"{given:.12g}"
        return text if to_field(parse_number(text)) == value else repr(given)

    return ValueType(lambda text: to_field(parse_number(text)), write, needed)


def scaled(factor: float) -> ValueType:
    """Return the type of numbers that are given in factor × the unit of the field."""
    return in_unit(lambda number: number * factor, lambda value: value / factor, "a number")


NUMBER = in_unit(float, float, "a number")


def separated(needed: str, separator: str = ",", count: int | None = None) -> ValueType:
    """Return the type of finite numbers in one text, `count` of them or as many as there are."""

    def read(text: str) -> tuple[float, ...]:
        numbers = tuple(parse_numbers(text.split(separator)))
        if not all(map(isfinite, numbers)) or count not in (None, len(numbers)):
            raise ValueError(text)
        return numbers

    return ValueType(read, lambda values: separator.join(map(NUMBER.write, values)), needed)


TEXT = ValueType(str, str, "a text")
PATH = ValueType(Path, str, "a path")
INTEGER = ValueType(parse_integer, str, "a whole number")
PERCENT = in_unit(lambda number: number / 100, lambda value: 100 * value, "a number")
MILLIMETRES, MICROMETRES, MILLISECONDS = scaled(1e-3), scaled(1e-6), scaled(1e-3)
DEGREES = scaled(pi / 180)
NUMBERS = separated("numbers, separated by commas")
SIZE = ValueType(parse_size, lambda size: "{}x{}".format(*size), "a size, written as WIDTHxHEIGHT such as 1920x1080")
CROP = ValueType(
    parse_crop, lambda part: "{}x{}+{}+{}".format(*part), "a part, written as WxH+X+Y such as 640x480+10+20"
)
NAMES = ValueType(
    lambda text: tuple(name for part in text.split(",") if (name := part.strip())), ",".join, "names, with commas"
)
_UNITS = {"MM": "millimetres", "METRES": "metres", "UM": "micrometres", "MS": "milliseconds", "DEG": "degrees"}
_BY_TYPE = {str: TEXT, Path: PATH, int: INTEGER, float: NUMBER}


@dataclass(frozen=True)
class Written:
    """What the path of an output may be.

    suffixes: of the files that are written, "" among them where a name needs none; a function where only the core knows
    them. folder: it may be a folder, and is one without a suffix. stdout: "-" stands for standard output. words: texts
    that are no path.
    """

    suffixes: Sequence[str] | Callable[[], Sequence[str]] = ()
    folder: bool = False
    stdout: bool = False
    words: tuple[str, ...] = ()

    @property
    def known(self) -> tuple[str, ...]:
        """The suffixes of files."""
        return tuple(self.suffixes() if callable(self.suffixes) else self.suffixes)


@dataclass(frozen=True)
class Option:
    """The help of an option, and its values.

    help: sentences, or a function that makes them where that needs more than the options. names: the spellings, the
    long one first, as '--output -o' or '--landscape/--portrait'; by default that of the field. type: by default that
    of the field. values: so many texts make one value. least, most: of the field's value. suggested: beginnings that a
    shell completes. recorded: whether it belongs to the command that a result records; what changes no number does not.
    required: on a command line, although the field has a default. written: of an option for an output. several: whether
    it can be given more than once, as one of a tuple of texts always can.
    """

    help: str | Callable[[], str]
    metavar: str = ""
    group: str = METHOD
    names: str = ""
    type: ValueType | None = None
    values: int = 1
    least: float | None = None
    most: float | None = None
    choices: tuple[str, ...] = ()
    suggested: Callable[[], Sequence[str]] | None = None
    recorded: bool = True
    required: bool = False
    written: Written | None = None
    several: bool = False


@dataclass(frozen=True)
class Argument(Option):
    """What is given without a name, in the order of the fields; numbers: it may be a number below zero."""

    group: str = INPUT
    numbers: bool = False


@dataclass(frozen=True)
class Without:
    """The options of the record in a field that are not offered, by their paths in it, such as 'layout.frame'."""

    paths: tuple[str, ...]


class OptionsRecord(Brief):
    """Base of options records: values outside of what their options take raise InvalidInput, however they got there."""

    def __post_init__(self) -> None:
        for each in declared(type(self)):
            if len(each.path) == 1:  # what it holds has checked itself
                each.check(each.of(self))


@dataclass(frozen=True)
class Declared:
    """An option of a record, or of one that it holds: the names of the fields that lead to it, and its default.

    several: whether it can be given more than once; its value is a tuple then.
    """

    path: tuple[str, ...]
    option: Option
    type: ValueType | None
    default: Any
    several: bool

    @property
    def positional(self) -> bool:
        """Whether it is an argument."""
        return isinstance(self.option, Argument)

    @property
    def flag(self) -> bool:
        """Whether it takes no value."""
        return self.type is None

    @property
    def help(self) -> str:
        """The help text, which names the sign for standard output where the option takes it."""
        said = self.option.help if isinstance(self.option.help, str) else self.option.help()
        written = self.option.written
        return f"{said.removesuffix('.')} (- for standard output)." if written and written.stdout else said

    @property
    def required(self) -> bool:
        """Whether it has to be given."""
        return self.default is MISSING or self.option.required

    @property
    def spellings(self) -> tuple[str, ...]:
        """The names that give it: of an argument its placeholder, of a flag those that switch it on."""
        return tuple(name.partition("/")[0] for name in self._names)

    @property
    def opposite(self) -> str:
        """The name that switches a flag off, empty if there is none."""
        return self._names[0].partition("/")[2]

    @property
    def name(self) -> str:
        """The name that messages use: --output, or IMAGES…"""
        return self.spellings[0]

    @property
    def key(self) -> str:
        """Its name in settings files."""
        return self.name.lstrip("-")

    @property
    def _names(self) -> Sequence[str]:
        if self.positional:
            return (self.option.metavar,)
        name = "--" + self.path[-1].replace("_", "-")
        switched = f"{name}/--no-{name[2:]}" if self.flag and self.default is not False else name
        return self.option.names.split() or (switched,)

    def read(self, given: Any) -> Any:
        """Return the value of a text, of several texts, or of a flag; raises InvalidInput naming the option."""
        if self.type is None:
            return given
        if self.option.values > 1:
            value: Any = tuple(map(self._read, given))
        else:
            value = tuple(map(self._read, given)) if self.several else self._read(given)
        self.check(value)
        return value

    def _read(self, text: str) -> Any:
        assert self.type is not None
        if not text and (self.positional or self.type is PATH):  # as a path it would be the working directory
            raise self.invalid("an empty text; is a variable of the shell not set?")
        try:
            return self.type.read(text)
        except ValueError:
            unit = _UNITS.get(self.option.metavar)
            hint = f"; give {unit}, without the unit" if unit and self.type.needed == "a number" else ""
            raise self.invalid(f"{text!r} is not {self.type.needed}{hint}") from None
        except InvalidInput as error:
            raise self.invalid(error.message) from error

    def check(self, value: Any) -> None:
        """Raise InvalidInput, naming the option, for a value out of its range, or none of its choices."""
        option = self.option
        for item in value if isinstance(value, tuple) else (value,):
            if option.choices and item not in (None, *option.choices):
                near = did_you_mean(item, option.choices, otherwise="")
                raise self.invalid(f"{item!r} is not one of {', '.join(option.choices)}{near}")
            if item is None or isinstance(item, (str, bool)) or (option.least is None and option.most is None):
                continue
            if isnan(item):
                raise self.invalid("nan is not a number")
            if option.least is not None and not item >= option.least:
                raise self.invalid(f"{self.written(item)} is less than {self.written(option.least)}")
            if option.most is not None and not item <= option.most:
                raise self.invalid(f"{self.written(item)} is more than {self.written(option.most)}")

    def invalid(self, reason: str) -> InvalidInput:
        """Return the error of a value that does not do."""
        return InvalidInput(f"Invalid value for '{self.name}': {reason}")

    def written(self, value: Any) -> str:
        """Return the text of one value."""
        return str(value) if self.type is None else self.type.write(value)

    def texts(self, value: Any) -> list[str]:
        """Return the texts that give the value of an option that takes one."""
        return [self.written(item) for item in (value if self.several or self.option.values > 1 else (value,))]

    def words(self, value: Any) -> list[str]:
        """Return a value as words of a command line."""
        if self.type is None:
            return [self.name if value else self.opposite]
        texts = self.texts(value)
        if self.positional:
            return texts
        return [self.name, *texts] if not self.several else [word for text in texts for word in (self.name, text)]

    def setting(self, value: Any) -> bool | str | list[str]:
        """Return a value as settings files have it."""
        if self.type is None:
            return bool(value)
        return self.texts(value) if self.several or self.option.values > 1 else self.written(value)

    def of(self, options: Any) -> Any:
        """Return its value in an options record."""
        for name in self.path:
            options = getattr(options, name)
        return options


_KNOWN: dict[type, tuple[Declared, ...]] = {}


def declared(record: type) -> tuple[Declared, ...]:
    """Return the options of a record and of those that it holds, in the order of their fields; keywords come last."""
    if record not in _KNOWN:
        _KNOWN[record] = tuple(_declared(record, ()))
    return _KNOWN[record]


def _hints(record: type) -> dict[str, Any]:
    """Return the annotations of a record's fields; a name that only type checkers import stands for anything."""
    return get_type_hints(record, localns=_Names(vars(import_module(record.__module__))), include_extras=True)


class _Names(dict[str, Any]):
    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, Any)


def _declared(record: type, above: tuple[str, ...]) -> Iterator[Declared]:
    hints = _hints(record)
    # what a command shares with others comes behind its own
    for field in sorted(dataclasses.fields(record), key=lambda each: each.kw_only is True):
        path = (*above, field.name)
        plain, notes = _split(hints[field.name])
        options = [note for note in notes if isinstance(note, Option)]
        if options:
            default = field.default if field.default_factory is MISSING else field.default_factory()
            texts = get_origin(plain) is tuple and options[0].type is None and options[0].values == 1
            several = options[0].several or texts
            each = Declared(path, options[0], _type_of(plain, options[0]), default, several)
            if each.type is PATH and options[0].group == OUTPUT and options[0].written is None:
                raise TypeError(f"{each.name}: the option of an output has to say what is written")
            yield each
        elif dataclasses.is_dataclass(plain):
            hidden = {name for note in notes if isinstance(note, Without) for name in note.paths}
            below = _declared(plain, path)  # type: ignore[arg-type] # it is a class
            yield from (each for each in below if ".".join(each.path[len(path) :]) not in hidden)


def _split(hint: Any) -> tuple[Any, list[Any]]:
    """Return a type without None, and what it is annotated with."""
    plain, *notes = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    if get_origin(plain) in (Union, types.UnionType):
        members = [member for member in get_args(plain) if member is not type(None)]
        plain = members[0] if len(members) == 1 else plain
    return plain, notes


def _type_of(plain: Any, option: Option) -> ValueType | None:
    """Return how values of a field are written, None for a flag; raises TypeError where the field does not say."""
    if option.type is not None or plain is bool:
        return option.type
    item = get_args(plain)[0] if get_origin(plain) is tuple else plain
    if item not in _BY_TYPE:
        raise TypeError(f"{plain!r}: an option of this type has to say how it is written")
    return _BY_TYPE[item]


def assembled(record: type, values: Mapping[tuple[str, ...], Any]) -> Any:
    """Return the record with some of its options given, by their paths; raises InvalidInput as the records do."""
    given: dict[str, Any] = {path[0]: value for path, value in values.items() if len(path) == 1}
    hints = _hints(record)
    for name in dict.fromkeys(path[0] for path in values if len(path) > 1):
        below = {path[1:]: value for path, value in values.items() if path[0] == name and len(path) > 1}
        given[name] = assembled(_split(hints[name])[0], below)
    return record(**given)


def given_words(options: Any) -> list[str]:
    """Return the words of a command line that give the options differing from their defaults and changing a result.

    They come in the order of their declaration, arguments left out.
    """
    every = [
        (each, each.of(options)) for each in declared(type(options)) if not each.positional and each.option.recorded
    ]
    return [word for each, value in every if value is not None and value != each.default for word in each.words(value)]


def command_line(command: str, options: Any) -> list[str]:
    """Return the words of the command that has these options, after the program's name.

    Arguments come first, then options; see `given_words`.
    """
    arguments = [(each, each.of(options)) for each in declared(type(options)) if each.positional]
    positional = [word for each, value in arguments if value is not None for word in each.words(value)]
    return [*command.split(), *positional, *given_words(options)]


def by_group(every: Sequence[Declared]) -> dict[str, list[Declared]]:
    """Return options under the titles of their groups: those of every command in one order, its own between them."""
    titles = dict.fromkeys(each.option.group for each in every)
    own_titles = [title for title in titles if title not in (*_FIRST, *_LAST)]
    ordered = [title for title in (*_FIRST, *own_titles, *_LAST) if title in titles]
    return {title: [each for each in every if each.option.group == title] for title in ordered}
