"""Agents that come with the package load as runs do, and are what was trained."""

import pytest
import yaml
from tiny import nightly

from bbq_torchrl.cli import evaluate
from bbq_torchrl.evaluation.run_result import read_result
from bbq_torchrl.runs import folders


@pytest.mark.parametrize("name", nightly(folders.shipped_agents(), ["bbqn_map"]))
def test_a_shipped_agent_does_what_its_result_says(name):
    given = (f"policy=shipped:{name}", "dialogues=500", "batch=500")
    line = evaluate.evaluation(evaluate.composed(given))
    result = read_result(folders.SHIPPED / name)
    assert result.replicas == 1
    # five standard errors of a difference of two rates
    assert line["success_rate"] == pytest.approx(result.success_rate, abs=0.11)
    assert line["mode"] == result.policy


def test_shipped_agents_are_small_files_without_a_path_of_a_machine():
    files = [file for file in folders.SHIPPED.rglob("*") if file.is_file()]
    assert sum(file.stat().st_size for file in files) < 3_500_000
    for name in folders.shipped_agents():
        config = yaml.safe_load((folders.SHIPPED / name / "config.yaml").read_text())
        assert config["domain"].get("path") is None
        assert (folders.SHIPPED / name / "overrides.yaml").is_file()
