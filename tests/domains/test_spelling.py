"""Values that look alike but do not match are reported; a byte-order mark is ignored."""

from __future__ import annotations

import shutil
from dataclasses import replace

import pytest

from bbq_torchrl.domains import load_domain
from bbq_torchrl.domains.values import plain
from bbq_torchrl.envs.measured import load_errors
from bbq_torchrl.people.language.phrases import load_phrases
from bbq_torchrl.people.language.training_lines import lines_of

ALIKE = {
    "a blank at the end": ("reno", "reno "),
    "a no-break space": ("las vegas", "las\u00a0vegas"),
    "a thin space": ("7 pm", "7\u2009pm"),
    "two blanks": ("las vegas", "las  vegas"),
    "an apostrophe": ("freddy's", "Freddy\u2019s"),
    "quotes": ('the "best"', "the \u201cbest\u201d"),
    "a dash": ("sci-fi", "sci\u2011fi"),
    "an accent beside its letter": ("caf\u00e9", "cafe\u0301"),
    "a ligature": ("fish", "\ufb01sh"),
    "wide digits": ("12", "\uff11\uff12"),
    "a space without width": ("reno", "re\u200bno"),
    "a byte-order mark": ("reno", "\ufeffreno"),
}


@pytest.mark.parametrize(("one", "other"), ALIKE.values(), ids=ALIKE)
def test_texts_that_people_read_as_one_are_alike(one, other):
    assert plain(one) == plain(other) == plain(plain(other))


@pytest.mark.parametrize(
    ("one", "other"),
    [("7pm", "7 pm"), ("cafe", "caf\u00e9"), ("o'fallon", "ofallon"), ("sci-fi", "scifi")],
)
def test_texts_of_other_letters_are_not_alike(one, other):
    assert plain(one) != plain(other)


def edit(path, old, new, count=1):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, count), encoding="utf-8")


@pytest.fixture
def folder(restaurant_folder, tmp_path):
    """A copy of the restaurant domain that a test may change."""
    return shutil.copytree(restaurant_folder, tmp_path / "domain")


@pytest.mark.parametrize("name", ["knowledge_base.csv", "values.json", "goals.jsonl"])
def test_a_folder_with_a_value_that_never_matches_its_like_is_refused(folder, name):
    spelled = {
        "knowledge_base.csv": ("saturday,7:30 pm", "saturday,7:30\u00a0pm"),
        "values.json": ('"7:30 pm"', '"7:30 pm "'),
        "goals.jsonl": ('"7:30 pm"', '"7:30  pm"'),
    }[name]
    lines = (folder / name).read_text().splitlines()
    line = next(number for number, text in enumerate(lines, 1) if spelled[0] in text)
    edit(folder / name, *spelled)
    odd = spelled[1].removeprefix("saturday,").strip('"')
    with pytest.raises(ValueError, match="never matches") as caught:
        load_domain(folder)
    assert str(caught.value) == (
        f"{folder}: {name}, line {line}: it has hour = {odd!r}, which never matches '7:30 pm': "
        "they differ only in blanks, quotes, dashes or how letters are encoded, so write both alike"
    )


def test_a_value_that_looks_like_a_reserved_one_is_refused(folder):
    edit(folder / "knowledge_base.csv", "saturday,7:30 pm", "saturday,no\u00a0match")
    with pytest.raises(ValueError, match=r"hour = 'no\\xa0match', which never matches 'no match'"):
        load_domain(folder)


def test_the_spelling_that_most_places_have_is_the_one_to_write(folder):
    file = folder / "knowledge_base.csv"
    before = file.read_text()
    edit(file, "italian", "italian ", before.count("italian"))
    with pytest.raises(ValueError, match="'italian', which never matches 'italian '"):
        load_domain(folder)


TEXTS = """domain.yaml knowledge_base.csv goals.jsonl values.json errors.json language.yaml
learned.txt"""


@pytest.mark.parametrize("name", TEXTS.split())
def test_a_byte_order_mark_is_no_part_of_a_file_of_a_domain(movie, tmp_path, name):
    folder = shutil.copytree(movie.folder, tmp_path / "domain")
    text = (folder / name).read_text(encoding="utf-8")
    (folder / name).write_text(text, encoding="utf-8-sig")
    domain = load_domain(folder)
    assert replace(domain, folder=movie.folder) == movie
    assert load_phrases(domain) == load_phrases(movie)
    assert lines_of(domain, "learned.txt") == lines_of(movie, "learned.txt")
    load_errors(domain)
