"""A bootstrapped Q-network as a TorchRL actor, which acts by its heads' majority vote."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torchrl.data import Categorical, Composite, OneHot
from torchrl.modules import QValueActor

from bbq_torchrl.networks.q_actor import check_spec_of_one_action, legal_actions, masked

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey
    from torch import Tensor, nn


class VoteModule(TensorDictModuleBase):
    """Turns the values of K heads into an action by majority vote.

    Each head votes for its legal action of greatest value, and the action with the most votes is
    taken. Among actions with equally many votes the one of greatest mean value over all heads
    wins, and of equal means the one with the lowest index: the vote draws nothing.

    Args:
        spec: of one action, without batch dimensions: Categorical or OneHot.

    Keyword Args:
        head_value_key: values [*batch, K, N], which it reads.
        action_mask_key: bool [*batch, N], True for actions that may be taken; None for no mask.
        action_key: where the action goes, an index [*batch] or one-hot [*batch, N] (int64).
        action_value_key: where the mean of the values over the heads goes, [*batch, N];
            forbidden actions have the least float there.
        chosen_action_value_key: where that of the action goes, [*batch, 1].

    Raises:
        ValueError: for another spec.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.networks.vote import VoteModule
        >>> vote = VoteModule(Categorical(3), action_mask_key=None)
        >>> values = torch.tensor([[[9.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 2.0, 1.0]]])
        >>> td = vote(TensorDict(head_value=values, batch_size=[1]))
        >>> td["action"], td["action_value"]  # two heads of three are for action 1
        (tensor([1]), tensor([[3.0000, 1.3333, 0.3333]]))
    """

    def __init__(
        self,
        spec: Categorical | OneHot,
        *,
        head_value_key: NestedKey = "head_value",
        action_mask_key: NestedKey | None = "action_mask",
        action_key: NestedKey = "action",
        action_value_key: NestedKey = "action_value",
        chosen_action_value_key: NestedKey = "chosen_action_value",
    ) -> None:
        super().__init__()
        if type(spec) not in (Categorical, OneHot):  # Binary is a Categorical
            raise ValueError(f"spec must be a Categorical or a OneHot, got {type(spec).__name__}")
        check_spec_of_one_action(spec)
        # what TorchRL calls the key that a Q-value module reads
        self.action_value_key = head_value_key
        self.action_mask_key = action_mask_key
        self.in_keys = [head_value_key]
        if action_mask_key is not None:
            self.in_keys.append(action_mask_key)
        self.out_keys = [action_key, action_value_key, chosen_action_value_key]
        self._action_spec = spec
        self._spec = Composite(dict.fromkeys(self.out_keys))
        self._spec[action_key] = spec.clone()

    @property
    def spec(self) -> Composite:
        """Specs of what it writes."""
        return self._spec

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action that wins the vote, the heads' mean values, and the action's."""
        return self.vote(tensordict, tensordict.get(self.action_value_key))

    def vote(self, tensordict: TensorDictBase, head_values: Tensor) -> TensorDictBase:
        """Writes what :meth:`forward` does; head_values has shape [*batch, K, N]."""
        mask = legal_actions(tensordict, self.action_mask_key)
        ballots = masked(head_values, None if mask is None else mask.unsqueeze(-2)).argmax(-1)
        shape = (*head_values.shape[:-2], head_values.shape[-1])
        votes = ballots.new_zeros(shape).scatter_add_(-1, ballots, torch.ones_like(ballots))
        mean = head_values.mean(-2)
        tied = votes == votes.amax(-1, keepdim=True)
        index = mean.masked_fill(~tied, float("-inf")).argmax(-1, keepdim=True)
        return self._write(tensordict, masked(mean, mask), index)

    def act_greedily(self, tensordict: TensorDictBase, values: Tensor) -> TensorDictBase:
        """Writes the legal action of greatest value; values has shape [*batch, N]."""
        values = masked(values, legal_actions(tensordict, self.action_mask_key))
        return self._write(tensordict, values, values.argmax(-1, keepdim=True))

    def _write(self, tensordict: TensorDictBase, values: Tensor, index: Tensor) -> TensorDictBase:
        spec = self._action_spec
        if isinstance(spec, OneHot):
            action = torch.zeros_like(values, dtype=torch.int64).scatter_(-1, index, 1)
        else:
            action = index.reshape((*values.shape[:-1], *spec.shape))
        written = (action, values, values.gather(-1, index))
        for key, value in zip(self.out_keys, written, strict=True):
            tensordict.set(key, value)
        return tensordict


class _BootstrapActor(QValueActor):
    """A QValueActor with a vote in the place of its argmax."""

    def __init__(self, network: TensorDictModule, vote: VoteModule) -> None:
        self.action_space = "one_hot" if isinstance(vote._action_spec, OneHot) else "categorical"
        self.action_value_key = vote.action_value_key
        super(QValueActor, self).__init__(network, vote)


def bootstrap_actor(
    network: nn.Module,
    spec: Categorical | OneHot,
    *,
    in_keys: Sequence[NestedKey] = ("observation",),
    action_mask_key: NestedKey | None = "action_mask",
    action_key: NestedKey = "action",
    action_value_key: NestedKey = "action_value",
    head_value_key: NestedKey = "head_value",
) -> QValueActor:
    """Returns an actor on a network with heads, which acts by their majority vote.

    Its two parts are those of a :class:`~torchrl.modules.QValueActor`: the network, which writes
    the values of all heads, and the choice, a :class:`VoteModule`. So
    :class:`~bbq_torchrl.objectives.BootstrapDQNLoss` learns it and
    :class:`~bbq_torchrl.exploration.BootstrapSampling` and
    :class:`~bbq_torchrl.exploration.MajorityVote` act on it; and so do, by the vote,
    :class:`~bbq_torchrl.exploration.Greedy` (with an ``EGreedyModule`` behind it) and
    :class:`~bbq_torchrl.exploration.EvaluationPolicy` in its mode "mean".

    Args:
        network: maps the observation [*batch, F] to values [*batch, K, N], such as a
            :class:`~bbq_torchrl.networks.BootstrapMLP`.
        spec: of one action, without batch dimensions (``env.action_spec_unbatched``).

    Keyword Args:
        in_keys: what the network reads. Defaults to ("observation",).
        action_mask_key: bool [*batch, N], True for actions that may be taken; None for no mask.
        action_key: where the action goes.
        action_value_key: where the mean of the heads' values goes.
        head_value_key: where the values of all heads go.

    Raises:
        ValueError: for a spec that is neither Categorical nor OneHot, or has batch dimensions.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.networks import BootstrapMLP, bootstrap_actor
        >>> actor = bootstrap_actor(BootstrapMLP(3, 4, heads=10), Categorical(4))
        >>> td = TensorDict(observation=torch.ones(2, 3), batch_size=[2])
        >>> td["action_mask"] = torch.tensor([[False, True, False, False]] * 2)
        >>> td = actor(td)
        >>> td["action"], td["action_value"].shape, td["head_value"].shape
        (tensor([1, 1]), torch.Size([2, 4]), torch.Size([2, 10, 4]))
    """
    vote = VoteModule(
        spec,
        head_value_key=head_value_key,
        action_mask_key=action_mask_key,
        action_key=action_key,
        action_value_key=action_value_key,
    )
    return _BootstrapActor(TensorDictModule(network, list(in_keys), [head_value_key]), vote)
