"""Which script spikes, and what readers are told of a domain and its policies."""

import json
import logging
import pickle
from dataclasses import replace

import pytest
from tiny import TINY, composed, without_drawing

from bbq_torchrl.cli import evaluate
from bbq_torchrl.domains import ScriptedPolicySpec
from bbq_torchrl.evaluation.run_result import read_result
from bbq_torchrl.runs import build
from bbq_torchrl.runs.build import find_spike_policy
from bbq_torchrl.runs.train import run
from bbq_torchrl.settings import ConfigError

FORGETFUL = ScriptedPolicySpec("script", ("request(cuisine)", "thanks"))
EARLY = ScriptedPolicySpec("careful", ("cuisine", "area"))
CAREFUL = ScriptedPolicySpec("careful", ("cuisine", "area", "day", "hour", "party_size"))


@pytest.fixture
def spiking(restaurant, monkeypatch):
    """The policy that spikes among some of the restaurants, of which few dialogues are tried."""
    monkeypatch.setattr(build, "TRIED", 100)

    def found(policies, *choices):
        config = composed("env.slot_error_prob=0", *choices)
        return find_spike_policy(config, replace(restaurant, policies=policies))

    return found


@pytest.mark.parametrize(("choices", "expected"), [([], "early"), (["spike=best"], "careful")])
def test_a_script_that_succeeds_spikes_the_first_or_the_best(spiking, caplog, choices, expected):
    policies = {"rule": FORGETFUL, "early": EARLY, "careful": CAREFUL, "later": EARLY}
    with caplog.at_level(logging.INFO):
        assert {spiking(policies, *choices, f"seed={seed}") for seed in (0, 1)} == {expected}
    assert any(expected in text for text in caplog.messages)


def test_a_domain_none_of_whose_scripts_succeeds_is_refused_with_the_way_out(spiking):
    with pytest.raises(ConfigError, match="spike=none"):
        spiking({"rule": FORGETFUL})
    assert spiking({"rule": FORGETFUL}, "spike=none") is None


def test_a_script_of_a_later_round_is_passed_over_and_not_in_the_result(
    spiking, restaurant, tmp_path, monkeypatch, caplog
):
    late = ScriptedPolicySpec("script", ("request(price_range)", "thanks"))
    policies = {"rule": late, "careful": CAREFUL}
    assert spiking(policies, "env=domain_ext") == "careful"
    config = composed(*TINY, "env=domain_ext", "spike.policy=careful", "protocol.rounds=1")
    domain = replace(restaurant, policies=policies)
    monkeypatch.setattr(type(config.domain), "make", lambda self: domain)
    assert run(config, tmp_path / "run").scripted.keys() == {"careful", "random"}
    assert "price_range" in caplog.text  # it is told why


def test_what_of_a_corpus_is_left_out_is_told(tmp_path, caplog, capsys):
    corpus = tmp_path / "corpus"
    corpus.mkdir()
    goal = {"diaact": "request", "inform_slots": {"city": "seattle"}, "request_slots": {}}
    both = goal | {"request_slots": {"city": "UNK"}}
    for name, content in (
        ("goals.p", [both, goal, both]),
        ("movie_kb.1k.p", {0: {"city": "seattle"}, 1: {"city": "boston"}}),
        ("dicts.v3.p", {"city": ["seattle", "boston"]}),
    ):
        (corpus / name).write_bytes(pickle.dumps(content, 0))
    of = ["domain=miulab", f"domain.path={corpus}", "domain.goals=goals.p"]
    with caplog.at_level(logging.WARNING), without_drawing():
        run(composed(*TINY, "agent=dqn", "protocol.rounds=1", *of), tmp_path / "run")
    (text,) = read_result(tmp_path / "run").skipped
    assert text.startswith("goals.p, goals 0, 2: ")
    assert any(text in told for told in caplog.messages)
    assert evaluate.main(["policy=rule", "dialogues=10", *of]) == 0
    assert json.loads(capsys.readouterr().out)["skipped"] == [text]
