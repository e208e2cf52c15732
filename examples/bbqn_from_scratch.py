"""BBQN in one file: a Bayes-by-Backprop Q-network that learns to book tickets by Thompson sampling.

    python examples/bbqn_from_scratch.py                # 40 rounds of 50 dialogues, a minute or two
    python examples/bbqn_from_scratch.py --seed 3 --rounds 10

The algorithm of Lipton et al. (BBQ-Networks, AAAI 2018), to be read from top to bottom: plain torch
on our environment, without options, replicas, checkpoints or optimizations. It plays and learns as
``python train.py +experiment=agents/bbqn_map env=full protocol=quick`` does, with the same numbers,
and the results agree (docs/learning_starts.md).
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import torch
import torch.nn.functional as F
from tensordict import TensorDict
from torch import Tensor, nn

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.envs import DialogueEnv, scripted_policy

# The protocol: in each round 50 dialogues, then twice: freeze the target, 3 epochs of learning.
ROUNDS, DIALOGUES, FREEZES, EPOCHS, BATCH_SIZE = 40, 50, 2, 3, 128
CAPACITY = 5_000  # transitions in the buffer, including the spike
SPIKE_DIALOGUES = 100  # the rule agent's dialogues in the buffer before the first round
EVALUATION_DIALOGUES = 2_000

HIDDEN = (256, 256)
PRIOR_STD = 0.037  # the prior of every weight is N(0, PRIOR_STD²)
STD_INIT = 0.09  # initial σ of every weight
NOISE_STD = 1.0  # noise of the targets, in units of Q: the likelihood is N(target; Q, NOISE_STD²)
KL_TEMPERATURE = 0.014  # factor on the KL; 1 would be Bayes' rule
GAMMA = 0.9
LEARNING_RATE, FINAL_RATE = 2e-3, 0.05  # the second is a factor, reached in the last round

Policy = Callable[[TensorDict], TensorDict]


class BayesLinear(nn.Module):
    """A linear layer with a Gaussian N(μ, σ²) for each weight; σ = softplus(ρ) keeps it positive.

    The bias is the last row of the weights: the weights of an input that is always 1.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        bound = 1 / math.sqrt(inputs)  # μ starts as the weights of nn.Linear do
        self.mu = nn.Parameter(torch.empty(inputs + 1, outputs).uniform_(-bound, bound))
        self.rho = nn.Parameter(torch.full_like(self.mu, math.log(math.expm1(STD_INIT))))

    @property
    def sigma(self) -> Tensor:
        """The standard deviations, [inputs + 1, outputs]."""
        return F.softplus(self.rho)

    def draw(self) -> Tensor:
        """Returns weights μ + σ·ε with ε ~ N(0, 1), so that gradients reach μ and ρ."""
        return self.mu + self.sigma * torch.randn_like(self.mu)

    def kl(self) -> Tensor:
        """Returns KL(N(μ, σ²) ‖ N(0, PRIOR_STD²)) in closed form, summed over the weights."""
        sigma, prior = self.sigma, PRIOR_STD
        return ((prior / sigma).log() + (sigma**2 + self.mu**2) / (2 * prior**2) - 0.5).sum()

    def forward(self, x: Tensor, how: str) -> Tensor:
        """Returns the outputs [rows, outputs] for inputs [rows, inputs].

        Args:
            x: the inputs.
            how: "mean": with the weights μ; "draw": with one draw for all rows; "draws": with a
                draw for each row.
        """
        x = F.pad(x, (0, 1), value=1.0)
        if how == "mean":
            return x @ self.mu
        if how == "draw":
            return x @ self.draw()
        # With Gaussian weights the outputs are Gaussian too. Drawing them is equivalent, and takes
        # fewer draws than weights for each row (local reparameterization, Kingma et al. 2015).
        std = (x**2 @ self.sigma**2).sqrt()
        return x @ self.mu + std * torch.randn_like(std)


class BayesQNetwork(nn.Module):
    """Q(s, ·) from a state's features: Bayesian layers with ReLUs in between."""

    def __init__(self, features: int, actions: int) -> None:
        super().__init__()
        sizes = (features, *HIDDEN, actions)
        self.layers = nn.ModuleList(BayesLinear(*shape) for shape in pairwise(sizes))

    def forward(self, x: Tensor, how: str) -> Tensor:
        """Returns the values [rows, actions]; ``how`` as in :class:`BayesLinear`."""
        for layer in self.layers[:-1]:
            x = layer(x, how).relu()
        return self.layers[-1](x, how)

    def kl(self) -> Tensor:
        """Returns the KL of all weights from the prior."""
        return torch.stack([layer.kl() for layer in self.layers]).sum()


def best_legal(values: Tensor, legal: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the highest values [rows] among the legal actions, and their actions."""
    return values.masked_fill(~legal, -math.inf).max(-1)


def policy_of(net: BayesQNetwork, how: str) -> Policy:
    """Returns a policy: "draws" is Thompson sampling by step and dialogue, "mean" the greedy one.

    Thompson sampling draws a value function from the posterior and takes the action that is best
    in it: an action is chosen as often as it is probable that it is the best.
    """

    @torch.no_grad()
    def policy(td: TensorDict) -> TensorDict:
        values = net(td["observation"], how)
        return td.set("action", best_legal(values, td["action_mask"])[1])

    return policy


def play(env: DialogueEnv, policy: Policy) -> tuple[TensorDict, float]:
    """Plays a batch of dialogues to their ends. Returns the transitions [n] and the success."""
    rollout = env.rollout(
        env.max_agent_turns,
        policy,
        break_when_any_done=False,
        break_when_all_done=True,
        trust_policy=True,
    )
    done = rollout["next", "done"].squeeze(-1)  # [dialogues, turns]
    played = done.cumsum(-1) - done.long() == 0  # up to the dialogue's end
    success = (rollout["next", "success"].squeeze(-1) & played).any(-1)
    return rollout[played], success.double().mean().item()


@torch.no_grad()
def targets_of(net: BayesQNetwork, data: TensorDict) -> Tensor:
    """Returns r + γ max Q(s', ·) over legal actions, [rows], from the current mean network."""
    after = data["next"]
    following, _ = best_legal(net(after["observation"], "mean"), after["action_mask"])
    going_on = ~after["terminated"].squeeze(-1)
    return after["reward"].squeeze(-1) + GAMMA * following * going_on


def loss_of(
    net: BayesQNetwork, states: Tensor, actions: Tensor, targets: Tensor, num_data: int
) -> Tensor:
    """Returns the negative evidence lower bound of a batch with one weight draw, divided by N.

    Args:
        net: the network.
        states: features, [rows, features].
        actions: those taken, int64 [rows].
        targets: of their values, [rows].
        num_data: N, the transitions in the buffer: the more there are, the less the prior weighs.
    """
    values = net(states, "draw").gather(-1, actions.unsqueeze(-1)).squeeze(-1)
    error = (values - targets).square().mean() / (2 * NOISE_STD**2)
    return error + KL_TEMPERATURE * net.kl() / num_data


def learn(net: BayesQNetwork, optimizer: torch.optim.Optimizer, data: TensorDict) -> None:
    """Freezes the target and learns for some epochs over the buffer, repeatedly."""
    states, actions = data["observation"], data["action"]
    for _ in range(FREEZES):
        targets = targets_of(net, data)  # the only use of the frozen network
        for _ in range(EPOCHS):
            for rows in torch.randperm(len(data)).split(BATCH_SIZE):
                loss = loss_of(net, states[rows], actions[rows], targets[rows], len(data))
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()


def rate_of(number: int, rounds: int) -> float:
    """Returns the factor on the learning rate in a round from 0: 1 at first, falling at half."""
    return 1 - (1 - FINAL_RATE) * max(0.0, 2 * (number + 1) / rounds - 1)


def train(seed: int, rounds: int, dialogues: int) -> float:
    """Trains an agent; returns the mean network's success in ``dialogues`` new dialogues."""
    torch.manual_seed(seed)
    env = DialogueEnv(movie_domain(), batch_size=(DIALOGUES,), seed=seed)
    net = BayesQNetwork(env.layout.size, len(env.domain.actions))
    optimizer = torch.optim.Adam(net.parameters(), LEARNING_RATE, fused=True)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda number: rate_of(number, rounds))

    # Spiking: random actions succeed in one of 2,000 dialogues, so the agent would learn nothing
    # without some successes of a simple agent. These transitions are never evicted.
    rule = scripted_policy("rule", env)
    spiked = torch.cat([play(env, rule)[0] for _ in range(SPIKE_DIALOGUES // DIALOGUES)])
    own = spiked[:0]
    for number in range(rounds):
        transitions, success = play(env, policy_of(net, "draws"))
        own = torch.cat([own, transitions])[-(CAPACITY - len(spiked)) :]
        learn(net, optimizer, torch.cat([spiked, own]))
        schedule.step()
        print(f"round {number + 1:2}  success {success:.2f}")

    test = DialogueEnv(env.domain, batch_size=(dialogues,), seed=seed + 1_000_000)
    return play(test, policy_of(net, "mean"))[1]


def main() -> None:
    """Trains one agent, prints its final success, and adds it to a file if given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument(
        "--dialogues", type=int, default=EVALUATION_DIALOGUES, help="of the final evaluation"
    )
    parser.add_argument("--file", type=Path, help="CSV file that a line is added to")
    options = parser.parse_args()
    torch.set_num_threads(1)  # the network is too small for more
    success = train(options.seed, options.rounds, options.dialogues)
    print(f"final success {success:.4f} in {options.dialogues:,} dialogues")
    if options.file is not None:
        is_new = not options.file.exists()
        with options.file.open("a", newline="", encoding="utf-8") as stream:
            lines = csv.writer(stream, lineterminator="\n")
            lines.writerows([["seed", "rounds", "final_success"]] * is_new)
            lines.writerow([options.seed, options.rounds, success])


if __name__ == "__main__":
    main()
