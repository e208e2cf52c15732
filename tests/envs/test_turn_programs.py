"""A turn waits for no device, and is the same compiled, as a CUDA graph and as it is."""

from __future__ import annotations

import copy

import pytest
import torch
from host_waits import NeverWaits, use_tapes

from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule


def make_env(domain, mode="mixed", **options):
    return DialogueEnv(
        domain,
        batch_size=(2, 5),
        slot_error_prob=0.3,
        slot_error_mode=mode,
        intent_error_prob=0.2,
        schedule=ExtensionSchedule(start=1, every=1),
        seed=3,
        **options,
    )


def turns(env):
    """Returns what an agent that acts at random is told, over two rounds of the extension."""
    torch.manual_seed(5)
    told = []
    for round_number in (0, 4):
        env.set_round(round_number)
        told.append(env.rollout(7, break_when_any_done=False).exclude("collector"))
        told.append(env.rollout(4, break_when_any_done=False).exclude("collector"))
    return told


def assert_same(one, other):
    for before, after in zip(one, other, strict=True):
        assert set(before.keys(True, True)) == set(after.keys(True, True))
        for key in before.keys(True, True):
            assert torch.equal(before[key], after[key]), key


@pytest.mark.parametrize("mode", ["value", "slot", "delete", "mixed"])
def test_a_turn_never_waits_for_the_device(movie, mode):
    env = make_env(movie, mode)
    state = env.reset()
    state["action"] = env.rand_action()["action"]
    with NeverWaits():
        env._step(state)


def test_a_reset_never_waits_for_the_device(movie):
    env = make_env(movie)
    state = env.reset()
    state["_reset"] = torch.rand(2, 5, 1) < 0.5
    with NeverWaits():
        env._reset(state)
        env._reset()


def test_a_captured_turn_is_the_turn(restaurant, monkeypatch):
    plain = turns(make_env(restaurant))
    graphs = use_tapes(monkeypatch)
    captured = turns(make_env(restaurant))
    assert [graph.launches > 10 for graph in graphs] == [True]
    assert_same(plain, captured)


def test_a_turn_can_be_left_uncaptured(restaurant, monkeypatch):
    graphs = use_tapes(monkeypatch)
    turns(make_env(restaurant, cuda_graph=False))
    assert graphs == []


def test_a_copy_of_an_environment_captures_its_own_turn(restaurant, monkeypatch):
    graphs = use_tapes(monkeypatch)
    env = make_env(restaurant)
    turns(env)
    other = copy.deepcopy(env)
    env.set_seed(1)
    other.set_seed(1)
    assert_same(turns(env), turns(other))
    assert len(graphs) == 2


@pytest.mark.slow
def test_a_compiled_turn_is_the_turn(restaurant):
    assert_same(turns(make_env(restaurant)), turns(make_env(restaurant, compile_turns=True)))
