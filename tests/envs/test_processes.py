"""Environments in several processes: without a seed they play different dialogues."""

import pickle
from functools import partial

import forked
import pytest
import torch
from torchrl.envs import EnvCreator, ParallelEnv, SerialEnv, TransformedEnv

from bbq_torchrl.data import BootstrapMask
from bbq_torchrl.envs import DialogueEnv, EnvState

pytestmark = pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")


def goals(env):
    return env.reset()["goal_id"].flatten().tolist()


def in_forked(folder, call):
    """Returns what a function returns in each of two forked processes, as text."""
    return [forked.call(lambda: print(call()), cwd=folder)[0].strip() for _ in range(2)]


def test_environments_without_a_seed_play_different_dialogues(restaurant, tmp_path):
    made = partial(DialogueEnv, restaurant, batch_size=(8,))
    env = made()
    env.reset()
    copied = pickle.dumps(env)
    for call in (
        lambda: goals(made()),
        lambda: goals(env),
        lambda: goals(pickle.loads(copied)),
        lambda: BootstrapMask(4).generator_state.sum().item(),
    ):
        one, other = in_forked(tmp_path, call)
        assert one != other


def test_what_was_seeded_plays_the_same(restaurant, tmp_path):
    def by_torchs_seed():
        torch.manual_seed(123)
        return goals(DialogueEnv(restaurant, batch_size=(8,)))

    seeded = DialogueEnv(restaurant, batch_size=(8,), seed=5)
    loaded = DialogueEnv(restaurant, batch_size=(8,))
    loaded.load_state_dict(seeded.state_dict())
    for call in (by_torchs_seed, lambda: goals(seeded), lambda: goals(loaded)):
        assert in_forked(tmp_path, call) == [str(call())] * 2


@pytest.mark.parametrize(
    ("kind", "settings"), [(SerialEnv, {}), (ParallelEnv, {"mp_start_method": "fork"})]
)
def test_workers_whose_environments_load_the_state_of_a_template_differ(restaurant, kind, settings):
    """TorchRL loads it for a lambda and an EnvCreator."""
    made = partial(DialogueEnv, restaurant, batch_size=(8,))
    env = kind(2, EnvCreator(lambda: TransformedEnv(made(), EnvState())), **settings)
    one, other = env.reset()["goal_id"]
    env.close()
    assert not torch.equal(one, other)
