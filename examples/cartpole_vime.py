"""CartPole with a DQN and VIME: the parts of this package in a plain TorchRL loop.

There are no dialogues. Every transition gets a bonus for its information gain about a dynamics
model. The Q-network learns from task reward + bonus, the dynamics model from the same batches. The
printed return is the task's, without the bonus.

    pip install -e '.[examples]'
    python examples/cartpole_vime.py                  # 20,000 frames
    python examples/cartpole_vime.py --frames 600     # only to see it run
"""

from __future__ import annotations

import argparse
import sys

import torch
from tensordict.nn import TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import GymEnv, RewardSum, TransformedEnv
from torchrl.modules import EGreedyModule
from torchrl.objectives import HardUpdate

from bbq_torchrl.exploration import Greedy
from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import DropoutDQNLoss
from bbq_torchrl.vime import DynamicsLoss, DynamicsModel, VIMEReward


def recent(returns: list[float]) -> float:
    """Returns the mean of the last 10 returns."""
    return sum(returns[-10:]) / max(1, len(returns[-10:]))


def main() -> None:
    """Trains, and prints the mean return of the last 10 episodes every 20 batches."""
    parser = argparse.ArgumentParser(description="CartPole with a DQN and VIME")
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--frames-per-batch", type=int, default=100)
    parser.add_argument("--updates-per-batch", type=int, default=50)
    parser.add_argument("--eta", type=float, default=0.1, help="weight of the bonus; 0 for none")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.manual_seed(args.seed)

    env = TransformedEnv(GymEnv("CartPole-v1", categorical_action_encoding=True), RewardSum())
    env.set_seed(args.seed)
    actor = q_actor(FlatMLP(4, 2, (128, 128)), env.action_spec_unbatched, action_mask_key=None)
    epsilon = EGreedyModule(
        env.action_spec_unbatched, eps_end=0.05, annealing_num_steps=args.frames // 4
    )
    policy = TensorDictSequential(Greedy(actor), epsilon)

    dynamics = DynamicsModel(4, 2)
    memory = TensorDictReplayBuffer(
        storage=LazyTensorStorage(20_000),
        transform=VIMEReward(dynamics, eta=args.eta),
        batch_size=128,
    )
    q_loss = DropoutDQNLoss(actor, gamma=0.99, loss_function="smooth_l1")
    dynamics_loss = DynamicsLoss(dynamics)
    freeze = HardUpdate(q_loss, value_network_update_interval=100)
    optimizer = torch.optim.Adam([*q_loss.parameters(), *dynamics_loss.parameters()], lr=1e-3)

    returns: list[float] = []
    collector = Collector(
        env,
        policy,
        frames_per_batch=args.frames_per_batch,
        total_frames=args.frames,
        auto_register_policy_transforms=False,
    )
    for number, rows in enumerate(collector):
        memory.extend(rows)
        epsilon.step(len(rows))
        dynamics_loss.set_num_data(len(memory))
        for _ in range(args.updates_per_batch):
            batch = memory.sample()
            losses = dynamics_loss(batch)
            optimizer.zero_grad()
            (q_loss(batch)["loss"] + losses["loss"]).backward()
            optimizer.step()
            freeze.step()
        returns += rows["next", "episode_reward"][rows["next", "done"]].tolist()
        if (number + 1) % 20 == 0:
            frames = (number + 1) * args.frames_per_batch
            sys.stdout.write(
                f"{frames:6d} frames: return {recent(returns):5.1f}, dynamics loss "
                f"{losses['dynamics_loss']:.3f}\n"
            )
    collector.shutdown()
    sys.stdout.write(f"mean return of the last 10 episodes: {recent(returns):.1f}\n")


if __name__ == "__main__":
    main()
