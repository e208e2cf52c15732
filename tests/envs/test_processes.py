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
    for call in (lambda: goals(made()), lambda: goals(env), lambda: goals(pickle.loads(copied))):
        one, other = in_forked(2, call)
        assert one != other


@pytest.mark.parametrize("is_loaded", [False, True])
def test_copies_of_what_was_seeded_play_the_same(restaurant, is_loaded):
    env = DialogueEnv(restaurant, batch_size=(8,))
    env.set_seed(5)
    if is_loaded:
        env.load_state_dict(env.state_dict())
    found = in_forked(2, lambda: goals(env))
    assert found == [goals(env)] * 2


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


def test_a_process_that_seeds_torch_itself_plays_by_that_seed(restaurant):
    def played():
        torch.manual_seed(123)
        return goals(DialogueEnv(restaurant, batch_size=(8,)))

    assert in_forked(2, played) == [played()] * 2


def test_what_draws_its_own_seed_draws_another_one_in_every_process():
    one, other = in_forked(2, lambda: BootstrapMask(4).generator_state.sum().item())
    assert one != other
