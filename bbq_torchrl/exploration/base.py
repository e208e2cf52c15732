"""The base class and helpers of exploration strategies."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, get_args

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, exploration_type

from bbq_torchrl.protocols import Resampled, provides
from bbq_torchrl.settings import at_least, check, one_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey
    from torch import Tensor
    from torchrl.data import Composite
    from torchrl.modules import QValueActor
    from typing_extensions import Self

    from bbq_torchrl.bayes import GaussianPosterior

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
