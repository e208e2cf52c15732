"""The configuration in a run folder: written, read, also of earlier versions, and gone on with."""

from __future__ import annotations

import dataclasses
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from bbq_torchrl.options import Config
from bbq_torchrl.options.registry import EXPERIMENT
from bbq_torchrl.options.settings import ConfigError, walk
from bbq_torchrl.run_folder import CONFIG, CURVE, RESULT, write_text
from bbq_torchrl.runs.compose import compose_raw, load_yaml, read_config, run_of, to_config
from bbq_torchrl.runs.overrides import key_of, not_an_option
from bbq_torchrl.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from bbq_torchrl.evaluation.results import RunResult

NOT_SWEPT = "resume cannot be combined with --multirun"

ANOTHER_SWEEP = (
    "a sweep goes on by the same command; give another hydra.sweep.dir, or a hydra.sweep.subdir "
    "with a folder of its own for each job"
)

CHANGEABLE = (
    "protocol.rounds",
    "protocol.keep_checkpoints",
    "logger",
    "device",
    "domain.path",  # a folder may be moved
)
"""What may be given beside ``resume``; the rest is the run's own."""

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
"""Keys, and groups, that a checkpoint does not depend on."""

_ADDED = {"intrinsic": {"name": "none"}, "protocol": {"eval_every": 0}}
"""Groups and keys that configurations of earlier versions lack, and what those versions did."""

_REMOVED_KEYS = ("cuda_graph",)
"""Keys of earlier versions that changed no number."""


def description(config: Config) -> dict[str, Any]:
    """What a checkpoint of a run depends on, as JSON values by dotted key."""
    return {
        key: value
        for key, _, value in walk(config)
        if not {key, key.partition(".")[0]} & set(_NOT_OF_THE_TRAINING)
    }


def result_of(folder: Path, rounds: int) -> RunResult | None:
    """The final evaluation of a training of so many rounds; None if there is none to be read."""
    if not (folder / RESULT).is_file():
        return None
    # Imported here: it takes a second, and most folders have none.
    from bbq_torchrl.evaluation.results import read_result

    try:
        result = read_result(folder)
    except (OSError, ValueError):
        return None
    return result if result.rounds == rounds else None


def is_finished(folder: Path, rounds: int) -> bool:
    """Whether nothing is left to do in a run folder whose configuration asks for so many rounds."""
    return result_of(folder, rounds) is not None and (folder / CURVE).is_file()


def run_config(folder: Path) -> Config:
    """The configuration of a run folder.

    Raises:
        ConfigError: the folder is not there, or is no run folder.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder} is not a run folder: there is no such folder")
    if not (folder / CONFIG).is_file():
        raise ConfigError(f"{folder} is not a run folder: it has no {CONFIG}")
    return load_config(folder / CONFIG)


def save_config(config: Config, file: Path) -> None:
    """Writes a configuration as YAML, atomically, so that a reader never sees half of it."""
    write_text(file, OmegaConf.to_yaml(OmegaConf.structured(config)))


def load_config(file: Path) -> Config:
    """Reads a configuration that :func:`save_config` wrote; keys it lacks take their defaults.

    Raises:
        ConfigError: no readable configuration, or one that cannot be run.
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
    """Yields dotted keys and texts that OmegaConf would resolve, by the environment for one."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield from _references(part, f"{key}.{name}".strip("."))
    elif isinstance(value, list):
        for number, part in enumerate(value):
            yield from _references(part, f"{key}[{number}]")
    elif isinstance(value, str) and "${" in value:
        yield key, value


def _rename(plain: DictConfig) -> None:
    """Says what our strategies of 0.1.0 did by the keys and words of today."""
    if OmegaConf.select(plain, "spike.dialogues") == 0:
        plain.spike.policy = None  # which said "rule", of no dialogues
    explore, rounds = plain.get("explore"), OmegaConf.select(plain, "protocol.rounds")
    if not OmegaConf.is_dict(explore):
        return
    if explore.get("name") in ("bootstrap", "thompson") and explore.get("per") == "dialogue":
        explore.per = "episode"
    if explore.get("name") in ("boltzmann", "epsilon_greedy", "thompson_epsilon"):
        fall = explore.get("anneal_rounds")
        if isinstance(fall, int) and isinstance(rounds, int):
            explore.anneal_fraction = min(1.0, explore.pop("anneal_rounds") / max(1, rounds))


def folder_to_resume(overrides: Sequence[str]) -> Path | None:
    """The folder that ``resume=`` names on a command line; None where a run is to begin."""
    given = run_of(overrides, "resume")
    return Path(expanduser(given)).resolve() if given else None


def resumed(folder: Path, overrides: Sequence[str]) -> tuple[DictConfig, Config]:
    """The configuration of the run in a folder, with the changes that a command line may make.

    Args:
        folder: the run folder.
        overrides: the command line, which is read on the values of the run.

    Returns:
        what Hydra composed, with its own part, and the configuration.

    Raises:
        ConfigError: no run folder, a finished run, an override that contradicts the run, or a run
            that cannot be gone on with so.
    """
    run = run_config(folder)
    if (refusal := not_an_option(overrides, Config)) is not None:
        raise ConfigError(refusal)

    def contradiction(override: str) -> ConfigError:
        return ConfigError(
            f"{override} contradicts the run in {folder}: beside resume only "
            f"{', '.join(CHANGEABLE)} can be given"
        )

    rest = []
    for override in overrides:
        key, value = key_of(override), override.partition("=")[2]
        is_option = dataclasses.is_dataclass(getattr(run, key, None)) and key not in CHANGEABLE
        if is_option and value.strip("'\"") == _value(run, key):
            continue  # the run's own
        if is_option or key.partition("/")[0] == EXPERIMENT or key == "hydra.run.dir":
            raise contradiction(override)
        if not override.startswith(("resume=", "++resume=")):
            rest.append(override)
    composed = compose_raw(rest, run=run)
    if composed.hydra.mode is RunMode.MULTIRUN:
        raise ConfigError(NOT_SWEPT)
    config = to_config(composed, Config)
    config.resume = str(folder)
    for override in rest:
        key = key_of(override)
        changes = _value(config, key) != _value(run, key)
        if changes and not {key, key.partition(".")[0]} & set(CHANGEABLE):
            raise contradiction(override)
    rounds = config.protocol.rounds
    if rounds < run.protocol.rounds:
        raise ConfigError(
            f"protocol.rounds must be at least {run.protocol.rounds}, which {folder} was started "
            f"with, got {rounds}"
        )
    if is_finished(folder, rounds):
        only = " of a run with protocol.keep_checkpoints=last"
        extended = only if config.protocol.keep_checkpoints == "weights" else ""
        raise ConfigError(
            f"the run in {folder} is finished ({rounds} rounds): protocol.rounds=<more> goes on "
            f"beyond the end{extended}"
        )
    return composed, config


def restarted_config(config: Config, folder: Path, *, way: str = ANOTHER_SWEEP) -> Config:
    """The configuration of a job of a sweep or a trial of a search: it resumes what is there.

    Launchers start a job again whose worker died (Ray) or that ran out of time (SLURM).

    Args:
        config: of the job, as if it were new.
        folder: the job's run folder.
        way: what to do where the folder holds another run. Defaults to that of a sweep.

    Raises:
        ConfigError: the folder holds a run of another configuration.
    """
    if not (folder / CONFIG).is_file():
        return config
    if run_config(folder) != dataclasses.replace(config, resume=None):
        raise ConfigError(f"{folder} already holds another run: {way}")
    return dataclasses.replace(config, resume=str(folder))


def _value(config: Any, key: str) -> Any:
    """The value of a dotted key; the option's name where the key is a group."""
    for name in key.split("."):
        config = getattr(config, name, None)
    return getattr(config, "name", config)
