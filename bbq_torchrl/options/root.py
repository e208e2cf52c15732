"""The root schemas of the commands, registered with Hydra, and what two options must agree on.

Options of other packages add such checks in the same way::

    @agreement
    def check_my_pair(config: Config) -> None: ...
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from bbq_torchrl.options.agent import BBQN, DQN, GP, AgentOption
from bbq_torchrl.options.env import DomainOption, EnvOption, FullDomain
from bbq_torchrl.options.explore import ExploreOption, IntrinsicOption
from bbq_torchrl.options.logger import LoggerOption
from bbq_torchrl.options.protocol import ProtocolOption, SpikeOption
from bbq_torchrl.options.registry import Option, conf_folder, explorations, schemas
from bbq_torchrl.options.task import lists
from bbq_torchrl.settings import (
    ANY_TEXT,
    BATCH,
    COUNT,
    PROBABILITY,
    REQUIRED,
    SEED,
    SIZE,
    THREADS,
    Allowed,
    ConfigError,
    check_values,
    integers,
    one_of,
    optional,
    setting,
)

PLAYED = integers(1, 10**7)
DEVICE = Allowed(
    "'cpu', 'cuda' or 'cuda:<number>'",
    lambda value: (
        value in ("cpu", "cuda")
        or (isinstance(value, str) and value.startswith("cuda:") and value[5:].isdigit())
    ),
)


@dataclass
class Config:
    """A training run: the root of the configuration of ``train.py``."""

    agent: AgentOption = REQUIRED  # type: ignore[assignment]
    explore: ExploreOption = REQUIRED  # type: ignore[assignment]
    intrinsic: IntrinsicOption = REQUIRED  # type: ignore[assignment]
    env: EnvOption = REQUIRED  # type: ignore[assignment]
    domain: DomainOption = REQUIRED  # type: ignore[assignment]
    spike: SpikeOption = REQUIRED  # type: ignore[assignment]
    protocol: ProtocolOption = REQUIRED  # type: ignore[assignment]
    logger: LoggerOption = REQUIRED  # type: ignore[assignment]
    replicas: int = setting(1, SIZE, "independent seeds trained in parallel")
    seed: int = setting(0, SEED, "seed of all random numbers")
    device: str = setting("cpu", DEVICE, "device of all tensors")
    threads: int = setting(1, THREADS, "CPU threads of torch")
    resume: str | None = setting(
        None, optional(ANY_TEXT, "a new run"), "run folder of the run to continue"
    )


@dataclass
class _Played:
    """The keys of commands that play dialogues without learning."""

    env: EnvOption = REQUIRED  # type: ignore[assignment]
    domain: DomainOption = REQUIRED  # type: ignore[assignment]
    batch: int = setting(2_500, BATCH, "dialogues played in parallel")
    seed: int = setting(0, SEED, "seed of all random numbers")
    device: str = setting("cpu", DEVICE, "device of all tensors")
    threads: int = setting(1, THREADS, "CPU threads of torch")


@dataclass
class EvaluateConfig(_Played):
    """An evaluation: the root of the configuration of ``bbq evaluate``."""

    policy: str = setting(
        REQUIRED, ANY_TEXT, "random, clairvoyant, a script, a run folder, or shipped:<name>"
    )
    dialogues: int = setting(10_000, PLAYED, "dialogues played, by each replica of a run folder")
    mode: str | None = setting(
        None, optional(ANY_TEXT, "the agent's default"), "mean, average, draw or thompson, for bbqn"
    )
    weights: str = setting(
        "last", one_of("last", "best"), "the latest, or each replica's at its best evaluation"
    )
    log: str | None = setting(None, optional(ANY_TEXT, "none"), "file for readable dialogues")
    log_dialogues: int = setting(10, COUNT, "dialogues written to log")


@dataclass
class CalibrateConfig(_Played):
    """The root of the configuration of ``bbq domains calibrate``."""

    policy: str = setting("rule", ANY_TEXT, "scripted policy of the domain")
    success: float = setting(0.183, PROBABILITY, "success rate to calibrate for")
    dialogues: int = setting(100_000, PLAYED, "dialogues played for each probability tried")


_AGREEMENTS: dict[str, Callable[[Config], None]] = {}


def agreement(check: Callable[[Config], None]) -> Callable[[Config], None]:
    """Registers a check of a training's configuration; a decorator.

    The check raises :class:`~bbq_torchrl.settings.ConfigError` for invalid combinations.
    """
    _AGREEMENTS[f"{check.__module__}.{check.__qualname__}"] = check
    return check


def validate(config: Config | EvaluateConfig | CalibrateConfig) -> None:
    """Refuses an invalid configuration.

    Raises:
        ConfigError: one sentence that names the key, its value and what is allowed.
    """
    if isinstance(config, Config):
        # First, so that an error names the key that was given: other keys take over its values.
        check_values(config.env, "env.")
        check_values(config.protocol, "protocol.")
    check_values(config)
    for part in vars(config).values():
        if isinstance(part, Option):
            part.check()
    if isinstance(config, Config):
        for check in _AGREEMENTS.values():
            check(config)


@agreement
def _check_pair(config: Config) -> None:
    """Refuses a strategy that requires what the agent does not provide."""
    agent, explore = config.agent.name, config.explore.name
    allowed = explorations()[agent]
    if explore not in allowed:
        raise ConfigError(
            f"explore must be one of {', '.join(allowed)} with agent={agent}, got {explore}"
        )


@agreement
def _check_lists(config: Config) -> None:
    """Refuses lists whose values the replicas cannot share."""
    for key, value in lists(config):
        if config.replicas % len(value):
            raise ConfigError(
                f"{key} must be one value or a list of a number that divides the "
                f"{config.replicas} replicas, got {len(value)}: {value}"
            )


@agreement
def _check_agent(config: Config) -> None:
    """Refuses settings of other groups that the agent cannot learn with."""
    agent, capacity = config.agent, config.protocol.capacity
    if isinstance(agent, DQN) and "noise" in config.explore.requires and not agent.noisy:
        raise ConfigError(f"agent.noisy must be true with explore={config.explore.name}, got false")
    if isinstance(agent, GP) and agent.inducing > capacity:
        raise ConfigError(
            f"agent.inducing must be at most protocol.capacity ({capacity}), the transitions to "
            f"choose them from, got {agent.inducing}"
        )
    if isinstance(agent, GP) and config.spike.margin:
        raise ConfigError(
            f"spike.margin must be 0 with agent=gp, which learns no margin, got "
            f"{config.spike.margin:g}"
        )
    if isinstance(agent, BBQN) and agent.kl == "sampled" and config.env.extends:
        raise ConfigError(
            f"agent.kl must be closed with env={config.env.name}, got 'sampled', which moves the "
            "weights of slots that are not yet active"
        )


@agreement
def _check_level(config: Config) -> None:
    """Refuses sentences in training."""
    if isinstance(config.env, FullDomain) and config.env.level == "text":
        raise ConfigError(
            "env.level must be act in training, got 'text': sentences are too slow for it; "
            "env.errors=measured has the errors counted in sentences"
        )


ROOTS = {Config: "config", EvaluateConfig: "evaluate", CalibrateConfig: "calibrate"}
"""Schema of a root -> its YAML file."""

_stored: set[type] = set()


def register_options() -> None:
    """Registers the roots and all options with Hydra's configuration store.

    ``conf/<group>/<option>.yaml`` has the keys of an option of ours with their defaults, and
    includes its schema, which has their types; ``scripts/write_docs.py`` writes these files. An
    option of your own needs no file.
    """
    from hydra.core.config_store import ConfigStore

    store = ConfigStore.instance()
    for root, name in ROOTS.items():
        store.store(name=f"_{name}", node=root)
    for group, known in schemas().items():
        for name, option in known.items():
            if option in _stored:
                continue
            _stored.add(option)
            store.store(name=f"_{group}_{name}", node=option)
            if capacity := getattr(option, "buffer_capacity", None):
                store.store(name=f"_{group}_{name}_buffer", node={"capacity": capacity})
            if not (conf_folder() / group / f"{name}.yaml").is_file():
                store.store(group=group, name=name, node={"defaults": defaults(option)})


def defaults(option: type[Option]) -> list[Any]:
    """Returns the defaults list of an option: its schema, and an agent's strategy and buffer."""
    schema = f"/_{option.group}_{option.name}"
    chosen = getattr(option, "explores_by", None)
    own: list[Any] = [{"override /explore@_global_.explore": chosen}] if chosen else []
    if getattr(option, "buffer_capacity", None):
        own.insert(0, f"{schema}_buffer@_global_.protocol")
    return [f"{schema}@_here_", *own, "_self_"]
