"""The keys of ``spike=``, ``protocol=`` and ``logger=``: how a training goes."""

from __future__ import annotations

from dataclasses import dataclass

from bbq_torchrl.config.settings import (
    ANY_TEXT,
    BELOW_ONE,
    BOOLEAN,
    COUNT,
    NON_NEGATIVE_INTEGER,
    REQUIRED,
    STEP_SIZE,
    Allowed,
    one_of,
    option,
    optional,
    setting,
)

__all__ = [
    "CsvLoggerConfig",
    "LoggerConfig",
    "MLFlowLoggerConfig",
    "NoSpikeConfig",
    "PaperProtocolConfig",
    "ProtocolConfig",
    "QuickProtocolConfig",
    "RuleSpikeConfig",
    "SpikeConfig",
    "TensorboardLoggerConfig",
    "WandbLoggerConfig",
]


EMPTY = Allowed("0, or be given with spike=rule", lambda value: value == 0)


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

    name: str = option("rule")


@dataclass
class NoSpikeConfig(SpikeConfig):
    """An empty buffer."""

    name: str = option("none")
    dialogues: int = setting(0, EMPTY, "scripted dialogues put into the buffer")


@dataclass
class ProtocolConfig:
    """How long and in which steps an agent trains and is measured."""

    name: str = REQUIRED
    rounds: int = setting("${env.paper_rounds}", COUNT, "rounds of training")
    dialogues: int = setting(50, COUNT, "dialogues of a round and replica")
    batch_size: int = setting(32, COUNT, "transitions of an update")
    lr: float = setting(1e-3, STEP_SIZE, "step size of Adam, for batches of this size")
    freezes: int = setting(2, COUNT, "target freezes of a round")
    epochs: int = setting(2, COUNT, "passes over the buffer after each freeze")
    capacity: int = setting(10_000, COUNT, "transitions a replica's buffer holds")
    eval_dialogues: int = setting(10_000, COUNT, "dialogues of the final evaluation of a replica")
    eval_batch: int = setting(2_500, COUNT, "evaluation dialogues of all replicas side by side")
    eval_every: int = setting(
        5, NON_NEGATIVE_INTEGER, "rounds between two evaluations while training; 0: never"
    )
    eval_every_dialogues: int = setting(
        400, COUNT, "dialogues of an evaluation while training, of a replica"
    )
    checkpoint_every: int = setting(10, COUNT, "rounds between two checkpoints")
    keep_checkpoints: str = setting(
        "weights",
        one_of("all", "last", "weights"),
        "every checkpoint, the last two, or after the end nothing but the weights",
    )


@dataclass
class PaperProtocolConfig(ProtocolConfig):
    """The paper's protocol."""

    name: str = option("paper")


@dataclass
class QuickProtocolConfig(ProtocolConfig):
    """A minute on one core: fewer rounds, larger batches, a smaller buffer; it learns to book."""

    name: str = option("quick")
    rounds: int = setting(40, COUNT, "rounds of training")
    batch_size: int = setting(128, COUNT, "transitions of an update")
    lr: float = setting(2e-3, STEP_SIZE, "step size of Adam, for batches of this size")
    epochs: int = setting(3, COUNT, "passes over the buffer after each freeze")
    capacity: int = setting(5_000, COUNT, "transitions a replica's buffer holds")
    eval_dialogues: int = setting(2_000, COUNT, "dialogues of the final evaluation of a replica")
    eval_batch: int = setting(2_000, COUNT, "evaluation dialogues of all replicas side by side")
    eval_every_dialogues: int = setting(
        200, COUNT, "dialogues of an evaluation while training, of a replica"
    )


@dataclass
class LoggerConfig:
    """Where metrics go besides metrics.csv, which is always written."""

    name: str = REQUIRED


@dataclass
class CsvLoggerConfig(LoggerConfig):
    """CSV files only."""

    name: str = option("csv")


@dataclass
class TensorboardLoggerConfig(LoggerConfig):
    """TensorBoard event files in the run folder."""

    name: str = option("tensorboard")


@dataclass
class WandbLoggerConfig(LoggerConfig):
    """Weights & Biases."""

    name: str = option("wandb")
    project: str = setting("bbq-torchrl", ANY_TEXT, "project that the run is listed under")


@dataclass
class MLFlowLoggerConfig(LoggerConfig):
    """MLflow, a database in the run folder."""

    name: str = option("mlflow")
