"""Pipeline files: the steps in a YAML file, with variables, lists and settings files filled in.

Everything that is wrong with a file is found before a step runs, and named with its line.
"""

import glob
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from camcal import files
from camcal.dataclass import dataclass
from camcal.errors import CamcalError, InvalidInput
from camcal.files import STANDARD
from camcal.formats import documents
from camcal.formats.documents import Document, Fault, child
from camcal.options import Declared, declared
from camcal.parsing import did_you_mean, in_one_line
from camcal.run.options import is_folder, located
from camcal.run.settings import is_note, read_settings, typed, wrong_settings
from camcal.tasks.pipelines.step import NOT_STEPS, Step

Commands = Mapping[str, type]

KEYS = ("variables", "environment", "lists", "steps")
STEP_KEYS = ("command", "arguments", "config", "foreach", "after")  # no option of a command is called so
OF_ALL_STEPS = ("json", "quiet", "verbose", "max-pixels")  # options of commands that `camcal run` takes for all

_NAME = re.compile(r"[A-Za-z_][\w-]*\Z", re.ASCII)
_PLACEHOLDER = re.compile(r"\$(\$?)\(([^()]*)\)")  # $(name), which YAML takes without quotes everywhere
_NAMED = re.compile(r"Invalid value for '[^']*': ")


@dataclass(frozen=True, eq=False)
class Pipeline:
    """The steps of a pipeline file, in its order, and the document for messages about them."""

    document: Document
    steps: tuple[Step, ...]

    def fault(self, step: Step, text: str) -> Fault:
        """Return what is wrong with a step, at its line."""
        return Fault(child("steps", step.family), text)


def read_pipeline(text: str, where: str, given: Mapping[str, str], commands: Commands) -> Pipeline:
    """Return the pipeline in the text of a file; paths in it are relative to the working directory.

    where: the file's name for messages. given: values for its variables. commands: options records by their commands.
    Raises FileError if it is no YAML mapping, InvalidInput with one line for everything that is wrong.
    """
    document = documents.parse(text, where)
    reader = _Reader(document, commands)
    reader.read_values(given)
    reader.read_lists()
    steps = reader.read_steps()
    if reader.found:
        raise document.error(dict.fromkeys(reader.found))
    return Pipeline(document, tuple(steps))


class _Reader:
    """Reads a document, noting what is wrong with it on the way."""

    def __init__(self, document: Document, commands: Commands) -> None:
        self.document = document
        self.commands = commands
        self.found: list[Fault] = []
        self.values: dict[str, str] = {}
        self.lists: dict[str, list[str]] = {}
        for key in document:
            if key not in KEYS and not is_note(key):
                self.note(key, f"unknown key{did_you_mean(key, KEYS)}")

    def note(self, path: str, text: str) -> None:
        self.found.append(Fault(path, text))

    def block(self, key: str) -> dict[str, Any]:
        """Return a mapping of the file whose keys are names; empty if it has none."""
        data = self.document.get(key, {})
        if not isinstance(data, dict):
            self.note(key, "is a mapping, NAME: …, one for each line")
            return {}
        wrong = [name for name in data if not _NAME.match(name)]
        for name in wrong:
            self.note(child(key, name), "is no name: use letters, digits, - and _")
        return {name: value for name, value in data.items() if name not in wrong}

    def read_values(self, given: Mapping[str, str]) -> None:
        """Take the variables of the environment that the file asks for, then its own, in their order."""
        names = self.document.get("environment", [])
        for place, name in enumerate(self.texts("environment", names)):
            if name in os.environ:
                self.values[name] = os.environ[name]
            else:
                self.note(child("environment", place), f"the environment has no variable {name}")
        own = self.block("variables")
        for name in given:
            if name not in own:
                raise InvalidInput(f"--set {name}: the pipeline has no such variable{did_you_mean(name, own)}")
        for name, value in own.items():
            if isinstance(value, dict | list) or value is None:
                self.note(child("variables", name), "a variable is one text or number")
            else:
                text = self.filled(typed(value, several=False), child("variables", name))
                self.values[name] = given.get(name, str(text).lower() if isinstance(text, bool) else str(text))

    def read_lists(self) -> None:
        """Take the lists of the file: items, or what the * of a pattern stands for."""
        for name, data in self.block("lists").items():
            path = child("lists", name)
            if name in self.values:
                self.note(path, "is also the name of a variable")
            items = [str(self.filled(text, path)) for text in self.texts(path, data)]
            if isinstance(data, str) and "*" in data:
                items = self.matched(path, items[0])
            elif not items:
                self.note(path, "is an empty list")
            for item in {item for item in items if items.count(item) > 1}:
                self.note(path, f"has {item!r} twice")
            self.lists[name] = items

    def matched(self, path: str, pattern: str) -> list[str]:
        """Return what the one * of a pattern stands for in the files and folders that it matches, in natural order."""
        before, _, after = pattern.partition("*")
        if glob.has_magic(before + after):
            self.note(path, f"{pattern!r}: a pattern of a list has one * and no other wildcard")
            return []
        found = glob.glob(pattern)  # noqa: PTH207 - Path.glob refuses absolute patterns
        if not found:
            self.note(path, f"{pattern!r} matches no file or folder")
        items = [name[len(before) : len(name) - len(after)] for name in found]
        return sorted(items, key=files.natural_key)

    def texts(self, path: str, data: Any) -> list[str]:
        """Return one text or a list of them as a list."""
        items = data if isinstance(data, list) else [data]
        if any(isinstance(item, dict | list) or item is None for item in items):
            self.note(path, "is a text or a list of texts")
            return []
        return [str(item).lower() if isinstance(item, bool) else str(item) for item in items]

    def filled(self, value: Any, path: str, item: tuple[str, str] | None = None) -> Any:
        """Return a value with its placeholders filled in; item: name and value of the list that the step is for."""
        if isinstance(value, list):
            return [self.filled(each, path, item) for each in value]
        if not isinstance(value, str):
            return value
        known = self.values if item is None else self.values | dict([item])

        def value_of(match: re.Match[str]) -> str:
            doubled, name = match.groups()
            if doubled:
                return f"$({name})"
            if name not in known:
                self.note(path, self._unknown(name, known))
            return known.get(name, "")

        return _PLACEHOLDER.sub(value_of, value)

    def _unknown(self, name: str, known: Mapping[str, str]) -> str:
        if name in self.lists:
            return f"$({name}) is a list: add 'foreach: {name}' to the step"
        if not _NAME.match(name):
            return f"$({name}) is no variable; write $$({name}) for the text itself"
        if name in self.block("variables"):
            return f"$({name}) is set below it; put it above"
        return f"$({name}): no such variable{did_you_mean(name, known)}"

    def read_steps(self) -> list[Step]:
        """Return the steps, one for each item of those with a list."""
        blocks = self.block("steps")
        if not blocks and not self.found:
            self.note("steps", "no steps; each is NAME: with its command and options")
        found: list[Step] = []
        for name, data in blocks.items():
            path = child("steps", name)
            if not isinstance(data, dict):
                self.note(path, "a step is a mapping: command: …, then its options")
            elif (record := self.record_of(path, data)) is not None:
                found += self.steps_of(name, path, data, record)
        return found

    def record_of(self, path: str, data: Mapping[str, Any]) -> type | None:
        """Return the options record of a step's command."""
        command = data.get("command")
        if command is None:
            self.note(path, "has no command")
        elif command in NOT_STEPS:
            self.note(child(path, "command"), f"{command} cannot be a step")
        elif not isinstance(command, str) or command not in self.commands:
            said = did_you_mean(str(command), self.commands, otherwise="; 'camcal --help' lists all")
            self.note(child(path, "command"), f"no command {str(command)!r} for a step{said}")
        else:
            return self.commands[command]
        return None

    def steps_of(self, name: str, path: str, data: Mapping[str, Any], record: type) -> list[Step]:
        """Return the steps that a block of the file stands for."""
        own = {key: value for key, value in data.items() if key not in STEP_KEYS}
        keys = {each.key.replace("-", "_"): each for each in declared(record) if not each.positional}
        unknown = list(self.wrong_keys(path, own, keys))
        self.found += unknown
        before = tuple(self.texts(child(path, "after"), data.get("after", [])))
        for other in before:
            if other not in self.document["steps"]:
                known = [step for step in self.document["steps"] if step != name]
                self.note(child(path, "after"), f"no step {other!r}{did_you_mean(other, known)}")
        steps = []
        for item in self.items(path, data.get("foreach")):
            noted = len(self.found)
            given = {} if unknown else self.given(path, data, keys, record, item)
            label = name if item is None else in_one_line(f"{name}[{item[1]}]")
            step = Step(label, name, str(data["command"]), record, given, before)
            if not unknown and len(self.found) == noted:
                self.check(path, step)
            steps.append(step)
        return steps

    def wrong_keys(self, path: str, own: Mapping[str, Any], keys: Mapping[str, Declared]) -> Iterator[Fault]:
        """Yield what is wrong with the keys of a step that are no keys of every step, and with the kinds of values."""
        of_all = [key for key in own if key.replace("_", "-") in OF_ALL_STEPS]
        yield from (Fault(child(path, key), f"give --{key} to camcal run, for all steps") for key in of_all)
        known = dict.fromkeys(STEP_KEYS, False) | {key: _takes_list(each) for key, each in keys.items()}
        yield from wrong_settings({key: value for key, value in own.items() if key not in of_all}, known, path)

    def items(self, path: str, name: Any) -> list[tuple[str, str] | None]:
        """Return the items that a step is for, each with the name of their list; None if it is for none."""
        if name is None:
            return [None]
        if name not in self.lists:
            self.note(child(path, "foreach"), f"no list {name!r} under 'lists'{did_you_mean(str(name), self.lists)}")
            return []
        return [(name, item) for item in self.lists[name]]

    def given(
        self,
        path: str,
        data: Mapping[str, Any],
        keys: Mapping[str, Declared],
        record: type,
        item: tuple[str, str] | None,
    ) -> dict[Declared, Any]:
        """Return the values of the options of a step: those of its settings file, then its own, and its arguments."""
        texts: dict[Declared, tuple[str, Any]] = {}
        if "config" in data:
            place = child(path, "config")
            config = self.settings(place, self.filled(data["config"], place, item), keys)
            texts = {keys[key]: (place, value) for key, value in config.items()}
        for key, value in data.items():
            if key not in STEP_KEYS and not is_note(key):
                each, place = keys[key.replace("-", "_")], child(path, key)
                texts[each] = place, typed(self.filled(value, place, item), several=_takes_list(each))
        place = child(path, "arguments")
        words = [str(self.filled(text, place, item)) for text in self.texts(place, data.get("arguments", []))]
        for each, given in self.arguments(place, [each for each in declared(record) if each.positional], words).items():
            texts[each] = place, given
        wrong = {fault.path for fault in self.found}  # such as an unknown variable: what it leaves is not judged too
        values = {
            each: None if where in wrong else self.value(where, each, text) for each, (where, text) in texts.items()
        }
        for each in declared(record):
            if each.required and each not in values and not each.positional:
                self.note(path, f"{each.key} is missing")
        return {each: value for each, value in values.items() if value is not None}

    def settings(self, path: str, config: Any, keys: Mapping[str, Declared]) -> Mapping[str, Any]:
        """Return the values in a settings file; none if it is wrong."""
        if not isinstance(config, str):
            self.note(path, "is the name of one settings file")
            return {}
        try:
            return read_settings(Path(config), {key: _takes_list(each) for key, each in keys.items()}).values
        except CamcalError as error:
            for line in str(error).splitlines():
                self.note(path, line)
            return {}

    def arguments(self, path: str, options: list[Declared], words: list[str]) -> dict[Declared, Any]:
        """Return the words that stand for each argument, as on a command line: one that takes several has the rest."""
        found: dict[Declared, Any] = {}
        left = list(words)
        several = next((place for place, each in enumerate(options) if each.several), len(options))
        last = [each for each in options[several + 1 :] for _ in range(each.option.values)]
        for each in options[:several]:
            taken = [left.pop(0) for _ in range(min(each.option.values, len(left)))]
            if taken:
                found[each] = taken if each.option.values > 1 else taken[0]
        for each in reversed(last):
            if left:
                found[each] = left.pop()
        if several < len(options) and left:
            found[options[several]], left = left, []
        missing = [each.name for each in options if each.required and each not in found]
        if missing:
            self.note(path, f"{' and '.join(missing)} missing")
        if left:
            known = " ".join(each.name for each in options) or "no arguments"
            self.note(path, f"{len(left)} too many: {' '.join(left)}; the command takes {known}")
        return found

    def value(self, path: str, each: Declared, given: Any) -> Any:
        """Return the value of an option; None if it has none that does."""
        if each.flag and not isinstance(given, bool):
            self.note(path, f"takes true or false, not {given!r}")
        elif each.option.values > 1 and len(given) != each.option.values:
            self.note(path, f"takes {each.option.values} values, not {len(given)}")
        else:
            try:
                text = str(given).lower() if isinstance(given, bool) and not each.flag else given
                return each.read(located(each, text))
            except InvalidInput as error:
                self.note(path, _NAMED.sub("", error.message))
        return None

    def check(self, path: str, step: Step) -> None:
        """Note what is wrong with the options of a step together, and with the places of its outputs."""
        for each, value in step.given.items():
            for text in [] if each.flag else each.texts(value):
                if text == STANDARD and (each.positional or each.option.written):
                    self.note(path, f"{each.key} -: a step reads and writes files, not standard streams")
                    return
        try:
            step.options()
            for output, each in step.outputs.items():
                is_folder(each, output)
        except InvalidInput as error:
            self.note(path, str(error))


def _takes_list(each: Declared) -> bool:
    return each.several or each.option.values > 1
