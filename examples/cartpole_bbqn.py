"""BBQN on CartPole: the parts in a plain TorchRL loop, without dialogues.

    pip install -e '.[examples]'
    python examples/cartpole_bbqn.py                  # 15,000 frames, half a minute
    python examples/cartpole_bbqn.py --agent dqn      # the same loop with DQN, epsilon-greedy
    python examples/cartpole_bbqn.py --frames 500     # only to see it run

BBQN has the prior of ``agent=bbqn``, "bbqn_paper_start" the paper's initial posterior;
"bbqn_episode" keeps a draw of the weights for an episode. The returns of five seeds are in
results/cartpole.csv and on docs/parts.md.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any, Literal, get_args

import torch
from tensordict.nn import TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import GymEnv
from torchrl.modules import EGreedyModule
from torchrl.objectives import SoftUpdate

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.exploration import EvaluationPolicy, Greedy, ThompsonSampling
from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import BBQNLoss, DropoutDQNLoss

Agent = Literal["bbqn", "bbqn_episode", "bbqn_paper_start", "dqn"]

GAMMA, CAPACITY, BATCH_SIZE = 0.9, 10_000, 128
FRAMES_PER_BATCH, UPDATES_PER_BATCH = 100, 20
LONGEST = 500  # frames of an episode of CartPole-v1, each with a reward of 1


def make_env(seed: int) -> GymEnv:
    """Returns CartPole with actions 0 and 1."""
    env = GymEnv("CartPole-v1", categorical_action_encoding=True)
    env.set_seed(seed)
    return env


def mean_return(env: GymEnv, policy: EvaluationPolicy, episodes: int) -> float:
    """Returns the mean return over episodes of a policy that does not explore."""
    returns = [env.rollout(LONGEST, policy)["next", "reward"].sum() for _ in range(episodes)]
    return float(torch.stack(returns).mean())


def make_agent(agent: Agent, env: GymEnv, frames: int) -> tuple[Any, Any, Any]:
    """Returns the Q-value actor, the policy that explores, and the loss.

    Args:
        agent: "bbqn" explores by Thompson sampling, one weight draw a step; "bbqn_episode", by
            one an episode; "bbqn_paper_start", a draw a step, has a posterior that starts at the
            prior; "dqn", the same network without uncertainty, explores by ε from 1 to .05 in a
            quarter of the frames.
        env: whose actions there are.
        frames: to learn from.
    """
    spec = env.action_spec_unbatched
    if agent == "dqn":
        actor = q_actor(FlatMLP(4, 2), spec, action_mask_key=None)
        dither = EGreedyModule(spec, eps_end=0.05, annealing_num_steps=frames // 4)
        explore = TensorDictSequential(Greedy(actor), dither)
        return actor, explore, DropoutDQNLoss(actor, gamma=GAMMA)
    network, settings = BayesMLP(4, 2, prior_std=0.037), {}
    if agent == "bbqn_paper_start":
        network = BayesMLP(4, 2, prior_std=0.1, mean_init="zero", std_init=None)
        settings = {"kl_temperature": 1.0}
    actor = q_actor(network, spec, action_mask_key=None)
    loss = BBQNLoss(actor, num_data=CAPACITY, gamma=GAMMA, **settings)
    explore = ThompsonSampling(actor, per="episode" if agent == "bbqn_episode" else "step")
    return actor, explore, loss


def train(agent: Agent, frames: int, seed: int, *, every: int = 3000) -> float:
    """Learns for a number of frames and returns the mean network's mean return.

    Args:
        agent: which one.
        frames: of the environment, all of them explored.
        seed: of the weights, the draws and the environment.

    Keyword Args:
        every: number of frames after which progress is printed.
    """
    torch.manual_seed(seed)
    env, test_env = make_env(seed), make_env(seed + 10_000)
    actor, explore, loss = make_agent(agent, env, frames)
    target = SoftUpdate(loss, eps=0.995)
    adam = torch.optim.Adam(loss.parameters(), lr=1e-3)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(CAPACITY), batch_size=BATCH_SIZE)
    collector = Collector(
        env,
        explore,
        frames_per_batch=FRAMES_PER_BATCH,
        total_frames=frames,
        auto_register_policy_transforms=True,  # transforms that the policy needs
    )
    policy = EvaluationPolicy(actor)  # the mean network
    seen = 0
    for batch in collector:
        buffer.extend(batch)
        if agent == "dqn":
            explore[-1].step(batch.numel())  # ε falls
        for _ in range(UPDATES_PER_BATCH):
            out = loss(buffer.sample())
            adam.zero_grad()
            out["loss"].backward()
            adam.step()
            target.step()
        seen += batch.numel()
        if seen % every == 0:
            figures = f"TD error {out['td_error']:5.2f}  Q {out['q_value']:5.1f}"
            print(f"{seen:6} frames  return {mean_return(test_env, policy, 3):5.1f}  {figures}")
    collector.shutdown()
    return mean_return(test_env, policy, 20)


def write_row(file: Path, row: dict[str, object]) -> None:
    """Adds a row to a CSV file, creating it if necessary."""
    is_new = not file.exists()
    with file.open("a", newline="") as lines:
        writer = csv.DictWriter(lines, row, lineterminator="\n")
        if is_new:
            writer.writeheader()
        writer.writerow(row)


def main() -> None:
    """Trains one agent and prints its return."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--agent", choices=get_args(Agent), default="bbqn")
    parser.add_argument("--frames", type=int, default=15_000, help="frames to learn from")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--file", type=Path, help="a CSV file that a row is added to")
    options = parser.parse_args()
    result = train(options.agent, options.frames, options.seed)
    if options.file is not None:
        row = {"agent": options.agent, "seed": options.seed, "frames": options.frames}
        write_row(options.file, {**row, "return": f"{result:.1f}"})
    print(f"mean network, 20 episodes: return {result:.1f} of at most {LONGEST}")


if __name__ == "__main__":
    main()
