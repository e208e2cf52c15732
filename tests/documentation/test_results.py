"""The files kept of a run, and the tables made of them."""

import lzma

import pytest
import yaml
from result_folders import make_run
from scipy import stats

from bbq_torchrl.options import EvaluateConfig
from bbq_torchrl.runs.compose import compose
from scripts import keep_result, measure_policies
from scripts.docs_blocks import BLOCKS, common, results

MACHINE = "/home/somebody/corpus"
RATES = {"bbqn": [0.7, 0.8, 0.75, 0.72, 0.78], "dqn": [0.5, 0.4, 0.6, 0.5, 0.5]}


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
    for agent, rates in RATES.items():
        run = run_of(tmp_path / agent, agent, rates)
        for experiment in ("miulab", "table1"):
            keep_result.keep(run, folder / experiment, f"full/{agent}")
    return folder


def test_nothing_of_the_machine_is_kept(kept):
    files = [file for file in kept.rglob("*") if file.is_file()]
    assert len(files) == 4
    for file in files:
        content = file.read_bytes()
        text = lzma.decompress(content) if file.suffix == ".xz" else content
        assert MACHINE.encode() not in text
        assert b"seconds" not in text.partition(b"\n")[0]


def test_an_experiment_is_shown_with_a_command_that_made_it(kept):
    text = BLOCKS["results.miulab"]()
    assert "| BBQN-MAP | 0.750 [" in text
    assert text.splitlines()[3].endswith("| +0.250 [+0.131, +0.369] |")
    assert "`python train.py agent=bbqn domain=miulab 'domain.path=<folder>'`" in text
    table1 = BLOCKS["results.table1"]()
    assert "| DQN | 0.2693 | – | – | – | – | 0.500 [" in table1


def test_two_agents_are_compared_by_pairs(kept):
    rows = {"the corpus": ["miulab/full/bbqn", "miulab/full/dqn"], "another": ["a", "b"]}
    head, _, line = results.compared(rows, ["on", "one", "other"]).splitlines()
    assert head == "| on: one minus other | end | first 1,000 | all of training |"
    assert line == "| the corpus | +0.250 [+0.131, +0.369] | – | +0.125 [+0.065, +0.185] |"


def test_claims_are_judged_by_what_is_there(kept):
    found = {claim.quantity: claim for claim in results.claims()}
    assert {*found} == {"end", "all of training"}  # the runs are too short for the other
    end = found["end"]
    assert (end.one, end.other, end.verdict, end.paper) == ("BBQN-MAP", "DQN", "yes", "+0.234")
    raw = stats.ttest_rel(*RATES.values()).pvalue
    assert end.p == pytest.approx(8 * raw)  # for all that were declared
    results.write_claims()
    assert (kept / "comparisons.csv").read_text().count("\n") == 3
    assert "| Table 1, full domain | 2 | 0 | 0 |" in BLOCKS["results.claims"]()


@pytest.mark.slow
def test_every_measurement_of_a_policy_is_a_command(tmp_path):
    for overrides in {*measure_policies.MEASUREMENTS.values()}:
        given = overrides.replace(measure_policies.PLACE, str(tmp_path)).split()
        assert compose(["policy=rule", *given], EvaluateConfig).dialogues >= 20_000


def test_every_public_number_has_a_measurement_beside_it():
    measured = {key[1:] for key in measure_policies.MEASUREMENTS if key[0] == "miulab"}
    public = common.read_csv("public_simulator.csv")
    assert {(line["setting"], line["policy"]) for line in public} <= measured
