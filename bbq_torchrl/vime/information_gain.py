r"""The information gain of a transition about a Bayesian dynamics model, in closed form.

The information gain of a transition is the divergence of the posterior after learning from it
from the posterior before. One natural-gradient step of length λ on the loss -log p(s'|s, a; w),
w = μ + σ ε, moves the variational parameters by -λ H⁻¹ g, where H is the Hessian of this
divergence. It is diagonal, 1/σ² for μ and 2 (dσ/dρ)²/σ² for ρ, so to second order

    gain = ½ λ² gᵀ H⁻¹ g     (VIME, Houthooft et al. 2016, section 2.3).

With g_μ = g_w and g_ρ = g_w ε dσ/dρ, dσ/dρ cancels, and a weight adds g_w² σ² (1 + ε²/2). In a
layer g_w is the product of its input a and its output's error δ. So the sum over its matrix needs
no gradients of single transitions, only one more matrix product for all of them:

    gain = ½ λ² Σ_layers Σ_j δ_j² [ Σ_i a_i² σ_ij² (1 + ε_ij²/2) + σ_bj² (1 + ε_bj²/2) ].

The prior's term is left out: the prior of a step is the posterior before it, where the gradient of
this term is 0.

Gains are measured in units of a running median, :class:`RunningMedian`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

import torch
from torch import Tensor, nn

from bbq_torchrl.bayes.functional import affine, run_layers
from bbq_torchrl.vime.dynamics import DynamicsModel


@torch.no_grad()
def information_gain(
    dynamics: DynamicsModel,
    observation: Tensor,
    action: Tensor,
    next_observation: Tensor,
    *,
    noise: Tensor | None = None,
    step_size: float = 0.01,
) -> Tensor:
    """Returns the information gain of each transition, [*replicas, *rows], in nats, detached.

    Args:
        dynamics: the model and its posterior.
        observation: state, shape [*replicas, *rows, S].
        action: index [*replicas, *rows] or vector [*replicas, *rows, A].
        next_observation: next state, shape [*replicas, *rows, S].

    Keyword Args:
        noise: ε, shape [*replicas, P], the noise of one weight draw for all rows; None for the gain
            at the mean, ε = 0.
        step_size: λ; the gain is proportional to its square. Defaults to 0.01.

    Raises:
        ValueError: for a wrong shape.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.vime import DynamicsModel, information_gain
        >>> dynamics = DynamicsModel(3, 2, replicas=5)
        >>> state, action = torch.randn(5, 32, 3), torch.randint(2, (5, 32))
        >>> gain = information_gain(dynamics, state, action, torch.randn(5, 32, 3))
        >>> gain.shape, bool((gain > 0).all())
        (torch.Size([5, 32]), True)
    """
    x, target = dynamics.inputs(observation, action), dynamics.standardize(next_observation)
    layout, posterior = dynamics.network.layout, dynamics.network.posterior
    if target.shape[:-1] != x.shape[:-1]:
        raise ValueError(
            f"next_observation must have shape {list(observation.shape)}, got "
            f"{list(next_observation.shape)}"
        )
    if noise is not None and noise.shape != posterior.mu.shape:
        raise ValueError(
            f"noise must have shape {list(posterior.mu.shape)}, got {list(noise.shape)}"
        )
    weights: Tensor = posterior.mu
    sigma = posterior.sigma
    variance = sigma.square()
    if noise is not None:
        weights = torch.addcmul(weights, sigma, noise)
        variance.mul_(noise.square().mul_(0.5).add_(1))
    variances = layout.unflatten(variance.view(-1, layout.numel))

    rows = x.reshape(prod(posterior.replicas), -1, layout.sizes[0])
    error, inputs, matrices = run_layers(rows, weights, layout)
    error.sub_(target.reshape(error.shape)).div_(dynamics.noise_std**2)

    gain = error.new_zeros(error.shape[:-1])
    for k in range(len(matrices) - 1, -1, -1):
        spread = affine(inputs[k].square(), *variances[k])
        gain += spread.mul_(error.square()).sum(-1)
        if k > 0:
            error = torch.bmm(error, matrices[k].mT).mul_(inputs[k] > 0)
    # where the posterior is so wide that the sum overflows, the gain is the largest float
    gain = gain.mul_(0.5 * step_size**2).clamp_max_(torch.finfo(gain.dtype).max)
    return gain.reshape(x.shape[:-1])


class RunningMedian(nn.Module):
    """The median of the medians of the last calls, for each replica.

    A median depends neither on the order of the values nor on the number of invalid ones, so
    replicas stay independent to the bit. (For an even number of values it is the lower one.)

    Args:
        replicas: leading shape.
        window: the number of calls, at least 1.
        like: a tensor with the dtype and device of the buffers.

    Attributes:
        medians: buffer [*replicas, window], the medians of the last calls, overwritten in turns.
        calls: int64 buffer [*replicas], the number of calls with a valid value.

    Examples:
        >>> import torch
        >>> median = RunningMedian((), 2, torch.zeros(1))
        >>> for values in ([1.0, 2.0, 9.0], [4.0], [5.0, 7.0]):
        ...     median.update(torch.tensor(values))
        tensor(2.)
        tensor(2.)
        tensor(4.)
    """

    medians: Tensor
    calls: Tensor

    def __init__(self, replicas: Sequence[int], window: int, like: Tensor) -> None:
        super().__init__()
        self.register_buffer("medians", like.new_zeros((*replicas, window)))
        self.register_buffer("calls", like.new_zeros(tuple(replicas), dtype=torch.int64))

    @torch.no_grad()
    def update(self, values: Tensor, valid: Tensor | None = None) -> Tensor:
        """Adds values and returns the median of the last medians, [*replicas]; NaN without values.

        Args:
            values: shape [*replicas, n]; NaN is ignored.
            valid: bool [*replicas, n], True for valid values; None for all. A replica without
                valid values keeps its state.
        """
        window = self.medians.shape[-1]
        if valid is not None:
            values = torch.where(valid, values, torch.nan)
        median = values.nanmedian(-1, keepdim=True).values
        calls = self.calls.unsqueeze(-1)
        slots = torch.arange(window, device=values.device)
        is_new = ~median.isnan()
        here = is_new & (slots == calls % window)
        self.medians.copy_(torch.where(here, median, self.medians))
        calls = calls + is_new
        self.calls.copy_(calls.squeeze(-1))
        return torch.where(slots < calls, self.medians, torch.nan).nanmedian(-1).values
