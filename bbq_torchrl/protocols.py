"""Optional methods that the trainer calls, as protocols.

A class need not inherit from a protocol: :func:`provides` looks for the methods. Each docstring
says when a method is called; the trainer skips methods that an object lacks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, TypeGuard, TypeVar, cast

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from tensordict import TensorDictBase
    from torch import Tensor, nn

Methods = TypeVar("Methods")


def provides(owner: object, protocol: type[Methods]) -> TypeGuard[Methods]:
    """Returns whether an object has every member of a protocol.

    Unlike ``isinstance`` with a runtime-checkable protocol (from Python 3.12 on), it finds members
    that a wrapper such as TorchRL's ``TransformedEnv`` forwards to the wrapped object.

    Args:
        owner: the object.
        protocol: the protocol.

    Examples:
        >>> from bbq_torchrl.protocols import Resampled
        >>> class Policy:
        ...     def resample(self) -> None: ...
        >>> provides(Policy(), Resampled), provides(object(), Resampled)
        (True, False)
    """
    named = {name: item for name, item in vars(protocol).items() if not name.startswith("_")}
    return all(
        callable(getattr(owner, name, None)) if callable(item) else hasattr(owner, name)
        for name, item in named.items()
    )


def modules_with(root: nn.Module | None, protocol: type[Methods]) -> list[Methods]:
    """Returns the submodules whose class has every member of a protocol; [] for None.

    Wrappers such as ``TensorDictModule`` are left out, so that the wrapped module, which is in the
    list, is not called twice.

    Args:
        root: the module.
        protocol: the protocol.
    """
    modules = () if root is None else root.modules()
    return [cast("Methods", module) for module in modules if provides(type(module), protocol)]


# -- losses -----------------------------------------------------------------------------------


class UsesNumData(Protocol):
    """A loss that weighs its prior by the number of data."""

    def set_num_data(self, num_data: Tensor) -> None:
        """Sets the number of stored transitions, int64 [replicas]; called before learning."""


class BeginsEpochs(Protocol):
    """A loss with per-epoch work or state."""

    def begin_epoch(self) -> None:
        """Prepares for an epoch; called before each epoch over the buffers."""


class FixedTargets(Protocol):
    """A loss whose targets can be computed once per freeze, for the whole buffer.

    Other losses, and those whose ``has_fixed_targets`` is False, compute their targets at every
    update.

    Attributes:
        has_fixed_targets: whether the targets are the same for every batch until the next freeze.
        tensor_keys: the loss's keys; ``next_state_value`` names the entry of the values in "next".
    """

    @property
    def has_fixed_targets(self) -> bool:
        """True if all batches until the next freeze share their targets."""

    @property
    def tensor_keys(self) -> Any:
        """The loss's keys."""

    def next_state_values(self, tensordict: TensorDictBase, /) -> Tensor:
        """Returns the frozen network's values, [replicas, rows, 1], for [replicas, rows]."""


class FitsBuffers(Protocol):
    """A loss that learns from all stored transitions at once, in closed form.

    Attributes:
        only_fits: whether that is all its learning, so that mini-batches are not needed.
    """

    @property
    def only_fits(self) -> bool:
        """True if nothing is learned by gradient."""

    def fit(self, tensordict: TensorDictBase, /) -> TensorDictBase:
        """Learns from [replicas, rows], shuffled; called once a round, after the mini-batches.

        Returns:
            ``loss_value`` and further metrics, [replicas] each; they replace the mini-batches'
            metrics of the same names.
        """


# -- modules of a policy ----------------------------------------------------------------------


class Resampled(Protocol):
    """A module that draws something for a round, such as weights."""

    def resample(self) -> None:
        """Redraws; called before the dialogues of a round are played."""


class Annealed(Protocol):
    """A module with a schedule, such as TorchRL's ``EGreedyModule``."""

    def step(self, frames: int = 1, /) -> None:
        """Advances the schedule; called after each round, with 1."""


class SeesSuccess(Protocol):
    """A module that acts by what its replicas have achieved."""

    def see_success(self, success_rate: Tensor, /) -> None:
        """Receives the share of a round's dialogues that succeeded, float64 [replicas]."""


# -- modules of a replay buffer's transform ---------------------------------------------------


class Seeded(Protocol):
    """A transform with separate random numbers for each replica."""

    def set_seeds(self, seeds: Sequence[int], /) -> None:
        """Seeds each replica; called whenever the replay's shuffling is seeded."""


class Measured(Protocol):
    """A transform that reports metrics."""

    def pop_metrics(self) -> Mapping[str, Tensor]:
        """Returns metrics of the rows stored since the last call, by name, [replicas] each."""


# -- environments and checkpoints --------------------------------------------------------------


class RoundEnv(Protocol):
    """An environment that changes with the rounds (domain extension)."""

    def set_round(self, round: int, /) -> None:
        """Enters a round; called before its dialogues are played, and with 0 before spiking."""


def enter_round(env: object, round: int) -> None:
    """Enters a round in an environment that changes with the rounds."""
    if provides(env, RoundEnv):
        env.set_round(round)


class Stateful(Protocol):
    """A component of a checkpoint."""

    def state_dict(self) -> dict[str, Any]:
        """Returns the state, tensors and JSON values in dicts, lists and tuples."""

    def load_state_dict(self, state_dict: Mapping[str, Any], /) -> object:
        """Restores the state from :meth:`state_dict`."""


# -- optimizers and networks ------------------------------------------------------------------


class ReplicaOptimizer(Stateful, Protocol):
    """An optimizer of parameters whose first dimension is independent replicas.

    An example is :class:`~bbq_torchrl.trainers.ReplicaAdam`. Random numbers, if any, must come from
    torch's global generator, which the trainer seeds for each epoch, and must be drawn for all
    replicas at every step.
    """

    @property
    def replicas(self) -> int:
        """The number of replicas."""

    def zero_grad(self) -> None:
        """Clears the gradients."""

    def step(self, active: Sequence[bool] | None = None) -> None:
        """Updates the active replicas, by default all; the others are bitwise unchanged."""

    def scale_lr(self, share: float) -> None:
        """Sets the learning rate to this share of the initial one; called if it is scheduled."""


class Growing(Protocol):
    """A network that can start with inputs and outputs that come into use later.

    The paper grows a network when a feature or an action appears. Here the network has its full
    size from the start: inactive features are 0, inactive actions are masked, and their weights
    start where growth would put them. The two are equivalent as long as nothing moves an inactive
    weight. Its data gradient is 0, and so is the gradient of the closed KL at the prior. (A sampled
    KL moves it.)
    """

    def reset_inactive_(self, inputs: Tensor, outputs: Tensor) -> None:
        """Initializes the weights of inactive inputs and outputs.

        Called once, without gradients, before a loss copies the network, because target updaters do
        not update the copy of a prior function.

        Args:
            inputs: bool [in_features], True for inactive inputs. Their weights become 0 (in a noisy
                network μ and σ), or those of the prior in a Bayesian network. So a new feature
                changes neither the mean nor the noise before it is learned. The weights of a prior
                function become 0 too.
            outputs: bool [out_features], True for inactive outputs. Their weights become the
                prior's in a Bayesian network. Others keep their initial weights; a noisy network
                explores a new action by its initial σ.
        """
