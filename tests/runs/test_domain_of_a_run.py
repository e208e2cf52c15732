"""The domain of a run, as its readers are told."""

import json
import logging
import pickle
import shutil

import pytest
from tiny import TINY

from bbq_torchrl.cli import evaluate
from bbq_torchrl.evaluation.run_result import read_result
from bbq_torchrl.runs import final
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import run


@pytest.fixture
def played(tmp_path, monkeypatch):
    """Runs a configuration; returns its result and the titles of its curves."""
    titles = []
    monkeypatch.setattr(final, "draw_run", lambda *_, title, **__: titles.append(title))

    def play(*overrides):
        run(compose([*TINY, "agent=dqn", "protocol.rounds=1", *overrides]), tmp_path)
        return read_result(tmp_path), titles

    return play


def test_results_and_curves_bear_the_name_of_domain_yaml(played, restaurant_folder):
    result, titles = played("domain=folder", f"domain.path={restaurant_folder}")
    assert result.domain == "restaurant"
    assert result.skipped == ()
    assert [title.endswith("domain=restaurant") for title in titles] == [True]


def test_a_result_says_what_of_a_corpus_was_left_out(played, tcbot, tmp_path_factory, caplog):
    corpus = tmp_path_factory.mktemp("corpus")
    for name in ("movie_kb.1k.p", "dicts.v3.p"):
        shutil.copyfile(tcbot / name, corpus / name)
    goal = {"diaact": "request", "inform_slots": {"city": "seattle"}, "request_slots": {}}
    both = goal | {"request_slots": {"city": "UNK"}}
    (corpus / "goals.p").write_bytes(pickle.dumps([both, goal, both], 0))
    with caplog.at_level(logging.WARNING):
        result, _ = played("domain=miulab", f"domain.path={corpus}", "domain.goals=goals.p")
    (text,) = result.skipped
    assert text.startswith("goals.p, goals 0, 2: ")
    assert any(text in told for told in caplog.messages)


def test_whoever_trains_or_evaluates_is_told_of_values_that_never_match(
    played, tmp_path_factory, caplog, capsys
):
    corpus = tmp_path_factory.mktemp("corpus")
    goal = {"diaact": "request", "inform_slots": {"city": "seattle"}, "request_slots": {}}
    for name, content in (
        ("user_goals_first_turn_template.v2.p", [goal]),
        ("movie_kb.1k.p", {0: {"city": "seattle "}, 1: {"city": "boston"}}),
        ("dicts.v3.p", {"city": ["seattle", "boston"]}),
    ):
        (corpus / name).write_bytes(pickle.dumps(content, 0))
    of = ["domain=miulab", f"domain.path={corpus}"]
    with caplog.at_level(logging.WARNING):
        result, _ = played(*of)
    doubt = "city = 'seattle ', which never matches 'seattle'"
    assert result.skipped == ()
    assert any("movie_kb.1k.p, row 0: " in text and doubt in text for text in caplog.messages)
    assert evaluate.main(["policy=rule", "dialogues=10", *of]) == 0
    (told,) = json.loads(capsys.readouterr().out)["doubts"]
    assert doubt in told


def test_the_public_corpus_is_evaluated_with_files_and_difficulty_of_choice(capsys, tcbot):
    goals = "user_goals_first_turn_template.part.movie.v1.p"
    corpus = f"domain=miulab domain.path={tcbot} domain.kb=movie_kb.1k.p domain.goals={goals}"
    errors = "env.slot_error_prob=.05 env.slot_error_mode=value env.intent_error_prob=0"
    arguments = f"policy=careful dialogues=40 batch=16 env.max_turn=40 {corpus} {errors}".split()
    assert evaluate.main(arguments) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["domain"], answer["dialogues"]) == ("miulab", 40)
    # The scripted policy succeeds in about two thirds of the dialogues at this difficulty.
    assert answer["success_rate"] > 0.2
