"""What goes beside a training: an environment that changes, callbacks, an evaluator."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from bbq_torchrl.protocols import provides

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor
    from torchrl.envs import EnvBase

    from bbq_torchrl.trainers.best_weights import BestWeights
    from bbq_torchrl.trainers.metrics import MetricRow
    from bbq_torchrl.trainers.round_trainer import RoundTrainer


class RoundEnv(Protocol):
    """An environment that changes with the rounds (domain extension). Others stay as they are."""

    def set_round(self, round: int, /) -> None:
        """Enters a round; called before its dialogues are played, and before spiking with 0."""


def enter_round(env: EnvBase, round: int) -> None:
    """Has an environment that changes with the rounds be as in one of them."""
    if provides(env, RoundEnv):
        env.set_round(round)


RoundCallback = Callable[["RoundTrainer", "Sequence[MetricRow]"], None]
"""What is called after every round with the trainer and the round's rows, one for each replica."""


class EvaluationHook(Protocol):
    """Plays the policy that is to be reported, after every round."""

    @property
    def best(self) -> BestWeights:
        """The best weights so far; they are saved in every checkpoint."""

    def __call__(self, round_number: int) -> Mapping[str, float | Tensor]:
        """Returns metrics of the round by name, one number or [replicas]; the same names always.

        NaN stands for a round without an evaluation. It may use torch's global generator, but
        nothing else of the training's.
        """
