"""The base class of policies, its helpers, and acting without exploration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Literal, get_args

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import QValueActor

from bbq_torchrl.bayes import GaussianPosterior
from bbq_torchrl.bayes.layers import local_weight_scope
from bbq_torchrl.bayes.posterior import posteriors
from bbq_torchrl.bayes.scope import weight_scope
from bbq_torchrl.networks.q_actor import split_actor
from bbq_torchrl.protocols import Resampled, provides
from bbq_torchrl.settings import at_least, check, one_of

if TYPE_CHECKING:
    from typing_extensions import Self

Per = Literal["step", "episode", "round"]


def explores() -> bool:
    """Returns whether exploration modules explore: under RANDOM and outside of any context.

    Outside of any context counts as RANDOM, as for TorchRL's ``EGreedyModule``.
    """
    return exploration_type() in (ExplorationType.RANDOM, None)


def schedule(
    start: float | Tensor, end: float | Tensor, annealing_num_steps: int
) -> tuple[Tensor, Tensor]:
    """Returns copies of the start and end of a schedule, float32 and of the same shape.

    Raises:
        ValueError: if the schedule has no step.
    """
    check("annealing_num_steps", annealing_num_steps, at_least(1))
    pair = [torch.as_tensor(value, dtype=torch.float32) for value in (start, end)]
    first, last = (value.clone() for value in torch.broadcast_tensors(*pair))
    return first, last


def fit_posteriors(drawn: Mapping[GaussianPosterior, Tensor]) -> bool:
    """Returns whether draws still have the dtype and device of their posteriors.

    They differ if a loss that shares the network was moved, which does not notify the policy.
    """
    return all(
        (draws.dtype, draws.device) == (posterior.mu.dtype, posterior.mu.device)
        for posterior, draws in drawn.items()
    )


def weight_sums(weights: Iterable[Tensor]) -> list[float]:
    """Returns the sum of each weight tensor, which changes when weights are updated or synced.

    Draws that last for a round are renewed when a sum changes. A collector's worker process is not
    notified of rounds: new weights are copied in place into its policy, past every hook and version
    counter.
    """
    sums = [weight.detach().sum() for weight in weights]
    if any(total.is_meta for total in sums):
        return []
    return list(torch.stack(sums).tolist()) if sums else []


def posterior_sums(found: Iterable[GaussianPosterior]) -> list[float]:
    """Returns the :func:`weight_sums` of posteriors."""
    return weight_sums(weight for posterior in found for weight in posterior.parameters())


def forget_draws(policy: Resampled, _: object = None) -> None:
    """Renews a policy's draws after its state was loaded; a ``load_state_dict`` hook."""
    policy.resample()


class ActorPolicy(TensorDictModuleBase):
    """The base class of policies that read and write the entries of an actor.

    A policy has the actor's modules under the same names. So ``state_dict`` and
    ``TensorDict.from_module`` use the same weight names for both, and TorchRL's trainers and
    collectors can sync an actor's weights into a policy by name.

    Moving or casting the policy (:meth:`to`) renews its draws.

    Args:
        actor: the module that chooses actions from values.
        per: the lifetime of a draw, for policies that draw.
        init_key: bool [*batch, 1] or [*batch], True where a row begins an episode; read for
            per="episode".

    Raises:
        ValueError: for an unknown ``per``, or an actor that is not a TensorDict module.
    """

    actor: QValueActor

    def __init__(
        self, actor: QValueActor, per: Per = "step", init_key: NestedKey = "is_init"
    ) -> None:
        check("per", per, one_of(*get_args(Per)))
        if not (hasattr(actor, "in_keys") and hasattr(actor, "out_keys")):  # or a compiled one
            raise ValueError(
                "actor must be a TensorDict module, such as q_actor returns, got "
                f"{type(actor).__name__}"
            )
        super().__init__()
        # Not a submodule, which would give its weights second names.
        self.__dict__["actor"] = actor
        for name, module in actor.named_children():
            self.add_module(name, module)
        for own in ("_parameters", "_buffers"):
            if vars(actor)[own]:  # the actor itself is a layer
                self.__dict__[own] = vars(actor)[own]
        self.per = per
        self.init_key = init_key
        self.in_keys = [*actor.in_keys, init_key] if per == "episode" else actor.in_keys
        self.out_keys = actor.out_keys

    def _episode_starts(self, tensordict: TensorDictBase) -> Tensor | None:
        """Returns the mask of rows that begin an episode, bool [*batch]; None unless per="episode".

        Raises:
            ValueError: if the entry ``init_key`` is missing.
        """
        if self.per != "episode":
            return None
        found: Tensor | None = tensordict.get(self.init_key, None)
        if found is None:
            raise ValueError(
                f"per='episode' needs the entry {self.init_key!r}, True where an episode begins: "
                "append torchrl.envs.InitTracker() to the environment, or use per='step' or "
                "per='round'"
            )
        return found.reshape(tensordict.batch_size)

    def train(self, mode: bool = True) -> Self:
        """Sets the training mode of the policy and its actor, and returns the policy."""
        self.actor.train(mode)
        return super().train(mode)

    def _apply(self, *args: Any, **kwargs: Any) -> Self:
        if provides(type(self), Resampled):
            self.resample()
        return super()._apply(*args, **kwargs)

    @property
    def spec(self) -> Composite | None:
        """Specs of the entries that the actor writes; None if it has no specs."""
        return getattr(self.actor, "spec", None)


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
