"""A Q-network as a TorchRL actor: of one value for each action, or of heads that vote."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
import torch.nn.functional as F
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.data import Categorical, Composite, OneHot, TensorSpec
from torchrl.modules import QValueActor

_HEAD_VALUE = "head_value"
"""The key of the values of all heads, [*batch, K, N]."""


def q_actor(
    network: nn.Module,
    spec: TensorSpec,
    *,
    in_keys: Sequence[NestedKey] = ("observation",),
    action_mask_key: NestedKey | None = "action_mask",
    action_key: NestedKey = "action",
    action_value_key: NestedKey = "action_value",
) -> QValueActor:
    """Returns an actor that takes the legal action with the highest value.

    Args:
        network: maps the observation [*batch, F] to values [*batch, N].
        spec: the spec of one action, without batch dimensions (``env.action_spec_unbatched``).

    Keyword Args:
        in_keys: the entries that the network reads. Defaults to ("observation",).
        action_mask_key: bool [*batch, N], True for legal actions; None for no mask.
        action_key: the action's key, "action" or a nested key that ends in it.
        action_value_key: the values' key; illegal actions get the lowest finite float.

    Raises:
        ValueError: for any other action_key, with which TorchRL would not find the spec, or a spec
            with batch dimensions.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> from bbq_torchrl.networks import q_actor
        >>> actor = q_actor(BayesMLP(3, 4, mean_init="zero"), Categorical(4))
        >>> td = TensorDict(observation=torch.ones(2, 3), batch_size=[2])
        >>> td["action_mask"] = torch.tensor([[False, True, True, True]] * 2)
        >>> actor(td)["action"]
        tensor([1, 1])
    """
    if unravel_key(("", action_key))[-1] != "action":
        raise ValueError(f"action_key must be 'action' or end in it, got {action_key!r}")
    check_spec_of_one_action(spec)
    actor = QValueActor(
        network,
        in_keys=list(in_keys),
        spec=spec,
        action_key=action_key,
        action_value_key=action_value_key,
        action_mask_key=action_mask_key,
    )
    # TorchRL's function marks every action of the highest value: several, if all values are 0.
    actor[-1].action_func_mapping["one_hot"] = _one_hot
    return actor


def check_spec_of_one_action(spec: TensorSpec) -> None:
    """Raises ValueError for a spec of a batch of action indices."""
    if isinstance(spec, Categorical) and spec.shape not in ((), (1,)):
        raise ValueError(
            "spec must be that of one action, env.action_spec_unbatched, got shape "
            f"{list(spec.shape)}"
        )


def _one_hot(values: Tensor) -> Tensor:
    return F.one_hot(values.argmax(-1), values.shape[-1])


def legal_actions(tensordict: TensorDictBase, key: NestedKey | None) -> Tensor | None:
    """Returns the mask of legal actions, bool [*batch, N]; None without a key.

    Raises:
        KeyError: if the mask is missing.
    """
    if key is None:
        return None
    mask: Tensor | None = tensordict.get(key, None)
    if mask is None:
        raise KeyError(
            f"{key!r} is missing, the mask of legal actions; if every action is always legal, make "
            "actor and exploration with action_mask_key=None"
        )
    return mask


def masked(values: Tensor, mask: Tensor | None) -> Tensor:
    """Returns values [*batch, N] with the lowest float at illegal actions, as TorchRL does.

    Args:
        values: the values of all actions, [*batch, N].
        mask: bool [*batch, N], True for legal actions; None if all are.
    """
    if mask is None:
        return values
    return torch.where(mask, values, torch.finfo(values.dtype).min)


def split_actor(
    actor: TensorDictModuleBase,
) -> tuple[TensorDictModuleBase, TensorDictModuleBase | None]:
    """Splits an actor into the network that writes values and the module that chooses an action.

    Args:
        actor: a ``QValueActor``, or any ``TensorDictSequential`` of modules (convolutional,
            recurrent, nested) that includes a ``QValueModule`` or
            :class:`~bbq_torchrl.networks.q_actor.VoteModule`; modules after that are left out.

    Returns:
        the network and the choosing module, not copies; the whole actor and None if no module
        chooses.

    Examples:
        >>> from tensordict.nn import TensorDictModule, TensorDictSequential
        >>> from torch import nn
        >>> from torchrl.modules import QValueModule
        >>> from bbq_torchrl.networks.q_actor import split_actor
        >>> trunk = TensorDictModule(nn.Linear(3, 8), ["observation"], ["hidden"])
        >>> head = TensorDictModule(nn.Linear(8, 4), ["hidden"], ["action_value"])
        >>> choice = QValueModule(action_space="categorical")
        >>> network, chooses = split_actor(TensorDictSequential(trunk, head, choice))
        >>> network.in_keys, chooses is choice
        (['observation'], True)
    """
    modules = list(_parts(actor))
    for number, module in enumerate(modules):
        if hasattr(module, "action_value_key") and hasattr(module, "action_mask_key"):
            network = modules[:number]
            return network[0] if number == 1 else TensorDictSequential(*network), module
    return actor, None


def _parts(module: TensorDictModuleBase) -> Iterator[TensorDictModuleBase]:
    """Yields the modules of a sequence in order, including nested ones."""
    if isinstance(module, TensorDictSequential):
        for part in module.module:
            yield from _parts(part)
    else:
        yield module


class VoteModule(TensorDictModuleBase):
    """Turns the values of K heads into an action by majority vote.

    It reads ``head_value`` [*batch, K, N], and also writes ``chosen_action_value`` [*batch, 1], the
    mean value of the chosen action.

    Each head votes for its legal action with the highest value, and the action with the most votes
    is taken. Ties are broken by the highest mean value over all heads, then by the lowest index, so
    the vote draws no random numbers.

    Args:
        spec: the spec of one action, without batch dimensions: Categorical or OneHot.

    Keyword Args:
        action_mask_key: bool [*batch, N], True for legal actions; None for no mask.
        action_key: the action's key, an index [*batch] or one-hot [*batch, N] (int64).
        action_value_key: the key of the mean values over the heads, [*batch, N]; illegal actions
            get the lowest finite float.

    Raises:
        ValueError: for any other spec.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.networks.q_actor import VoteModule
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
        action_mask_key: NestedKey | None = "action_mask",
        action_key: NestedKey = "action",
        action_value_key: NestedKey = "action_value",
    ) -> None:
        super().__init__()
        if type(spec) not in (Categorical, OneHot):  # Binary is a Categorical
            raise ValueError(f"spec must be a Categorical or a OneHot, got {type(spec).__name__}")
        check_spec_of_one_action(spec)
        # TorchRL's name for the key that a Q-value module reads
        self.action_value_key = _HEAD_VALUE
        self.action_mask_key = action_mask_key
        self.in_keys = [_HEAD_VALUE]
        if action_mask_key is not None:
            self.in_keys.append(action_mask_key)
        self.out_keys = [action_key, action_value_key, "chosen_action_value"]
        self._action_spec = spec
        self._spec = Composite(dict.fromkeys(self.out_keys))
        self._spec[action_key] = spec.clone()

    @property
    def spec(self) -> Composite:
        """Specs of the written entries."""
        return self._spec

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the winning action, the heads' mean values, and the action's mean value."""
        return self.vote(tensordict, tensordict.get(self.action_value_key))

    def vote(self, tensordict: TensorDictBase, head_values: Tensor) -> TensorDictBase:
        """Writes the entries of :meth:`forward` for head_values [*batch, K, N]."""
        mask = legal_actions(tensordict, self.action_mask_key)
        ballots = masked(head_values, None if mask is None else mask.unsqueeze(-2)).argmax(-1)
        shape = (*head_values.shape[:-2], head_values.shape[-1])
        votes = ballots.new_zeros(shape).scatter_add_(-1, ballots, torch.ones_like(ballots))
        mean = head_values.mean(-2)
        tied = votes == votes.amax(-1, keepdim=True)
        index = mean.masked_fill(~tied, float("-inf")).argmax(-1, keepdim=True)
        return self._write(tensordict, masked(mean, mask), index)

    def act_greedily(self, tensordict: TensorDictBase, values: Tensor) -> TensorDictBase:
        """Writes the legal action with the highest value, for values [*batch, N]."""
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
    """A QValueActor that votes instead of taking the argmax."""

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
) -> QValueActor:
    """Returns an actor on a network with heads that acts by their majority vote.

    It has two parts, as a :class:`~torchrl.modules.QValueActor` does: the network, which writes the
    values of all heads, and a :class:`VoteModule`, which chooses. So
    :class:`~bbq_torchrl.objectives.BootstrapDQNLoss` trains it, and
    :class:`~bbq_torchrl.exploration.BootstrapSampling` and
    :class:`~bbq_torchrl.exploration.MajorityVote` act on it.
    :class:`~bbq_torchrl.exploration.Greedy` (followed by an ``EGreedyModule``) and
    :class:`~bbq_torchrl.exploration.EvaluationPolicy` in mode "mean" act by the vote too.

    Args:
        network: maps the observation [*batch, F] to values [*batch, K, N], such as a
            :class:`~bbq_torchrl.networks.BootstrapMLP`.
        spec: the spec of one action, without batch dimensions (``env.action_spec_unbatched``).

    Keyword Args:
        in_keys: the entries that the network reads. Defaults to ("observation",).
        action_mask_key: bool [*batch, N], True for legal actions; None for no mask.
        action_key: the action's key.
        action_value_key: the key of the mean values over the heads.

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
        action_mask_key=action_mask_key,
        action_key=action_key,
        action_value_key=action_value_key,
    )
    return _BootstrapActor(TensorDictModule(network, list(in_keys), [_HEAD_VALUE]), vote)
