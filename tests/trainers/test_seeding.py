"""Seeds of phases."""

from __future__ import annotations

from bbq_torchrl.trainers import derive_seed


def test_seeds_differ_by_run_phase_and_round():
    paths = [(s, p, r) for s in range(20) for p in ("env", "torch", "replay") for r in range(400)]

    seeds = [derive_seed(s, p, r) for s, p, r in paths]

    # 24,000 draws of 63 bits hold two equal ones with probability 3e-11.
    assert len(set(seeds)) == len(paths)
    assert all(0 <= seed < 2**63 for seed in seeds)


def test_a_number_and_its_text_are_different_paths():
    assert derive_seed(0, 1) != derive_seed(0, "1")
    assert derive_seed(0, 1, 1) != derive_seed(0, 11)


def test_a_seed_is_the_same_in_every_process_and_version():
    assert derive_seed(7, "collect", 3) == 3145391869347424827
