"""Evaluating an agent while it is trained."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, field
from typing import TYPE_CHECKING

from bbq_torchrl.evaluation.rollouts import evaluate
from bbq_torchrl.protocols import enter_round
from bbq_torchrl.trainers import BestWeights, derive_seed

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor
    from torchrl.envs import EnvBase

_COLUMNS = ("eval_success_rate", "eval_reward", "eval_turns")


@dataclass(eq=False)
class RoundEvaluator:
    """Plays the reported policy, without exploration, at the end of every few rounds.

    The dialogues are of an environment and a seed of their own, one for each round, so that the
    training does not notice, and two agents of one seed meet the same users. The domain is in the
    state of the round.

    Args:
        env: batch size [replicas, places], not the training's.
        policy: returns the policy, sharing the weights that are trained; called for each
            evaluation, so that draws of weights are new ones.
        every: rounds between two evaluations: the first is at the end of round ``every - 1``.
        dialogues: of an evaluation, for each replica.
        seed: the run's.
        max_steps: the most turns of a dialogue.
        changes: the rounds in which the environment becomes another one.

    Attributes:
        best: each replica's weights at its best evaluation. What was before the domain grew counts
            only until the next evaluation.
    """

    env: EnvBase
    policy: Callable[[], TensorDictModuleBase]
    _: KW_ONLY
    every: int
    dialogues: int
    seed: int
    max_steps: int = 1000
    changes: Collection[int] = ()
    best: BestWeights = field(init=False)

    def __post_init__(self) -> None:
        self.best = BestWeights(self.policy(), self.env.batch_size[0])

    def __call__(self, round_number: int) -> dict[str, float | Tensor]:
        """Returns mean statistics, [replicas] each; NaN in a round without an evaluation."""
        if (round_number + 1) % self.every:
            return dict.fromkeys(_COLUMNS, math.nan)
        enter_round(self.env, round_number)
        seed = derive_seed(self.seed, "evaluate while training", round_number)
        stats = evaluate(
            self.env, self.policy(), self.dialogues, seed=seed, max_steps=self.max_steps
        )
        means = [entry.double().mean(-1) for entry in stats]
        since = max((change for change in self.changes if change <= round_number), default=0)
        self.best.update(round_number, means[0], since=since)
        return dict(zip(_COLUMNS, means, strict=True))
