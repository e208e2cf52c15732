"""The configuration in a run folder: writing, reading (also earlier versions) and resuming."""

from __future__ import annotations

import dataclasses
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from bbq_torchrl.options import Config
from bbq_torchrl.options.registry import EXPERIMENT
from bbq_torchrl.runs.compose import (
    load_yaml,
    options_of,
    read_config,
    run_of,
    take_values,
    to_config,
)
from bbq_torchrl.runs.folders import quoted, run_lock
from bbq_torchrl.runs.overrides import key_of, not_an_option
from bbq_torchrl.settings import ConfigError, walk
from bbq_torchrl.utils.files import CONFIG, CURVE, RESULT, write_text
from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from contextlib import ExitStack

    from bbq_torchrl.evaluation.run_result import RunResult

NOT_SWEPT = "resume cannot be combined with --multirun"

ANOTHER_SWEEP = (
    "the same command continues a sweep; give another hydra.sweep.dir, or a hydra.sweep.subdir "
    "with a separate folder for each job"
)

CHANGEABLE = (
    "protocol.rounds",
    "protocol.keep_checkpoints",
    "logger",
    "device",
    "domain.path",  # a folder may be moved
)
"""Keys and groups that may be changed with ``resume``."""

_NOT_OF_THE_TRAINING = (
    *CHANGEABLE,
    "resume",
    "threads",
    "protocol.checkpoint_every",
    "protocol.eval_dialogues",
    "protocol.eval_batch",
    "protocol.eval_every",
    "protocol.eval_every_dialogues",
    "agent.evaluate",
    "agent.evaluate_draws",
)
"""Keys and groups that a checkpoint does not depend on."""

_ADDED = {"intrinsic": {"name": "none"}, "protocol": {"eval_every": 0}}
"""Groups and keys missing in configurations of earlier versions -> their effective values."""

_REMOVED_KEYS = ("cuda_graph",)
"""Keys of earlier versions without effect on results."""


def config_fingerprint(config: Config) -> dict[str, Any]:
    """Returns the settings that a checkpoint depends on, as JSON values by dotted key."""
    return {
        key: value
        for key, _, value in walk(config)
        if not {key, key.partition(".")[0]} & set(_NOT_OF_THE_TRAINING)
    }


def result_of(folder: Path, rounds: int) -> RunResult | None:
    """Returns the result of a folder; None if it is missing, unreadable or of other rounds."""
    if not (folder / RESULT).is_file():
        return None
    # Imported here, since it takes a second and most folders have no result.
    from bbq_torchrl.evaluation.run_result import read_result

    try:
        result = read_result(folder)
    except (OSError, ValueError):
        return None
    return result if result.rounds == rounds else None


def is_finished(folder: Path, rounds: int) -> bool:
    """Returns whether a run folder has the result of so many rounds, and the curve."""
    return result_of(folder, rounds) is not None and (folder / CURVE).is_file()


def run_config(folder: Path) -> Config:
    """Returns the configuration of a run folder.

    Raises:
        ConfigError: the folder is missing or not a run folder.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder} is not a run folder: there is no such folder")
    if not (folder / CONFIG).is_file():
        raise ConfigError(f"{folder} is not a run folder: it has no {CONFIG}")
    return load_config(folder / CONFIG)


def save_config(config: Config, file: Path) -> None:
    """Writes a configuration as YAML, atomically."""
    write_text(file, OmegaConf.to_yaml(OmegaConf.structured(config)))


def load_config(file: Path) -> Config:
    """Reads a configuration that :func:`save_config` wrote; missing keys take their defaults.

    Raises:
        ConfigError: the configuration is unreadable or invalid.
    """
    plain = load_yaml(file, "a run")
    if not isinstance(plain, DictConfig):
        raise ConfigError(f"{file} must hold a mapping of groups, got a list")
    for key, value in _references(OmegaConf.to_container(plain, resolve=False)):
        raise ConfigError(f"{file}: {key} must be a value, not a reference, got {shown(value)}")
    for key in _REMOVED_KEYS:
        plain.pop(key, None)
    try:
        is_whole = OmegaConf.is_dict(plain.get("protocol"))
        complete = OmegaConf.merge(plain, _ADDED, plain) if is_whole else plain
        assert isinstance(complete, DictConfig)
        _rename(complete)
        return read_config(complete)
    except (ConfigError, OmegaConfBaseException) as error:
        raise ConfigError(f"{file}: {sentence(error)}") from error


def _references(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Yields dotted keys and texts that OmegaConf would resolve, such as ``${oc.env:HOME}``."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield from _references(part, f"{key}.{name}".strip("."))
    elif isinstance(value, list):
        for number, part in enumerate(value):
            yield from _references(part, f"{key}[{number}]")
    elif isinstance(value, str) and "${" in value:
        yield key, value


def _rename(plain: DictConfig) -> None:
    """Translates keys and values of 0.1.0's strategies to today's."""
    if OmegaConf.select(plain, "spike.dialogues") == 0:
        plain.spike.policy = None  # was "rule" with no dialogues
    explore, rounds = plain.get("explore"), OmegaConf.select(plain, "protocol.rounds")
    if not OmegaConf.is_dict(explore):
        return
    if explore.get("name") in ("bootstrap", "thompson") and explore.get("per") == "dialogue":
        explore.per = "episode"
    if explore.get("name") in ("boltzmann", "epsilon_greedy", "thompson_epsilon"):
        fall = explore.get("anneal_rounds")
        if isinstance(fall, int) and isinstance(rounds, int):
            explore.anneal_fraction = min(1.0, explore.pop("anneal_rounds") / max(1, rounds))


class Resumption(NamedTuple):
    """A run to resume.

    Attributes:
        folder: the run folder.
        run: its configuration.
        overrides: the command line's other overrides.
    """

    folder: Path
    run: Config
    overrides: Sequence[str]

    @classmethod
    def of(cls, overrides: Sequence[str], locks: ExitStack) -> Resumption | None:
        """Returns the run that ``resume=`` names on a command line; None without ``resume=``.

        Args:
            overrides: the command line.
            locks: the stack that releases the lock of the run folder.

        Raises:
            ConfigError: not a run folder, one in use, or an option that contradicts the run.
        """
        given = run_of(overrides, "resume")
        if not given:
            return None
        folder = Path(expanduser(given)).resolve()
        if (folder / CONFIG).is_file():
            locks.enter_context(run_lock(folder))
        run = run_config(folder)
        if (refusal := not_an_option(overrides, Config)) is not None:
            raise ConfigError(refusal)
        rest = []
        for override in overrides:
            key, value = key_of(override), override.partition("=")[2]
            is_option = dataclasses.is_dataclass(getattr(run, key, None)) and key not in CHANGEABLE
            if is_option and value.strip("'\"") == _value(run, key):
                continue  # as in the run
            if is_option or key.partition("/")[0] == EXPERIMENT or key == "hydra.run.dir":
                raise _contradiction(override, folder)
            if not override.startswith(("resume=", "++resume=")):
                rest.append(override)
        return cls(folder, run, rest)

    def arguments(self) -> list[str]:
        """Returns the command line with the options of the run."""
        options = options_of(self.run, self.overrides)
        return [*options, *self.overrides, f"resume={quoted(self.folder)}"]

    def config(self, composed: DictConfig) -> Config:
        """Returns the configuration of the run with the changes of the command line.

        Args:
            composed: the configuration composed from :meth:`arguments`; the run's values are set
                in it.

        Raises:
            ConfigError: the run is finished, or an override contradicts it.
        """
        if composed.hydra.mode is RunMode.MULTIRUN:
            raise ConfigError(NOT_SWEPT)
        run, folder = self.run, self.folder
        take_values(composed, run, [*self.overrides, "resume="])
        config = to_config(composed, Config)
        for override in self.overrides:
            key = key_of(override)
            changes = _value(config, key) != _value(run, key)
            if changes and not {key, key.partition(".")[0]} & set(CHANGEABLE):
                raise _contradiction(override, folder)
        rounds = config.protocol.rounds
        if rounds < run.protocol.rounds:
            raise ConfigError(
                f"protocol.rounds must be at least {run.protocol.rounds}, which {folder} was "
                f"started with, got {rounds}"
            )
        if is_finished(folder, rounds):
            only = " of a run with protocol.keep_checkpoints=last"
            extended = only if config.protocol.keep_checkpoints == "weights" else ""
            raise ConfigError(
                f"the run in {folder} is finished ({rounds} rounds): protocol.rounds=<more> "
                f"continues beyond the end{extended}"
            )
        return config


def _contradiction(override: str, folder: Path) -> ConfigError:
    return ConfigError(
        f"{override} contradicts the run in {folder}: with resume only "
        f"{', '.join(CHANGEABLE)} can be given"
    )


def restarted_config(config: Config, folder: Path, *, way: str = ANOTHER_SWEEP) -> Config:
    """Returns the configuration of a job or trial; it resumes the run in the folder, if any.

    Launchers restart a job whose worker died (Ray) or that ran out of time (SLURM).

    Args:
        config: the job's configuration for a new run.
        folder: the job's run folder.
        way: advice for a folder with another run. Defaults to that for a sweep.

    Raises:
        ConfigError: the folder has a run of another configuration.
    """
    if not (folder / CONFIG).is_file():
        return config
    if run_config(folder) != dataclasses.replace(config, resume=None):
        raise ConfigError(f"{folder} already holds another run: {way}")
    return dataclasses.replace(config, resume=str(folder))


def _value(config: Any, key: str) -> Any:
    """Returns the value of a dotted key; for a group the name of its option."""
    for name in key.split("."):
        config = getattr(config, name, None)
    return getattr(config, "name", config)
