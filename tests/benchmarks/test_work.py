"""The work that the floor counts, against networks and optimizers that torch counts itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch.utils.flop_counter import FlopCounterMode

from bbq_torchrl.envs import DialogueEnv
from bbq_torchrl.networks import FlatMLP
from benchmarks.floor import KINDS, least_seconds
from benchmarks.parts.work import PARAMETERS, UPDATES, Work, turn, valid_share
from benchmarks.parts.yardstick import ACTIONS, BATCH, FEATURES, HIDDEN, bare_update

if TYPE_CHECKING:
    from bbq_torchrl.domains import Domain


def test_operations_are_those_that_torch_counts() -> None:
    update = bare_update()
    with FlopCounterMode(display=False) as counter:
        update()
    counted = sum(step.operations for step in UPDATES["bare dqn"])
    assert counted == counter.get_total_flops()


def test_parameters_are_those_of_the_network() -> None:
    network = FlatMLP(FEATURES, ACTIONS, HIDDEN)
    assert sum(p.numel() for p in network.parameters()) == PARAMETERS
    assert torch.Size([BATCH, FEATURES]) == torch.Size([32, 268])


def test_only_bayesian_updates_need_normal_numbers_and_fewer_than_a_draw_each() -> None:
    normals = {agent: sum(step.normals for step in steps) for agent, steps in UPDATES.items()}
    assert normals["bare dqn"] == normals["dqn"] == 0
    assert 0 < normals["bbqn-map"] == normals["bbqn-mc"] < PARAMETERS


def test_mc_alone_runs_the_target_at_every_update() -> None:
    operations = {agent: sum(step.operations for step in s) for agent, s in UPDATES.items()}
    assert operations["bbqn-mc"] == operations["bare dqn"]
    assert operations["bbqn-map"] == operations["dqn"] < operations["bare dqn"]


def test_turn_draws_what_the_simulator_draws(movie: Domain) -> None:
    env = DialogueEnv(movie, batch_size=(8,), seed=0)
    draws = env.simulator.draw_turn((1,))
    steps = turn(env)
    assert sum(step.uniforms for step in steps) == sum(entry.numel() for entry in draws.values())
    assert all(step.bytes > 0 for step in steps)
    assert 0 < valid_share(env) <= 1


def test_least_time_adds_up_what_a_step_does() -> None:
    measured = dict(
        zip(
            KINDS,
            (
                {"small": 1.0, "large": 10.0},
                {"L2": 9.0, "L3": 5.0, "DRAM": 1.0},
                {"normals": 2.0, "uniforms": 4.0, "exponentials": 8.0},
            ),
            strict=True,
        )
    )
    work = Work("all", operations=20, bytes=15, normals=2, uniforms=4, functions=16)
    assert least_seconds(work, measured) == 2 + 3 + 1 + 1 + 2
