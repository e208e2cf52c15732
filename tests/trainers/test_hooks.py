"""Hooks are found by their protocols: through wrappers, and only where they can be called."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs import InitTracker, TransformedEnv
from torchrl.modules import EGreedyModule
from trainer_parts import GuessEnv

from bbq_torchrl.data import BootstrapMask
from bbq_torchrl.data.hooks import Measured, Seeded
from bbq_torchrl.exploration.hooks import Annealed, Resampled
from bbq_torchrl.hooks import modules_with, provides
from bbq_torchrl.trainers import RoundEnv


def test_a_hook_of_a_wrapped_environment_is_found():
    env = TransformedEnv(GuessEnv(2, 3), InitTracker())
    assert provides(env, RoundEnv)
    assert not provides(nn.Identity(), RoundEnv)


def test_torchrls_own_modules_and_foreign_ones_need_not_inherit():
    class Counts(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.register_buffer("step", torch.zeros(()))  # of this name, but no method

    greedy = EGreedyModule(GuessEnv(2, 3).action_spec, annealing_num_steps=10)
    assert provides(greedy, Annealed)
    assert not provides(greedy, Resampled)
    assert not provides(Counts(), Annealed)
    # a wrapper that hands on what it wraps is not called besides
    policy = nn.Sequential(TensorDictModule(greedy, ["a"], ["b"]), Counts())
    assert modules_with(policy, Annealed) == [greedy]
    mask = BootstrapMask(2)
    assert provides(mask, Seeded)
    assert not provides(mask, Measured)
