"""Composing and checking configurations."""

from __future__ import annotations

import contextlib
import copy
import os
import re
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar

from hydra import compose as hydra_compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.utils import to_absolute_path
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import InterpolationResolutionError, OmegaConfBaseException
from yaml import YAMLError

from bbq_torchrl.options import CalibrateConfig, Config, EvaluateConfig, schemas, validate
from bbq_torchrl.options.registry import conf_folder, options_folder
from bbq_torchrl.options.store import ROOTS, register_options
from bbq_torchrl.runs.folders import quoted
from bbq_torchrl.runs.overrides import (
    allowed,
    explain,
    group_choices,
    groups_of,
    key_of,
    not_an_option,
    of_a_key,
    too_large,
    unknown_key,
)
from bbq_torchrl.settings import ConfigError, walk
from bbq_torchrl.utils.files import check_yaml
from bbq_torchrl.utils.text import conceal_environment, sentence, shown

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from omegaconf import ListConfig

    from bbq_torchrl.options import Option

Root = TypeVar("Root", Config, EvaluateConfig, CalibrateConfig)


@contextlib.contextmanager
def session() -> Iterator[Any]:
    """Opens a Hydra session on the ``conf`` folder, and restores the previous one at the end."""
    register_options()
    before = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(str(conf_folder()), version_base="1.3"):
            yield GlobalHydra.instance().hydra
    finally:
        GlobalHydra.instance().hydra = before  # initialize_config_dir leaves a copy


def compose_raw(
    overrides: Sequence[str], root: type = Config, run: Config | None = None
) -> DictConfig:
    """Composes YAML files and overrides in a :func:`session`, with Hydra's part.

    Values have their keys' types but are not checked further. With ``run``, options and their keys
    default to that run's; for a training, all keys do.

    Raises:
        ConfigError: an unknown group, option or key, or a value of the wrong type.
    """
    refusal = too_large(overrides) or not_an_option(overrides, root)
    if refusal is not None:
        raise ConfigError(refusal)
    chosen = [] if run is None else options_of(run, overrides, root)
    try:
        composed = hydra_compose(
            ROOTS[root], searched([*chosen, *overrides]), return_hydra_config=True
        )
        if run is not None:
            take_values(composed, run, overrides, root)
        return composed
    # The last ones: very long or deep texts, and numbers of thousands of digits.
    except (
        HydraException,
        OmegaConfBaseException,
        YAMLError,
        ValueError,
        OSError,
        OverflowError,
        RecursionError,
    ) as error:
        raise ConfigError(why_refused(error, [*chosen, *overrides], root)) from error


def options_of(run: Config, overrides: Sequence[str], root: type = Config) -> list[str]:
    """Returns overrides that choose a run's options in the groups that a command line omits."""
    given = set(map(key_of, overrides))
    return [f"{name}={getattr(run, name).name}" for name in groups_of(root) if name not in given]


def take_values(
    composed: DictConfig, run: Config, overrides: Sequence[str], root: type = Config
) -> None:
    """Sets the keys that a command line omits to the values of a run."""
    given = set(map(key_of, overrides))
    shared = groups_of(root) if root is EvaluateConfig else [item.name for item in fields(root)]
    for key, _, value in walk(run):
        if key.partition(".")[0] in shared and not {key, key.partition(".")[0]} & given:
            OmegaConf.update(composed, key, value)


def why_refused(error: Exception, overrides: Sequence[str], root: type = Config) -> str:
    """Explains in one sentence why overrides cannot be composed; call it in a :func:`session`."""
    composed = None
    with contextlib.suppress(Exception):  # an unreadable option or file
        composed = hydra_compose(
            ROOTS[root], searched(group_choices(overrides)), return_hydra_config=True
        )
    return explain(error, overrides, root, composed)


def run_of(overrides: Sequence[str], key: str) -> str | None:
    """Returns the run folder that a command line gives for a key; None without one."""
    given = [override for override in overrides if key_of(override) == key]
    if not given or too_large(given):
        return None
    try:
        value = OverridesParser.create().parse_override(given[-1]).value()
    except (HydraException, ValueError):  # refused later, when composed
        return None
    if isinstance(value, (int, float)):
        return given[-1].partition("=")[2]  # a folder may be named 1.50
    return value if isinstance(value, str) else None


def searched(overrides: Sequence[str]) -> list[str]:
    """Adds a folder of options, if one is loaded, to Hydra's search path."""
    folder = options_folder()
    if folder is None:
        return list(overrides)
    return [f"hydra.searchpath=[{quoted(f'file://{folder}')}]", *overrides]


def to_config(typed: DictConfig, root: type[Root]) -> Root:
    """Returns the checked dataclass of a composed configuration. Paths become absolute.

    Raises:
        ConfigError: the first invalid value or combination.
    """
    conceal_environment(str(OmegaConf.to_container(typed, resolve=False)))
    typed = copy.deepcopy(typed)
    with open_dict(typed):
        typed.pop("hydra", None)
    for key in sorted(item.name for item in fields(root)):
        if key not in typed or OmegaConf.is_missing(typed, key):
            raise _not_given(key)
    try:
        missing = sorted(OmegaConf.missing_keys(typed))
    except InterpolationResolutionError as error:
        given = _unresolved(typed, str(error.full_key))
        raise ConfigError(
            f"{error.full_key}={given} cannot be resolved: {str(error).splitlines()[0]}"
        ) from error
    for key in missing:
        raise _not_given(key)
    config: Root = OmegaConf.to_object(typed)  # type: ignore[assignment]
    chosen = {group: getattr(config, group) for group in schemas() if hasattr(config, group)}
    for group, part in {"": config, **chosen}.items():
        for key in vars(part).keys() - part.__dataclass_fields__.keys():  # added by a plus
            raise ConfigError(unknown_key(f"{group}.{key}".strip("."), type(part)))
    for group, option in chosen.items():
        if option.name != type(option).name:
            raise ConfigError(
                f"{group}.name must be {type(option).name!r}, got {option.name!r}: "
                f"choose by {group}={option.name}"
            )
    if path := getattr(config.domain, "path", ""):
        # Relative to where the command started: with hydra.job.chdir=true a job runs elsewhere.
        config.domain.path = os.path.abspath(to_absolute_path(os.path.expanduser(path)))  # type: ignore[attr-defined]
    validate(config)
    return config


def _unresolved(typed: DictConfig, key: str) -> Any:
    """Returns a value with its references unresolved."""
    plain: Any = OmegaConf.to_container(typed, resolve=False)
    for name in re.findall(r"[^.\[\]]+", key):
        plain = plain[int(name) if isinstance(plain, list) else name]
    return plain


def load_yaml(file: Path, of: str) -> DictConfig | ListConfig:
    """Reads a YAML file.

    Raises:
        ConfigError: it cannot be read as YAML; the message has ``of``, what the file describes.
    """
    try:
        check_yaml(file.read_text(encoding="utf-8"))
        return OmegaConf.load(file)
    except OSError as error:
        raise ConfigError(f"{file} cannot be read: {error.strerror}") from error
    except Exception as error:
        raise ConfigError(f"{file} is not a YAML file of {of}: {sentence(error)}") from error


def read_config(plain: DictConfig) -> Config:
    """Returns the checked dataclass of a saved training configuration.

    Raises:
        ConfigError: as :func:`to_config`.
    """
    typed = OmegaConf.structured(Config)
    try:
        for group in groups_of(Config):
            if group in plain:
                typed[group] = _saved_option(group, plain[group])
                _check_saved(group, plain[group], typed[group])
        typed.merge_with(plain)
        return to_config(typed, Config)
    except OmegaConfBaseException as error:
        key = str(error.full_key).split("[")[0]
        got = shown(OmegaConf.select(plain, key))
        raise ConfigError(of_a_key(error, key, got, Config)) from error


def _not_given(key: str) -> ConfigError:
    return ConfigError(f"{key} must be given, as {key}=<value>")


def _check_saved(group: str, plain: DictConfig, typed: DictConfig) -> None:
    """Refuses values that OmegaConf would merge silently, or refuse without naming the key."""
    for name in map(str, plain):
        key = f"{group}.{name}"
        if OmegaConf.is_missing(plain, name):
            raise _not_given(key)
        if OmegaConf.is_dict(plain[name]) and OmegaConf.is_list(typed.get(name)):
            text = allowed(key, OmegaConf.get_type(typed))
            raise ConfigError(f"{key} must be {text}, got {shown(plain[name])}")


def _saved_option(group: str, plain: Any) -> type[Option]:
    known = schemas()[group]
    name = plain.get("name") if OmegaConf.is_dict(plain) else None
    if not isinstance(name, str) or name not in known:
        raise ConfigError(
            f"{group} must be one of {', '.join(sorted(known))}, got {name!r}: options of your own "
            "come with an installed package or with --config-dir <folder>"
        )
    return known[name]


def compose(
    overrides: Sequence[str] = (),
    root: type[Root] = Config,  # type: ignore[assignment]
    run: Config | None = None,
) -> Root:
    """Returns the checked configuration of a command line.

    Args:
        overrides: as on the command line, such as ``["agent=dqn", "protocol.rounds=20"]``.
        root: :class:`Config` for a training, :class:`EvaluateConfig` for an evaluation.
        run: a run that provides the default options and keys.

    Raises:
        ConfigError: one sentence that names the wrong key and its allowed values.

    Examples:
        >>> compose(["agent=dqn"]).explore.name
        'epsilon_greedy'
        >>> compose(["env=domain_ext"]).protocol.rounds
        200
    """
    with session():
        return to_config(compose_raw(overrides, root, run), root)
