"""Uncertainty of a Bayes-by-Backprop network in regression (Blundell et al. 2015, section 5.2).

    python examples/regression.py                     # half a minute, writes the figure in docs/
    python examples/regression.py --steps 200 --out quick.png

Two networks of the same size learn a curve from noisy points in [0, 0.5]: a
:class:`~bbq_torchrl.bayes.BayesMLP`, trained on the evidence bound with
:func:`~bbq_torchrl.bayes.weight_scope`, and a plain network. Outside the data the plain network
extrapolates a single curve, while the weight draws of the Bayesian one fan out. Thompson sampling
explores by this uncertainty. The example needs neither reinforcement learning nor dialogues.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import torch
from torch import Tensor

from bbq_torchrl.bayes import BayesMLP, KLSum, weight_scope
from bbq_torchrl.networks import FlatMLP

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OUT = Path(__file__).parent.parent / "docs" / "figures" / "regression.png"
HIDDEN = (100, 100)  # the paper's hidden layers are not given for this figure
NOISE_STD = 0.1  # of y as the likelihood has it; ε reaches y by the slope of the curve, up to 6 ε


def curve(count: int) -> tuple[Tensor, Tensor]:
    """Returns points x in [0, 0.5] and noisy values y, each [count, 1].

    As the paper makes them; its N(0, 0.02) is read as a standard deviation of 0.02.
    """
    x = 0.5 * torch.rand(count, 1)
    noise = 0.02 * torch.randn(count, 1)
    moved = 2 * torch.pi * (x + noise)
    return x, x + 0.3 * moved.sin() + 0.3 * (2 * moved).sin() + noise


def standardized(x: Tensor) -> Tensor:
    """Returns x standardized by the mean and std of [0, 0.5]."""
    return (x - 0.25) / 0.144


def train_bayesian(x: Tensor, y: Tensor, steps: int) -> BayesMLP:
    """Returns a network trained on the evidence bound, with a weight draw for each step."""
    net = BayesMLP(1, 1, HIDDEN, prior_std="fan_in", mean_init="kaiming", std_init=0.02)
    optimizer = torch.optim.Adam(net.parameters(), 3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        kl = KLSum()
        with weight_scope("draw", kl=kl):
            error = net(standardized(x)) - y
        loss = error.square().mean() / (2 * NOISE_STD**2) + kl.total() / len(x)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return net


def train_plain(x: Tensor, y: Tensor, steps: int) -> FlatMLP:
    """Returns a network trained on the squared error."""
    net = FlatMLP(1, 1, HIDDEN)
    optimizer = torch.optim.Adam(net.parameters(), 3e-3)
    for _ in range(steps):
        loss = (net(standardized(x)) - y).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return net


@torch.no_grad()
def draws(net: BayesMLP, x: Tensor, count: int = 500) -> Tensor:
    """Returns the curves of weight draws at x [n, 1], shape [count, n]."""
    weights = net.draw_weights((count,))
    rows = standardized(x).expand(count, *x.shape)
    return net(rows, weights=weights).squeeze(-1)


def spread_ratio(net: BayesMLP) -> float:
    """Returns the std of draws, averaged over x = -0.3 and 1, divided by that on the data."""
    off = draws(net, torch.tensor([[-0.3], [1.0]])).std(0).mean()
    on = draws(net, torch.linspace(0.0, 0.5, 51).unsqueeze(-1)).std(0).mean()
    return float(off / on)


def draw_panel(axes: Axes, title: str, x: Tensor, y: Tensor) -> None:
    """Draws the common parts of both panels: points, limits and labels."""
    axes.plot(x, y, ".", color="0.35", markersize=2, alpha=0.5, label="data")
    axes.set(title=title, xlabel="x", xlim=(-0.4, 1.2), ylim=(-1.3, 1.7))
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="upper left", frameon=False, fontsize=8)


def draw_figure(out: Path, x: Tensor, y: Tensor, bayesian: BayesMLP, plain: FlatMLP) -> None:
    """Saves the figure: quantiles of the Bayesian network's draws next to the plain network."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    grid = torch.linspace(-0.4, 1.2, 161).unsqueeze(-1)
    curves = draws(bayesian, grid)
    at = grid.squeeze(-1)
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.2), sharey=True)
    for low, high, alpha in ((0.025, 0.975, 0.2), (0.25, 0.75, 0.4)):
        bounds = curves.quantile(torch.tensor([low, high]), 0)
        label = f"{high - low:.0%} of the draws"
        left.fill_between(at, *bounds, color="C0", alpha=alpha, linewidth=0, label=label)
    left.plot(at, curves.median(0).values, color="C3", label="median")
    draw_panel(left, "Bayes by Backprop", x, y)
    left.set_ylabel("y")
    with torch.no_grad():
        right.plot(at, plain(standardized(grid)).squeeze(-1), color="C3", label="prediction")
    draw_panel(right, "Plain network", x, y)
    figure.tight_layout()
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=110)
    plt.close(figure)


def main() -> None:
    """Trains both networks, prints the ratio of spreads and saves the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=5000, help="updates of each network")
    parser.add_argument("--points", type=int, default=500, help="points to learn from")
    parser.add_argument("--out", type=Path, default=OUT, help="where the figure goes")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.manual_seed(options.seed)
    x, y = curve(options.points)
    bayesian = train_bayesian(x, y, options.steps)
    plain = train_plain(x, y, options.steps)
    draw_figure(options.out, x, y, bayesian, plain)
    print(f"spread of the draws off the data / on the data: {spread_ratio(bayesian):.1f}")
    print(f"figure: {options.out}")


if __name__ == "__main__":
    main()
