"""Parts of the dialogue environment: domain extension, checks, the compiled turn, saved state."""

from __future__ import annotations

from dataclasses import dataclass
from operator import index
from typing import TYPE_CHECKING, Any

import torch
from torchrl.envs import Transform

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDict, TensorDictBase
    from torch import Tensor

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.simulator import Simulator


@dataclass(frozen=True)
class ExtensionSchedule:
    """A schedule that starts with a domain's essential slots and adds others one at a time.

    Lipton et al. (2018) train 40 rounds on the essential slots and then add a slot every 10 rounds.
    The domain's ``extension_order`` has the order.

    Args:
        start: the round, counted from 0, that adds the first slot.
        every: rounds from one addition to the next.

    Raises:
        ValueError: if ``start`` is below 0 or ``every`` below 1.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> schedule = ExtensionSchedule(start=40, every=10)
        >>> len(schedule.active(movie_domain(), 39))
        8
        >>> "genre" in schedule.active(movie_domain(), 40)
        True
    """

    start: int = 40
    every: int = 10

    def __post_init__(self) -> None:
        if self.start < 0:
            raise ValueError(f"start must be a round from 0 on, got {self.start}")
        if self.every < 1:
            raise ValueError(f"every must be at least 1 round, got {self.every}")

    def active(self, domain: Domain, round: int) -> tuple[str, ...]:
        """Returns the slots active in a round, in the order of the domain's slots.

        Args:
            domain: the domain.
            round: the round, counted from 0.
        """
        added = {slot for start, slot in self.additions(domain).items() if start <= round}
        return tuple(slot for slot in domain.slots if slot in added or slot in domain.essential)

    def never_active(self, domain: Domain) -> tuple[str, ...]:
        """Returns the slots that no round activates; goals are restricted to the others.

        Raises:
            ValueError: if the agent has actions for one of them, which could never be played.
        """
        active = {*domain.essential, *domain.extension_order}
        never = tuple(slot for slot in domain.slots if slot not in active)
        dead = [slot for slot in never if any(action.slot == slot for action in domain.actions)]
        if dead:
            raise ValueError(
                f"domain extension would never activate {', '.join(dead)}, for which the agent has "
                f"actions: domain {domain.name!r} must have them in essential or in extension_order"
            )
        return never

    def additions(self, domain: Domain) -> dict[int, str]:
        """Returns the added slot by round."""
        order = enumerate(domain.extension_order)
        return {self.start + index * self.every: slot for index, slot in order}


def action_indices(action: Tensor, batch_size: Sequence[int], count: int) -> Tensor:
    """Returns indices of actions, of any integer dtype, as int64, shape [*batch].

    Args:
        action: the actions.
        batch_size: their expected shape.
        count: number of actions to choose from.

    Raises:
        ValueError: if shape or dtype differ, as for one-hot actions.

    Examples:
        >>> action_indices(torch.tensor([3, 0], dtype=torch.int32), [2], 4)
        tensor([3, 0])
    """
    is_integer = not (action.is_floating_point() or action.is_complex())
    if not is_integer or action.dtype == torch.bool or action.shape != torch.Size(batch_size):
        raise ValueError(
            f"action must be Categorical: indices from 0 to {count - 1}, of an integer dtype and "
            f"shape {list(batch_size)}, got {action.dtype} of shape {list(action.shape)}"
        )
    return action.long()


def check_range(action: Tensor, count: int) -> None:
    """Raises ValueError if an index is out of range."""
    wrong = action[(action < 0) | (action >= count)]
    if wrong.numel():
        raise ValueError(f"action must be from 0 to {count - 1}, got {int(wrong[0])}")


def checked_batch(batch_size: Sequence[int]) -> torch.Size:
    """Returns the batch size.

    Raises:
        ValueError: if it is not a sequence of positive integers.
    """
    try:
        shape = torch.Size([index(size) for size in batch_size])
    except TypeError:
        shape = torch.Size([0])
    if any(size < 1 for size in shape):
        raise ValueError(
            f"batch_size must be a sequence of positive numbers, such as (50,), got {batch_size}"
        )
    return shape


def present_device(device: torch.device | str) -> torch.device:
    """Returns the device.

    Raises:
        ValueError: if it is absent.
    """
    try:
        return torch.empty(0, device=device).device
    except (AssertionError, RuntimeError) as error:
        raise ValueError(
            f"device must be one that is present, got {str(device)!r}: {error}"
        ) from error


class CompiledPlay:
    """A simulator's compiled turn; copies and other processes compile it again.

    Its numbers are the same, except for the rounding of floating-point ones: the features, which
    are ratios of small integers.
    """

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        # isolate_recompiles: otherwise all environments of a process share torch's limit of 8
        # programs. (Torch's overloads lack the keyword.)
        self._play = torch.compile(  # type: ignore[call-overload]
            simulator.play, fullgraph=True, dynamic=False, isolate_recompiles=True
        )

    def __call__(self, *state_and_action: Any) -> tuple[TensorDict, torch.Tensor]:
        """Plays one turn, as :meth:`~bbq_torchrl.simulator.Simulator.play`."""
        return self._play(*state_and_action)

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledPlay, (self._simulator,)


class EnvState(Transform):
    """Adds the state of the base environment to the ``state_dict`` of a ``TransformedEnv``.

    TorchRL saves only the transforms of a ``TransformedEnv``, and so of a ``Collector`` and a
    ``Trainer``. This transform saves and loads a :class:`~bbq_torchrl.envs.DialogueEnv` (or a
    ``SerialEnv`` or ``ParallelEnv`` of them) along with them: dialogues, random generator and
    round. It has no other effect.

    A ``Collector`` does not save its last observation. Get it again after loading by
    ``collector.reset(resume=True)``, which restarts the counts of other transforms, such as
    ``StepCounter``. The ``MultiSyncCollector`` cannot pass on ``resume``: its dialogues continue,
    but each worker chooses its next actions from the observation before loading. A ``ParallelEnv``
    needs ``use_buffers=False``: with buffers, that of torchrl 0.14.1 responds too early after
    loading.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from bbq_torchrl.domains import movie_domain
        >>> from bbq_torchrl.envs import DialogueEnv, EnvState
        >>> one, other = (
        ...     TransformedEnv(DialogueEnv(movie_domain(), seed=seed), EnvState())
        ...     for seed in (0, 1)
        ... )
        >>> observed = one.reset()
        >>> _ = other.load_state_dict(one.state_dict())
        >>> bool((other.reset(resume=True) == observed).all())
        True
    """

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=[])

    def get_extra_state(self) -> dict[str, Any]:
        """Returns the environment's ``state_dict``; empty outside an environment."""
        container = self.container
        return {} if container is None else dict(container.base_env.state_dict())

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Loads the result of :meth:`get_extra_state` into the environment."""
        if self.container is not None:
            self.container.base_env.load_state_dict(state)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset
