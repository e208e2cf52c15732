"""Acting without exploration: the mean network and other evaluation policies."""

from __future__ import annotations

from typing import Literal, get_args

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.modules import QValueActor

from bbq_torchrl.bayes import GaussianPosterior
from bbq_torchrl.bayes.layers import local_weight_scope
from bbq_torchrl.bayes.posterior import posteriors
from bbq_torchrl.bayes.scope import weight_scope
from bbq_torchrl.exploration.base import (
    ActorPolicy,
    fit_posteriors,
    forget_draws,
    posterior_sums,
)
from bbq_torchrl.networks.q_actor import split_actor
from bbq_torchrl.settings import at_least, check, one_of


class Greedy(ActorPolicy):
    """Acts greedily on the mean network, whatever the exploration type.

    Dropout of this package's networks is off; ``nn.Dropout`` follows ``eval()`` and ``train()``.

    Args:
        actor: the module that chooses actions from values.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictSequential
        >>> from torchrl.data import Categorical
        >>> from torchrl.modules import EGreedyModule
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> from bbq_torchrl.exploration import Greedy
        >>> from bbq_torchrl.networks import q_actor
        >>> actor = q_actor(BayesMLP(3, 4), Categorical(4))
        >>> policy = TensorDictSequential(
        ...     Greedy(actor),
        ...     EGreedyModule(Categorical(4), 0.1, 0.1, action_mask_key="action_mask"),
        ... )
        >>> mask = torch.tensor([False, True, True, True]).expand(2, 4)
        >>> td = TensorDict(observation=torch.ones(2, 3), action_mask=mask, batch_size=[2])
        >>> bool((policy(td)["action"] > 0).all())
        True
    """

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the greedy action and the values."""
        with weight_scope("mean"):
            return self.actor(tensordict)


EvaluationMode = Literal["mean", "average", "draw", "thompson"]


class EvaluationPolicy(ActorPolicy):
    """The policy for evaluation, greedy whatever the exploration type.

    ReLU of noise has a positive mean, so Q at the mean weights differs from the mean of Q, and the
    modes are different policies.

    Args:
        actor: a Q-value actor: a network, followed by the choice of the action.

    Keyword Args:
        mode: "mean", Q at the mean weights (without dropout, except ``nn.Dropout``, which follows
            ``eval()`` and ``train()``); "average", the mean of Q over ``num_draws`` weight draws;
            "draw", Q at one weight draw; "thompson", Q at new draws for each row in every call, as
            in training with ThompsonSampling(per="step"). "average" and "draw" draw for each
            replica at the first call, and again after :meth:`resample` or a change of the weights
            (by learning, a collector's sync, or loading). Other entries that the network writes,
            such as a recurrent state, are means over the draws too.
        num_draws: number of draws for "average". Defaults to 10.

    Raises:
        ValueError: for an unknown mode, fewer than one draw, or draws from a network without
            Bayesian layers.

    Examples:
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
        check("mode", mode, one_of(*get_args(EvaluationMode)))
        check("num_draws", num_draws, at_least(1))
        if mode != "mean":
            posteriors(actor)
        super().__init__(actor)
        self.mode = mode
        self.num_draws = num_draws if mode == "average" else 1
        self._draws: list[dict[GaussianPosterior, Tensor]] = []
        self._drawn_from: list[float] = []
        self.register_load_state_dict_post_hook(forget_draws)

    def resample(self) -> None:
        """Discards the draws; the next call makes new ones."""
        self._draws = []

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the greedy action and the values."""
        if self.mode in ("mean", "thompson"):
            is_mean = self.mode == "mean"
            batch = tensordict.batch_size
            scope = weight_scope("mean") if is_mean else local_weight_scope(self.actor, batch)
            with scope:
                return self.actor(tensordict)
        found = posteriors(self.actor)
        now = posterior_sums(found)
        if not self._draws or self._drawn_from != now or not fit_posteriors(self._draws[0]):
            self._draws = [{p: p.sample() for p in found} for _ in range(self.num_draws)]
            self._drawn_from = now
        network, choice = split_actor(self.actor)
        inputs = tensordict.select(*network.in_keys, strict=False)
        totals: dict[NestedKey, Tensor] = {}
        for weights in self._draws:
            with weight_scope(weights=weights):
                out = network(inputs.copy())
            for key in network.out_keys:
                entry = out.get(key)
                totals[key] = entry if key not in totals else totals[key] + entry
        for key, total in totals.items():
            tensordict.set(key, total / self.num_draws)
        return tensordict if choice is None else choice(tensordict)
