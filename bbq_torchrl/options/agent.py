"""The options of ``agent=``: Q-networks and how they learn."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.options.task import keywords, spread
from bbq_torchrl.settings import (
    ABOVE_ZERO_TO_ONE,
    BELOW_ONE,
    BOOLEAN,
    COUNTS,
    NON_NEGATIVE,
    NON_NEGATIVE_INTEGER,
    POSITIVE,
    PROBABILITY,
    SIZE,
    STEP_SIZE,
    ConfigError,
    Values,
    integers,
    one_of,
    option,
    optional,
    or_text,
    per_replica,
    setting,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tensordict.nn import TensorDictModuleBase
    from torch import nn
    from torchrl.envs import Transform
    from torchrl.modules import QValueActor
    from torchrl.objectives import LossModule

    from bbq_torchrl.options.task import Task
    from bbq_torchrl.protocols import ReplicaOptimizer


@dataclass
class AgentOption(Option):
    """A Q-network with hidden layers, trained by Adam.

    Attributes:
        provides: the features that exploration can use: any of ``posterior``, ``heads``, ``noise``,
            ``values`` (a Q-value for each action), or a word that your strategy requires.
        explores_by: the default strategy.
        remedy: what to do when learning diverges.
        buffer_capacity: the default of ``protocol.capacity``; None: the protocol's.
        modes: the modes of :meth:`make_evaluation`, if the agent has several policies.
    """

    group: ClassVar[str] = "agent"

    hidden: list[int] = setting([256, 256], COUNTS, "units of each hidden layer")
    lr: Values = setting("${protocol.lr}", per_replica(STEP_SIZE), "learning rate of Adam")
    gamma: Values = setting(0.9, per_replica(PROBABILITY), "discount of a turn")

    provides: ClassVar[tuple[str, ...]] = ("values",)
    explores_by: ClassVar[str] = "epsilon_greedy"
    buffer_capacity: ClassVar[int | None] = None
    remedy: ClassVar[str] = "lower agent.lr"
    modes: ClassVar[tuple[str, ...]] = ()
    weight_decay = 0.0  # no key, unless an agent makes it one

    @abstractmethod
    def make_actor(self, task: Task) -> QValueActor:
        """Makes the Q-network and its choice of an action, as :meth:`Task.make_actor` does.

        Weights are drawn from torch's global generator, with the replicas as the first dimension;
        your network needs an attribute ``replicas`` with their number.
        """

    @abstractmethod
    def make_loss(self, actor: QValueActor, task: Task) -> LossModule:
        """Makes the loss, which returns ``loss``, a scalar, and ``loss_value``, [replicas]."""

    def make_optimizer(
        self, actor: QValueActor, parameters: Iterable[nn.Parameter], task: Task
    ) -> ReplicaOptimizer:
        """Makes the optimizer: Adam, a separate one for each replica.

        Args:
            actor: the result of :meth:`make_actor`.
            parameters: all learned parameters: the actor's, and those of a model for intrinsic
                rewards.
            task: the task.
        """
        from bbq_torchrl.trainers import ReplicaAdam

        rates = list(map(float, spread(self.lr, task.replicas)))
        return ReplicaAdam(parameters, task.replicas, lr=rates, weight_decay=self.weight_decay)

    def make_greedy(self, actor: QValueActor) -> TensorDictModuleBase:
        """Makes the policy that acts without exploration."""
        from bbq_torchrl.exploration import Greedy

        return Greedy(actor)

    def make_evaluation(
        self, actor: QValueActor, mode: str | None = None
    ) -> tuple[str, TensorDictModuleBase]:
        """Returns the name of the policy to report, and the policy.

        Args:
            actor: the result of :meth:`make_actor`.
            mode: one of :attr:`modes`; None: the agent's default.
        """
        return "greedy", self.make_greedy(actor)

    def check_mode(self, mode: str | None) -> None:
        """Refuses a mode that the agent does not have."""
        if mode is not None and mode not in self.modes:
            several = f"one of {', '.join(self.modes)} or " if self.modes else ""
            raise ConfigError(f"mode must be {several}null for agent={self.name}, got {mode!r}")

    def make_transforms(self, task: Task) -> list[Transform]:
        """Returns the transforms of the replay buffer that the agent needs."""
        return []


EVALUATION_MODES = ("mean", "average", "draw", "thompson")
"""The policies for evaluating a Bayesian agent."""

TARGET_NOISE = {"map": ("mean",), "mc": ("independent", "shared")}
"""target -> allowed noise of its weights, the default first."""


@register
@dataclass
class BBQN(AgentOption):
    """Bayes-by-Backprop Q-network: a Gaussian over each weight and bias."""

    name: str = option("bbqn")
    prior_std: Any = setting(
        0.037,
        or_text(per_replica(POSITIVE), "fan_in"),
        "std of the prior; fan_in: sqrt(2 / fan-in)",
    )
    mean_init: str = setting("kaiming", one_of("zero", "kaiming"), "initial posterior means")
    std_init: Any = setting(0.02, optional(per_replica(POSITIVE), "prior_std"), "posterior's start")
    noise_std: Values = setting(1.0, per_replica(POSITIVE), "std of the target's noise, unit of Q")
    kl: str = setting("closed", one_of("closed", "sampled"), "how KL(q || p) is computed")
    kl_temperature: Values = setting(0.014, per_replica(NON_NEGATIVE), "factor on the KL term")
    target: str = setting("map", one_of("map", "mc"), "target at the frozen mean, or at a draw")
    target_noise: str | None = setting(
        None,
        optional(one_of("mean", "independent", "shared"), "mean for map, independent for mc"),
        "noise of the target's weights: none, another draw, or that of the online draw",
    )
    evaluate: str = setting(
        "mean", one_of(*EVALUATION_MODES), "policy evaluated; thompson: a new draw at every step"
    )
    evaluate_draws: int = setting(10, SIZE, "number of draws that evaluate=average averages")

    provides: ClassVar[tuple[str, ...]] = ("posterior", "values")
    explores_by: ClassVar[str] = "thompson_boltzmann"
    modes: ClassVar[tuple[str, ...]] = EVALUATION_MODES

    def check(self) -> None:
        """Refuses a target noise that the target does not allow."""
        allowed = TARGET_NOISE[self.target]
        if self.target_noise not in (None, *allowed):
            raise ConfigError(
                f"agent.target_noise must be {' or '.join(allowed)} with "
                f"agent.target={self.target}, got {self.target_noise!r}"
            )

    def make_actor(self, task: Task) -> QValueActor:
        """A Gaussian posterior over all weights of a ReLU network."""
        from bbq_torchrl.bayes import BayesMLP

        posterior = keywords(self, task, "prior_std", "mean_init", "std_init")
        network = BayesMLP(task.inputs, task.actions, self.hidden, **task.place, **posterior)
        return task.make_actor(network)

    def make_loss(self, actor: QValueActor, task: Task) -> LossModule:
        """The negative ELBO of a weight draw."""
        from bbq_torchrl.objectives import BBQNLoss

        names = ("target", "target_noise", "kl", "noise_std", "kl_temperature", "gamma")
        return BBQNLoss(actor, cache=True, **keywords(self, task, *names))

    def make_evaluation(
        self, actor: QValueActor, mode: str | None = None
    ) -> tuple[str, TensorDictModuleBase]:
        """The mode and its policy, one of :data:`EVALUATION_MODES`."""
        from bbq_torchrl.exploration import EvaluationPolicy

        name: Any = self.evaluate if mode is None else mode
        return name, EvaluationPolicy(actor, mode=name, num_draws=self.evaluate_draws)


@register
@dataclass
class Bootstrap(AgentOption):
    """Bootstrapped DQN: heads that each learn from a sample of the transitions."""

    name: str = option("bootstrap")
    heads: int = setting(10, SIZE, "number of heads")
    trunk_layers: int | None = setting(
        None, optional(NON_NEGATIVE_INTEGER, "all"), "hidden layers that the heads share"
    )
    mask_prob: float = setting(1.0, ABOVE_ZERO_TO_ONE, "probability of learning from a transition")
    prior_scale: float = setting(3.0, NON_NEGATIVE, "scale of the randomized prior functions")
    double: bool = setting(False, BOOLEAN, "choose the target's action by the online head")

    # The greedy action is a majority vote of the heads, which has no values for a softmax.
    provides: ClassVar[tuple[str, ...]] = ("heads",)
    explores_by: ClassVar[str] = "bootstrap"

    def check(self) -> None:
        """Refuses more shared layers than hidden layers."""
        if (self.trunk_layers or 0) > len(self.hidden):
            raise ConfigError(
                f"agent.trunk_layers must be at most the {len(self.hidden)} layers of "
                f"agent.hidden, got {self.trunk_layers}"
            )

    def make_actor(self, task: Task) -> QValueActor:
        """A shared trunk and its heads."""
        from bbq_torchrl.networks import BootstrapMLP, bootstrap_actor

        heads = keywords(self, task, "heads", "trunk_layers", "prior_scale")
        network = BootstrapMLP(task.inputs, task.actions, self.hidden, **task.place, **heads)
        return task.make_actor(network, bootstrap_actor)

    def make_loss(self, actor: QValueActor, task: Task) -> LossModule:
        """The squared TD error of the heads that learn from a transition."""
        from bbq_torchrl.objectives import BootstrapDQNLoss

        return BootstrapDQNLoss(actor, double_dqn=self.double, **keywords(self, task, "gamma"))

    def make_greedy(self, actor: QValueActor) -> TensorDictModuleBase:
        """The majority vote of the heads."""
        from bbq_torchrl.exploration import MajorityVote

        return MajorityVote(actor)

    def make_evaluation(
        self, actor: QValueActor, mode: str | None = None
    ) -> tuple[str, TensorDictModuleBase]:
        """The majority vote."""
        return "vote", super().make_evaluation(actor, mode)[1]

    def make_transforms(self, task: Task) -> list[Transform]:
        """Draws the heads that learn from each stored transition."""
        from bbq_torchrl.data import BootstrapMask

        return [BootstrapMask(self.heads, self.mask_prob, replicas=task.replicas)]


@register
@dataclass
class GP(AgentOption):
    """A Gaussian process for each action, fitted in closed form once a round.

    It keeps all transitions: ``protocol.capacity`` is 40,000 unless you set it.
    """

    name: str = option("gp")
    inducing: int = setting(512, integers(1, 10_000), "inducing states of the kernel's features")
    prior_std: float = setting(2.0, POSITIVE, "std of the prior of an action's weights")
    value_std: float = setting(6.0, POSITIVE, "std of the value that all actions share")
    noise_std: float = setting(3.0, POSITIVE, "std of the noise on the target, in units of Q")
    sweeps: int = setting(8, SIZE, "regressions a round, each on new targets")

    provides: ClassVar[tuple[str, ...]] = ("posterior", "values")
    explores_by: ClassVar[str] = "thompson"
    buffer_capacity: ClassVar[int | None] = 40_000
    remedy: ClassVar[str] = "raise agent.noise_std, or lower agent.prior_std and agent.value_std"
    modes: ClassVar[tuple[str, ...]] = EVALUATION_MODES

    def make_actor(self, task: Task) -> QValueActor:
        """Gaussian processes on Nyström features of the states."""
        from bbq_torchrl.networks import GaussianProcess
        from bbq_torchrl.networks.gaussian_process import StateFeatures

        features = StateFeatures(task.inputs, self.inducing, **task.place)
        return task.make_actor(
            GaussianProcess(features, task.actions, prior_std=self.prior_std, device=task.device)
        )

    def make_loss(self, actor: QValueActor, task: Task) -> LossModule:
        """The fit."""
        from bbq_torchrl.objectives import GPLoss

        return GPLoss(actor, **keywords(self, task, "noise_std", "value_std", "sweeps", "gamma"))

    def make_evaluation(
        self, actor: QValueActor, mode: str | None = None
    ) -> tuple[str, TensorDictModuleBase]:
        """The mode and its policy, one of :data:`EVALUATION_MODES`."""
        from bbq_torchrl.exploration import EvaluationPolicy

        name: Any = mode or "mean"
        return name, EvaluationPolicy(actor, mode=name)


@register
@dataclass
class DQN(AgentOption):
    """Deep Q-network, with or without dropout."""

    name: str = option("dqn")
    dropout: float = setting(0.0, BELOW_ONE, "dropout of hidden units in the prediction")
    weight_decay: float = setting(0.0, NON_NEGATIVE, "decoupled weight decay, as in AdamW")
    double: bool = setting(False, BOOLEAN, "choose the target's action by the online network")
    noisy: bool = setting(False, BOOLEAN, "NoisyNet layers instead of dropout")

    provides: ClassVar[tuple[str, ...]] = ("values", "noise")

    def check(self) -> None:
        """Refuses noise together with dropout."""
        if self.noisy and self.dropout:
            raise ConfigError(f"agent.dropout must be 0 with agent.noisy=true, got {self.dropout}")

    def make_actor(self, task: Task) -> QValueActor:
        """A ReLU network, with noisy layers if chosen."""
        from bbq_torchrl.networks import FlatMLP, NoisyMLP

        network: nn.Module
        if self.noisy:
            network = NoisyMLP(task.inputs, task.actions, self.hidden, **task.place)
        else:
            place = {"dropout": self.dropout, **task.place}
            network = FlatMLP(task.inputs, task.actions, self.hidden, **place)
        return task.make_actor(network)

    def make_loss(self, actor: QValueActor, task: Task) -> LossModule:
        """The squared TD error, with dropout or noise in the prediction."""
        from bbq_torchrl.objectives import DropoutDQNLoss, NoisyDQNLoss

        loss: Any = NoisyDQNLoss if self.noisy else DropoutDQNLoss
        return loss(actor, double_dqn=self.double, **keywords(self, task, "gamma"))
