"""The root schemas of training, evaluation and calibration, and what two options must agree on.

Options of other packages add such checks in the same way::

    @agreement
    def check_my_pair(config: Config) -> None: ...
"""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields

from bbq_torchrl.options.agent import (
    BBQN,
    DQN,
    GP,
    AgentOption,
)
from bbq_torchrl.options.domain import DomainOption  # noqa: TC001
from bbq_torchrl.options.env import (
    EnvOption,
    FullDomain,
)
from bbq_torchrl.options.explore import ExploreOption  # noqa: TC001
from bbq_torchrl.options.intrinsic import IntrinsicOption  # noqa: TC001
from bbq_torchrl.options.logger import LoggerOption  # noqa: TC001
from bbq_torchrl.options.protocol import ProtocolOption  # noqa: TC001
from bbq_torchrl.options.registry import Option, explorations
from bbq_torchrl.options.spike import SpikeOption  # noqa: TC001
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
class EvaluateConfig:
    """An evaluation: the root of the configuration of ``bbq evaluate``."""

    env: EnvOption = REQUIRED  # type: ignore[assignment]
    domain: DomainOption = REQUIRED  # type: ignore[assignment]
    policy: str = setting(
        REQUIRED,
        ANY_TEXT,
        "random, a scripted policy of the domain (rule, ...), the privileged clairvoyant, a run "
        "folder, or shipped:<name>",
    )
    dialogues: int = setting(10_000, PLAYED, "dialogues played, by each replica of a run folder")
    batch: int = setting(2_500, BATCH, "dialogues played in parallel")
    mode: str | None = setting(
        None,
        optional(ANY_TEXT, "the agent's default"),
        "policy of an agent with several, such as bbqn: mean network, average of draws, one draw, "
        "or thompson, a new draw at every step",
    )
    weights: str = setting(
        "last",
        one_of("last", "best"),
        "a run's weights: the latest, or each replica's at its best evaluation during training",
    )
    log: str | None = setting(None, optional(ANY_TEXT, "none"), "file for readable dialogues")
    log_dialogues: int = setting(10, COUNT, "dialogues written to log")
    seed: int = setting(0, SEED, "seed of all random numbers")
    device: str = setting("cpu", DEVICE, "device of all tensors")
    threads: int = setting(1, THREADS, "CPU threads of torch")


@dataclass
class CalibrateConfig:
    """The root of the configuration of ``python -m bbq_torchrl.domains calibrate``."""

    env: EnvOption = REQUIRED  # type: ignore[assignment]
    domain: DomainOption = REQUIRED  # type: ignore[assignment]
    policy: str = setting("rule", ANY_TEXT, "scripted policy of the domain")
    success: float = setting(0.183, PROBABILITY, "success rate to calibrate for")
    dialogues: int = setting(100_000, PLAYED, "dialogues played for each probability tried")
    batch: int = setting(2_500, BATCH, "dialogues played in parallel")
    seed: int = setting(0, SEED, "seed of all random numbers")
    device: str = setting("cpu", DEVICE, "device of all tensors")
    threads: int = setting(1, THREADS, "CPU threads of torch")


Agreement = Callable[[Config], None]

_AGREEMENTS: dict[str, Agreement] = {}

FIXED_ROWS = 200
"""The fixed cost of an update, or of a step of parallel dialogues, in rows.

With it the time per row, measured on a CPU core for BBQN and DQN, batches of 32 and 128, 50 to
1,000 dialogues, one and five replicas, is within a factor of two of its mean.
"""


def agreement(check: Agreement) -> Agreement:
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
    if not isinstance(config, Config):
        return
    _check_pair(config)
    _check_lists(config)
    for item in fields(config):
        part = getattr(config, item.name)
        if isinstance(part, Option):
            _check_alone(part, config)
    for check in _AGREEMENTS.values():
        check(config)


def _check_alone(part: Option, config: Config) -> None:
    """Calls an option's ``check``, which in its old form takes the configuration."""
    if inspect.signature(part.check).parameters:
        warnings.warn(
            f"{type(part).__qualname__}.check(config) will have no argument: what two options "
            "must agree on is a function with @bbq_torchrl.options.agreement",
            DeprecationWarning,
            stacklevel=2,
        )
        part.check(config)  # type: ignore[call-arg]
    else:
        part.check()


def _check_pair(config: Config) -> None:
    agent, explore = config.agent.name, config.explore.name
    allowed = explorations()[agent]
    if explore not in allowed:
        raise ConfigError(
            f"agent={agent} cannot be combined with explore={explore}: "
            f"explore must be one of {', '.join(allowed)}"
        )


def _check_lists(config: Config) -> None:
    """Checks that the replicas can share the values of each list."""
    for key, value in lists(config):
        if config.replicas % len(value):
            raise ConfigError(
                f"{key} must be one value or a list of {config.replicas} (one for each of the "
                f"replicas) or of a number that divides {config.replicas}, got {len(value)}: "
                f"{value}"
            )


@agreement
def _check_noise(config: Config) -> None:
    """Refuses a strategy that needs noise for a network without noise."""
    agent, explore = config.agent, config.explore
    if isinstance(agent, DQN) and "noise" in explore.requires and not agent.noisy:
        raise ConfigError(
            f"explore={explore.name} needs a network with noise: agent.noisy must be true"
        )


@agreement
def _check_inducing(config: Config) -> None:
    """Refuses more inducing states than transitions to choose them from."""
    agent, capacity = config.agent, config.protocol.capacity
    if isinstance(agent, GP) and agent.features == "states" and agent.inducing > capacity:
        raise ConfigError(
            f"agent.inducing must be at most protocol.capacity ({capacity}), the transitions to "
            f"choose them from, got {agent.inducing}"
        )


@agreement
def _check_imitation(config: Config) -> None:
    """Refuses imitation by an agent that learns nothing by gradient."""
    agent, margin = config.agent, config.spike.margin
    if isinstance(agent, GP) and agent.features == "states" and margin:
        raise ConfigError(
            f"spike.margin must be 0 with agent.features=states, which learns no margin, got "
            f"{margin:g}"
        )


@agreement
def _check_kl(config: Config) -> None:
    """Refuses a sampled KL with domain extension."""
    if config.env.extends and isinstance(config.agent, BBQN) and config.agent.kl == "sampled":
        raise ConfigError(
            f"env={config.env.name} cannot be combined with agent.kl=sampled: the sampled "
            "estimate moves the weights of slots that are not yet active, so agent.kl must be "
            "closed"
        )


@agreement
def _check_level(config: Config) -> None:
    """Refuses sentences in training."""
    if isinstance(config.env, FullDomain) and config.env.level == "text":
        raise ConfigError(
            "env.level must be act in training, got 'text': sentences are too slow for it; "
            "env.errors=measured has the errors counted in sentences"
        )


@agreement
def _check_evaluation(config: Config) -> None:
    """Refuses evaluations that would take longer than the rounds between them.

    Both sides are counted, not timed: every step of parallel dialogues and every update counts 200
    plus its rows (dialogues or transitions of all replicas). Dialogues count with their maximal
    length, and the buffer as full as it gets.

    Raises:
        ConfigError: with both counts and the allowed values.
    """
    protocol, replicas = config.protocol, config.replicas
    if not protocol.eval_every or protocol.eval_every > protocol.rounds:
        return
    turns = config.env.steps()
    dialogues = protocol.eval_every_dialogues
    parallel = protocol.parallel_dialogues(dialogues, replicas)
    evaluation = math.ceil(dialogues / parallel) * turns * (FIXED_ROWS + replicas * parallel)
    stored = (config.spike.dialogues + protocol.rounds * protocol.dialogues) * turns
    updates = protocol.updates_per_round
    if updates is None:
        batches = math.ceil(min(protocol.capacity, stored) / protocol.batch_size)
        updates = protocol.freezes * protocol.epochs * batches
    a_round = turns * (FIXED_ROWS + replicas * protocol.dialogues)
    a_round += updates * (FIXED_ROWS + replicas * protocol.batch_size)
    if evaluation <= protocol.eval_every * a_round:
        return
    raise ConfigError(
        f"protocol.eval_every must be 0 or at least {math.ceil(evaluation / a_round)} with "
        f"protocol.eval_every_dialogues={dialogues}, got {protocol.eval_every}: an evaluation "
        f"would take longer than the training between two ({evaluation:,} against "
        f"{protocol.eval_every * a_round:,}, where a step or an update counts {FIXED_ROWS} and its "
        "rows)"
    )
