"""A Bayes-by-Backprop gated recurrent unit."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bbq_torchrl.bayes.functional import affine, affine_local, as_rows
from bbq_torchrl.bayes.layers import BayesLayer, LayerSettings

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from bbq_torchrl.bayes.scope import WeightMode


class BayesGRU(BayesLayer):
    """A layer of gated recurrent units (as ``nn.GRU``) with a Gaussian over every weight and bias.

    All steps of a sequence share one weight draw (Fortunato, Blundell, Vinyals, "Bayesian
    Recurrent Neural Networks", 2017). Mode "local" draws the pre-activations of each row, which is
    equivalent to a separate weight draw for each row. It accepts a single step only, because
    several steps would not share their weights.

    Args:
        input_size: features of the input.
        hidden_size: features of the state.

    Keyword Args:
        replicas: the number R of independent layers, or a shape; inputs have it as their
            leading dimensions. Defaults to ().
        prior_std: standard deviation of the prior, a number, a tensor [*replicas], or "fan_in" for
            √(2/input_size) and √(2/hidden_size). Defaults to 0.037.
        mean_init: "kaiming" (uniform in ±1/√hidden_size, as in ``nn.GRU``), or "zero".
            Defaults to "kaiming".
        std_init: initial standard deviation; None for the prior's. Defaults to 0.03.
        device: of the parameters.
        dtype: of the parameters.

    Raises:
        ValueError: for an invalid argument or, when called, for wrong shapes or mode "local" with
            more than one step.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesGRU
        >>> net = BayesGRU(3, 8, replicas=5)
        >>> outputs, state = net(torch.ones(5, 32, 10, 3), mode="draw")  # ten steps
        >>> outputs.shape, state.shape
        (torch.Size([5, 32, 10, 8]), torch.Size([5, 32, 8]))
        >>> output, state = net(torch.ones(5, 32, 3), state, mode="draw")  # one step
        >>> output.shape
        torch.Size([5, 32, 8])
    """

    def __init__(
        self, input_size: int, hidden_size: int, **settings: Unpack[LayerSettings]
    ) -> None:
        if min(input_size, hidden_size) < 1:
            raise ValueError(
                f"input_size and hidden_size must be positive, got {input_size} and {hidden_size}"
            )
        self.input_size, self.hidden_size = input_size, hidden_size
        units = 3 * hidden_size
        groups = [(input_size + 1) * units, (hidden_size + 1) * units]
        super().__init__(groups, [input_size, hidden_size], **settings)

    @torch.no_grad()
    def init_means_(self) -> None:
        """Draws the means uniformly in ±1/√hidden_size."""
        bound = self.hidden_size**-0.5
        self.posterior.mu.uniform_(-bound, bound)

    def forward(  # type: ignore[override]
        self,
        x: Tensor,
        state: Tensor | None = None,
        mode: WeightMode | None = None,
        weights: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Returns the outputs and the last state.

        Args:
            x: a sequence [*replicas, *batch, time, input_size] or, with a state, one step
                [*replicas, *batch, input_size].
            state: [*replicas, *batch, hidden_size]; None for zeros.
            mode: as in :meth:`BayesLayer.forward`.
            weights: as in :meth:`BayesLayer.forward`.

        Returns:
            the outputs, shaped like x with hidden_size features, and the state after the last step,
            [*replicas, *batch, hidden_size].
        """
        is_step = state is not None and state.ndim == x.ndim
        steps = x.unsqueeze(-2) if is_step else x
        if state is None:
            state = steps.new_zeros((*steps.shape[:-2], self.hidden_size))
        batch = steps.shape[:-2]
        if (
            steps.ndim < len(self.replicas) + 2
            or not steps.shape[-2]
            or steps.shape[-1] != self.input_size
            or state.shape != (*batch, self.hidden_size)
        ):
            raise ValueError(
                f"input must have shape [*replicas, *batch, time, {self.input_size}] and "
                f"state [*replicas, *batch, {self.hidden_size}] (or one step of input with a "
                f"state), got {list(x.shape)} and {list(state.shape)}"
            )
        # one tensor, because BayesLayer passes a single input to run and run_local
        both = torch.cat([steps.flatten(-2), state], -1)
        outputs = super().forward(both, mode, weights)
        outputs = outputs.unflatten(-1, (steps.shape[-2], self.hidden_size))
        return (outputs.squeeze(-2) if is_step else outputs), outputs[..., -1, :]

    def run(self, x: Tensor, weights: Tensor) -> Tensor:
        """Returns the states after each step, [*replicas, *batch, time · hidden_size].

        Args:
            x: inputs of all steps and the state before, [*replicas, *batch, time · in + hidden].
            weights: [*replicas, *rows, P].
        """
        lead = weights.shape[:-1]
        if x.shape[: len(lead)] != lead:
            raise ValueError(
                f"input must have shape [{', '.join(map(str, lead))}, *batch, time, "
                f"{self.input_size}], got batch {list(x.shape[:-1])}"
            )
        steps, state = self._split(as_rows(x, lead, x.shape[-1]))
        from_input, from_state = self._matrices(weights.reshape(prod(lead), -1))
        # one matrix product for the inputs of all steps
        gates = affine(steps.flatten(1, 2), *from_input).unflatten(1, steps.shape[1:3])
        states = []
        for gate in gates.unbind(2):
            state = _next_state(gate, affine(state, *from_state), state)
            states.append(state)
        return torch.cat(states, -1).reshape(*x.shape[:-1], len(states) * self.hidden_size)

    def run_local(self, x: Tensor) -> Tensor:
        """Returns the state after one step by local reparameterization."""
        count = prod(self.replicas)
        steps, state = self._split(as_rows(x, self.replicas, x.shape[-1]))
        if steps.shape[2] != 1:
            raise ValueError(
                f'BayesGRU in mode "local" takes one step, got {steps.shape[2]}: with '
                "independent noise in each step the steps would not share their weights; use mode "
                '"draw", or pass separate weights for each row from draw_weights(rows); in '
                "ThompsonSampling use shared=True or per='episode'"
            )
        means = self._matrices(self.posterior.mu.reshape(count, -1))
        variances = self._matrices(self.posterior.sigma.square().reshape(count, -1))
        inputs = steps[:, :, 0], state
        from_input, from_state = map(affine_local, inputs, means, variances)
        return _next_state(from_input, from_state, state).reshape(*x.shape[:-1], self.hidden_size)

    def _split(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the inputs [count, rows, time, in] and the state [count, rows, hidden]."""
        steps, state = x.split([x.shape[-1] - self.hidden_size, self.hidden_size], -1)
        return steps.unflatten(-1, (-1, self.input_size)), state

    def _matrices(self, flat: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Returns the matrices [count, in, 3 · hidden] and biases for the inputs and the state."""
        found = []
        sizes = (self.input_size, self.hidden_size)
        for part, inputs in zip(flat.split(self.posterior.group_sizes, -1), sizes, strict=True):
            units = 3 * self.hidden_size
            matrix, bias = part.split([inputs * units, units], -1)
            found.append((matrix.reshape(-1, inputs, units), bias))
        return found

    def extra_repr(self) -> str:
        """Returns the sizes for ``repr``."""
        return f"{self.input_size}, {self.hidden_size}, replicas={tuple(self.replicas)}"


def _next_state(from_input: Tensor, from_state: Tensor, state: Tensor) -> Tensor:
    """Returns the next state from pre-activations [*, 3 · hidden] in torch's gate order."""
    reset, update, new = from_input.chunk(3, -1)
    reset_state, update_state, new_state = from_state.chunk(3, -1)
    update = torch.sigmoid(update + update_state)
    new = torch.tanh(new + torch.sigmoid(reset + reset_state) * new_state)
    return torch.lerp(new, state.to(new.dtype), update)
