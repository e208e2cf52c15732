"""Four policies that one posterior gives: its mean network, an average, one draw, many draws."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

import torch
from tensordict.nn import TensorDictModuleBase

from bbq_torchrl.bayes.layers import bayesian_layers
from bbq_torchrl.bayes.weight_mode import given_weights, set_weight_mode

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torch import Tensor
    from torchrl.data import Composite
    from torchrl.modules import QValueActor

    from bbq_torchrl.bayes.bayes_mlp import BayesMLP

__all__ = ["EvaluationMode", "EvaluationPolicy"]

EvaluationMode = Literal["mean", "average", "draw", "thompson"]


class EvaluationPolicy(TensorDictModuleBase):
    """Acts greedily on what is to be reported, whatever the exploration type.

    ReLU of noise has a positive mean, so that Q at the mean weights is not the mean of Q: these
    are different policies.

    Args:
        actor: a Q-value actor: a network and the choice of the action behind it.

    Keyword Args:
        mode: "mean", Q at the mean weights (and without dropout); "average", the mean of Q over
            ``num_draws`` weight draws; "draw", Q at one weight draw; "thompson", Q at new draws at
            every call, for each row its own, as ThompsonSampling(per="step") trains. The draws of
            "average" and "draw" are made at the first call, for each element of the stack, and
            stay until :meth:`resample`.
        num_draws: number of draws for "average". Defaults to 10.

    Raises:
        ValueError: for another mode, fewer than one draw, or draws from a network that has no
            Bayesian layers.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> from bbq_torchrl.exploration import EvaluationPolicy
        >>> from bbq_torchrl.networks import q_actor
        >>> actor = q_actor(BayesMLP(3, 4), Categorical(4), action_mask_key=None)
        >>> policy = EvaluationPolicy(actor, mode="average")
        >>> td = TensorDict(observation=torch.ones(2, 3), batch_size=[2])
        >>> torch.equal(policy(td.clone())["action_value"], policy(td.clone())["action_value"])
        True
    """

    def __init__(
        self, actor: QValueActor, *, mode: EvaluationMode = "mean", num_draws: int = 10
    ) -> None:
        if mode not in get_args(EvaluationMode):
            raise ValueError(f"mode must be one of {list(get_args(EvaluationMode))}, got {mode!r}")
        if num_draws < 1:
            raise ValueError(f"num_draws must be at least 1, got {num_draws}")
        if mode != "mean":
            bayesian_layers(actor)
        super().__init__()
        self.actor = actor
        self.mode = mode
        self.num_draws = num_draws if mode == "average" else 1
        self.in_keys = actor.in_keys
        self.out_keys = actor.out_keys
        self._held: list[dict[BayesMLP, Tensor]] = []

    @property
    def spec(self) -> Composite:
        """Specs of what the actor writes."""
        return self.actor.spec

    def resample(self) -> None:
        """Forgets the draws: the next call makes new ones."""
        self._held = []

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the greedy action and the values it comes from."""
        if self.mode in ("mean", "thompson"):
            with set_weight_mode("mean" if self.mode == "mean" else "local"):
                return self.actor(tensordict)
        if not self._held:
            layers = bayesian_layers(self.actor)
            self._held = [
                {layer: layer.draw_weights() for layer in layers} for _ in range(self.num_draws)
            ]
        network, choice = self.actor[0], self.actor[-1]
        total: Tensor | None = None
        for weights in self._held:
            with given_weights(weights):
                values = network(tensordict).get(choice.action_value_key)
            total = values if total is None else total + values
        assert total is not None
        tensordict.set(choice.action_value_key, total / self.num_draws)
        return choice(tensordict)
