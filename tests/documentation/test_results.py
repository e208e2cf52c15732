"""The files kept of a run, and the tables made of them."""

from __future__ import annotations

import json

import pytest
import yaml
from result_folders import make_run

from bbq_torchrl.evaluation import comparison
from bbq_torchrl.options import EvaluateConfig
from bbq_torchrl.runs.compose import compose
from scripts import keep_result, measure_policies
from scripts.docs_blocks import BLOCKS, common, results

MACHINE = "/home/somebody/corpus"
FOLDER = "miulab"


def run_of(folder, agent, rates):
    """Makes a finished run folder of two rounds."""
    explore = "thompson" if agent == "bbqn" else "epsilon_greedy"
    corpus = {"domain.name": "miulab", "domain.path": MACHINE, "resume": MACHINE}
    make_run(folder, rates, agent=agent, explore=explore, rounds=2, changes=corpus)
    (folder / ".hydra").mkdir()
    overrides = [f"agent={agent}", "domain=miulab", f"domain.path={MACHINE}"]
    (folder / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump(overrides))
    return folder


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """Results of two agents, kept in a folder of their own."""
    folder = tmp_path / "results"
    monkeypatch.setattr(common, "RESULTS", folder)
    monkeypatch.setattr(common, "FIGURES", tmp_path / "figures")
    folder.mkdir()
    common.FIGURES.mkdir()
    entry = {"corpus": "miulab", "setting": "reference", "policy": "clairvoyant"}
    entries = [entry | {"result": {"success_rate": 0.9}}]
    (folder / "policies.json").write_text(json.dumps(entries))
    monkeypatch.setattr(results, "EXPERIMENTS", {FOLDER: results.EXPERIMENTS[FOLDER]})
    for name, agent, rates in (
        ("bbqn_map", "bbqn", [0.7, 0.8, 0.75, 0.72, 0.78]),
        ("dqn", "dqn", [0.5, 0.4, 0.6, 0.5, 0.5]),
    ):
        keep_result.keep(run_of(tmp_path / agent, agent, rates), folder / FOLDER / name)
    return folder


def test_nothing_of_the_machine_is_kept(kept):
    files = [file for file in kept.rglob("*") if file.is_file()]
    assert len(files) == 9
    assert not [file for file in files if MACHINE in file.read_text()]


def test_unfinished_run_is_not_kept(tmp_path):
    run = run_of(tmp_path / "run", "dqn", [0.5])
    (run / "result.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"result\.json"):
        keep_result.keep(run, tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


def test_the_best_script_is_the_one_that_was_measured_to_be(tmp_path, monkeypatch):
    rates = {"random": 0.9, "rule": 0.2, "a_script": 0.5, "another": 0.7, "clairvoyant": 0.8}
    entries = [
        {"corpus": "movie", "setting": setting, "policy": policy, "result": {"success_rate": rate}}
        for setting, policy, rate in [
            *(("reference", *item) for item in rates.items()),
            ("no error", "a_script", 0.95),
        ]
    ]
    (tmp_path / "policies.json").write_text(json.dumps(entries))
    monkeypatch.setattr(common, "RESULTS", tmp_path)
    assert BLOCKS["results.scripts"]() == (
        "In the full domain the best script, `another`, books 0.70 of the dialogues, the rule "
        "agent that spikes the buffer 0.20, and a privileged policy that reads the user's hidden "
        "goal 0.80."
    )


def test_an_experiment_is_shown_with_the_commands_that_made_it(kept):
    text = BLOCKS["results.miulab"]()
    assert "| BBQN-MAP | thompson | 5 | 2 | 0.750 [" in text
    assert "| BBQN-MAP minus DQN | 5 | +0.250 [" in text
    assert "python train.py agent=bbqn domain=miulab 'domain.path=<folder>'\n" in text
    assert not any(note in text for note in comparison.NOTES)


def test_two_agents_are_compared_by_pairs(kept):
    rows = {"the corpus": [f"{FOLDER}/bbqn_map", f"{FOLDER}/dqn"], "another": ["a", "b"]}
    text = results.compared(rows, ["on", "one", "other"])
    head, _, line = text.splitlines()  # the other one was not run
    assert head == (
        "| on | one | other | difference | of the first 1,000 dialogues | of all training |"
    )
    assert line.startswith("| the corpus | 0.750 [")
    assert line.endswith("| +0.250 [+0.131, +0.369] | – | +0.125 [+0.065, +0.185] |")


def test_claims_are_judged_by_what_is_there_and_the_rest_is_not_run(kept):
    lines = BLOCKS["results.claims"]().splitlines()[2:]
    ends, learns, *rest = lines
    where = "| Full domain, MiuLab's corpus | yes |"
    assert ends.startswith(f"| BBQN-MAP ends higher than DQN {where} +0.250 [")
    assert learns.startswith(f"| BBQN-MAP books more in training than DQN {where} +0.125 [")
    assert len(rest) > 20
    early = "first 1,000 dialogues than DQN | Full domain, MiuLab's"  # of runs that are too short
    assert all(f"| not {'paired' if early in line else 'run'} | – | – |" in line for line in rest)
    assert any(line.endswith("| +0.234 |") for line in rest)  # the paper's .5031 less .2693


def test_table1_is_made_of_what_is_kept_of_it(kept, tmp_path):
    keep_result.keep(tmp_path / "dqn", kept / "table1" / "full" / "dqn" / "seed0")
    text = BLOCKS["results.table1"]()
    assert text.startswith("Not run: BBQN-MAP with env=full; ")
    assert "DQN with env=full;" not in text
    assert "| DQN | 5 | 2 | 0.500 [" in text
    assert text.count("python train.py") == 1
    assert "table1_full.png" in text
    assert "table1_domain_ext.png" not in text
    results.draw_figures()
    drawn = sorted(file.name for file in common.FIGURES.iterdir())
    assert drawn == ["miulab.png", "table1_full.png"]
    lines = (kept / "table1.csv").read_text().splitlines()
    assert len(lines) == 6
    assert lines[1] == "movie,full,DQN,0,0,2,,0.5,10.0,8.0,0.25,"


def test_every_measurement_of_a_policy_is_a_command(tmp_path):
    for overrides in {*measure_policies.MEASUREMENTS.values()}:
        given = overrides.replace(measure_policies.PLACE, str(tmp_path)).split()
        assert compose(["policy=rule", *given], EvaluateConfig).dialogues >= 20_000


def test_every_public_number_has_a_measurement_beside_it():
    measured = {key[1:] for key in measure_policies.MEASUREMENTS if key[0] == "miulab"}
    public = common.read_csv("public_simulator.csv")
    assert {(line["setting"], line["policy"]) for line in public} <= measured
