"""The sizes that networks and exploration have to fit: features, actions, replicas."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bbq_torchrl.options.settings import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch
    from torch import Tensor
    from torchrl.data import TensorSpec
    from torchrl.envs import EnvBase


@dataclass(frozen=True)
class Task:
    """The sizes that networks and exploration have to fit.

    Attributes:
        inputs: features of an observation.
        action_spec: of one action, categorical.
        replicas: independent seeds trained side by side; the first dimension of all weights and
            of every batch.
        rounds: of the training, which schedules take a share of.
        device: of the weights.
        action_mask_key: where an observation says which actions are legal; None: all always are.
        inactive_inputs: bool [inputs], features that come into use later; None: all are in use.
        inactive_actions: bool [actions], the same of actions.
        counted_inputs: bool [inputs], features that tell kinds of states apart, for counts of
            visits; None: all do.
    """

    inputs: int
    action_spec: TensorSpec
    replicas: int
    rounds: int
    device: torch.device | None = None
    action_mask_key: str | None = "action_mask"
    inactive_inputs: Tensor | None = None
    inactive_actions: Tensor | None = None
    counted_inputs: Tensor | None = None

    @property
    def actions(self) -> int:
        """The number of actions."""
        return int(self.action_spec.n)

    def reset_inactive_(self, network: Any) -> None:
        """Starts weights of what is not active yet as if it were added only later.

        See :func:`~bbq_torchrl.networks.growth.reset_inactive_`; the network must be
        :class:`~bbq_torchrl.protocols.Growing`.
        """
        from bbq_torchrl.networks.growth import reset_inactive_

        if self.inactive_inputs is not None or self.inactive_actions is not None:
            reset_inactive_(network, inputs=self.inactive_inputs, outputs=self.inactive_actions)


def action_mask_key(env: EnvBase) -> str | None:
    """Returns the key of an environment's mask of legal actions; None: all are always legal."""
    return "action_mask" if "action_mask" in list(env.observation_spec.keys()) else None


def check_env(env: EnvBase, option: str, batch_size: Sequence[int]) -> None:
    """Refuses an environment that an agent cannot be trained in, by its specs.

    Args:
        env: what the option made.
        option: its name.
        batch_size: what it was to be made with.

    Raises:
        ConfigError: the first thing that does not fit.
    """
    import torch
    from torchrl.data import Categorical, OneHot

    batch, makes = torch.Size(batch_size), f"env={option} must make an environment"
    found = getattr(env, "batch_size", None)
    if found != batch:
        got = type(env).__name__ if found is None else str(list(found))
        raise ConfigError(f"{makes} of batch size {list(batch)}, got {got}")
    rows = ", ".join(map(str, batch))

    def refusal(name: str, spec: TensorSpec | None, wanted: str) -> ConfigError:
        got = "none" if spec is None else f"{type(spec).__name__} {list(spec.shape)}"
        return ConfigError(f"{makes} whose specs have {name}, {wanted}, got {got}")

    spec = env.observation_spec.get("observation", None)
    if spec is None or not spec.dtype.is_floating_point or spec.shape[:-1] != batch:
        raise refusal("observation", spec, f"floats [{rows}, features]")
    spec = env.full_action_spec.get("action", None)
    is_index = isinstance(spec, Categorical) and spec.shape == batch
    if not is_index and not (isinstance(spec, OneHot) and spec.shape[:-1] == batch):
        raise refusal("action", spec, f"Categorical [{rows}] or OneHot [{rows}, actions]")
