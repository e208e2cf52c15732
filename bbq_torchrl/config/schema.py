"""Every configuration key of the project, with its type, default, allowed values and meaning.

One dataclass for each option of each group; the YAML files in ``conf/`` choose among them. A class
says which option it describes by ``name``, which is also how a saved configuration finds its
classes again. Nothing here imports torch or Hydra.
"""

from __future__ import annotations

from dataclasses import MISSING as _ABSENT
from dataclasses import dataclass, fields

from bbq_torchrl.config.agents import (
    EVALUATION_MODES,
    AgentConfig,
    BBQNConfig,
    BootstrapConfig,
    DQNConfig,
)
from bbq_torchrl.config.explorations import (
    BoltzmannConfig,
    BootstrapSamplingConfig,
    EpsilonGreedyConfig,
    ExploreConfig,
    GreedyConfig,
    NoisyConfig,
    ThompsonConfig,
    ThompsonEpsilonConfig,
)
from bbq_torchrl.config.intrinsic import IntrinsicConfig, NoIntrinsicConfig, VIMEConfig
from bbq_torchrl.config.protocols import (
    CsvLoggerConfig,
    LoggerConfig,
    MLFlowLoggerConfig,
    NoSpikeConfig,
    PaperProtocolConfig,
    ProtocolConfig,
    QuickProtocolConfig,
    RuleSpikeConfig,
    SpikeConfig,
    TensorboardLoggerConfig,
    WandbLoggerConfig,
)
from bbq_torchrl.config.settings import (
    ANY_TEXT,
    COUNT,
    PROBABILITY,
    REQUIRED,
    SEED,
    THREADS,
    Allowed,
    one_of,
    optional,
    setting,
)
from bbq_torchrl.config.worlds import (
    DomainConfig,
    DomainExtensionConfig,
    EnvConfig,
    FolderDomainConfig,
    FullEnvConfig,
    MiuLabDomainConfig,
    MovieDomainConfig,
)

__all__ = [
    "EXPERIMENT",
    "SCHEMAS",
    "CalibrateConfig",
    "Config",
    "EvaluateConfig",
    "option_name",
]

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

    agent: AgentConfig = REQUIRED  # type: ignore[assignment]
    explore: ExploreConfig = REQUIRED  # type: ignore[assignment]
    intrinsic: IntrinsicConfig = REQUIRED  # type: ignore[assignment]
    env: EnvConfig = REQUIRED  # type: ignore[assignment]
    domain: DomainConfig = REQUIRED  # type: ignore[assignment]
    spike: SpikeConfig = REQUIRED  # type: ignore[assignment]
    protocol: ProtocolConfig = REQUIRED  # type: ignore[assignment]
    logger: LoggerConfig = REQUIRED  # type: ignore[assignment]
    replicas: int = setting(1, COUNT, "independent seeds trained side by side")
    seed: int = setting(0, SEED, "seed that all random numbers derive from")
    device: str = setting("cpu", DEVICE, "where tensors live")
    threads: int = setting(1, THREADS, "CPU threads of torch")
    resume: str | None = setting(
        None, optional(ANY_TEXT, "a new run"), "run folder of the run to go on with"
    )


@dataclass
class EvaluateConfig:
    """An evaluation: the root of the configuration of ``python -m bbq_torchrl.evaluate``."""

    env: EnvConfig = REQUIRED  # type: ignore[assignment]
    domain: DomainConfig = REQUIRED  # type: ignore[assignment]
    policy: str = setting(
        REQUIRED, ANY_TEXT, "random, a scripted policy of the domain (rule, careful, ...), or a run"
    )
    dialogues: int = setting(10_000, COUNT, "dialogues played; for each replica of a run folder")
    batch: int = setting(2_500, COUNT, "dialogues that run side by side")
    mode: str | None = setting(
        None,
        optional(one_of(*EVALUATION_MODES), "the agent's own"),
        "policy of a Bayesian agent: mean network, average of draws, one draw, or new draws at "
        "every step",
    )
    weights: str = setting(
        "last",
        one_of("last", "best"),
        "a run's weights: the newest, or each replica's at its best evaluation while training",
    )
    log: str | None = setting(None, optional(ANY_TEXT, "none"), "file for readable dialogues")
    log_dialogues: int = setting(10, COUNT, "dialogues written to log")
    seed: int = setting(0, SEED, "seed that all random numbers derive from")
    device: str = setting("cpu", DEVICE, "where tensors live")
    threads: int = setting(1, THREADS, "CPU threads of torch")


@dataclass
class CalibrateConfig:
    """The root of the configuration of ``python -m bbq_torchrl.domains calibrate``."""

    env: EnvConfig = REQUIRED  # type: ignore[assignment]
    domain: DomainConfig = REQUIRED  # type: ignore[assignment]
    policy: str = setting("rule", ANY_TEXT, "scripted policy of the domain")
    success: float = setting(0.183, PROBABILITY, "success rate that the policy is to have")
    dialogues: int = setting(100_000, COUNT, "dialogues played for each probability tried")
    batch: int = setting(2_500, COUNT, "dialogues that run side by side")
    seed: int = setting(0, SEED, "seed that all random numbers derive from")
    device: str = setting("cpu", DEVICE, "where tensors live")
    threads: int = setting(1, THREADS, "CPU threads of torch")


def option_name(schema: type) -> str:
    """The option that a schema class describes, such as ``bbqn``."""
    for item in fields(schema):
        if item.name == "name" and item.default is not _ABSENT:
            return str(item.default)
    raise TypeError(f"{schema.__name__} has no default for its field 'name'")


def _options(*schemas: type) -> dict[str, type]:
    return {option_name(schema): schema for schema in schemas}


SCHEMAS: dict[str, dict[str, type]] = {
    "agent": _options(BBQNConfig, DQNConfig, BootstrapConfig),
    "explore": _options(
        ThompsonConfig,
        EpsilonGreedyConfig,
        ThompsonEpsilonConfig,
        GreedyConfig,
        BoltzmannConfig,
        BootstrapSamplingConfig,
        NoisyConfig,
    ),
    "intrinsic": _options(NoIntrinsicConfig, VIMEConfig),
    "env": _options(FullEnvConfig, DomainExtensionConfig),
    "domain": _options(MovieDomainConfig, MiuLabDomainConfig, FolderDomainConfig),
    "spike": _options(RuleSpikeConfig, NoSpikeConfig),
    "protocol": _options(PaperProtocolConfig, QuickProtocolConfig),
    "logger": _options(
        CsvLoggerConfig, TensorboardLoggerConfig, WandbLoggerConfig, MLFlowLoggerConfig
    ),
}
"""group -> option -> the dataclass of its keys."""

EXPERIMENT = "experiment"
"""The group without a schema: files that fix options and keys of the others, added by a plus."""
