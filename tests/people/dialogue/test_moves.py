"""Moves made with words alone: accepting an offer, and taking wishes back."""

from pathlib import Path

import pytest
import yaml

from bbq_torchrl.people.dialogue.moves import accepts, beside_yes, says, taken_back

TEXTS = yaml.safe_load(Path(__file__).with_name("moves.yaml").read_text(encoding="utf-8"))


def heard(text, lexicon):
    return "all" if says(text, "restart") else " ".join(taken_back(text, TEXTS["held"], lexicon))


@pytest.mark.parametrize("kind", TEXTS["taken_back"])
def test_a_wish_is_taken_back_in_any_words(lexicon, kind):
    texts = TEXTS["taken_back"][kind]
    assert {text: heard(text, lexicon) for text in texts} == texts


def test_other_texts_take_nothing_back(lexicon):
    assert not [text for text in TEXTS["kept"] if heard(text, lexicon)]


def test_an_offer_is_accepted_by_a_text_that_says_nothing_else():
    assert not [text for text in TEXTS["accepted"] if not accepts(text)]
    assert not [text for text in TEXTS["not_accepted"] if accepts(text)]


@pytest.mark.parametrize("text", TEXTS["no_yes"])
def test_politeness_beside_a_wish_is_no_yes(text):
    assert beside_yes(text) is None


@pytest.mark.parametrize("text", TEXTS["yes_and_more"])
def test_a_yes_and_what_is_said_beside_it(text):
    assert beside_yes(text) == TEXTS["yes_and_more"][text]
