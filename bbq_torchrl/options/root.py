"""The root schemas of the configurations: training, evaluation and calibration."""

from __future__ import annotations

from dataclasses import dataclass

from bbq_torchrl.options.agent import AgentOption  # noqa: TC001 (OmegaConf reads them)
from bbq_torchrl.options.domain import DomainOption  # noqa: TC001
from bbq_torchrl.options.env import EnvOption  # noqa: TC001
from bbq_torchrl.options.explore import ExploreOption  # noqa: TC001
from bbq_torchrl.options.intrinsic import IntrinsicOption  # noqa: TC001
from bbq_torchrl.options.logger import LoggerOption  # noqa: TC001
from bbq_torchrl.options.protocol import ProtocolOption  # noqa: TC001
from bbq_torchrl.options.settings import (
    ANY_TEXT,
    BATCH,
    COUNT,
    PROBABILITY,
    REQUIRED,
    SEED,
    SIZE,
    THREADS,
    Allowed,
    integers,
    one_of,
    optional,
    setting,
)
from bbq_torchrl.options.spike import SpikeOption  # noqa: TC001

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
