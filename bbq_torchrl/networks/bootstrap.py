"""A bootstrapped Q-network, and the actor that acts by majority vote of its heads."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import Categorical, Composite, OneHot
from torchrl.modules import QValueActor

from bbq_torchrl.bayes.functional import FlatLayout, as_rows, init_linear_, mlp, replica_shape
from bbq_torchrl.networks.q_actor import check_spec_of_one_action, legal_actions, masked
from bbq_torchrl.settings import AT_LEAST_ZERO, at_least, check

_HEAD_VALUE = "head_value"
"""The key of the values of all heads, [*batch, K, N]."""


class BootstrapMLP(nn.Module):
    """A ReLU network with K heads (Osband et al., Bootstrapped DQN, 2016), or replicas of it.

    The heads share the first ``trunk_layers`` hidden layers. Their losses are summed, so a head
    learns as fast as a separate network. The gradient that they pass to the trunk, and through it
    to the input, is divided by K (section 6.1 of the paper).

    Args:
        in_features: size of the input.
        out_features: size of each head's output.
        hidden: sizes of the hidden layers. Defaults to (256, 256).

    Keyword Args:
        heads: the number K of heads. Defaults to 10.
        replicas: the number R of independent networks of K heads, or a shape; inputs have it as
            their leading dimensions. Defaults to (), one network.
        trunk_layers: the number of hidden layers that the heads share; 0 makes K separate networks.
            Defaults to None, all of them.
        prior_scale: if positive, the scale of a fixed network added to each head and initialized
            like the trained one (randomized prior functions, Osband et al. 2018). Heads then differ
            where data are missing. Defaults to 0.
        device: of the weights.
        dtype: of the weights.

    Attributes:
        trunk: parameter [*replicas, P_trunk], None without a trunk.
        heads: parameter [*replicas, K, P_head].
        prior_trunk: buffer of the trunk's shape, None without a trunk or a prior.
        prior_heads: buffer of the heads' shape, None without a prior.
        trunk_layout: layout of the trunk's weight vector, None without a trunk.
        head_layout: layout of each head's weight vector.

    Raises:
        ValueError: for an invalid argument.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.networks import BootstrapMLP
        >>> net = BootstrapMLP(268, 39, heads=10, replicas=5, prior_scale=1.0)
        >>> net(torch.ones(5, 32, 268)).shape
        torch.Size([5, 32, 10, 39])
        >>> [name for name, _ in net.named_parameters()]
        ['trunk', 'heads']
    """

    prior_trunk: Tensor | None
    prior_heads: Tensor | None

    def __init__(
        self,
        in_features: int,
        out_features: int,
        hidden: Sequence[int] = (256, 256),
        *,
        heads: int = 10,
        replicas: int | Sequence[int] = (),
        trunk_layers: int | None = None,
        prior_scale: float = 0.0,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        trunk_layers = len(hidden) if trunk_layers is None else trunk_layers
        check("heads", heads, at_least(1))
        if not 0 <= trunk_layers <= len(hidden):
            raise ValueError(
                f"trunk_layers must be from 0 to {len(hidden)}, the number of hidden layers, got "
                f"{trunk_layers}"
            )
        check("prior_scale", prior_scale, AT_LEAST_ZERO)
        self.in_features, self.out_features = in_features, out_features
        sizes = (in_features, *hidden, out_features)
        self.trunk_layout = FlatLayout(sizes[: trunk_layers + 1]) if trunk_layers else None
        self.head_layout = FlatLayout(sizes[trunk_layers:])
        self.replicas = replica_shape(replicas)
        self.num_heads = heads
        self.prior_scale = prior_scale

        def empty(layout: FlatLayout, *rows: int) -> Tensor:
            return torch.empty((*self.replicas, *rows, layout.numel), device=device, dtype=dtype)

        trunk, layout = self.trunk_layout, self.head_layout
        self.trunk = None if trunk is None else nn.Parameter(empty(trunk))
        self.heads = nn.Parameter(empty(layout, heads))
        has_prior = prior_scale > 0
        self.register_buffer("prior_trunk", empty(trunk) if trunk and has_prior else None)
        self.register_buffer("prior_heads", empty(layout, heads) if has_prior else None)
        self._init_linear_(self.prior_trunk, self.prior_heads)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Draws the weights like ``nn.Linear``, uniform in ±1/√inputs; the priors are unchanged."""
        self._init_linear_(self.trunk, self.heads)

    def _init_linear_(self, trunk: Tensor | None, heads: Tensor | None) -> None:
        if trunk is not None and self.trunk_layout is not None:
            init_linear_(trunk, self.trunk_layout)
        if heads is not None:
            init_linear_(heads, self.head_layout)

    def reset_inactive_(self, inputs: Tensor, outputs: Tensor) -> None:
        """Sets the weights of inactive inputs to 0, those of the priors too.

        See :class:`bbq_torchrl.protocols.Growing`.
        """
        layout = self.trunk_layout or self.head_layout
        flats: tuple[Tensor | None, ...] = (self.heads, self.prior_heads)
        if self.trunk_layout is not None:
            flats = (self.trunk, self.prior_trunk)
        for flat in flats:
            if flat is not None:
                layout.unflatten(flat)[0][0][..., inputs, :] = 0

    def forward(self, x: Tensor) -> Tensor:
        """Returns the outputs of all heads, shape [*replicas, *batch, K, out].

        Args:
            x: inputs, shape [*replicas, *batch, in].

        Raises:
            ValueError: for a wrong shape.
        """
        as_rows(x, self.replicas, self.in_features)  # checks the shape
        out = self._run(x, self.trunk, self.heads)
        if self.prior_heads is not None:
            prior = self._run(x, self.prior_trunk, self.prior_heads)
            out = torch.add(out, prior, alpha=self.prior_scale)
        return out.movedim(len(self.replicas), -2)

    def _run(self, x: Tensor, trunk: Tensor | None, heads: Tensor) -> Tensor:
        """Returns [*replicas, K, *batch, out]."""
        dim = len(self.replicas)
        if trunk is not None and self.trunk_layout is not None:
            x = mlp(x, trunk, self.trunk_layout).relu()
            if torch.is_grad_enabled():
                # the same (finite) values with 1/K of the gradient, as the heads' gradients add up
                x = x.detach() + (x - x.detach()) / self.num_heads
        x = x.unsqueeze(dim).expand(*x.shape[:dim], self.num_heads, *x.shape[dim:])
        return mlp(x, heads, self.head_layout)


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
        >>> from bbq_torchrl.networks.bootstrap import VoteModule
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
