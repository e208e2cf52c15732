"""The baseline: a bare hand-written DQN update, a lower bound for every implementation."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import torch

from benchmarks.parts.timing import cpu_seconds

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.parts.timing import Block

FEATURES, HIDDEN, ACTIONS, BATCH = 268, (256, 256), 39, 32


def bare_update(batch: int = BATCH, device: str = "cpu") -> Callable[[], None]:
    """Returns a DQN update of a ready batch: three ``addmm`` for each network, fused Adam."""
    sizes = (FEATURES, *HIDDEN, ACTIONS)
    params = []
    for inputs, outputs in itertools.pairwise(sizes):
        matrix = torch.randn(inputs, outputs, device=device) * inputs**-0.5
        params.append(torch.nn.Parameter(matrix))
        params.append(torch.nn.Parameter(torch.zeros(outputs, device=device)))
    frozen = [p.detach().clone() for p in params]
    optimizer = torch.optim.Adam(params, lr=1e-3, fused=True)
    # about 27 of the 268 features of a dialogue state are active
    shape = (batch, FEATURES)
    observation, following = ((torch.rand(shape, device=device) < 0.1).float() for _ in range(2))
    action = torch.randint(ACTIONS, (batch, 1), device=device)
    mask = torch.ones(batch, ACTIONS, dtype=torch.bool, device=device)
    reward = torch.randn(batch, device=device)
    discount = 0.9 * (torch.rand(batch, device=device) >= 0.1).float()
    least = torch.finfo(torch.float32).min

    def network(w: list[torch.Tensor], x: torch.Tensor) -> torch.Tensor:
        hidden = torch.addmm(w[1], x, w[0]).relu()
        hidden = torch.addmm(w[3], hidden, w[2]).relu()
        return torch.addmm(w[5], hidden, w[4])

    def update() -> None:
        chosen = network(params, observation).gather(-1, action).squeeze(-1)
        with torch.no_grad():
            value = torch.where(mask, network(frozen, following), least).amax(-1)
            target = reward + discount * value
        loss = (chosen - target).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    return update


def bare_block(updates: int) -> Block:
    """Returns a block of bare updates; its unit is an update."""
    update = bare_update()
    for _ in range(5):
        update()

    def block() -> float:
        return cpu_seconds(lambda: [update() for _ in range(updates)]) / updates

    return block
