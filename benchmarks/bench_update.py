"""One update of a 268-256-256-39 network on a batch of 32: what the Bayesian part costs.

    OMP_NUM_THREADS=1 pytest benchmarks/bench_update.py --benchmark-enable --benchmark-only -s

The yardstick is a bare DQN update written by hand: three ``addmm``, fused Adam, no TensorDict.
The other ones are whole updates with this package's losses: loss(td), backward, fused Adam, for
one network and for a stack of five and ten, freed memory kept as in training. Times are per
network; the ratios of one run, which are what holds across machines, are printed at the end.
"""

from __future__ import annotations

import itertools

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Categorical
from torchrl.objectives import HardUpdate

from bbq_torchrl.modules import MLP, BayesMLP, q_network
from bbq_torchrl.objectives import BBQNLoss, DropoutDQNLoss
from bbq_torchrl.trainers import keep_freed_memory

FEATURES, HIDDEN, ACTIONS, BATCH = 268, (256, 256), 39, 32
STACKS = [(), (5,), (10,)]
ROUNDS, ITERATIONS, WARMUP = 20, 25, 3

_best: dict[tuple[str, tuple[int, ...]], float] = {}


@pytest.fixture(autouse=True, scope="module")
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    keep_freed_memory()
    yield
    torch.set_num_threads(threads)
    _report()


def _report() -> None:
    bare = _best.get(("bare", ()))
    if bare is None:
        return
    print("\n\n                       stack   ms per network   times bare   times DQN")
    for (name, stack), seconds in _best.items():
        dqn = _best.get(("dqn", stack), float("nan"))
        print(
            f"{name:>20} {stack!s:>7} {1e3 * seconds:16.3f} {seconds / bare:12.2f} "
            f"{seconds / dqn:11.2f}"
        )


def _transitions(stack: tuple[int, ...]) -> TensorDict:
    shape = (*stack, BATCH)

    def state() -> dict[str, torch.Tensor]:
        # about 27 of the 268 features of a dialogue state are active
        return {
            "observation": (torch.rand(*shape, FEATURES) < 0.1).float(),
            "action_mask": torch.ones(*shape, ACTIONS, dtype=torch.bool),
        }

    return TensorDict(
        {
            **state(),
            "action": torch.randint(ACTIONS, shape),
            "valid": torch.ones(shape, dtype=torch.bool),
            "next": {
                **state(),
                "reward": torch.randn(*shape, 1),
                "done": torch.rand(*shape, 1) < 0.1,
                "terminated": torch.rand(*shape, 1) < 0.1,
            },
        },
        shape,
    )


def _bare_update():
    """Returns a hand-written DQN update: what none of the machinery can be below."""
    sizes = (FEATURES, *HIDDEN, ACTIONS)
    params = []
    for inputs, outputs in itertools.pairwise(sizes):
        params.append(torch.nn.Parameter(torch.randn(inputs, outputs) * inputs**-0.5))
        params.append(torch.nn.Parameter(torch.zeros(outputs)))
    frozen = [p.detach().clone() for p in params]
    optimiser = torch.optim.Adam(params, lr=1e-3, fused=True)
    td = _transitions(())
    observation, action = td["observation"], td["action"].unsqueeze(-1)
    following, mask = td["next", "observation"], td["next", "action_mask"]
    reward = td["next", "reward"].squeeze(-1)
    discount = 0.9 * (~td["next", "terminated"].squeeze(-1)).float()
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
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()

    return update


def _loss_update(name: str, stack: tuple[int, ...]):
    """Returns a whole update with one of this package's losses."""
    spec = Categorical(ACTIONS)
    if name.startswith("dqn"):
        dropout = 0.5 if name == "dqn" else 0.0
        loss = DropoutDQNLoss(
            q_network(MLP(FEATURES, ACTIONS, HIDDEN, stack=stack, dropout=dropout), spec)
        )
    else:
        loss = BBQNLoss(
            q_network(BayesMLP(FEATURES, ACTIONS, HIDDEN, stack=stack), spec),
            target="mc" if name == "bbqn-mc" else "map",
            num_data=10_000,
        )
    HardUpdate(loss, value_network_update_interval=0)
    # one entry of the optimiser for each network, as the trainer's replicas have it
    leaves = []
    for p in loss.parameters():
        leaves += [v.requires_grad_() for v in p.data.view(-1, p.shape[-1]).unbind()]
    optimiser = torch.optim.Adam(leaves, lr=1e-3, fused=True)
    params = list(loss.parameters())
    td = _transitions(stack)

    def update() -> None:
        for p in params:
            p.grad = None
        loss(td)["loss"].backward()
        grads = [g for p in params for g in p.grad.view(-1, p.shape[-1]).unbind()]
        for leaf, grad in zip(leaves, grads, strict=True):
            leaf.grad = grad
        optimiser.step()

    return update


def _measure(benchmark, key: tuple[str, tuple[int, ...]], update, networks: int) -> None:
    benchmark.pedantic(update, rounds=ROUNDS, iterations=ITERATIONS, warmup_rounds=WARMUP)
    if benchmark.stats is not None:  # None where benchmarks are disabled
        _best[key] = benchmark.stats.stats.min / networks
        benchmark.extra_info["milliseconds_per_network"] = 1e3 * _best[key]


def test_bare_dqn_update(benchmark):
    _measure(benchmark, ("bare", ()), _bare_update(), 1)


@pytest.mark.parametrize("stack", STACKS, ids=str)
@pytest.mark.parametrize("name", ["dqn", "dqn without dropout", "bbqn-map", "bbqn-mc"])
def test_update(benchmark, name, stack):
    networks = torch.Size(stack).numel()
    _measure(benchmark, (name, stack), _loss_update(name, stack), networks)
