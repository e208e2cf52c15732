"""The options: ours, those of installed packages, and those of a folder of files.

All enter by the same door, :func:`register`.
"""

from __future__ import annotations

import importlib
import os
import sys
from abc import ABC
from dataclasses import dataclass, fields
from importlib.metadata import entry_points
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeVar

from bbq_torchrl.options.settings import REQUIRED, Allowed, ConfigError
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Mapping


ENTRY_POINTS = "bbq_torchrl.options"
"""The group of entry points by which an installed package offers options: each a module."""

FOLDER_VARIABLE = "BBQ_TORCHRL_OPTIONS"
"""The environment variable that hands a folder of options on to the workers of a sweep."""

EXPERIMENT = "experiment"
"""The group without options: files that fix options and keys of the others, added by a plus."""

GROUPS = ("agent", "explore", "intrinsic", "env", "domain", "spike", "protocol", "logger")
"""The groups, in the order that help and documentation have."""


@dataclass
class Option(ABC):
    """One choice of a group of the configuration: a dataclass, ours or anybody's.

    Its fields are keys with default, bounds and meaning
    (:func:`~bbq_torchrl.options.settings.setting`); its field ``name``
    (:func:`~bbq_torchrl.options.settings.option`) is the name by which it is chosen. Importing an
    option does not import torch: making it does.

    Attributes:
        group: the group that it belongs to; set by the base class of the group.
    """

    name: str = REQUIRED

    group: ClassVar[str]

    def check(self) -> None:  # noqa: B027 (most have nothing to refuse)
        """Refuses values that contradict each other; each value alone has been checked by then.

        What two options must agree on is in :mod:`bbq_torchrl.options.agreements`.

        Raises:
            ConfigError: one sentence that names the key, its value and what is allowed.
        """


_OPTIONS: dict[str, dict[str, type[Option]]] = {group: {} for group in GROUPS}
_loaded: set[str] = set()

_PACKAGE = Path(__file__).resolve().parent.parent

Registered = TypeVar("Registered", bound="type[Option]")


def register(option: Registered) -> Registered:
    """Makes a dataclass an option of its group; a decorator.

    The group is that of the base class (:class:`~bbq_torchrl.options.AgentOption`, ...), the
    name is the default of the field ``name``.

    Raises:
        TypeError: a class that is no dataclass of a group, lacks a method that its group asks for,
            has a field that was not declared by :func:`~bbq_torchrl.options.settings.setting`, or
            the name of another class.
    """
    group, name = _group(option), _name(option)
    for item in fields(option):
        if not isinstance(item.metadata.get("allowed"), Allowed):
            raise TypeError(
                f"{option.__qualname__}.{item.name} must be declared by setting(default, allowed, "
                f"meaning), got {item.default!r}"
            )
    if option.__abstractmethods__:
        raise TypeError(
            f"{option.__qualname__} must have the methods that {group}= asks for; it lacks "
            f"{', '.join(sorted(option.__abstractmethods__))}"
        )
    other = _OPTIONS[group].get(name)
    if other is not None and _where(other) != _where(option):
        raise TypeError(f"{group}={name} is registered already, by {_where(other)}")
    _OPTIONS[group][name] = option
    return option


def schemas() -> Mapping[str, Mapping[str, type[Option]]]:
    """Returns group -> name -> option; finds those of installed packages at the first call.

    Raises:
        ConfigError: a package or file of options that cannot be imported.
    """
    if ENTRY_POINTS not in _loaded:
        for group in GROUPS:
            importlib.import_module(f"{__package__}.{group}")
            _OPTIONS[group] = dict(sorted(_OPTIONS[group].items()))
        for point in entry_points(group=ENTRY_POINTS):
            try:
                point.load()
            except Exception as error:
                raise ConfigError(
                    f"the options of {point.name} ({point.value}) cannot be imported: {error}"
                ) from error
        _loaded.add(ENTRY_POINTS)
        folder = options_folder()
        if folder is not None:
            load_folder(folder)
    return _OPTIONS


def load_folder(folder: Path | str, given_by: str = "--config-dir") -> None:
    """Imports the Python files of a folder, which register their options.

    The folder is put in front of the module path, so that a sweep's workers find them too.

    Args:
        folder: where they are.
        given_by: the argument that named it, for the message.

    Raises:
        ConfigError: no such folder, a file that cannot be imported, or one that has the name of an
            option or a file of ours.
    """
    given, folder = str(folder), Path(expanduser(folder)).resolve()
    if not folder.is_dir():
        raise ConfigError(f"{given_by} must be a folder, got {shown(given)}")
    schemas()  # ours first: of two options of one name the folder's is refused
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    for file in sorted(folder.glob("*.py")):
        try:
            module = importlib.import_module(file.stem)
        except Exception as error:
            raise ConfigError(f"{file} cannot be imported: {error}") from error
        if module.__file__ is None or Path(module.__file__).resolve() != file:
            raise ConfigError(
                f"{file} must have a name that no other module has, got {file.stem}, which is "
                f"{module.__file__}"
            )
    ours = conf_folder()
    for group in sorted({*GROUPS, *(place.name for place in ours.iterdir() if place.is_dir())}):
        for file in sorted((folder / group).rglob("*.yaml")):
            name = file.relative_to(folder / group).with_suffix("").as_posix()
            # Hydra would take ours without a word, or fail to merge the two.
            if name in _OPTIONS.get(group, ()) or (ours / group / f"{name}.yaml").is_file():
                raise ConfigError(f"{file} must have another name: {group}={name} is there already")
    os.environ[FOLDER_VARIABLE] = str(folder)


def options_folder() -> Path | None:
    """The folder whose files :func:`load_folder` imported, here or in the process that began."""
    folder = os.environ.get(FOLDER_VARIABLE)
    return None if folder is None else Path(folder)


def conf_folder() -> Path:
    """The folder of the YAML files: ``bbq_torchrl/conf`` in a wheel, else ``conf`` next to it.

    Raises:
        FileNotFoundError: neither is there.
    """
    for folder in (_PACKAGE / "conf", _PACKAGE.parent / "conf"):
        if (folder / "config.yaml").is_file():
            return folder
    raise FileNotFoundError(f"no configuration folder 'conf' in {_PACKAGE} or beside it")


def config_folders() -> list[Path]:
    """The folders of YAML files: ours, and that of ``--config-dir`` if one is given."""
    own = options_folder()
    return [conf_folder()] if own is None else [conf_folder(), own]


def options(group: str) -> list[str]:
    """The options of a configuration group, such as ``["bbqn", "dqn"]`` for ``agent``.

    Those of ``experiment`` are files; one in a subfolder is named with it: ``agents/vime``.
    """
    names = set(schemas().get(group, {}))
    for root in config_folders():
        files = (root / group).rglob("*.yaml")
        names |= {file.relative_to(root / group).with_suffix("").as_posix() for file in files}
    return sorted(names)


def explorations() -> dict[str, tuple[str, ...]]:
    """Returns for each agent the strategies that it can use, its own first.

    An agent can use a strategy if it offers all that the strategy needs.

    Raises:
        ConfigError: an agent that cannot use the strategy that it names as its own.
    """
    known = schemas()
    found = {}
    for name, agent in known["agent"].items():
        own = agent.explores_by  # type: ignore[attr-defined]
        able = [
            other
            for other, explore in known["explore"].items()
            if set(explore.needs) <= set(agent.offers)  # type: ignore[attr-defined]
        ]
        if own not in able:
            raise ConfigError(
                f"{_where(agent)}.explores_by must be one of {', '.join(able)}, which need only "
                f"what the agent offers, got {own!r}"
            )
        found[name] = tuple(sorted(able, key=lambda other: other != own))
    return found


def _group(option: type[Option]) -> str:
    if "__dataclass_fields__" not in vars(option):  # is_dataclass finds those of a base class, too
        raise TypeError(
            f"an option must be a dataclass, with @register above @dataclass, got {option!r}"
        )
    group = getattr(option, "group", None)
    if group not in GROUPS:
        raise TypeError(
            f"{option.__qualname__} must extend the option of a group, such as ExploreOption"
        )
    return group


def _name(option: type[Option]) -> str:
    item = next(item for item in fields(option) if item.name == "name")
    name = item.default
    is_name = isinstance(name, str) and name.isidentifier()
    if not is_name or "allowed" not in item.metadata:
        call = f"option({name!r})" if is_name else "option('<name>')"
        raise TypeError(f"{option.__qualname__}.name must be {call}, got {name!r}")
    return str(name)


def _where(option: type[Option]) -> str:
    return f"{option.__module__}.{option.__qualname__}"
