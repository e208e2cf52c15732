"""Optional methods that the trainer calls, one protocol for each.

A part need not inherit from a protocol: :func:`provides` looks for the methods. Each docstring says
who calls a method and when; a part without it is used as it is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, TypeGuard, TypeVar, cast

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from tensordict import TensorDictBase
    from torch import Tensor, nn

Methods = TypeVar("Methods")


def provides(owner: object, protocol: type[Methods]) -> TypeGuard[Methods]:
    """Returns whether an object has everything that a protocol names.

    Unlike ``isinstance`` with a runtime-checkable protocol (from Python 3.12 on) it finds what a
    wrapper such as TorchRL's ``TransformedEnv`` forwards to the object that it wraps.

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
    """Returns the submodules whose class has everything that a protocol names; [] for None.

    A wrapper such as ``TensorDictModule`` is left out: the module that it wraps is in the list, and
    must not be called twice.

    Args:
        root: the module.
        protocol: the protocol.
    """
    modules = () if root is None else root.modules()
    return [cast("Methods", module) for module in modules if provides(type(module), protocol)]


# -- losses -----------------------------------------------------------------------------------


class UsesNumData(Protocol):
    """A loss that weighs a prior against the number of data."""

    def set_num_data(self, num_data: Tensor) -> None:
        """Takes the number of stored transitions, int64 [replicas]; called before learning."""


class BeginsEpochs(Protocol):
    """A loss that does something once an epoch."""

    def begin_epoch(self) -> None:
        """Called before each epoch over the buffers."""


class FixedTargets(Protocol):
    """A loss whose targets may be computed once a freeze, for the whole buffer.

    Other losses compute their targets at every update, and so does one whose
    ``has_fixed_targets`` is False.

    Attributes:
        has_fixed_targets: whether the targets are the same for every batch until the next freeze.
        tensor_keys: names, as ``next_state_value``, the entry of "next" that the values go to.
    """

    @property
    def has_fixed_targets(self) -> bool:
        """Whether the targets are the same for every batch until the next freeze."""

    @property
    def tensor_keys(self) -> Any:
        """The loss's keys."""

    def next_state_values(self, tensordict: TensorDictBase, /) -> Tensor:
        """Returns the frozen network's values of transitions [replicas, rows], the same shape."""


# -- modules of a policy ----------------------------------------------------------------------


class Resampled(Protocol):
    """A module that keeps something for a round, such as a draw of weights."""

    def resample(self) -> None:
        """Draws anew; called before the episodes of a round are played."""


class Annealed(Protocol):
    """A module with a schedule, such as TorchRL's ``EGreedyModule``."""

    def step(self, frames: int = 1, /) -> None:
        """Advances the schedule; called after each round, with 1."""


# -- modules of a replay buffer's transform ---------------------------------------------------


class Seeded(Protocol):
    """A transform with separate random numbers. Others draw none, or from torch's generator."""

    def set_seeds(self, seeds: Sequence[int], /) -> None:
        """Takes a seed for each replica; called whenever the replay's shuffling is seeded."""


class Measured(Protocol):
    """A transform that reports metrics."""

    def pop_metrics(self) -> Mapping[str, Tensor]:
        """Returns metrics by name, each [replicas], of what was stored since the last call."""


# -- environments and evaluators --------------------------------------------------------------


class RoundEnv(Protocol):
    """An environment that changes with the rounds (domain extension)."""

    def set_round(self, round: int, /) -> None:
        """Enters a round; called before its dialogues are played, and before spiking with 0."""


def enter_round(env: object, round: int) -> None:
    """Puts an environment that changes with the rounds into the state of a round."""
    if provides(env, RoundEnv):
        env.set_round(round)


class Stateful(Protocol):
    """A part of a checkpoint."""

    def state_dict(self) -> dict[str, Any]:
        """Returns the state: tensors and JSON values in dicts, lists and tuples."""

    def load_state_dict(self, state_dict: Mapping[str, Any], /) -> object:
        """Restores what :meth:`state_dict` returned."""


class BestSoFar(Stateful, Protocol):
    """The weights that each replica had at its best evaluation."""

    @property
    def round(self) -> Tensor:
        """The round of each replica's best, int64 [replicas]."""

    @property
    def success_rate(self) -> Tensor:
        """The success rate in that round, [replicas]."""


class EvaluationHook(Protocol):
    """Plays the policy that is to be reported, after every round."""

    @property
    def best(self) -> BestSoFar:
        """The best weights so far; saved in every checkpoint."""

    def __call__(self, round_number: int) -> Mapping[str, float | Tensor]:
        """Returns metrics of the round by name, one number or [replicas]; always the same names.

        NaN stands for a round without an evaluation. It may use torch's global generator, but
        none of the training's other sources of random numbers.
        """


# -- optimizers and networks ------------------------------------------------------------------


class ReplicaOptimizer(Stateful, Protocol):
    """An optimizer of parameters whose first dimension is independent replicas.

    :class:`~bbq_torchrl.trainers.ReplicaAdam` is one. Its random numbers, if any, come from torch's
    global generator, which the trainer seeds for each epoch, and are drawn for all replicas at
    every step.
    """

    @property
    def replicas(self) -> int:
        """The number of replicas."""

    def zero_grad(self) -> None:
        """Clears the gradients."""

    def step(self, active: Sequence[bool] | None = None) -> None:
        """Updates the active replicas, all by default; the others stay bitwise the same."""

    def scale_lr(self, share: float) -> None:
        """Sets the learning rate to this share of the first one; called where the rate falls."""


class Growing(Protocol):
    """A network that can start with inputs and outputs that come into use later.

    ``BayesMLP``, ``BootstrapMLP``, ``FlatMLP`` and ``NoisyMLP`` are such networks; any other with
    these three members is one, too. :func:`bbq_torchrl.networks.growth.reset_inactive_` refuses
    networks without them.
    """

    @property
    def in_features(self) -> int:
        """Size of the input."""

    @property
    def out_features(self) -> int:
        """Size of the output."""

    def reset_inactive_(self, inputs: Tensor, outputs: Tensor) -> None:
        """Starts the weights of inactive inputs and outputs.

        Called without gradients, and with masks of the right shape.

        Args:
            inputs: bool [in_features], True for the inactive ones.
            outputs: bool [out_features], the same.
        """
