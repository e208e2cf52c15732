"""Seeds of phases."""

from __future__ import annotations

import torch
from trainer_parts import make_trainer

from bbq_torchrl.trainers import derive_seed


def test_seeds_differ_by_run_and_path_and_a_number_is_not_its_text():
    paths = [(0, 1), (0, "1"), (0, 1, 1), (0, 11), (1, 1), (0, "1", 1), (0, "a", 1), (0, "b", 1)]
    assert len({derive_seed(*path) for path in paths}) == len(paths)


def test_a_seed_is_the_same_in_every_process_and_version():
    assert derive_seed(7, "collect", 3) == 3145391869347424827


def test_every_phase_and_epoch_of_every_replica_has_a_seed_of_its_own(tmp_path, monkeypatch):
    trainer = make_trainer(tmp_path, rounds=2, replicas=3)
    of_torch, of_env, of_replay = [], [], []
    monkeypatch.setattr(torch, "manual_seed", of_torch.append)
    monkeypatch.setattr(trainer.env, "set_seed", of_env.append)
    monkeypatch.setattr(trainer.replay, "seed", of_replay.extend)
    trainer.train()
    phases = 1 + 2 * (1 + 2 * 2)  # the spike; in a round: collect, two epochs after each freeze
    assert [len(set(seeds)) for seeds in (of_torch, of_env, of_replay)] == [
        *(phases, phases, 3 * phases)
    ]
