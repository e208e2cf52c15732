"""The registry of options: ours, those of installed packages, and those of a folder of files.

All are registered by :func:`register`.
"""

from __future__ import annotations

import importlib
import os
import sys
from abc import ABC
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from importlib.metadata import entry_points
from os.path import expanduser
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from bbq_torchrl.settings import REQUIRED, ConfigError
from bbq_torchrl.utils.files import read_yaml
from bbq_torchrl.utils.text import sentence, shown

ENTRY_POINTS = "bbq_torchrl.options"
"""The entry-point group of packages with options; each entry point is a module."""

FOLDER_VARIABLE = "BBQ_TORCHRL_OPTIONS"
"""The environment variable that passes a folder of options to the workers of a sweep."""

EXPERIMENT = "experiment"
"""The group without options: its files set options and keys of other groups (``+experiment=``)."""

GROUPS = ("agent", "explore", "intrinsic", "env", "domain", "spike", "protocol", "logger")
"""The groups, in the order of help and documentation."""


@dataclass
class Option(ABC):
    """A choice of a configuration group, as a dataclass.

    Its fields are keys with default, bounds and meaning
    (:func:`~bbq_torchrl.settings.setting`). The field ``name``
    (:func:`~bbq_torchrl.settings.option`) has its name on the command line. Importing an
    option does not import torch; making it does.

    Attributes:
        group: the group, set by the group's base class.
    """

    name: str = REQUIRED

    group: ClassVar[str]

    def check(self) -> None:  # noqa: B027 (most options have nothing to refuse)
        """Refuses values that contradict each other; single values have been checked before.

        :mod:`bbq_torchrl.options.root` checks what two options must agree on.

        Raises:
            ConfigError: one sentence that names the key, its value and what is allowed.
        """


_OPTIONS: dict[str, dict[str, type[Option]]] = {group: {} for group in GROUPS}
_loaded: set[str] = set()

_PACKAGE = Path(__file__).resolve().parent.parent

Registered = TypeVar("Registered", bound="type[Option]")


def register(option: Registered) -> Registered:
    """Registers a dataclass as an option of its group; a decorator.

    The base class (:class:`~bbq_torchrl.options.AgentOption`, ...) has the group, the default of
    the field ``name`` is the name.

    Raises:
        TypeError: the class is not a dataclass of a group, has a field that is not declared by
            :func:`~bbq_torchrl.settings.setting` or
            :func:`~bbq_torchrl.settings.option`, or has the name of another option.
    """
    group = getattr(option, "group", None)
    # is_dataclass also accepts a base class's
    if "__dataclass_fields__" not in vars(option) or group not in GROUPS:
        raise TypeError(
            "an option must be a dataclass, with @register above @dataclass, that extends the "
            f"option of a group, such as ExploreOption, got {option!r}"
        )
    for item in fields(option):
        if "allowed" not in item.metadata:
            call = "option(name)" if item.name == "name" else "setting(default, allowed, meaning)"
            raise TypeError(f"{_where(option)}.{item.name} must be declared by {call}")
    other = _OPTIONS[group].get(option.name)
    if other is not None and _where(other) != _where(option):
        raise TypeError(f"{group}={option.name} is registered already, by {_where(other)}")
    _OPTIONS[group][option.name] = option
    return option


def schemas() -> Mapping[str, Mapping[str, type[Option]]]:
    """Returns group -> name -> option. The first call imports options of installed packages.

    Raises:
        ConfigError: a package or file of options cannot be imported.
    """
    if ENTRY_POINTS not in _loaded:
        for group in GROUPS:
            _OPTIONS[group] = dict(sorted(_OPTIONS[group].items()))
        for point in entry_points(group=ENTRY_POINTS):
            with _importing(f"the options of {point.name} ({point.value})"):
                point.load()
        _loaded.add(ENTRY_POINTS)
        folder = options_folder()
        if folder is not None:
            load_folder(folder)
    return _OPTIONS


@contextmanager
def _importing(what: object) -> Iterator[None]:
    """Turns any error of somebody's module into a sentence."""
    try:
        yield
    except Exception as error:
        raise ConfigError(f"{what} cannot be imported: {error}") from error


def load_folder(folder: Path | str, given_by: str = "--config-dir") -> None:
    """Imports the Python files of a folder, which register options.

    The folder is put in front of the module path, so that the workers of a sweep find them too.

    Args:
        folder: the folder.
        given_by: the argument with the folder, for messages.

    Raises:
        ConfigError: the folder is missing, a file cannot be imported or read, a file has the name
            of another module, or an option is not registered.
    """
    given, folder = str(folder), Path(expanduser(folder)).resolve()
    if not folder.is_dir():
        raise ConfigError(f"{given_by} must be a folder, got {shown(given)}")
    schemas()  # ours first: of two options with one name the folder's is refused
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    for file in sorted(folder.glob("*.py")):
        with _importing(file):
            module = importlib.import_module(file.stem)
            for found in vars(module).values():
                _refuse_unregistered(found, module.__name__)
        if module.__file__ is None or Path(module.__file__).resolve() != file:
            raise ConfigError(
                f"{file} must have a name that no other module has, got {file.stem}, which is "
                f"{module.__file__}"
            )
    for group in sorted(place.name for place in conf_folder().iterdir() if place.is_dir()):
        for file in sorted((folder / group).rglob("*.yaml")):
            try:
                read_yaml(file.read_text(encoding="utf-8"))  # Hydra would print a traceback
            except (OSError, ValueError) as error:
                raise ConfigError(f"{file}: {sentence(error)}") from error
    os.environ[FOLDER_VARIABLE] = str(folder)


def _refuse_unregistered(found: object, module: str) -> None:
    """Refuses an option with a name that lacks the decorator; a base class has no name."""
    if not (isinstance(found, type) and issubclass(found, Option) and found.__module__ == module):
        return
    name = getattr(found, "name", REQUIRED)
    if name != REQUIRED and name not in _OPTIONS[found.group]:
        raise ConfigError(f"{_where(found)} must have @register above @dataclass to be an option")


def options_folder() -> Path | None:
    """The folder of :func:`load_folder`, called in this process or a parent."""
    folder = os.environ.get(FOLDER_VARIABLE)
    return None if folder is None else Path(folder)


def conf_folder() -> Path:
    """The folder of the YAML files: ``bbq_torchrl/conf`` in a wheel, else ``conf`` next to it."""
    within = _PACKAGE / "conf"
    return within if within.is_dir() else _PACKAGE.parent / "conf"


def config_folders() -> list[Path]:
    """The folders of YAML files: ours, and that of ``--config-dir`` if given."""
    given = options_folder()
    return [conf_folder()] if given is None else [conf_folder(), given]


def options(group: str) -> list[str]:
    """The options of a configuration group, such as ``["bbqn", "dqn"]`` for ``agent``.

    Those of ``experiment`` are files, named with their subfolder: ``agents/vime``.
    """
    names = set(schemas().get(group, {}))
    for root in config_folders():
        files = (root / group).rglob("*.yaml")
        names |= {file.relative_to(root / group).with_suffix("").as_posix() for file in files}
    return sorted(names)


def explorations() -> dict[str, tuple[str, ...]]:
    """Returns the strategies that each agent can use, its default first.

    An agent can use a strategy if it provides everything that the strategy requires.
    """
    known: Any = schemas()
    found = {}
    for name, agent in known["agent"].items():
        able = [
            other
            for other, explore in known["explore"].items()
            if set(explore.requires) <= set(agent.provides)
        ]
        able.sort(key=lambda other: other != agent.explores_by)
        found[name] = tuple(able)
    return found


def _where(option: type[Option]) -> str:
    return f"{option.__module__}.{option.__qualname__}"
