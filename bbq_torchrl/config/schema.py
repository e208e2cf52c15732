"""Every configuration key of the project, with its type, default, allowed values and meaning.

One dataclass for each option of each group; the YAML files in ``conf/`` choose among them. A class
says which option it describes by ``name``, which is also how a saved configuration finds its
classes again. This module imports neither torch nor Hydra.
"""

from __future__ import annotations

from dataclasses import MISSING as _ABSENT
from dataclasses import dataclass, fields
from typing import Any

from bbq_torchrl.config.settings import (
    ANY_TEXT,
    BELOW_ONE,
    BOOLEAN,
    COUNT,
    COUNTS,
    NON_NEGATIVE,
    NON_NEGATIVE_INTEGER,
    NUMBER,
    POSITIVE,
    PROBABILITY,
    Allowed,
    at_least,
    one_of,
    optional,
    or_text,
    setting,
)

__all__ = [
    "EXPERIMENT",
    "SCHEMAS",
    "AgentConfig",
    "BBQNConfig",
    "BoltzmannConfig",
    "Config",
    "CsvLoggerConfig",
    "DQNConfig",
    "DomainConfig",
    "DomainExtensionConfig",
    "EnvConfig",
    "EpsilonGreedyConfig",
    "EvaluateConfig",
    "ExploreConfig",
    "FolderDomainConfig",
    "FullEnvConfig",
    "GreedyConfig",
    "LoggerConfig",
    "MLFlowLoggerConfig",
    "MiuLabDomainConfig",
    "MovieDomainConfig",
    "NoSpikeConfig",
    "PaperProtocolConfig",
    "ProtocolConfig",
    "QuickProtocolConfig",
    "RuleSpikeConfig",
    "SpikeConfig",
    "TensorboardLoggerConfig",
    "ThompsonConfig",
    "ThompsonEpsilonConfig",
    "WandbLoggerConfig",
    "option_name",
]

REQUIRED = "???"
"""OmegaConf's mark for a value that somebody has to give."""

DEVICE = Allowed(
    "'cpu', 'cuda' or 'cuda:<number>'",
    lambda value: (
        value in ("cpu", "cuda")
        or (isinstance(value, str) and value.startswith("cuda:") and value[5:].isdigit())
    ),
)

EMPTY = Allowed("0, or be given with spike=rule", lambda value: value == 0)

EVALUATION_MODES = ("mean", "average", "draw")


def _name(option: str) -> Any:
    return setting(option, one_of(option), "the option of the group; chosen by <group>=<option>")


# ------------------------------------------------------------------------------------------ agent
@dataclass
class AgentConfig:
    """What every agent has: a Q-network of two hidden layers of 256 units, trained by Adam."""

    name: str = REQUIRED
    hidden: list[int] = setting([256, 256], COUNTS, "units of each hidden layer")
    lr: float = setting(1e-3, POSITIVE, "step size of Adam")
    gamma: float = setting(0.9, PROBABILITY, "discount of a turn")


@dataclass
class BBQNConfig(AgentConfig):
    """Bayes-by-Backprop Q-network: a Gaussian for every weight and bias."""

    name: str = _name("bbqn")
    prior_std: float | int | str = setting(
        0.1, or_text(POSITIVE, "fan_in"), "std of the prior; fan_in: sqrt(2 / fan-in) a layer"
    )
    mean_init: str = setting("zero", one_of("zero", "kaiming"), "where the posterior means start")
    std_init: float | None = setting(
        None, optional(POSITIVE, "prior_std"), "where the posterior stds start"
    )
    noise_std: float = setting(1.0, POSITIVE, "std of the noise on the target, in units of Q")
    kl: str = setting("closed", one_of("closed", "sampled"), "how KL(q || p) is computed")
    kl_temperature: float = setting(1.0, NON_NEGATIVE, "factor on the KL term")
    target: str = setting(
        "map", one_of("map", "mc"), "target by the frozen posterior's mean, or by one draw of it"
    )
    evaluate: str = setting(
        "mean", one_of(*EVALUATION_MODES), "policy evaluated: mean network, average of draws, draw"
    )
    evaluate_draws: int = setting(10, COUNT, "draws that evaluate=average takes the mean of")


@dataclass
class DQNConfig(AgentConfig):
    """Deep Q-network with dropout."""

    name: str = _name("dqn")
    dropout: float = setting(
        0.5,
        BELOW_ONE,
        "probability of dropping a hidden unit in the prediction",
    )
    double: bool = setting(False, BOOLEAN, "choose the target's action by the online network")


# ---------------------------------------------------------------------------------------- explore
@dataclass
class ExploreConfig:
    """What every exploration strategy has."""

    name: str = REQUIRED


@dataclass
class ThompsonConfig(ExploreConfig):
    """Draw weights from the posterior and act greedily on them."""

    name: str = _name("thompson")
    per: str = setting(
        "step", one_of("step", "dialogue", "round"), "how long one draw of the weights is kept"
    )
    shared: bool = setting(False, BOOLEAN, "one draw for all dialogues that run side by side")


@dataclass
class EpsilonGreedyConfig(ExploreConfig):
    """With probability epsilon a uniformly random legal action, else the greedy one."""

    name: str = _name("epsilon_greedy")
    eps_init: float = setting(0.1, PROBABILITY, "epsilon in the first round")
    eps_end: float = setting(0.01, PROBABILITY, "epsilon from the last annealed round on")
    anneal_rounds: int = setting(100, COUNT, "rounds over which epsilon falls, linearly")


@dataclass
class ThompsonEpsilonConfig(ExploreConfig):
    """Thompson sampling, and with probability epsilon a uniformly random legal action."""

    name: str = _name("thompson_epsilon")
    per: str = setting(
        "step", one_of("step", "dialogue", "round"), "how long one draw of the weights is kept"
    )
    shared: bool = setting(False, BOOLEAN, "one draw for all dialogues that run side by side")
    eps_init: float = setting(0.1, PROBABILITY, "epsilon in the first round")
    eps_end: float = setting(0.01, PROBABILITY, "epsilon from the last annealed round on")
    anneal_rounds: int = setting(100, COUNT, "rounds over which epsilon falls, linearly")


@dataclass
class GreedyConfig(ExploreConfig):
    """The action of the highest Q-value; no exploration."""

    name: str = _name("greedy")


@dataclass
class BoltzmannConfig(ExploreConfig):
    """Actions drawn from softmax(Q / temperature)."""

    name: str = _name("boltzmann")
    temperature_init: float = setting(1.0, POSITIVE, "temperature in the first round, units of Q")
    temperature_end: float = setting(1.0, POSITIVE, "temperature from the last annealed round on")
    anneal_rounds: int = setting(100, COUNT, "rounds over which the temperature moves, linearly")


# -------------------------------------------------------------------------------------------- env
@dataclass
class EnvConfig:
    """The user and the channel: what every environment has."""

    name: str = REQUIRED
    slot_error_prob: float | None = setting(
        None,
        optional(PROBABILITY, "the domain's calibrated difficulty"),
        "probability that an informed slot is hit by an error",
    )
    slot_error_mode: str = setting(
        "value", one_of("value", "slot", "delete", "mixed"), "what an error does to a slot"
    )
    intent_error_prob: float = setting(0.0, PROBABILITY, "probability of a random user act")
    max_turn: int = setting(40, at_least(2), "turns of a dialogue, both sides counted")
    success_reward: float = setting(40.0, NUMBER, "reward of a dialogue that succeeds")
    failure_reward: float = setting(-10.0, NUMBER, "reward of a dialogue that fails")
    turn_reward: float = setting(-1.0, NUMBER, "reward of a turn that does not end the dialogue")
    paper_rounds: int = setting(400, COUNT, "rounds of training in the paper")


@dataclass
class FullEnvConfig(EnvConfig):
    """All slots from the start."""

    name: str = _name("full")


@dataclass
class DomainExtensionConfig(EnvConfig):
    """The essential slots first; then the others one by one, in the domain's order."""

    name: str = _name("domain_ext")
    start: int = setting(40, NON_NEGATIVE_INTEGER, "round in which the first new slot appears")
    every: int = setting(10, COUNT, "rounds between two new slots")
    paper_rounds: int = setting(200, COUNT, "rounds of training in the paper")


# ----------------------------------------------------------------------------------------- domain
@dataclass
class DomainConfig:
    """What the dialogues are about."""

    name: str = REQUIRED


@dataclass
class MovieDomainConfig(DomainConfig):
    """The movie-booking corpus that ships with the package."""

    name: str = _name("movie")


@dataclass
class MiuLabDomainConfig(DomainConfig):
    """The public MiuLab files (TC-Bot), read safely; they are not part of this project."""

    name: str = _name("miulab")
    path: str = setting(REQUIRED, ANY_TEXT, "folder that holds the files")
    goals: str = setting("user_goals_first_turn_template.v2.p", ANY_TEXT, "file of user goals")
    kb: str = setting("movie_kb.1k.p", ANY_TEXT, "file of the knowledge base")
    values: str = setting("dicts.v3.p", ANY_TEXT, "file of the values that errors draw from")


@dataclass
class FolderDomainConfig(DomainConfig):
    """A domain folder: domain.yaml, knowledge_base.csv, goals.jsonl, values.json."""

    name: str = _name("folder")
    path: str = setting(REQUIRED, ANY_TEXT, "the folder")


# ------------------------------------------------------------------------- spike, protocol, logger
@dataclass
class SpikeConfig:
    """What is in the replay buffer before the first round."""

    name: str = REQUIRED
    dialogues: int = setting(100, NON_NEGATIVE_INTEGER, "scripted dialogues put into the buffer")
    policy: str = setting("rule", ANY_TEXT, "scripted policy of the domain that plays them")
    protect: bool = setting(True, BOOLEAN, "spiked transitions are never evicted")
    drop_above: float | None = setting(
        None,
        optional(BELOW_ONE, "never"),
        "training success above which a replica's spiked transitions are dropped for good",
    )
    drop_window: int = setting(5, COUNT, "rounds that drop_above takes the mean success of")


@dataclass
class RuleSpikeConfig(SpikeConfig):
    """Replay-buffer spiking: dialogues of a scripted policy."""

    name: str = _name("rule")


@dataclass
class NoSpikeConfig(SpikeConfig):
    """An empty buffer."""

    name: str = _name("none")
    dialogues: int = setting(0, EMPTY, "scripted dialogues put into the buffer")


@dataclass
class ProtocolConfig:
    """How long and in which steps an agent trains and is measured."""

    name: str = REQUIRED
    rounds: int = setting("${env.paper_rounds}", COUNT, "rounds of training")
    dialogues: int = setting(50, COUNT, "dialogues of a round and replica")
    batch_size: int = setting(32, COUNT, "transitions of an update")
    freezes: int = setting(2, COUNT, "target freezes of a round")
    epochs: int = setting(2, COUNT, "passes over the buffer after each freeze")
    capacity: int = setting(10_000, COUNT, "transitions a replica's buffer holds")
    eval_dialogues: int = setting(10_000, COUNT, "dialogues of the final evaluation of a replica")
    eval_batch: int = setting(2_500, COUNT, "evaluation dialogues that run side by side")
    checkpoint_every: int = setting(10, COUNT, "rounds between two checkpoints")


@dataclass
class PaperProtocolConfig(ProtocolConfig):
    """The paper's protocol."""

    name: str = _name("paper")


@dataclass
class QuickProtocolConfig(ProtocolConfig):
    """Under two minutes on one core: fewer rounds and a smaller buffer; it still learns visibly."""

    name: str = _name("quick")
    rounds: int = setting(40, COUNT, "rounds of training")
    capacity: int = setting(3_000, COUNT, "transitions a replica's buffer holds")
    eval_dialogues: int = setting(2_000, COUNT, "dialogues of the final evaluation of a replica")
    eval_batch: int = setting(2_000, COUNT, "evaluation dialogues that run side by side")


@dataclass
class LoggerConfig:
    """Where metrics go besides metrics.csv, which is always written."""

    name: str = REQUIRED


@dataclass
class CsvLoggerConfig(LoggerConfig):
    """CSV files only."""

    name: str = _name("csv")


@dataclass
class TensorboardLoggerConfig(LoggerConfig):
    """TensorBoard event files in the run folder."""

    name: str = _name("tensorboard")


@dataclass
class WandbLoggerConfig(LoggerConfig):
    """Weights & Biases."""

    name: str = _name("wandb")
    project: str = setting("bbq-torchrl", ANY_TEXT, "project that the run is listed under")


@dataclass
class MLFlowLoggerConfig(LoggerConfig):
    """MLflow, a database in the run folder."""

    name: str = _name("mlflow")


# ------------------------------------------------------------------------------------------- roots
@dataclass
class Config:
    """A training run: the root of the configuration of ``train.py``."""

    agent: AgentConfig = REQUIRED  # type: ignore[assignment]
    explore: ExploreConfig = REQUIRED  # type: ignore[assignment]
    env: EnvConfig = REQUIRED  # type: ignore[assignment]
    domain: DomainConfig = REQUIRED  # type: ignore[assignment]
    spike: SpikeConfig = REQUIRED  # type: ignore[assignment]
    protocol: ProtocolConfig = REQUIRED  # type: ignore[assignment]
    logger: LoggerConfig = REQUIRED  # type: ignore[assignment]
    replicas: int = setting(1, COUNT, "independent seeds trained side by side")
    seed: int = setting(0, NON_NEGATIVE_INTEGER, "seed that all random numbers derive from")
    device: str = setting("cpu", DEVICE, "where tensors live")
    threads: int = setting(1, COUNT, "CPU threads of torch")
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
        "policy of a Bayesian agent: mean network, average of draws, or one draw",
    )
    log: str | None = setting(None, optional(ANY_TEXT, "none"), "file for readable dialogues")
    log_dialogues: int = setting(10, COUNT, "dialogues written to log")
    seed: int = setting(0, NON_NEGATIVE_INTEGER, "seed that all random numbers derive from")
    device: str = setting("cpu", DEVICE, "where tensors live")
    threads: int = setting(1, COUNT, "CPU threads of torch")


def option_name(schema: type) -> str:
    """The option that a schema class describes, such as ``bbqn``."""
    for item in fields(schema):
        if item.name == "name" and item.default is not _ABSENT:
            return str(item.default)
    raise TypeError(f"{schema.__name__} has no default for its field 'name'")


def _options(*schemas: type) -> dict[str, type]:
    return {option_name(schema): schema for schema in schemas}


SCHEMAS: dict[str, dict[str, type]] = {
    "agent": _options(BBQNConfig, DQNConfig),
    "explore": _options(
        ThompsonConfig,
        EpsilonGreedyConfig,
        ThompsonEpsilonConfig,
        GreedyConfig,
        BoltzmannConfig,
    ),
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
