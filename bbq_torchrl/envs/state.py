"""A transform that saves the environment's state with that of the transforms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from torchrl.envs import Transform

if TYPE_CHECKING:
    from tensordict import TensorDictBase


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
