"""Agents that come with the package load as runs do, and are what was trained."""

import json

import forked
import pytest
import torch
import yaml
from planted import rewritten
from tiny import nightly
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl import load_run
from bbq_torchrl.cli import evaluate
from bbq_torchrl.evaluation.run_result import read_result
from bbq_torchrl.runs import folders
from scripts import ship_agent


def evaluated(*given):
    return evaluate.evaluation(evaluate.composed(given))


@pytest.mark.parametrize("name", nightly(folders.shipped_agents(), ["bbqn_map"]))
def test_a_shipped_agent_does_what_its_result_says(name):
    line = evaluated(f"policy=shipped:{name}", "dialogues=500", "batch=500")
    result = read_result(folders.SHIPPED / name)
    assert result.replicas == 1
    # five standard errors of a difference of two rates
    assert line["success_rate"] == pytest.approx(result.success_rate, abs=0.11)
    assert line["mode"] == result.policy


@pytest.mark.slow
def test_nothing_but_the_result_is_printed_of_weights_saved_with_other_versions(
    finished, copy, tmp_path
):
    def older(members):
        manifest = json.loads(members["manifest.json"])
        manifest["versions"] = dict.fromkeys(manifest["versions"], "0.0.1")
        members["manifest.json"] = json.dumps(manifest).encode()

    (saved,) = (copy(finished) / "checkpoint").iterdir()
    rewritten(saved, older)
    evaluate_it = ("evaluate", f"policy={tmp_path / 'run'}", "dialogues=4")
    out, error = forked.python("-m", "bbq_torchrl.cli.console", *evaluate_it, cwd=tmp_path)
    assert json.loads(out)["dialogues"] == 4
    assert error.startswith("result.json has ")
    assert error.count("\n") == 1


def test_a_key_of_the_environment_changes_the_runs_own():
    line = evaluated("policy=shipped:dqn_before", "env.max_turn=2", "dialogues=20", "batch=20")
    assert (line["env"], line["turns"]) == ("domain_ext", 2)
    chosen = evaluated("policy=shipped:dqn_before", "env=full", "dialogues=20", "batch=20")
    assert chosen["env"] == "full"


def test_the_six_agents_of_the_papers_human_evaluation_and_the_imitating_one_are_shipped():
    found = {name: read_result(folders.SHIPPED / name) for name in folders.shipped_agents()}
    given = {"": (150, "full"), "_before": (40, "domain_ext"), "_after": (200, "domain_ext")}
    assert {name: (result.rounds, result.env) for name, result in found.items()} == {
        f"{agent}{when}": given[when] for agent in ("bbqn_map", "dqn") for when in given
    } | {"bbqn_imitate": (40, "full")}


def test_an_agent_of_before_the_extension_knows_the_essential_slots_alone():
    def known(name):
        env = load_run(name)[0]
        return {env.domain.slots[slot] for slot in env.active_slots.nonzero().flatten().tolist()}

    domain = load_run("shipped:dqn")[0].domain
    assert known("shipped:dqn_before") == set(domain.essential)
    assert known("shipped:dqn_after") == {*domain.essential, *domain.extension_order}


def test_shipped_agents_are_small_files_without_a_path_of_a_machine():
    files = [file for file in folders.SHIPPED.rglob("*") if file.is_file()]
    assert sum(file.stat().st_size for file in files) < 3_500_000
    for name in folders.shipped_agents():
        config = yaml.safe_load((folders.SHIPPED / name / "config.yaml").read_text())
        assert config["domain"].get("path") is None
        assert (folders.SHIPPED / name / "overrides.yaml").is_file()


def test_what_is_shipped_is_one_replica_of_the_run(commanded, tmp_path, monkeypatch):
    monkeypatch.setattr(folders, "SHIPPED", tmp_path)
    ship_agent.ship(commanded, tmp_path / "second", replica=1)
    env, policy, config, mode = load_run("shipped:second", dialogues=4)
    assert (config.replicas, mode, env.batch_size) == (1, "mean", torch.Size([1, 4]))
    whole_env, whole, _, _ = load_run(commanded, dialogues=4)
    rows = whole_env.reset()
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        expected = whole(rows.clone())["action_value"][1:2]
        found = policy(rows[1:2].clone())["action_value"]
    assert torch.allclose(found, expected, atol=0.02)
    assert not torch.allclose(found, whole(rows.clone())["action_value"][:1], atol=0.02)
