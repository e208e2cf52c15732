"""Environments in several processes: without a seed they play different dialogues."""

import multiprocessing
import pickle
from functools import partial

import pytest
import torch
from torchrl.envs import EnvCreator, ParallelEnv, SerialEnv, TransformedEnv

from bbq_torchrl.data import BootstrapMask
from bbq_torchrl.envs import DialogueEnv, EnvState

FORK = pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="processes cannot be forked here"
)
pytestmark = [FORK, pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")]


def goals(env):
    return env.reset()["goal_id"].flatten().tolist()


def in_forked(count, call):
    """Returns the results of a function in several forked processes."""
    context = multiprocessing.get_context("fork")
    queues = [context.SimpleQueue() for _ in range(count)]
    workers = [context.Process(target=lambda q=queue: q.put(call())) for queue in queues]
    for worker in workers:
        worker.start()
    found = [queue.get() for queue in queues]
    for worker in workers:
        worker.join()
    return found


def test_environments_without_a_seed_play_different_dialogues(restaurant):
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
        one, other = in_forked(2, call)
        assert one != other


def test_what_was_seeded_plays_the_same(restaurant):
    def by_torchs_seed():
        torch.manual_seed(123)
        return goals(DialogueEnv(restaurant, batch_size=(8,)))

    seeded = DialogueEnv(restaurant, batch_size=(8,), seed=5)
    loaded = DialogueEnv(restaurant, batch_size=(8,))
    loaded.load_state_dict(seeded.state_dict())
    for call in (by_torchs_seed, lambda: goals(seeded), lambda: goals(loaded)):
        assert in_forked(2, call) == [call()] * 2


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
