"""Our movie corpus is what the script writes and, by construction, as hard as the public one."""

from __future__ import annotations

import collections
import runpy
from pathlib import Path

import pytest
from corpus_statistics import (
    CONSTRAINTS,
    DISTINCT,
    RECORDS,
    REQUESTS,
    goals_answerable,
    goals_met,
    share,
)

from bbq_torchrl.domains import Domain, fold
from bbq_torchrl.domains.folder import GOALS_FILE, MOVIE_FOLDER, RECORDS_FILE, VALUES_FILE

SCRIPT = Path(__file__).parents[2] / "scripts" / "make_movie_corpus.py"


def test_the_shipped_files_are_what_the_script_writes(tmp_path: Path):
    runpy.run_path(str(SCRIPT))["write_corpus"](tmp_path)
    for name in (RECORDS_FILE, GOALS_FILE, VALUES_FILE):
        assert (tmp_path / name).read_bytes() == (MOVIE_FOLDER / name).read_bytes(), name


@pytest.mark.parametrize(
    ("name", "records", "error", "goals", "goal_error"),
    [("movie", 1000, 0.02, 200, 0.03), ("miulab", 991, 0.006, 194, 0.006)],
)
def test_records_and_goals_are_as_described(request, name, records, error, goals, goal_error):
    domain: Domain = request.getfixturevalue(name)
    assert (len(domain.records), len(domain.goals)) == (records, goals)
    constraints = [goal.constraints for goal in domain.goals]
    requests = [goal.requests for goal in domain.goals]
    for shares, holders, close in (
        (RECORDS, domain.records, error),
        (CONSTRAINTS, constraints, goal_error),
        (REQUESTS, requests, goal_error),
    ):
        for slot, expected in shares.items():
            assert share(slot, holders) == pytest.approx(expected, abs=close), slot
    rest = {slot for record in domain.records for slot in record} - set(RECORDS)
    assert all(share(slot, domain.records) < 0.05 for slot in rest)
    sizes = collections.Counter(map(len, domain.records))
    assert (min(sizes), max(sizes), sizes.most_common(1)[0][0]) == (1, 11, 6)
    assert sum(map(len, constraints)) / goals == pytest.approx(4.4, abs=0.1)
    assert sum(map(len, requests)) / goals == pytest.approx(1.9, abs=0.1)
    spelled, close = (fold, 0.1) if name == "movie" else (str, 0.025)  # blanks are no values
    for slot, count in DISTINCT.items():
        found = len({spelled(record[slot]) for record in domain.records if slot in record})
        assert found == pytest.approx(count, rel=close), slot


def test_value_lists_are_longer_than_what_the_records_have(movie: Domain):
    for slot in movie.error_values:
        known = {fold(text) for text in movie.error_values[slot]}
        assert {fold(r[slot]) for r in movie.records if slot in r} <= known, slot
    for slot in ("moviename", "starttime", "theater", "date", "city"):
        used = {record[slot] for record in movie.records if slot in record}
        assert len(movie.error_values[slot]) > len(used), slot
    assert "numberofpeople" in movie.error_values


def test_records_meet_and_answer_as_many_goals_as_the_public_ones(movie: Domain):
    assert (
        goals_met(movie) == 188
    )  # of 200: 94.0 % in docs/environment.md, where the public has 94.3
    assert goals_answerable(movie) / 200 == pytest.approx(0.84, abs=0.02)
