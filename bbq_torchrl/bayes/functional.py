"""Multi-layer perceptrons on one flat weight vector, and the shapes of replicas.

A network's weights are one vector [*replicas, P] = (W₁, b₁, W₂, b₂, …), W_l of shape
[inputs, outputs]. So the whole network needs one draw, one KL, one optimizer entry and one gradient
buffer; the layers are views of the vector. Matrix products with ``out=`` write the gradients of all
layers into one vector. Autograd, which slices the vector for each layer, would instead fill a
vector of zeros for each layer and add them up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from math import prod, sqrt
from operator import index
from typing import Any, SupportsIndex, TypeVar

import torch
from torch import Tensor, nn

from bbq_torchrl.bayes.noise import fill_dropout_mask_, is_transformed
from bbq_torchrl.settings import ABOVE_ZERO, Allowed

Result = TypeVar("Result")

_relu_backward = torch.ops.aten.threshold_backward.grad_input


def once_differentiable(backward: Callable[..., Result]) -> Callable[..., Result]:
    """Decorates a hand-written backward pass to raise an error if it is differentiated again.

    torch's decorator silently returns a second derivative of zero where the incoming gradient is a
    constant, such as that of a sum.
    """

    @wraps(backward)
    def checked(*args: Any) -> Result:
        if torch.is_grad_enabled():
            raise RuntimeError(
                "this hand-written gradient cannot build a graph, as create_graph=True requires: "
                "take second derivatives with torch.func"
            )
        return backward(*args)

    return checked


class FlatLayout:
    """The layout of an MLP's weights and biases in its flat vector.

    Args:
        sizes: features of the input, of each hidden layer, and of the output.

    Attributes:
        shapes: shape [inputs, outputs] of each layer's matrix.
        layer_sizes: number of weights and biases in each layer.
        numel: P, the length of the flat vector.

    Examples:
        >>> layout = FlatLayout((3, 4, 2))
        >>> layout.numel, layout.layer_sizes
        (26, (16, 10))
    """

    def __init__(self, sizes: Sequence[int]) -> None:
        self.sizes = tuple(sizes)
        self.shapes = tuple(zip(self.sizes[:-1], self.sizes[1:], strict=True))
        self.layer_sizes = tuple((i + 1) * o for i, o in self.shapes)
        self.numel = sum(self.layer_sizes)
        self._split_sizes = [n for i, o in self.shapes for n in (i * o, o)]

    def unflatten(self, flat: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Returns each layer's matrix [*lead, inputs, outputs] and bias [*lead, outputs], views.

        Args:
            flat: shape [*lead, P].
        """
        parts = torch.split_with_sizes(flat, self._split_sizes, -1)
        lead = flat.shape[:-1]
        return [
            (matrix.view(*lead, *shape), bias)
            for matrix, bias, shape in zip(parts[::2], parts[1::2], self.shapes, strict=True)
        ]


def init_linear_(flat: Tensor, layout: FlatLayout) -> None:
    """Fills ``flat`` [*replicas, P] like ``nn.Linear``: uniform in ±1/√inputs, biases too."""
    with torch.no_grad():
        for (matrix, bias), (inputs, _) in zip(layout.unflatten(flat), layout.shapes, strict=True):
            bound = 1 / sqrt(inputs)
            matrix.uniform_(-bound, bound)
            bias.uniform_(-bound, bound)


class _FlatMLP(torch.autograd.Function):
    """Maps x [L, M, in] and flat [*lead, P] to [L, M, out]."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, flat: Tensor, layout: FlatLayout, dropout: float) -> Tensor:
        out, inputs, matrices = run_layers(x, flat, layout, dropout)
        # the first layer's matrix is needed only for the gradient of the input
        needed = matrices if ctx.needs_input_grad[0] else matrices[1:]
        ctx.save_for_backward(*inputs, *needed)
        ctx.layout, ctx.dropout, ctx.shape = layout, dropout, flat.shape
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None, None, None]:
        depth = len(ctx.layout.shapes)
        saved = ctx.saved_tensors  # read once: activation checkpointing forbids a second read
        inputs, matrices = saved[:depth], saved[depth:]
        grad_flat = grad.new_empty(ctx.shape)
        grads = ctx.layout.unflatten(grad_flat.view(-1, ctx.layout.numel))
        for k in range(depth - 1, -1, -1):
            torch.sum(grad, -2, out=grads[k][1])
            if k > 0 and ctx.dropout > 0:
                grad = grad * _dropout_scale(ctx.dropout)
            torch.bmm(inputs[k].mT, grad, out=grads[k][0])
            if k > 0:
                # a unit that is 0 after ReLU and dropout passes no gradient back
                below = torch.bmm(grad, matrices[k - depth].mT)
                grad = _relu_backward(below, inputs[k], 0, grad_input=below)
        grad_x = torch.bmm(grad, matrices[0].mT) if ctx.needs_input_grad[0] else None
        return grad_x, grad_flat, None, None


def run_layers(
    x: Tensor, flat: Tensor, layout: FlatLayout, dropout: float = 0.0
) -> tuple[Tensor, list[Tensor], list[Tensor]]:
    """Returns the outputs, the input of each layer after dropout, and the matrices.

    Args:
        x: inputs, shape [L, M, in].
        flat: weights, shape [*lead, P].
        layout: the layers.
        dropout: probability of dropping a hidden unit.
    """
    layers = layout.unflatten(flat.reshape(-1, layout.numel))
    widths = layout.sizes[1:-1]
    masks: Sequence[Tensor] = ()
    if dropout > 0 and widths:
        mask = fill_dropout_mask_(x.new_empty((*x.shape[:-1], sum(widths))), dropout)
        masks = mask.split(widths, -1)
    scale = _dropout_scale(dropout)
    inputs, out = [x], affine(x, *layers[0])
    for k, (matrix, bias) in enumerate(layers[1:]):
        hidden = out.relu_()
        inputs.append(hidden * masks[k] if masks else hidden)
        out = affine(inputs[-1], matrix, bias, scale)
    return out, inputs, [matrix for matrix, _ in layers]


def _dropout_scale(dropout: float) -> float:
    """Returns the factor of the remaining units that preserves the mean of their sum."""
    return 1 / (1 - dropout)


def affine(x: Tensor, matrix: Tensor, bias: Tensor, scale: float = 1.0) -> Tensor:
    """Returns scale · x W + b, shape [L, M, out], of x [L, M, in], W [L, in, out], b [L, out]."""
    return torch.baddbmm(bias.unsqueeze(-2), x, matrix, alpha=scale)


def affine_local(x: Tensor, mean: tuple[Tensor, Tensor], variance: tuple[Tensor, Tensor]) -> Tensor:
    """Returns x W + b with a separate draw of W and b for each row, shape [L, M, out].

    Args:
        x: inputs, shape [L, M, in].
        mean: means of W [L, in, out] and b [L, out].
        variance: variances of W and b, in the same shapes.
    """
    # keeps the gradient of √ finite where no input is active and σ has underflowed
    tiny = torch.finfo(x.dtype).tiny
    std = affine(x.square(), *variance).clamp_min(tiny).sqrt()
    return torch.addcmul(affine(x, *mean), std, torch.randn_like(std))


def as_rows(x: Tensor, lead: Sequence[int], *features: int | str, name: str = "input") -> Tensor:
    """Returns x [*lead, *rows, *features] as [L, rows, *features], L the product of lead.

    Args:
        x: the tensor.
        lead: the expected leading dimensions.
        features: the expected last dimensions: the size of the first, and the names of the others,
            whose sizes are free.

    Keyword Args:
        name: the tensor's name in the error message.

    Raises:
        ValueError: for a wrong shape of ``x``.
    """
    n, end = len(lead), x.ndim - len(features)
    if end < n or x.shape[:n] != torch.Size(lead) or x.shape[end] != features[0]:
        wanted = ", ".join(str(size) for size in (*lead, "*batch", *features))
        raise ValueError(f"{name} must have shape [{wanted}], got {list(x.shape)}")
    return x.reshape(prod(lead), prod(x.shape[n:end]), *x.shape[end:])


def mlp(x: Tensor, flat: Tensor, layout: FlatLayout, dropout: float = 0.0) -> Tensor:
    """Returns the outputs [*lead, *rows, out] of ReLU networks with these weights.

    Args:
        x: inputs, shape [*lead, *rows, in].
        flat: weights, shape [*lead, P], one network for each element of lead.
        layout: the layers.
        dropout: probability of dropping a hidden unit; 0 draws no random numbers.

    Raises:
        ValueError: for a wrong shape of ``x``.

    Examples:
        >>> import torch
        >>> layout = FlatLayout((3, 4, 2))
        >>> mlp(torch.ones(5, 7, 3), torch.ones(5, 26), layout).shape
        torch.Size([5, 7, 2])
    """
    rows = as_rows(x, flat.shape[:-1], layout.sizes[0])
    if (
        torch.is_grad_enabled()
        and (flat.requires_grad or rows.requires_grad)
        and not is_transformed()
        and not torch._C._is_any_autocast_enabled()  # it would give the layers other dtypes
    ):
        out: Tensor = _FlatMLP.apply(rows, flat, layout, dropout)
    else:
        out = run_layers(rows, flat, layout, dropout)[0]
    return out if out.shape[:-1] == x.shape[:-1] else out.reshape(*x.shape[:-1], layout.sizes[-1])


def mlp_local(x: Tensor, mu: Tensor, sigma: Tensor, layout: FlatLayout) -> Tensor:
    """Returns the outputs [*replicas, *rows, out] by local reparameterization.

    Each row sees Gaussian pre-activations with the mean and variance that independent Gaussian
    weights give it (Kingma, Salimans, Welling 2015). That is equivalent to a separate weight draw
    for each row, as long as a row is a single input.

    Args:
        x: inputs, shape [*replicas, *rows, in].
        mu: means, shape [*replicas, P].
        sigma: standard deviations, shape [*replicas, P].
        layout: the layers.

    Raises:
        ValueError: for a wrong shape of ``x``.
    """
    hidden = as_rows(x, mu.shape[:-1], layout.sizes[0])
    means = layout.unflatten(mu.reshape(-1, layout.numel))
    variances = layout.unflatten(sigma.square().reshape(-1, layout.numel))
    for k, (mean, variance) in enumerate(zip(means, variances, strict=True)):
        hidden = affine_local(hidden.relu() if k > 0 else hidden, mean, variance)
    return hidden.reshape(*x.shape[:-1], layout.sizes[-1])


# -- replicas: independent networks in one module --------------------------------------------


def replica_shape(replicas: SupportsIndex | Sequence[int]) -> torch.Size:
    """Returns the leading shape of weights and data for a number or shape of replicas.

    Examples:
        >>> replica_shape(5), replica_shape((2, 3)), replica_shape(())
        (torch.Size([5]), torch.Size([2, 3]), torch.Size([]))
    """
    return torch.Size([index(replicas)] if isinstance(replicas, SupportsIndex) else replicas)


def replicas_of(network: nn.Module) -> torch.Size:
    """Returns the replica shape that the layers of a network share, () if no layer has one.

    A layer's replica shape is its attribute ``replicas``, a shape or a number.

    Raises:
        ValueError: if layers differ.

    Examples:
        >>> network = torch.nn.Identity()
        >>> network.replicas = 5
        >>> replicas_of(torch.nn.Sequential(network, torch.nn.ReLU()))
        torch.Size([5])
    """
    shapes = set()
    for module in network.modules():
        found = getattr(module, "replicas", None)
        if found is None or callable(found):  # a module or method of that name is unrelated
            continue
        shapes.add(replica_shape(found))
    if len(shapes) > 1:
        raise ValueError(f"the network's layers must share one replica shape, got {shapes}")
    return shapes.pop() if shapes else torch.Size(())


def checked_number(
    name: str,
    value: float | Tensor,
    replicas: Sequence[int] = (),
    allowed: Allowed = ABOVE_ZERO,
) -> float | Tensor:
    """Returns a checked number, or checked numbers per replica as float64 [*replicas].

    The dtype is float64 so that results round as they do with one Python number.

    Args:
        name: the setting's name in the error message.
        value: a number, a tensor or list [*replicas], or a tensor [].
        replicas: the replica shape.
        allowed: the allowed numbers.

    Raises:
        ValueError: for a wrong shape or a value that is not allowed.

    Examples:
        >>> checked_number("noise_std", 1.0), checked_number("eta", torch.tensor([1, 2]), (2,))
        (1.0, tensor([1., 2.], dtype=torch.float64))
    """
    if not isinstance(value, (int, float)):
        value = torch.as_tensor(value, dtype=torch.float64).detach()
        if value.shape not in (torch.Size(replicas), torch.Size()):
            raise ValueError(
                f"{name} must be one number or have the replicas' shape {list(replicas)}, got "
                f"{list(value.shape)}"
            )
    numbers = value.flatten().tolist() if isinstance(value, Tensor) else [value]
    if not all(map(allowed.test, numbers)):
        got = value.tolist() if isinstance(value, Tensor) else value
        raise ValueError(f"{name} must be {allowed.text}, got {got}")
    return value
