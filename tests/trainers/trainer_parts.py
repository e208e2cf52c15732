"""A batched environment of a few lines, and a trainer of tiny parts: it needs no dialogue."""

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torchrl.data import Binary, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.modules import EGreedyModule
from torchrl.objectives import HardUpdate

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import DropoutDQNLoss
from bbq_torchrl.trainers import Learner, ReplicaAdam, RoundTrainer, Spike

FEATURES, ACTIONS = 6, 4
TURNS = 7


class GuessEnv(EnvBase):
    """The last action of `ACTIONS` is masked, action 0 ends an episode, the hint tells if well.

    An episode also ends after `TURNS`, so episodes have different lengths. Success: action 0 where
    the hint (feature 0) is 1. The hint is redrawn every turn.
    """

    def __init__(self, replicas, places):
        super().__init__(batch_size=[replicas, places])
        shape = (replicas, places)
        self.observation_spec = Composite(
            observation=Unbounded((*shape, FEATURES)),
            action_mask=Binary(ACTIONS, shape=(*shape, ACTIONS), dtype=torch.bool),
            success=Binary(1, shape=(*shape, 1), dtype=torch.bool),
            shape=shape,
        )
        self.action_spec = Categorical(ACTIONS, shape=shape)
        self.reward_spec = Unbounded((*shape, 1))
        self.generator = torch.Generator()
        self.rounds_seen = []

    def _set_seed(self, seed):
        self.generator.manual_seed(seed)

    def set_round(self, round_number):
        self.rounds_seen.append(round_number)

    def _observe(self):
        noise = torch.rand(*self.batch_size, FEATURES, generator=self.generator)
        noise[..., 0] = (noise[..., 0] < 0.5).float()
        self.hint = noise[..., :1] > 0
        mask = (torch.arange(ACTIONS) < ACTIONS - 1).expand(*self.batch_size, -1)
        return TensorDict({"observation": noise, "action_mask": mask.clone()}, self.batch_size)

    def _reset(self, tensordict):
        self.count = torch.zeros(*self.batch_size, 1, dtype=torch.long)
        return self._observe().set("success", self.count > 0)

    def _step(self, tensordict):
        guessed = tensordict["action"].unsqueeze(-1) == 0
        success = guessed & self.hint
        self.count = self.count + 1
        done = guessed | (self.count >= TURNS)
        reward = torch.where(success, 4.0, torch.where(done, -1.0, -0.1))
        values = {"success": success, "done": done, "terminated": done.clone(), "reward": reward}
        return self._observe().update(values)


def random_policy(tensordict):
    """Guesses at once half of the time: the spike policy of these tests."""
    action = (torch.rand(tensordict.batch_size) < 0.5).long()
    return tensordict.set("action", action)


def make_trainer(folder, *, replicas=3, places=8, capacity=120, env=None, optimizer=None, **given):
    """Returns a trainer of tiny parts that learns for a few rounds."""
    env = GuessEnv(replicas, places) if env is None else env
    spec = env.action_spec_unbatched
    torch.manual_seed(1)  # trainers that are compared start from the same weights
    actor = q_actor(FlatMLP(FEATURES, ACTIONS, (16,), replicas=replicas, dropout=0.1), spec)
    explore = EGreedyModule(spec, 0.8, 0.0, annealing_num_steps=4, action_mask_key="action_mask")
    loss = DropoutDQNLoss(actor, gamma=0.9)
    of_learner = {"batch_size": 16, "freezes": 2, "epochs": 2, "lr_share": None}
    of_learner = {name: given.pop(name, value) for name, value in of_learner.items()}
    learner = Learner(
        loss,
        ReplicaReplay(capacity, replicas=replicas),
        optimizer or ReplicaAdam(loss.parameters(), replicas, lr=1e-2),
        HardUpdate(loss, value_network_update_interval=0),
        **of_learner,
    )
    own = {"rounds": 6, "dialogues": places, "checkpoint_every": 2}
    own |= {"spike": Spike(random_policy, 5)}
    return RoundTrainer(
        env,
        TensorDictSequential(actor, explore),
        learner,
        folder,
        **{**own, **given},
        round_metrics={"epsilon": lambda: float(explore.eps)},
    )
