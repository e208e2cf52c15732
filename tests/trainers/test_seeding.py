"""Seeds of phases."""

from __future__ import annotations

from bbq_torchrl.trainers import derive_seed


def test_seeds_differ_by_run_and_path_and_a_number_is_not_its_text():
    paths = [(0, 1), (0, "1"), (0, 1, 1), (0, 11), (1, 1), (0, "1", 1), (0, "a", 1), (0, "b", 1)]
    assert len({derive_seed(*path) for path in paths}) == len(paths)


def test_a_seed_is_the_same_in_every_process_and_version():
    assert derive_seed(7, "collect", 3) == 3145391869347424827
