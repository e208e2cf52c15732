"""Acting on the heads of a bootstrapped Q-network: one at a time, or by majority vote."""

from __future__ import annotations

from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite
from torchrl.modules import QValueActor

from bbq_torchrl.bayes.scope import weight_scope
from bbq_torchrl.exploration.base import ActorPolicy, Per, explores, weight_sums
from bbq_torchrl.networks.bootstrap import VoteModule
from bbq_torchrl.networks.q_actor import split_actor


class _HeadPolicy(ActorPolicy):
    """The base class of policies on an actor's heads, without the entry of all heads' values."""

    def __init__(
        self, actor: QValueActor, per: Per = "step", init_key: NestedKey = "is_init"
    ) -> None:
        network, choice = split_actor(actor)
        if not isinstance(choice, VoteModule):
            raise ValueError(
                "actor must choose with a VoteModule, as the actors of bootstrap_actor do, "
                f"got {type(actor).__name__} with {type(choice).__name__}"
            )
        super().__init__(actor, per, init_key)
        states = [key for key in network.out_keys if key != choice.action_value_key]
        self.out_keys = [*states, *choice.out_keys]

    @property
    def spec(self) -> Composite:
        """Specs of the written entries."""
        return cast("VoteModule", split_actor(self.actor)[1]).spec

    def _head_values(self, tensordict: TensorDictBase) -> tuple[VoteModule, Tensor]:
        """Returns the vote module and all heads' values [*batch, K, N]; dropout is off."""
        network, choice = split_actor(self.actor)
        assert isinstance(choice, VoteModule)
        with weight_scope("mean"):
            out = network(tensordict.select(*network.in_keys, strict=False))
        for key in network.out_keys:  # such as a recurrent state
            if key != choice.action_value_key:
                tensordict.set(key, out.get(key))
        return choice, out.get(choice.action_value_key)


class MajorityVote(_HeadPolicy):
    """Acts by the majority vote of the heads, whatever the exploration type.

    Each head votes for its legal action with the highest value. Ties are broken by the highest mean
    value over all heads, then by the lowest index (see
    :class:`~bbq_torchrl.networks.bootstrap.VoteModule`). Writes the action and, as ``action_value``
    [*batch, N], the mean of the values over the heads.

    Args:
        actor: an actor from :func:`~bbq_torchrl.networks.bootstrap_actor`.

    Raises:
        ValueError: for any other actor.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.exploration import MajorityVote
        >>> from bbq_torchrl.networks import BootstrapMLP, bootstrap_actor
        >>> actor = bootstrap_actor(BootstrapMLP(3, 4), Categorical(4), action_mask_key=None)
        >>> td = MajorityVote(actor)(TensorDict(observation=torch.ones(2, 3), batch_size=[2]))
        >>> td["action"].shape, td["action_value"].shape
        (torch.Size([2]), torch.Size([2, 4]))
    """

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the winning action and the heads' mean values."""
        choice, values = self._head_values(tensordict)
        return choice.vote(tensordict, values)


class BootstrapSampling(_HeadPolicy):
    """Acts greedily on one head, drawn uniformly for each row (Bootstrapped DQN, Osband 2016).

    Under the exploration types DETERMINISTIC, MEAN and MODE it acts by majority vote; under RANDOM
    and outside of any context it explores (as ``EGreedyModule`` does). Writes the action and, as
    ``action_value`` [*batch, N], the values of the active head (for the vote: the mean over the
    heads).

    TorchRL's ``TensorDictPrimer(head=Categorical(10), random=True)`` also draws a head for each
    episode, but as a part of the environment. The environment would then depend on the agent's
    number of heads, every observation and transition would include the head, and the transform
    would have to be removed to vote or to compare agents in the same environment.

    Args:
        actor: an actor from :func:`~bbq_torchrl.networks.bootstrap_actor`.

    Keyword Args:
        per: the lifetime of a head. "step": one action. "episode" (as in the paper): until the
            row's next ``init_key``. "round": until :meth:`resample`, or until the weights change; a
            collector with worker processes redraws whenever it syncs new weights. Defaults to
            "episode".
        init_key: bool [*batch, 1] or [*batch], True where a row begins an episode (TorchRL's
            ``InitTracker`` writes it); read for per="episode" only. Defaults to "is_init".

    Attributes:
        heads: the last active head of each row, int64 [*batch]; None before the first action.

    A change of the batch shape redraws the heads, as other rows are other episodes. Each call that
    may need heads draws them for all rows from torch's global generator, so a row's draw does not
    depend on when other rows begin.

    Raises:
        ValueError: for an unknown ``per`` or another actor; when called, for per="episode"
            without ``init_key``.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.exploration import BootstrapSampling
        >>> from bbq_torchrl.networks import BootstrapMLP, bootstrap_actor
        >>> actor = bootstrap_actor(BootstrapMLP(3, 4), Categorical(4), action_mask_key=None)
        >>> policy = BootstrapSampling(actor)
        >>> td = TensorDict(observation=torch.ones(50, 3), batch_size=[50])
        >>> td["is_init"] = torch.zeros(50, 1, dtype=torch.bool)
        >>> first, again = policy(td.clone())["action"], policy(td.clone())["action"]
        >>> torch.equal(first, again), policy.heads.unique().numel() > 1
        (True, True)
    """

    def __init__(
        self, actor: QValueActor, *, per: Per = "episode", init_key: NestedKey = "is_init"
    ) -> None:
        super().__init__(actor, per, init_key)
        self.heads: Tensor | None = None
        self._drawn_from: list[float] | None = None

    def resample(self) -> None:
        """Discards the heads; the next call draws new ones."""
        self.heads = None

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the greedy action of the row's head and that head's values."""
        choice, values = self._head_values(tensordict)
        if not explores():
            return choice.vote(tensordict, values)
        self.heads = self._next_heads(tensordict, values)
        index = self.heads[..., None, None].expand(*self.heads.shape, 1, values.shape[-1])
        return choice.act_greedily(tensordict, values.gather(-2, index).squeeze(-2))

    @torch.inference_mode(False)  # the heads outlive the call
    def _next_heads(self, tensordict: TensorDictBase, values: Tensor) -> Tensor:
        rows = values.shape[:-2]
        new = self._episode_starts(tensordict)
        last = self.heads
        now = weight_sums(self.parameters()) if self.per == "round" else None
        if last is not None and (last.shape != rows or self._drawn_from != now):
            last = None
        self._drawn_from = now
        if last is not None and self.per == "round":
            return last
        drawn = torch.randint(values.shape[-2], rows, device=values.device)
        return drawn if new is None or last is None else torch.where(new, drawn, last)
