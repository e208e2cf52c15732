import random
from dataclasses import replace
from pathlib import Path

import pytest
from tables import rows

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.people.language import Frame, Understander, read_lines
from bbq_torchrl.people.language.__main__ import calibration_error, calibration_floor
from bbq_torchrl.people.language.asking import FOREIGN, OPENING
from bbq_torchrl.people.language.corpus import make_examples
from bbq_torchrl.people.language.sentence_features import Features
from bbq_torchrl.people.language.training_lines import Names, as_examples, make_foreign, varied
from bbq_torchrl.people.language.understander import cached_understander
from bbq_torchrl.people.language.words import ENGLISH
from bbq_torchrl.utils.text import FaultsError

DATA = Path(__file__).parents[2] / "data" / "language"


def test_the_sentences_that_measure_are_labeled_with_values_of_the_domain(lexicon):
    for voice in ("terse", "chatty", "nonnative"):
        lines = read_lines(DATA / f"{voice}.txt", movie_domain())
        assert len(lines) == 100
        for _, _, frame in lines:
            for slot, value in frame.informs.items():
                assert value == "I do not care" or value in lexicon.values(slot)


def test_features_tell_quantities_and_classes_and_have_slots_for_values(lexicon):
    words = ["want", "wonka", "on", "4/6", "at", "half", "past", "seven"]
    features = Features(lexicon, words)
    of_words = dict(zip(words, map(set, features.of_words(words, OPENING)), strict=True))
    assert {"c=date", "date:B", "1:w=at"} <= of_words["4/6"]
    assert {"-1:date:B", "2:w=past"} <= of_words["at"]
    assert {"time:I", "-1:time:B"} <= of_words["past"]
    tags = ["-", "moviename", "-", "date", "-", *["starttime"] * 3]
    of_sentence = features.of_sentence(words, tags, OPENING)
    assert {"2=<moviename>_on", "3=at_<starttime>_$", "S=date"} <= {*of_sentence}
    assert not {"1=wonka", "1=half", "1=past"} & {*of_sentence}


@pytest.mark.parametrize(("text", "meaning", "tags"), rows(__file__, "lines.txt"))
def test_own_lines_become_examples_with_the_place_of_each_value(
    lexicon, tmp_path, text, meaning, tags
):
    path = tmp_path / "own.txt"
    path.write_text(f"# mine\n | {text} | {meaning}\n")
    (example,) = as_examples(read_lines(path, movie_domain()), lexicon)
    assert " ".join(example.tags) == tags
    assert "?" not in str(example.frame)  # a name that the domain lacks, learned by its place


def test_what_chance_alone_gives_a_calibration_error_is_told():
    few, many = [0.5] * 50, [0.5] * 5000
    assert calibration_error(few, [True] * 50) == calibration_error(many, [True] * 5000) == 0.5
    assert 0.04 < calibration_floor(few) < 0.075  # sqrt(2 / pi) / 2 / sqrt(50) = 0.056
    assert calibration_floor(many) < 0.008


def test_both_files_of_lines_in_a_domains_folder_are_learned(understand, tmp_path):
    question = Frame("request", {}, ("city",))
    sentences = {"learned.txt": "flibber flobber", "drilled.txt": "wozzle wizzle"}
    for name, sentence in sentences.items():
        (tmp_path / name).write_text(f"request(city) | {sentence} | closing\n" * 60)
    taught = Understander.train(replace(movie_domain(), folder=tmp_path), sentences=120)
    for sentence in sentences.values():
        assert understand(sentence, question).frame.act != "closing"
        assert taught(sentence, question).frame == Frame("closing")


def test_a_line_is_learned_with_other_values_as_well(lexicon):
    meant = Frame.parse("request(ticket) inform(moviename=wonka, city=reno, date=tonight)")
    examples = as_examples([(None, "is wonka on in reno tonight", meant)], lexicon)
    found = varied(examples, lexicon, lambda slot, value, rng: value, copies=20, seed=0)
    cities, made_up = set(), 0
    for example in found:
        tagged = list(zip(example.words, example.tags, strict=True))
        assert [word for word, tag in tagged if tag == "-"] == ["is", "on", "in"]
        city = " ".join(word for word, tag in tagged if tag == "city")
        made_up += not lexicon.link("city", city).is_exact
        cities.add(city)
    assert len(cities) > 10
    assert 2 <= made_up <= 15  # of 20 copies with two in five made up


def test_no_made_up_name_is_that_of_a_value(lexicon):
    names, rng = Names(lexicon), random.Random(0)
    for slot in lexicon.slots:
        made = [" ".join(names.made_up(slot, rng)) for _ in range(40)]
        if lexicon.kinds[slot] != "text":
            assert set(made) == {""}
            continue
        assert sum(map(bool, made)) >= 30
        assert not any(lexicon.link(slot, name).is_exact for name in filter(None, made))


def test_foreign_sentences_open_a_dialogue_or_answer(lexicon):
    said = make_examples(lexicon, 50, 0)
    made = make_foreign(lexicon, said, 200, 0)
    assert all(example.frame == FOREIGN for example in made)
    assert any(example.question == OPENING for example in made)
    assert any(example.question != OPENING for example in made)


def test_no_sentence_of_the_sets_was_learned():
    own = " | ".join([*ENGLISH["foreign"], (movie_domain().folder / "language.yaml").read_text()])
    for name in ("out_of_scope", "out_of_scope_dev"):
        for _, text in rows(DATA / "limits" / "any", f"{name}.txt"):
            assert text.lower() not in own.lower()


def test_own_lines_that_are_not_there_are_missed_though_an_understander_is_kept(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(Understander, "load", lambda path, domain: "kept")
    assert cached_understander(movie_domain()) == "kept"
    with pytest.raises(FileNotFoundError, match=r"gone\.txt"):
        cached_understander(movie_domain(), tmp_path / "gone.txt")


def test_without_a_home_folder_an_understander_is_trained_and_not_kept(
    understand, tmp_path, monkeypatch
):
    def unknown(_):
        raise KeyError("getpwuid(): uid not found: 12345")

    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HOME")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr("pwd.getpwuid", unknown)
    monkeypatch.setattr(Understander, "train", lambda *_, **__: understand)
    for _ in range(2):
        assert cached_understander(movie_domain()) is understand
    assert not list(tmp_path.iterdir())


def test_lines_that_cannot_be_read_are_all_named(tmp_path):
    path = tmp_path / "own.txt"
    path.write_text("hello\n | hi | greets\n | hi | inform(town=reno)\n |  | greeting\n")
    with pytest.raises(FaultsError) as caught:
        read_lines(path, movie_domain())
    lines = [fault[:6] for fault in caught.value.faults]
    assert lines == ["line 1", "line 2", "line 3", "line 4"]


@pytest.mark.parametrize("text", ["", "(", "inform(city)", "request(city=reno)", "inform(a=1", "!"])
def test_a_frame_that_is_written_otherwise_is_refused(text):
    with pytest.raises(ValueError, match="a frame"):
        Frame.parse(text)
