"""The table at the end of a sweep."""

import yaml
from result_folders import run_result
from tiny import composed

from bbq_torchrl.evaluation.run_result import write_json
from bbq_torchrl.runs.folders import save_config
from bbq_torchrl.runs.prepare import table_of_runs


def make_run(folder, overrides, rate=None, rounds=5):
    (folder / ".hydra").mkdir(parents=True)
    (folder / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump(overrides))
    save_config(composed("protocol.rounds=5"), folder / "config.yaml")
    if rate is not None:
        write_json(run_result([rate], rounds=rounds), folder / "result.json")
        (folder / "curve.png").touch()


UNFINISHED = "– | not finished: train.log in it says why |"


def test_every_run_is_listed_with_what_sets_it_apart(tmp_path):
    make_run(tmp_path / "10_dqn", ["agent=dqn", "seed=1", "replicas=2"], 0.7)
    make_run(tmp_path / "2_bbqn", ["agent=bbqn", "seed=1", "replicas=2"])
    make_run(tmp_path / "0_dqn", ["agent=dqn", "seed=0", "replicas=2"])
    (tmp_path / "0_dqn" / "result.json").write_text("[" * 100_000)
    make_run(tmp_path / "3_refused", ["agent=dqn", "seed=3", "replicas=2"])
    (tmp_path / "3_refused" / "config.yaml").unlink()
    make_run(tmp_path / "4_extended", ["agent=dqn", "seed=4", "replicas=2"], 0.7, rounds=3)

    table, is_complete = table_of_runs(tmp_path)
    title, _, head, _, *rows = table.splitlines()

    assert not is_complete

    assert title == f"1 of 5 runs in {tmp_path} are finished"
    assert head == "| run | overrides | final success | state |"
    assert rows == [
        f"| 0_dqn | agent=dqn seed=0 | {UNFINISHED}",
        f"| 2_bbqn | agent=bbqn seed=1 | {UNFINISHED}",
        f"| 3_refused | agent=dqn seed=3 | {UNFINISHED}",
        f"| 4_extended | agent=dqn seed=4 | {UNFINISHED}",
        "| 10_dqn | agent=dqn seed=1 | 0.700 | finished |",
    ]


def test_a_single_run_shows_all_its_overrides(tmp_path):
    make_run(tmp_path / "0", ["agent=dqn"], 0.5)
    table, is_complete = table_of_runs(tmp_path)
    assert table.splitlines()[-1] == "| 0 | agent=dqn | 0.500 | finished |"
    assert is_complete


def test_a_sweep_of_which_nothing_started_has_a_table_too(tmp_path):
    assert table_of_runs(tmp_path)[0].startswith("0 of 0 runs")
