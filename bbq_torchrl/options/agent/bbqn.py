"""``agent=bbqn``: the Bayes-by-Backprop Q-network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from bbq_torchrl.options import AgentOption, ConfigError, register
from bbq_torchrl.options.settings import (
    NON_NEGATIVE,
    POSITIVE,
    SIZE,
    Values,
    one_of,
    option,
    optional,
    or_text,
    per_replica,
    setting,
)
from bbq_torchrl.options.values import over_replicas

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.modules import QValueActor
    from torchrl.objectives import LossModule

    from bbq_torchrl.options import Config, Task

EVALUATION_MODES = ("mean", "average", "draw", "thompson")
"""The policies that a Bayesian agent can be evaluated by."""

TARGET_NOISE = {"map": ("mean",), "mc": ("independent", "shared")}
"""target -> the noise its weights can have, the default first."""


@register
@dataclass
class BBQN(AgentOption):
    """Bayes-by-Backprop Q-network: a Gaussian for every weight and bias."""

    name: str = option("bbqn")
    prior_std: Any = setting(
        0.037,
        or_text(per_replica(POSITIVE), "fan_in"),
        "std of the prior; fan_in: sqrt(2 / fan-in) a layer",
    )
    mean_init: str = setting(
        "kaiming", one_of("zero", "kaiming"), "where the posterior means start"
    )
    std_init: Any = setting(
        0.09, optional(per_replica(POSITIVE), "prior_std"), "where the posterior stds start"
    )
    noise_std: Values = setting(
        1.0, per_replica(POSITIVE), "std of the noise on the target, in units of Q"
    )
    kl: str = setting("closed", one_of("closed", "sampled"), "how KL(q || p) is computed")
    kl_temperature: Values = setting(0.014, per_replica(NON_NEGATIVE), "factor on the KL term")
    target: str = setting(
        "map", one_of("map", "mc"), "target by the frozen posterior's mean, or by one draw of it"
    )
    target_noise: str | None = setting(
        None,
        optional(one_of("mean", "independent", "shared"), "mean for map, independent for mc"),
        "noise of the target's weights: none, its own, or that of the online draw",
    )
    evaluate: str = setting(
        "mean",
        one_of(*EVALUATION_MODES),
        "policy evaluated: mean network, average of draws, one draw, new draws at every step",
    )
    evaluate_draws: int = setting(10, SIZE, "draws that evaluate=average takes the mean of")

    offers: ClassVar[tuple[str, ...]] = ("posterior", "values")
    explores_by: ClassVar[str] = "thompson"
    modes: ClassVar[tuple[str, ...]] = EVALUATION_MODES

    def check(self, config: Config) -> None:
        """Refuses a target noise of the other target, and a sampled KL where slots are added."""
        allowed = TARGET_NOISE[self.target]
        if self.target_noise not in (None, *allowed):
            raise ConfigError(
                f"agent.target_noise must be {' or '.join(allowed)} with "
                f"agent.target={self.target}, got {self.target_noise!r}"
            )
        if config.env.extends and self.kl == "sampled":
            raise ConfigError(
                f"env={config.env.name} cannot be combined with agent.kl=sampled: the sampled "
                "estimate moves the weights of slots that are not there yet, so agent.kl must be "
                "closed"
            )

    def make_actor(self, task: Task) -> QValueActor:
        """A Gaussian posterior over all weights of a ReLU network."""
        from bbq_torchrl.bayes import BayesMLP
        from bbq_torchrl.networks import q_actor

        prior_std, std_init = self.prior_std, self.std_init
        network = BayesMLP(
            task.inputs,
            task.actions,
            self.hidden,
            replicas=task.replicas,
            prior_std=prior_std if prior_std == "fan_in" else over_replicas(prior_std, task),
            mean_init=self.mean_init,  # type: ignore[arg-type]
            std_init=None if std_init is None else over_replicas(std_init, task),
            device=task.device,
        )
        task.reset_inactive_(network)
        return q_actor(network, task.action_spec, action_mask_key=task.action_mask_key)

    def make_loss(self, actor: QValueActor, task: Task) -> LossModule:
        """The negative ELBO of a draw of the weights."""
        from bbq_torchrl.objectives import BBQNLoss

        return BBQNLoss(
            actor,
            target=self.target,  # type: ignore[arg-type]
            target_noise=self.target_noise,  # type: ignore[arg-type]
            kl=self.kl,  # type: ignore[arg-type]
            noise_std=over_replicas(self.noise_std, task),
            kl_temperature=over_replicas(self.kl_temperature, task),
            gamma=over_replicas(self.gamma, task),
            hold=True,
        )

    def make_evaluation(
        self, actor: QValueActor, mode: str | None = None
    ) -> tuple[str, TensorDictModuleBase]:
        """The mode and its policy, one of :data:`EVALUATION_MODES`."""
        from bbq_torchrl.exploration import EvaluationPolicy

        name = self.evaluate if mode is None else mode
        return name, EvaluationPolicy(actor, mode=name, num_draws=self.evaluate_draws)  # type: ignore[arg-type]
