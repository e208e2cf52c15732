"""Saving an environment's own state where TorchRL saves that of its transforms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from torchrl.envs import Transform

if TYPE_CHECKING:
    from tensordict import TensorDictBase


class EnvState(Transform):
    """Puts the state of the environment below it into the ``state_dict`` of its transforms.

    TorchRL saves of a ``TransformedEnv``, and so of a ``Collector`` and a ``Trainer``, the
    transforms alone. With this transform among them a :class:`~bbq_torchrl.envs.DialogueEnv` (or a
    ``SerialEnv`` or ``ParallelEnv`` of them) is saved and loaded with them: dialogues, random
    generator and round. Otherwise it changes nothing.

    A ``Collector`` does not save its last observation. Ask for it once more after loading, by
    ``collector.reset(resume=True)``; what other transforms count, as ``StepCounter`` does,
    begins anew there. The ``MultiSyncCollector`` cannot hand ``resume`` on: its dialogues go on,
    but each worker chooses its next actions by what it was told before loading. A ``ParallelEnv``
    needs ``use_buffers=False``: with buffers, that of torchrl 0.14.1 answers too early once it has
    loaded.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from bbq_torchrl.domains import movie_domain
        >>> from bbq_torchrl.envs import DialogueEnv, EnvState
        >>> one, other = (
        ...     TransformedEnv(DialogueEnv(movie_domain(), seed=seed), EnvState())
        ...     for seed in (0, 1)
        ... )
        >>> told = one.reset()
        >>> _ = other.load_state_dict(one.state_dict())
        >>> bool((other.reset(resume=True) == told).all())
        True
    """

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=[])

    def get_extra_state(self) -> dict[str, Any]:
        """Returns the environment's ``state_dict``; nothing outside of an environment."""
        container = self.container
        return {} if container is None else dict(container.base_env.state_dict())

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Loads what :meth:`get_extra_state` returned into the environment."""
        if self.container is not None:
            self.container.base_env.load_state_dict(state)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset
