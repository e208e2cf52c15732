"""The loss of Bayes-by-Backprop Q-networks (Lipton et al., BBQ-Networks, AAAI 2018)."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import torch
from torch import Tensor, nn
from torchrl.data import TensorSpec
from torchrl.envs.utils import ExplorationType
from torchrl.modules import QValueActor

from bbq_torchrl.bayes.functional import checked_number
from bbq_torchrl.bayes.noise import NoisePool, NoiseSource, SharedNoise
from bbq_torchrl.bayes.posterior import posteriors
from bbq_torchrl.bayes.scope import KLSum
from bbq_torchrl.bayes.weight_draw import KL_KIND, KLKind
from bbq_torchrl.networks.q_actor import Inputs
from bbq_torchrl.objectives.q_learning import OneStepQLoss
from bbq_torchrl.objectives.td_loss import NumData
from bbq_torchrl.settings import ABOVE_ZERO, AT_LEAST_ZERO, Allowed, check, one_of

Target = Literal["map", "mc"]
TargetNoise = Literal["mean", "independent", "shared"]

# The allowed target noises of each target, the default first.
_TARGET_NOISES: dict[Target, tuple[TargetNoise, ...]] = {
    "map": ("mean",),
    "mc": ("independent", "shared"),
}


@dataclass
class _Cache:
    """Tensors that change little between batches, computed at first use."""

    noise: NoisePool = field(default_factory=NoisePool)
    kl: dict[Hashable, Tensor] = field(default_factory=dict)
    sigma: dict[Hashable, Tensor] = field(default_factory=dict)


class BBQNLoss(NumData, OneStepQLoss):
    """Expected squared TD error under the posterior, plus its KL from the prior.

    For N transitions in the buffer each network's loss is

        mean over the batch of (y - Q(s, a; w))² / (2 noise_std²) + kl_temperature · KL / N

    with one weight draw w per batch. This is the negative evidence lower bound divided by N, so the
    prior weighs less the more data there are. y is a constant. The KL is the sum over every
    :class:`~bbq_torchrl.bayes.GaussianPosterior` in the network, in any layer.

    Args:
        value_network: an actor, or a network that maps the observation to values, with Bayesian
            layers.

    Keyword Args:
        target: "map", the mean network of the frozen posterior, or "mc", one weight draw of the
            frozen posterior per batch. Defaults to "map".
        target_noise: the noise of the target's weights. "mean": no noise (the only choice for
            "map"). For "mc", "independent": a separate draw (as in the paper), or "shared": the
            weights are μ⁻ + σ⁻·ε with the frozen μ⁻, σ⁻ and the noise ε of the batch's online
            draw, so one draw is one value function on both sides of the equation and its
            uncertainty propagates through the target. Defaults to None, "mean" for "map" and
            "independent" for "mc".
        kl: "closed" or "sampled" (log q(w) - log p(w) at the draw, as in the paper). Under Adam the
            sampled KL moves weights that no data reach away from the prior. Defaults to "closed".
        noise_std: standard deviation of the observation noise of y, in units of Q; a number or
            a tensor [*replicas]. Defaults to 1.
        kl_temperature: factor of the KL; 1 is Bayes' rule, as in the paper, a smaller one trusts
            the data more. A number or a tensor [*replicas]. Defaults to 0.014.
        gamma: discount of the one-step target, a number or a tensor [*replicas]. Defaults to 0.9.
        num_data: N, a number or a tensor [*replicas]. If None, call :meth:`set_num_data` before
            the first loss.
        action_space: "categorical", "one-hot" or the action's spec; taken from the actor if it
            has one.
        delay_value: whether the target is a frozen copy of the network. Defaults to True.
        cache: whether to compute tensors that change little between batches once, at the first
            batch after :meth:`begin_epoch`: the noise pool of all batches
            (:class:`~bbq_torchrl.bayes.noise.NoisePool`), the frozen posterior's σ for an "mc"
            target, and the value of the closed KL, as reported in ``kl`` and the losses (its
            gradient is computed for each batch). This saves a quarter of an update on a CPU. Call
            :meth:`begin_epoch` at least after each update of the target network. On other devices,
            where it would save little, nothing is cached. Defaults to False.

    Raises:
        ValueError: for an invalid argument, or a network without Bayesian layers.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from torchrl.objectives import HardUpdate
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> from bbq_torchrl.networks import q_actor
        >>> from bbq_torchrl.objectives import BBQNLoss
        >>> actor = q_actor(BayesMLP(3, 4, replicas=5), Categorical(4))
        >>> loss = BBQNLoss(actor, num_data=1000)
        >>> freeze = HardUpdate(loss, value_network_update_interval=0)
        >>> state = dict(observation=torch.ones(5, 32, 3), action_mask=torch.ones(5, 32, 4).bool())
        >>> end = dict(reward=torch.ones(5, 32, 1), terminated=torch.ones(5, 32, 1).bool())
        >>> td = TensorDict(
        ...     {**state, "action": torch.ones(5, 32).long(), "next": {**state, **end}}, [5, 32]
        ... )
        >>> out = loss(td)
        >>> out["loss"].backward()
        >>> sorted(out.keys())
        ['kl', 'loss', 'loss_value', 'q_value', 'td_error']
        >>> out["kl"].shape
        torch.Size([5])
    """

    # TorchRL runs a loss's forward pass under DETERMINISTIC, where layers that follow the
    # exploration type use their means, and σ would get no gradient.
    deterministic_sampling_mode = ExplorationType.RANDOM
    noise_std: float | Tensor
    kl_temperature: float | Tensor
    out_keys = ["loss", "loss_value", "td_error", "q_value", "kl"]  # noqa: RUF012

    def __init__(
        self,
        value_network: QValueActor | nn.Module,
        *,
        target: Target = "map",
        target_noise: TargetNoise | None = None,
        kl: KLKind = "closed",
        noise_std: float | Tensor = 1.0,
        kl_temperature: float | Tensor = 0.014,
        gamma: float | Tensor = 0.9,
        num_data: int | Tensor | None = None,
        action_space: str | TensorSpec | None = None,
        delay_value: bool = True,
        cache: bool = False,
    ) -> None:
        check("target", target, one_of(*get_args(Target)))
        if target_noise is not None and target_noise not in _TARGET_NOISES[target]:
            raise ValueError(
                f"target_noise must be one of {list(_TARGET_NOISES[target])} or None for "
                f"target={target!r}, got {target_noise!r}"
            )
        check("kl", kl, KL_KIND)
        super().__init__(
            value_network, gamma=gamma, action_space=action_space, delay_value=delay_value
        )
        first, *_ = posteriors(self.value_network)  # type: ignore[arg-type]
        self._register_num_data(num_data, first.mu)
        self.target = target
        self._target_mode = "mean" if target == "map" else "draw"
        self.target_noise = target_noise or _TARGET_NOISES[target][0]
        self._online_noise: SharedNoise | None = None
        self.kl = kl
        self.cache = cache
        self._epoch_cache = _Cache()
        self._set("noise_std", noise_std)
        self._set("kl_temperature", kl_temperature, AT_LEAST_ZERO)

    def _set(self, name: str, value: float | Tensor, allowed: Allowed = ABOVE_ZERO) -> None:
        """Sets a hyperparameter; values [*replicas] become a buffer that follows the device."""
        value = checked_number(name, value, self.replicas, allowed)
        if isinstance(value, Tensor):
            # Like a number, not part of the state.
            self.register_buffer(name, value.to(self.num_data.device), persistent=False)
        else:
            setattr(self, name, value)

    @property
    def _scale(self) -> float | Tensor:  # type: ignore[override]
        return 0.5 / self.noise_std**2

    @property
    def _kl_weight(self) -> Tensor:  # type: ignore[override]
        temperature = self.kl_temperature
        if isinstance(temperature, Tensor):
            temperature = temperature.to(self.num_data.dtype)
        return self.num_data.reciprocal() * temperature

    def begin_epoch(self) -> None:
        """Empties the cache; the next batch recomputes its tensors."""
        self._epoch_cache = _Cache()

    def _cache_for(self, tensors: Sequence[Tensor]) -> _Cache | None:
        """Returns the cache for a network with these parameters, or None where caching is off."""
        on_cpu = tensors[0].device.type == "cpu"
        is_used = self.cache and on_cpu and not torch.compiler.is_compiling()
        return self._epoch_cache if is_used else None

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_epoch_cache": _Cache()}

    def _predict(
        self, tensors: Sequence[Tensor], inputs: Inputs
    ) -> tuple[Tensor, dict[str, Tensor]]:
        self._check_num_data()
        cache = self._cache_for(tensors)
        noise: NoiseSource | None = cache.noise if cache else None
        if self.target_noise == "shared":
            noise = self._online_noise = SharedNoise(noise)
        kl = KLSum(self.kl, cache.kl if cache and self.kl == "closed" else None)
        values = self._function(tensors, inputs, "draw", noise=noise, kl=kl)
        return values, {"kl": kl.total()}

    def _target_values(self, tensors: Sequence[Tensor], inputs: Inputs) -> Tensor:
        # Cleared, because each batch has new noise, which must not outlive its batch.
        shared, self._online_noise = self._online_noise, None
        if self.target == "map":
            return super()._target_values(tensors, inputs)
        cache = self._cache_for(tensors)
        noise: NoiseSource | None = cache.noise if cache else None
        if shared is not None:
            noise = shared.again()
        sigma = cache.sigma if cache else None
        return self._function(tensors, inputs, "draw", noise=noise, sigma=sigma)
