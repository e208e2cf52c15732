import re
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from bbq_torchrl.people.language import Frame, Generator, PhrasesError, Unclear, Understood
from bbq_torchrl.people.language.corpus import make_examples, play

UNFIT = yaml.safe_load(Path(__file__).with_name("phrases.yaml").read_text("utf-8"))
SPOILT = re.compile(r"[{}<>\[\]|]|[a-z]_[a-z]|moviename|starttime|numberof|taskcomplete|mc_list")


@pytest.mark.parametrize(
    ("dialogues", "kept", "variants", "every"),
    [(20, 100, 40, 26), pytest.param(10_000, 500, 60, 1, marks=pytest.mark.slow)],
)
def test_every_act_of_dialogues_has_enough_sentences_without_placeholders(
    mouth, movie, dialogues, kept, variants, every
):
    """Of acts with the same slots one turn is spoken, by either side."""
    turns = play(movie, dialogues, kept=kept)
    acts = {
        tuple((f.act, *f.informs, *f.requests) if f else () for f in turn): turn for turn in turns
    }
    for agent, user in list(acts.values())[::every]:
        said = {mouth.user(user, agent, session=session) for session in range(variants)}
        assert len(said) >= 8, (user, said)
        if agent is not None:
            told = {mouth.agent(agent, user.informs, session=n) for n in range(variants)}
            assert len(told) >= 4, (agent, told)
            said |= told
        for sentence in said:
            assert sentence.strip(" .?!"), user
            assert not SPOILT.search(sentence), sentence


def test_equal_sessions_say_equal_things_and_others_differ(mouth):
    frame = Frame("request", {"city": "reno"}, ("theater",))
    first = [mouth.user(frame, session=s, turn=t) for s in range(5) for t in (0, 2)]
    assert first == [mouth.user(frame, session=s, turn=t) for s in range(5) for t in (0, 2)]
    assert len(set(first)) > 5


@pytest.mark.parametrize(("slot", "value"), [("starttime", "after 10pm"), ("date", "tomorrow")])
def test_a_value_with_its_own_preposition_is_given_no_other(mouth, slot, value):
    said = {mouth.agent(Frame("inform", {slot: value}), session=n) for n in range(50)}
    assert all(re.search(f"(?<!at )(?<!on ){value}", text) for text in said)
    assert len(said) >= 4


def test_no_match_names_the_wishes_that_clash(movie):
    here = {"moviename": "wonka", "theater": "the roxy", "city": "reno"}
    there = {"moviename": "wonka", "theater": "the odeon", "city": "boise"}
    speak = Generator(replace(movie, records=(here, there)))
    wishes = here | {"city": "boise"}
    assert set(speak.conflict(wishes)) == {"theater", "city"}
    text = speak.agent(Frame("inform", {"starttime": "no match"}), wishes).lower()
    assert [name in text for name in ("the roxy", "boise", "wonka")] == [True, True, False]
    assert speak.conflict(here | {"numberofpeople": "9", "state": "I do not care"}) == ()


def test_a_domain_without_phrases_speaks_by_generic_ones(restaurant):
    speak = Generator(restaurant)
    assert "party size" in speak.agent(Frame("request", {}, ("party_size",)))
    for slot in ("cuisine", "area"):
        value = next(record[slot] for record in restaurant.records if slot in record)
        said = {speak.user(Frame("inform", {slot: value}), session=s) for s in range(20)}
        assert len(said) >= 8
        assert all(value.lower() in text.lower() for text in said)
    frame = Frame("request", {}, ("cuisine", "area"))
    asked = {speak.user(frame, session=s).lower() for s in range(60)}
    assert all("cuisine" in text and "area" in text for text in asked)
    assert len(asked) > 40


def test_no_sentence_of_the_grammar_tells_what_it_asks_for(lexicon):
    for example in make_examples(lexicon, 500, seed=0):
        assert set(example.frame.requests).isdisjoint(example.frame.informs), example


def test_an_opening_of_which_each_phrase_needs_a_value_is_said_where_there_is_one(movie, tmp_path):
    (tmp_path / "language.yaml").write_text('user: {open: ["find me {city}"]}')
    speak = Generator(replace(movie, folder=tmp_path))
    for informs in ({"city": "reno"}, {"genre": "comedy"}, {"theater": "amc san jose 10"}):
        said = [speak.user(Frame("inform", informs), session=n).lower() for n in range(20)]
        assert all(value in text for text in said for value in informs.values())
        assert any("find me reno" in text for text in said) == ("city" in informs)


def test_what_was_without_a_match_is_corrected_by_that(mouth):
    agent, user = Frame("inform", {"date": "no match"}), Frame("inform", {"date": "friday"})
    said = {mouth.user(user, agent, session=session).lower() for session in range(200)}
    assert not any("no match" in sentence for sentence in said)
    assert any("not that" in sentence for sentence in said)


@pytest.mark.parametrize("row", [*UNFIT, {"key": "YAML", "content": "\0"}])
def test_phrases_that_do_not_fit_are_refused_by_their_key(movie, tmp_path, row):
    (tmp_path / "language.yaml").write_text(row["content"])
    with pytest.raises(PhrasesError, match=re.escape(row["key"])):
        Generator(replace(movie, folder=tmp_path))


def test_what_is_unclear_is_asked_about_by_its_words(mouth):
    several = Unclear("moviename", "godzilla", ("godzilla minus one", "godzilla x kong"))
    text = mouth.clarify(Understood(Frame("inform"), 0.9, (several,)))
    assert "Godzilla Minus One or Godzilla X Kong" in text
    unknown = Unclear("moviename", "casablanca")
    assert "casablanca" in mouth.clarify(Understood(Frame("inform"), 0.9, (unknown,))).lower()
    again = {mouth.clarify(Understood(Frame("inform"), 0.1), session=s) for s in range(20)}
    assert len(again) >= 4


def test_agents_write_an_before_a_vowel(movie, tmp_path):
    text = 'agent: {welcome: ["you have a e-bike, A Urban, a one-way and a unit."]}'
    (tmp_path / "language.yaml").write_text(text)
    said = Generator(replace(movie, folder=tmp_path)).agent(Frame("welcome"))
    assert said == "You have an e-bike, An Urban, a one-way and a unit."


def test_agents_write_names_as_titles_and_one_in_the_singular(mouth):
    wishes = {"moviename": "dune: part two", "state": "wa", "numberofpeople": "1"}
    texts = [mouth.say("understood", values=wishes, session=session) for session in range(20)]
    assert all("Dune: Part Two" in text and "WA" in text for text in texts)
    assert not any(re.search("1 (people|tickets)", text) for text in texts)
    assert any(re.search("1 (person|ticket)", text) for text in texts)


def test_a_list_says_beside_each_choice_what_goes_with_it(mouth):
    beside = ({"theater": "regal reno 12"}, {})
    text = mouth.say("several", ["starttime"], choices=("7 pm", "9 pm"), beside=beside)
    assert "7 pm (" in text
    assert "Regal Reno 12) or 9 pm" in text
