"""Checks of machine and domain before anything runs, and what readers are told of a domain."""

import json
import logging
import pickle
import shutil
from dataclasses import replace

import pytest
from tiny import TINY, composed, without_drawing

from bbq_torchrl.cli import evaluate
from bbq_torchrl.evaluation.run_result import read_result
from bbq_torchrl.runs import build
from bbq_torchrl.runs.build import find_spike_policy, make_domain
from bbq_torchrl.runs.train import run
from bbq_torchrl.settings import ConfigError


@pytest.fixture
def where(restaurant_folder, tmp_path):
    """A domain whose rule needs a slot that comes later."""
    folder = shutil.copytree(restaurant_folder, tmp_path / "domain")
    file = folder / "domain.yaml"
    script = "steps: [request(cuisine), "
    file.write_text(file.read_text().replace(script, f"{script}request(price_range), "))
    return "domain=folder", f"domain.path={folder}"


def test_a_result_says_which_policy_it_lacks_whose_slot_has_not_come(where, tmp_path, caplog):
    config = composed(*TINY, *where, "env=domain_ext", "spike.policy=careful", "protocol.rounds=1")
    with caplog.at_level(logging.WARNING):
        result = run(config, tmp_path / "run")
    assert {"careful", "random"} <= result.scripted.keys()
    assert "rule" not in result.scripted
    assert any("left out of the result: policy rule" in told for told in caplog.messages)


@pytest.fixture
def never(restaurant_folder, tmp_path):
    """Makes a domain whose first scripts forget to offer a booking."""

    def with_scripts(*names, rest=""):
        folder = shutil.copytree(restaurant_folder, tmp_path / "domain")
        head = (folder / "domain.yaml").read_text().partition("policies:\n")[0]
        forgetful = "".join(
            f"  {name}: {{kind: script, steps: [request(cuisine), thanks]}}\n" for name in names
        )
        (folder / "domain.yaml").write_text(f"{head}policies:\n{forgetful}{rest}")
        return "domain=folder", f"domain.path={folder}", "env.slot_error_prob=0"

    return with_scripts


SHORT = [item for item in TINY if not item.startswith(("spike", "env.max_turn"))]


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Scripts are tried in few dialogues."""
    monkeypatch.setattr(build, "TRIED", 100)


def spiking(config):
    return find_spike_policy(config, make_domain(config))


@pytest.mark.parametrize(("spike", "expected"), [("default", "early"), ("best", "careful")])
def test_a_script_that_succeeds_spikes_the_first_or_the_best(never, caplog, spike, expected):
    early = "  early: {kind: careful, steps: [cuisine, area]}\n"
    careful = "  careful: {kind: careful, steps: [cuisine, area, day, hour, party_size]}\n"
    where = never("rule", "second", rest=early + careful + early.replace("early", "later"))
    choice = () if spike == "default" else (f"spike={spike}",)
    with caplog.at_level(logging.INFO):
        config = composed(*SHORT, *where, *choice)
        found = {spiking(replace(config, seed=seed)) for seed in (0, 1)}
    assert found == {expected}
    assert any(expected in text for text in caplog.messages)


def test_a_domain_none_of_whose_scripts_succeeds_is_refused_with_the_way_out(never):
    where = never("rule", "second")
    with pytest.raises(ConfigError, match="spike=none"):
        spiking(composed(*where))
    assert spiking(composed(*where, "spike=none")) is None


def test_a_script_of_a_later_round_is_passed_over(where):
    config = composed(*where, "env=domain_ext")
    assert spiking(config) == "careful"


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
