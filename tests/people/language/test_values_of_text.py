import pytest
from tables import rows

from bbq_torchrl.people.language.quantities import READERS
from bbq_torchrl.people.language.words import tokenize


@pytest.mark.parametrize(("kind", "text", "key"), rows(__file__, "quantities.txt"))
def test_a_quantity_has_one_key(kind, text, key):
    assert READERS[kind](text) == (key or None)


@pytest.mark.parametrize("text", ["", "7" * 400], ids=["empty", "long"])
def test_nothing_and_a_number_without_end_are_no_quantity(text):
    assert {read(text) for read in READERS.values()} == {None}


@pytest.mark.parametrize(("slot", "text", "values"), rows(__file__, "names.txt"))
def test_a_name_is_linked_to_the_value_it_means(lexicon, slot, text, values):
    assert ", ".join(lexicon.link(slot, text).values) == values


def test_every_value_means_itself_in_the_most_frequent_spelling(lexicon):
    for slot in lexicon.slots:
        for value in lexicon.values(slot)[::7]:
            assert lexicon.link(slot, value).values == (lexicon.respell(slot, value),)
    assert lexicon.link("numberofpeople", "two").values == ("2",)


def test_a_count_after_x_is_a_word_of_its_own():
    assert tokenize("elvis x9?") == ["elvis", "x", "9", "?"]
    assert tokenize("X-Men x12 x2y max 2x") == ["x", "-", "men", "x", "12", "x2y", "max", "2x"]
