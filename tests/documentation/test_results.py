"""The files kept of a run, and the tables made of them."""

import lzma

import pytest
import yaml
from result_folders import make_run

from bbq_torchrl.options import EvaluateConfig
from bbq_torchrl.runs.compose import compose
from scripts import keep_result, measure_policies
from scripts.docs_blocks import common, results

MACHINE = "/home/somebody/corpus"


def test_nothing_of_the_machine_is_kept(tmp_path):
    corpus = {"domain.name": "miulab", "domain.path": MACHINE, "resume": MACHINE}
    run = make_run(tmp_path / "run", [0.7, 0.8], changes=corpus)
    (run / ".hydra").mkdir()
    overrides = ["agent=bbqn", "domain=miulab", f"domain.path={MACHINE}"]
    (run / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump(overrides))

    keep_result.keep(run, tmp_path / "kept", "full/bbqn")

    files = [*(tmp_path / "kept").iterdir()]
    assert len(files) == 2
    for file in files:
        content = file.read_bytes()
        text = lzma.decompress(content) if file.suffix == ".xz" else content
        assert MACHINE.encode() not in text
        assert b"seconds" not in text.partition(b"\n")[0]


@pytest.mark.slow
def test_the_kept_comparisons_are_those_of_the_kept_runs(tmp_path, monkeypatch):
    kept = (common.RESULTS / "comparisons.csv").read_text(encoding="utf-8")
    found = [*results.claims()]
    monkeypatch.setattr(results, "claims", lambda: found)
    monkeypatch.setattr(common, "RESULTS", tmp_path)
    results.write_claims()
    assert (tmp_path / "comparisons.csv").read_text(encoding="utf-8") == kept


@pytest.mark.slow
def test_every_measurement_of_a_policy_is_a_command(tmp_path):
    for overrides in {*measure_policies.MEASUREMENTS.values()}:
        given = overrides.replace(measure_policies.PLACE, str(tmp_path)).split()
        assert compose(["policy=rule", *given], EvaluateConfig).dialogues >= 20_000


def test_every_public_number_has_a_measurement_beside_it():
    measured = {key[1:] for key in measure_policies.MEASUREMENTS if key[0] == "miulab"}
    public = common.read_csv("public_simulator.csv")
    assert {(line["setting"], line["policy"]) for line in public} <= measured
