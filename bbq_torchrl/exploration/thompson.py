"""Acting on weight draws (Thompson sampling) or noise draws (NoisyNet)."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.modules import QValueActor

from bbq_torchrl.bayes import GaussianPosterior
from bbq_torchrl.bayes.layers import local_weight_scope
from bbq_torchrl.bayes.posterior import posteriors
from bbq_torchrl.bayes.scope import WeightMode, weight_scope
from bbq_torchrl.exploration.base import (
    ActorPolicy,
    Per,
    explores,
    fit_posteriors,
    forget_draws,
    posterior_sums,
)
from bbq_torchrl.networks.mlp import noisy_layers


class ThompsonSampling(ActorPolicy):
    """Draws weights from the posterior and acts greedily on them.

    Under the exploration types DETERMINISTIC, MEAN and MODE it acts on the mean network; under
    RANDOM and outside of any context it explores (as ``EGreedyModule`` does).

    Args:
        actor: an actor whose network has Bayesian layers.

    Keyword Args:
        per: the lifetime of a draw. "step" (as in the paper): one action. "episode": until the
            row's next ``init_key``; a running episode keeps its draw while the weights are trained
            or synced. "round": until :meth:`resample`, or until the weights change; a collector
            with worker processes redraws whenever it syncs new weights. Defaults to "step".
        shared: whether the rows of a batch share one draw (per replica) or each have a separate
            one. With a shared draw 50 parallel episodes are a single experiment; with per="episode"
            a new episode in any row redraws for all. Defaults to True for "round", else False.
        init_key: bool [*batch, 1] or [*batch], True where a row begins an episode (TorchRL's
            ``InitTracker`` writes it); read for per="episode" only. Defaults to "is_init".

    Independent draws for each row that outlive a step cost noise for every row and weight (B·P
    numbers, P ≈ 145,000 for 268-256-256-39). Draws per step cost a hundredth of that, as local
    reparameterization is exact for one input per draw; a custom layer without
    :meth:`~bbq_torchrl.bayes.BayesLayer.run_local` pays the full cost. A change of the batch shape
    redraws, as other rows are other episodes.

    Raises:
        ValueError: for an unknown ``per`` or an actor without Bayesian layers; when called, for
            per="episode" without ``init_key``.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> from bbq_torchrl.exploration import ThompsonSampling
        >>> from bbq_torchrl.networks import q_actor
        >>> actor = q_actor(BayesMLP(3, 4), Categorical(4), action_mask_key=None)
        >>> policy = ThompsonSampling(actor, per="episode")
        >>> td = TensorDict(observation=torch.ones(50, 3), batch_size=[50])
        >>> td["is_init"] = torch.zeros(50, 1, dtype=torch.bool)
        >>> first, again = policy(td.clone())["action"], policy(td.clone())["action"]
        >>> torch.equal(first, again), first.unique().numel() > 1
        (True, True)
    """

    def __init__(
        self,
        actor: QValueActor,
        *,
        per: Per = "step",
        shared: bool | None = None,
        init_key: NestedKey = "is_init",
    ) -> None:
        super().__init__(actor, per, init_key)
        self.shared = per == "round" if shared is None else shared
        self._draws: dict[GaussianPosterior, Tensor] = {}
        self._rows: torch.Size | None = None
        self._drawn_from: list[float] | None = None
        posteriors(actor)
        self.register_load_state_dict_post_hook(forget_draws)

    def resample(self) -> None:
        """Discards the draws; the next call makes new ones."""
        self._draws = {}
        self._rows = self._drawn_from = None

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the greedy action of the drawn weights and the values."""
        if not explores():
            with weight_scope("mean"):
                return self.actor(tensordict)
        if self.per == "step":
            batch = tensordict.batch_size
            scope = weight_scope("draw") if self.shared else local_weight_scope(self.actor, batch)
            with scope:
                return self.actor(tensordict)
        # the draws outlive the call, and are redrawn in place
        with torch.inference_mode(False), torch.no_grad():
            self._draw(tensordict)
        with weight_scope(weights=self._draws):
            return self.actor(tensordict)

    def _draw(self, tensordict: TensorDictBase) -> None:
        found = posteriors(self.actor)
        replicas = found[0].replicas
        rows = tensordict.batch_size[len(replicas) :]
        new = self._episode_starts(tensordict)
        now = posterior_sums(found) if self.per == "round" else None
        fits = self._rows == rows and self._drawn_from == now
        if not fits or not fit_posteriors(self._draws):
            drawn = () if self.shared else tuple(rows)
            self._draws = {posterior: posterior.sample(drawn) for posterior in found}
            self._rows, self._drawn_from = rows, now
        elif new is not None:
            if self.shared and rows:
                new = new.flatten(len(replicas)).any(-1)
            for posterior, draws in self._draws.items():
                posterior.redraw_(draws, new)


class NoisySampling(ActorPolicy):
    """Acts greedily on noise that is redrawn at every step (NoisyNet's exploration).

    Under the exploration types DETERMINISTIC, MEAN and MODE it acts on the mean network μ; under
    RANDOM and outside of any context it explores (as ``EGreedyModule`` does).

    Args:
        actor: an actor whose network has noisy layers.

    Keyword Args:
        shared: whether the rows of a batch share one noise draw (per replica) or each have a
            separate one. Defaults to False.

    Raises:
        ValueError: for an actor without noisy layers.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.exploration import NoisySampling
        >>> from bbq_torchrl.networks import NoisyMLP, q_actor
        >>> actor = q_actor(NoisyMLP(3, 4), Categorical(4), action_mask_key=None)
        >>> td = TensorDict(observation=torch.ones(50, 3), batch_size=[50])
        >>> NoisySampling(actor)(td)["action_value"].unique(dim=0).shape
        torch.Size([50, 4])
    """

    def __init__(self, actor: QValueActor, *, shared: bool = False) -> None:
        super().__init__(actor)
        noisy_layers(actor)
        self.shared = shared

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the greedy action under the noise and the values."""
        mode: WeightMode = "draw" if self.shared else "local"
        with weight_scope(mode if explores() else "mean"):
            return self.actor(tensordict)
