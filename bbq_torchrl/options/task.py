"""The task that networks and exploration must match, and keys with a value for each replica."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from bbq_torchrl.settings import ConfigError, Values, walk

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    import torch
    from torch import Tensor, nn
    from torchrl.data import TensorSpec
    from torchrl.envs import EnvBase
    from torchrl.modules import QValueActor

    from bbq_torchrl.options.registry import Option


@dataclass(frozen=True)
class Task:
    """The sizes and specs that networks and exploration must match.

    Attributes:
        inputs: number of features of an observation.
        action_spec: categorical spec of an action.
        replicas: number of independent seeds trained in parallel, the first dimension of all
            weights and batches.
        rounds: rounds of the training, for schedules.
        device: device of the weights.
        action_mask_key: key of the mask of legal actions; None: all actions are always legal.
        inactive: the features, bool [inputs], and actions, bool [actions], that become active
            later; None: all are active.
    """

    inputs: int
    action_spec: TensorSpec
    replicas: int
    rounds: int
    device: torch.device | None = None
    action_mask_key: str | None = "action_mask"
    inactive: tuple[Tensor, Tensor] | None = None

    @property
    def actions(self) -> int:
        """The number of actions."""
        return int(self.action_spec.n)

    @property
    def place(self) -> dict[str, Any]:
        """``replicas`` and ``device``, as keywords of a network."""
        return {"replicas": self.replicas, "device": self.device}

    def make_actor(
        self, network: nn.Module, make: Callable[..., QValueActor] | None = None
    ) -> QValueActor:
        """Returns a Q-network with its choice of an action; resets its inactive weights.

        Args:
            network: values of the actions by observation, for each replica.
            make: the function that makes the actor; by default
                :func:`~bbq_torchrl.networks.q_actor`.
        """
        from bbq_torchrl.networks import q_actor

        self.reset_inactive_(network)
        return (make or q_actor)(network, self.action_spec, action_mask_key=self.action_mask_key)

    def reset_inactive_(self, network: Any) -> None:
        """Initializes the weights of inactive inputs and actions as if they were added later.

        The network must be :class:`~bbq_torchrl.protocols.Growing`.
        """
        import torch

        if self.inactive is not None:
            with torch.no_grad():
                network.reset_inactive_(*self.inactive)


def action_mask_key(env: EnvBase) -> str | None:
    """Returns the key of an environment's action mask; None: all actions are always legal."""
    return "action_mask" if "action_mask" in list(env.observation_spec.keys()) else None


def check_env(env: EnvBase, option: str, batch_size: Sequence[int]) -> None:
    """Refuses an environment whose specs an agent cannot be trained with.

    Args:
        env: the environment that the option has made.
        option: the option's name.
        batch_size: the batch size requested.

    Raises:
        ConfigError: the batch size or a spec does not match.
    """
    import torch
    from torchrl.data import Categorical, OneHot

    batch = torch.Size(batch_size)
    state = action = None
    if getattr(env, "batch_size", None) == batch:
        state = env.observation_spec.get("observation", None)
        action = env.full_action_spec.get("action", None)
    has_state = state is not None and state.dtype.is_floating_point and state.shape[:-1] == batch
    is_index = isinstance(action, Categorical) and action.shape == batch
    if not has_state or not (is_index or isinstance(action, OneHot)):
        rows = ", ".join(map(str, batch))
        raise ConfigError(
            f"env={option} must make an environment of batch size [{rows}] whose specs have "
            f"observation, floats [{rows}, features], and action, Categorical or OneHot; got "
            f"{type(env).__name__} with {state} and {action}"
        )


def spread(value: Any, replicas: int) -> list[Any]:
    """Returns the value of each replica; neighboring replicas share the values of a shorter list.

    Args:
        value: one value, or a list whose length divides ``replicas``.
        replicas: the number of replicas.

    Examples:
        >>> spread([0.1, 0.2], 6)
        [0.1, 0.1, 0.1, 0.2, 0.2, 0.2]
        >>> spread(0.1, 2)
        [0.1, 0.1]
    """
    values = value if isinstance(value, list) else [value]
    times = replicas // len(values)
    return [item for item in values for _ in range(times)]


def replica_values(config: Any) -> list[dict[str, float]]:
    """Returns, for each replica, its values of the keys with lists, by dotted key."""
    columns = {key: spread(value, config.replicas) for key, value in lists(config)}
    return [
        {key: float(values[replica]) for key, values in columns.items()}
        for replica in range(config.replicas)
    ]


def lists(config: Any) -> Iterator[tuple[str, list[Any]]]:
    """Yields (dotted key, values) of the keys whose values differ between replicas."""
    for key, item, value in walk(config):
        if isinstance(value, list) and item.metadata["allowed"].per_replica:
            yield key, value


def over_replicas(value: Values, task: Task) -> float | Tensor:
    """Returns a list as a float64 tensor [replicas], an integer as a float, others unchanged."""
    if isinstance(value, list):
        import torch

        return torch.tensor(spread(value, task.replicas), dtype=torch.float64)
    return float(value) if isinstance(value, int) else value


def keywords(option: Option, task: Task, *names: str) -> dict[str, Any]:
    """Returns keys of an option as keywords of a part, lists as tensors [replicas].

    Args:
        option: the option.
        task: the task, for the number of replicas.
        names: keys that are arguments of the part, too.
    """
    lists_too = {item.name for item in fields(option) if item.metadata["allowed"].per_replica}
    values = {name: getattr(option, name) for name in names}
    return {
        name: over_replicas(value, task) if name in lists_too else value
        for name, value in values.items()
    }


def replica_column(value: Values, task: Task) -> float | Tensor:
    """Returns a number as a float, and a list as a float64 tensor [replicas, 1]."""
    over = over_replicas(value, task)
    return over if isinstance(over, float) else over.unsqueeze(-1)
