"""Ways to act on a Q-network: greedily, by Thompson sampling, by a softmax over values.

Each is a TensorDict module that honours the actor's action mask. TorchRL's ``EGreedyModule``
goes behind :class:`Greedy` or :class:`ThompsonSampling` in a ``TensorDictSequential``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, exploration_type

from bbq_torchrl.modules.bayes_mlp import BayesMLP
from bbq_torchrl.modules.weight_mode import given_weights, set_weight_mode

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey
    from torch import Tensor
    from torchrl.data import Composite
    from torchrl.modules import QValueActor

__all__ = ["Boltzmann", "Greedy", "Per", "ThompsonSampling"]

Per = Literal["step", "dialogue", "round"]


def explores() -> bool:
    """Returns whether exploration modules explore: under RANDOM, and outside of any context.

    None counts as RANDOM, as it does for TorchRL's ``EGreedyModule``.
    """
    return exploration_type() in (ExplorationType.RANDOM, None)


class Greedy(TensorDictModuleBase):
    """Acts greedily on the mean network (dropout off), whatever the exploration type.

    Args:
        actor: what chooses actions from values.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictSequential
        >>> from torchrl.data import Categorical
        >>> from torchrl.modules import EGreedyModule
        >>> from bbq_torchrl.modules import BayesMLP, Greedy, q_network
        >>> actor = q_network(BayesMLP(3, 4), Categorical(4))
        >>> policy = TensorDictSequential(
        ...     Greedy(actor),
        ...     EGreedyModule(Categorical(4), 0.1, 0.1, action_mask_key="action_mask"),
        ... )
        >>> mask = torch.tensor([False, True, True, True]).expand(2, 4)
        >>> td = TensorDict(observation=torch.ones(2, 3), action_mask=mask, batch_size=[2])
        >>> bool((policy(td)["action"] > 0).all())
        True
    """

    def __init__(self, actor: QValueActor) -> None:
        super().__init__()
        self.actor = actor
        self.in_keys = actor.in_keys
        self.out_keys = actor.out_keys

    @property
    def spec(self) -> Composite:
        """Specs of what the actor writes."""
        return self.actor.spec

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the greedy action and the values it comes from."""
        with set_weight_mode("mean"):
            return self.actor(tensordict)


class ThompsonSampling(TensorDictModuleBase):
    """Draws weights from the posterior and acts greedily on them.

    Under the exploration types DETERMINISTIC, MEAN and MODE it acts on the mean network; under
    RANDOM and outside of any context it explores (as ``EGreedyModule``).

    Args:
        actor: an actor whose network has Bayesian layers.

    Keyword Args:
        per: how long a draw is acted on. "step" (the paper): one action. "dialogue": until the
            row's next ``init_key``. "round": until :meth:`resample`. Defaults to "step".
        shared: whether the rows of a batch act on one draw (each element of the stack has its
            own) or each on its own. One shared draw makes 50 dialogues side by side one
            experiment. Defaults to True for "round", else False.
        init_key: bool [*batch, 1] or [*batch], True where a row begins a dialogue (TorchRL's
            ``InitTracker`` writes it); only read for per="dialogue". Without that entry draws
            stay until :meth:`resample`. Defaults to "is_init".

    Independent draws for each row cost a batch of noise for every weight if they are to stay
    (B·P numbers, P ≈ 145,000 for 268-256-256-39). Per step they come from local
    reparameterisation, which is exact for one input per draw, at a hundredth of that. A held
    draw is redrawn when the batch shape changes: other rows are other dialogues.

    Raises:
        ValueError: for another ``per``, or an actor without Bayesian layers.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.modules import BayesMLP, ThompsonSampling, q_network
        >>> actor = q_network(BayesMLP(3, 4), Categorical(4), action_mask_key=None)
        >>> policy = ThompsonSampling(actor, per="dialogue")
        >>> td = TensorDict(observation=torch.ones(50, 3), batch_size=[50])
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
        if per not in get_args(Per):
            raise ValueError(f"per must be one of {list(get_args(Per))}, got {per!r}")
        super().__init__()
        self.actor = actor
        self.per = per
        self.shared = per == "round" if shared is None else shared
        self.init_key = init_key
        self.in_keys = actor.in_keys
        self.out_keys = actor.out_keys
        self._held: dict[BayesMLP, Tensor] = {}
        self._held_rows: torch.Size | None = None
        bayesian_layers(actor)

    @property
    def spec(self) -> Composite:
        """Specs of what the actor writes."""
        return self.actor.spec

    def resample(self) -> None:
        """Forgets the draws: the next call acts on new ones."""
        self._held = {}
        self._held_rows = None

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action that is greedy on the drawn weights, and the values."""
        if not explores():
            with set_weight_mode("mean"):
                return self.actor(tensordict)
        if self.per == "step":
            with set_weight_mode("draw" if self.shared else "local"):
                return self.actor(tensordict)
        with torch.no_grad():
            self._hold(tensordict)
        with given_weights(self._held):
            return self.actor(tensordict)

    def _hold(self, tensordict: TensorDictBase) -> None:
        layers = bayesian_layers(self.actor)
        stack = layers[0].stack
        rows = tensordict.batch_size[len(stack) :]
        if self._held_rows != rows:
            drawn = () if self.shared else tuple(rows)
            self._held = {layer: layer.draw_weights(drawn) for layer in layers}
            self._held_rows = rows
            return
        if self.per == "round":
            return
        begins = tensordict.get(self.init_key, None)
        if begins is None:
            return
        begins = begins.reshape(tensordict.batch_size)
        if self.shared and rows:
            begins = begins.flatten(len(stack)).any(-1)
        for layer, draws in self._held.items():
            layer.posterior.redraw_(draws, begins)


class Boltzmann(TensorDictModuleBase):
    """Replaces the greedy action by a draw from softmax(Q / temperature).

    Goes behind an actor; explores under RANDOM and outside of any context, else leaves the
    action as it is. The temperature falls linearly with :meth:`step` and is a buffer, so that
    checkpoints hold it.

    Args:
        temperature_init: temperature at first, in units of Q (rewards).
        temperature_end: temperature after ``annealing_num_steps`` steps.
        annealing_num_steps: length of the schedule.

    Keyword Args:
        action_key: where the action (an index) goes.
        action_value_key: values [*batch, N].
        action_mask_key: bool [*batch, N], or None for no mask.
        spec: of the action, if known.

    Raises:
        ValueError: if not temperature_init ≥ temperature_end > 0, or without any step.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> explore = Boltzmann(2.0, 0.5, 3, action_mask_key=None)
        >>> td = TensorDict(action_value=torch.tensor([[0.0, 99.0, -99.0]]), batch_size=[1])
        >>> explore(td)["action"]
        tensor([1])
        >>> explore.step(2)
        >>> explore.temperature
        tensor(1.)
    """

    temperature: Tensor
    temperature_init: Tensor
    temperature_end: Tensor

    def __init__(
        self,
        temperature_init: float,
        temperature_end: float,
        annealing_num_steps: int = 1000,
        *,
        action_key: NestedKey = "action",
        action_value_key: NestedKey = "action_value",
        action_mask_key: NestedKey | None = "action_mask",
        spec: Composite | None = None,
        device: torch.device | str | None = None,
    ) -> None:
        if not temperature_init >= temperature_end > 0:
            raise ValueError(
                "temperature_init must be at least temperature_end and that positive, got "
                f"{temperature_init} and {temperature_end}"
            )
        if annealing_num_steps < 1:
            raise ValueError(f"annealing_num_steps must be at least 1, got {annealing_num_steps}")
        super().__init__()
        self.action_key = action_key
        self.action_value_key = action_value_key
        self.action_mask_key = action_mask_key
        self.in_keys = [action_value_key]
        if action_mask_key is not None:
            self.in_keys.append(action_mask_key)
        self.out_keys = [action_key]
        self.annealing_num_steps = annealing_num_steps
        for name, value in {
            "temperature_init": temperature_init,
            "temperature_end": temperature_end,
            "temperature": temperature_init,
        }.items():
            self.register_buffer(name, torch.tensor(float(value), device=device))
        self._spec = spec

    @property
    def spec(self) -> Composite | None:
        """Spec of the action, if one was given."""
        return self._spec

    def step(self, frames: int = 1) -> None:
        """Lowers the temperature by ``frames`` steps of the schedule."""
        fall = (self.temperature_init - self.temperature_end) / self.annealing_num_steps
        self.temperature.copy_(
            torch.maximum(self.temperature_end, self.temperature - frames * fall)
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the drawn action [*batch]."""
        if not explores():
            return tensordict
        logits = tensordict.get(self.action_value_key).detach() / self.temperature
        # argmax(logit - log E), E ~ Exp(1), is a draw from the softmax (the Gumbel trick)
        logits = logits - torch.empty_like(logits).exponential_().log_()
        if self.action_mask_key is not None:
            mask = tensordict.get(self.action_mask_key)
            logits = torch.where(mask, logits, float("-inf"))
        return tensordict.set(self.action_key, logits.argmax(-1))


def bayesian_layers(module: torch.nn.Module) -> list[BayesMLP]:
    """Returns the Bayesian layers and networks in ``module``.

    Raises:
        ValueError: if there are none.
    """
    layers = [m for m in module.modules() if isinstance(m, BayesMLP)]
    if not layers:
        raise ValueError(
            "Thompson sampling and weight draws need a network with Bayesian layers (BayesMLP, "
            "BayesLinear), got one without"
        )
    return layers
