"""Our movie corpus: what the script writes, and as hard as the public one by construction."""

from __future__ import annotations

import collections
import runpy
from pathlib import Path

import pytest
from corpus_statistics import goals_answerable, goals_met, share

from bbq_torchrl.domains import Domain, fold
from bbq_torchrl.domains.folder import GOALS_FILE, MOVIE_FOLDER, RECORDS_FILE, VALUES_FILE

SCRIPT = Path(__file__).parents[2] / "scripts" / "make_movie_corpus.py"

# Shares, sizes and counts of the public corpus, as the environment's description states them.
RECORD_SHARES = {
    "moviename": 0.97,
    "theater": 0.93,
    "date": 0.92,
    "starttime": 0.91,
    "city": 0.89,
    "state": 0.62,
    "zip": 0.33,
    "other": 0.32,
    "genre": 0.30,
    "distanceconstraints": 0.24,
    "critic_rating": 0.16,
    "video_format": 0.15,
    "theater_chain": 0.10,
    "mpaa_rating": 0.07,
}
DISTINCT = {"moviename": 59, "city": 87, "starttime": 211, "theater": 227, "date": 50}
CONSTRAINT_SHARES = {
    "numberofpeople": 1.0,
    "moviename": 0.66,
    "date": 0.63,
    "city": 0.62,
    "starttime": 0.47,
    "theater": 0.36,
    "state": 0.17,
    "genre": 0.11,
}
REQUEST_SHARES = {"theater": 0.64, "starttime": 0.53, "date": 0.37, "moviename": 0.34}


def test_the_shipped_files_are_what_the_script_writes(tmp_path: Path):
    runpy.run_path(str(SCRIPT))["write_corpus"](tmp_path)
    for name in (RECORDS_FILE, GOALS_FILE, VALUES_FILE):
        assert (tmp_path / name).read_bytes() == (MOVIE_FOLDER / name).read_bytes(), name


def test_records_are_as_sparse_as_the_public_ones(movie: Domain):
    assert len(movie.records) == 1000
    for slot, expected in RECORD_SHARES.items():
        assert share(slot, movie.records) == pytest.approx(expected, abs=0.02), slot
    rest = {slot for record in movie.records for slot in record} - set(RECORD_SHARES)
    assert all(share(slot, movie.records) < 0.05 for slot in rest)
    sizes = collections.Counter(map(len, movie.records))
    assert (min(sizes), max(sizes), sizes.most_common(1)[0][0]) == (1, 11, 6)


def test_records_have_about_as_many_values_as_the_public_ones(movie: Domain):
    for slot, expected in DISTINCT.items():
        found = len({fold(record[slot]) for record in movie.records if slot in record})
        assert found == pytest.approx(expected, rel=0.1), slot


def test_value_lists_are_longer_than_what_the_records_have(movie: Domain):
    for slot in movie.error_values:
        known = {fold(text) for text in movie.error_values[slot]}
        assert {fold(r[slot]) for r in movie.records if slot in r} <= known, slot
    for slot in ("moviename", "starttime", "theater", "date", "city"):
        used = {record[slot] for record in movie.records if slot in record}
        assert len(movie.error_values[slot]) > len(used), slot
    assert "numberofpeople" in movie.error_values


def test_goals_have_the_statistics_of_the_public_ones(movie: Domain):
    constraints = [goal.constraints for goal in movie.goals]
    requests = [goal.requests for goal in movie.goals]
    assert len(movie.goals) == 200
    assert sum(map(len, constraints)) / 200 == pytest.approx(4.4, abs=0.1)
    assert sum(map(len, requests)) / 200 == pytest.approx(1.9, abs=0.1)
    for slot, expected in CONSTRAINT_SHARES.items():
        assert share(slot, constraints) == pytest.approx(expected, abs=0.03), slot
    for slot, expected in REQUEST_SHARES.items():
        assert share(slot, requests) == pytest.approx(expected, abs=0.03), slot


def test_records_meet_and_answer_as_many_goals_as_the_public_ones(movie: Domain):
    assert goals_met(movie) / 200 == pytest.approx(0.943, abs=0.02)
    assert goals_answerable(movie) / 200 == pytest.approx(0.84, abs=0.02)


def test_a_theater_lies_in_one_city_and_belongs_to_one_chain(movie: Domain):
    places, chains, films = (collections.defaultdict(set) for _ in range(3))
    for record in movie.records:
        theater = record.get("theater")
        if theater is None:
            continue
        places[theater] |= {record["zip"]} if "zip" in record else set()
        chains[theater] |= {record["theater_chain"]} if "theater_chain" in record else set()
        films[theater] |= {record["moviename"]} if "moviename" in record else set()
    assert max(map(len, places.values())) == 1
    assert max(map(len, chains.values())) == 1
    assert all(theater.startswith(next(iter(c))) for theater, c in chains.items() if c)
    assert max(map(len, films.values())) > 1


def test_what_critics_say_and_whom_it_is_for_goes_with_the_film(movie: Domain):
    for slot, most in (("critic_rating", 1), ("mpaa_rating", 2), ("genre", 2), ("actor", 1)):
        said = collections.defaultdict(set)
        for record in movie.records:
            if slot in record and "moviename" in record:
                said[record["moviename"]].add(fold(record[slot]))
        assert max(map(len, said.values())) <= most, slot
