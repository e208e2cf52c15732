"""The work that the floor counts, against what torch and the simulator count themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torch.utils.flop_counter import FlopCounterMode

from bbq_torchrl.envs import DialogueEnv
from bbq_torchrl.networks import FlatMLP
from benchmarks.parts.floor import PARAMETERS, UPDATES, Work, least_seconds, turn, valid_share
from benchmarks.parts.yardstick import ACTIONS, FEATURES, HIDDEN, bare_update

if TYPE_CHECKING:
    from bbq_torchrl.domains import Domain


def test_operations_are_those_that_torch_counts() -> None:
    update = bare_update()
    with FlopCounterMode(display=False) as counter:
        update()
    assert UPDATES["bare dqn"]["operations"] == counter.get_total_flops()


def test_parameters_are_those_of_the_network() -> None:
    network = FlatMLP(FEATURES, ACTIONS, HIDDEN)
    assert sum(p.numel() for p in network.parameters()) == PARAMETERS


def test_turn_draws_what_the_simulator_draws(movie: Domain) -> None:
    env = DialogueEnv(movie, batch_size=(8,), seed=0)
    draws = env.simulator.draw_turn((1,))
    work = turn(env)
    assert work["uniforms"] == sum(entry.numel() for entry in draws.values())
    assert work["bytes"] > 0
    assert 0 < valid_share(env) <= 1


def test_least_time_adds_up_what_a_step_does() -> None:
    work = Work(operations=20, bytes=15, normals=2, uniforms=4, functions=16)
    rates = Work(operations=10, bytes=5, normals=2, uniforms=4, functions=8)
    assert least_seconds(work + work, rates) == 2 * (2 + 3 + 1 + 1 + 2)
