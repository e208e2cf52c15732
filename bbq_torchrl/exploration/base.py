"""The base class and the helpers of exploration strategies."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, get_args

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, exploration_type

from bbq_torchrl.checks import at_least, check, one_of
from bbq_torchrl.protocols import Resampled, provides

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey
    from torch import Tensor, nn
    from torchrl.data import Composite
    from torchrl.modules import QValueActor
    from typing_extensions import Self

    from bbq_torchrl.bayes import GaussianPosterior

Per = Literal["step", "episode", "round"]


def explores() -> bool:
    """Returns whether exploration modules explore: under RANDOM, and outside of any context.

    None counts as RANDOM, as it does for TorchRL's ``EGreedyModule``.
    """
    return exploration_type() in (ExplorationType.RANDOM, None)


def schedule(
    start: float | Tensor, end: float | Tensor, annealing_num_steps: int
) -> tuple[Tensor, Tensor]:
    """Returns where a schedule starts and ends, float32 of one shape: not those that were given.

    Raises:
        ValueError: for a schedule without a step.
    """
    check("annealing_num_steps", annealing_num_steps, at_least(1))
    pair = [torch.as_tensor(value, dtype=torch.float32) for value in (start, end)]
    first, last = (value.clone() for value in torch.broadcast_tensors(*pair))
    return first, last


def check_batch(name: str, values: Tensor, batch: torch.Size) -> None:
    """Raises ValueError unless values have a shape that broadcasts to the batch's."""
    try:
        values.expand(batch)
    except RuntimeError:
        raise ValueError(
            f"{name} of shape {list(values.shape)} must broadcast with the batch, got {list(batch)}"
        ) from None


def fit_posteriors(drawn: Mapping[GaussianPosterior, Tensor]) -> bool:
    """Returns whether draws have the dtype and device that their posteriors have now.

    A loss that shares the network may have been moved, which the policy is not told.
    """
    return all(
        (draws.dtype, draws.device) == (posterior.mu.dtype, posterior.mu.device)
        for posterior, draws in drawn.items()
    )


def weight_sums(weights: Iterable[Tensor]) -> list[float]:
    """Returns the sum of each tensor of weights: other numbers once they were learned or synced.

    What is drawn for a round is drawn anew then. A collector's process is told of no round: new
    weights are copied into its policy's in place, past every hook and version counter.
    """
    sums = [weight.detach().sum() for weight in weights]
    if any(total.is_meta for total in sums):
        return []
    return list(torch.stack(sums).tolist()) if sums else []


def posterior_sums(found: Iterable[GaussianPosterior]) -> list[float]:
    """Returns :func:`weight_sums` of posteriors."""
    return weight_sums(weight for posterior in found for weight in posterior.parameters())


def forget_draws(policy: Resampled, _: object = None) -> None:
    """Makes a policy draw anew after its state was loaded; a hook of ``load_state_dict``."""
    policy.resample()


def rename_older_keys(
    policy: nn.Module, state_dict: dict[str, Any], prefix: str, *_: object
) -> None:
    """Renames entries of when an actor's were below ``actor``; a hook of ``load_state_dict``."""
    older = f"{prefix}actor."
    if "actor" not in policy._modules:
        for key in [key for key in state_dict if key.startswith(older)]:
            state_dict[prefix + key.removeprefix(older)] = state_dict.pop(key)


class ActorPolicy(TensorDictModuleBase):
    """A policy that reads and writes what its actor does.

    The actor's modules are the policy's own, under the same names. So ``state_dict`` and
    ``TensorDict.from_module`` name the weights of both alike, and weights of an actor are synced
    into a policy by name, as TorchRL's trainers and collectors do.

    Its draws are renewed once the policy is moved or cast (:meth:`to`).

    Args:
        actor: what chooses actions from values.
        per: how long it acts on what it draws, if it draws.
        init_key: bool [*batch, 1] or [*batch], True where a row begins an episode; read for
            per="episode".

    Raises:
        ValueError: for another ``per``, or an actor that is no TensorDict module.
    """

    actor: QValueActor

    def __init__(
        self, actor: QValueActor, per: Per = "step", init_key: NestedKey = "is_init"
    ) -> None:
        check("per", per, one_of(*get_args(Per)))
        if not (hasattr(actor, "in_keys") and hasattr(actor, "out_keys")):  # compiled, too
            raise ValueError(
                "actor must be a TensorDict module, such as q_actor makes of a network, got "
                f"{type(actor).__name__}"
            )
        super().__init__()
        # Not as a submodule: its weights would have a second name.
        self.__dict__["actor"] = actor
        for name, module in actor.named_children():
            self.add_module(name, module)
        for own in ("_parameters", "_buffers"):
            if vars(actor)[own]:  # an actor that is a layer itself
                self.__dict__[own] = vars(actor)[own]
        self.register_load_state_dict_pre_hook(rename_older_keys)
        self.per = per
        self.init_key = init_key
        self.in_keys = [*actor.in_keys, init_key] if per == "episode" else actor.in_keys
        self.out_keys = actor.out_keys

    def _begins(self, tensordict: TensorDictBase) -> Tensor | None:
        """Returns which rows begin an episode, bool [*batch]; None unless they are to know.

        Raises:
            ValueError: if the entry that says so is missing.
        """
        if self.per != "episode":
            return None
        found: Tensor | None = tensordict.get(self.init_key, None)
        if found is None:
            raise ValueError(
                f"per='episode' needs the entry {self.init_key!r}, True where an episode begins: "
                "append torchrl.envs.InitTracker() to the environment, or take per='step' or "
                "per='round'"
            )
        return found.reshape(tensordict.batch_size)

    def train(self, mode: bool = True) -> Self:
        """Sets the training mode of the policy and its actor. Returns itself."""
        self.actor.train(mode)
        return super().train(mode)

    def _apply(self, *args: Any, **kwargs: Any) -> Self:
        if provides(type(self), Resampled):
            self.resample()
        return super()._apply(*args, **kwargs)

    @property
    def spec(self) -> Composite | None:
        """Specs of what the actor writes; None where it knows none, as a bare sequence."""
        return getattr(self.actor, "spec", None)
