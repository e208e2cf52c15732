"""Studies with simulated users go the way of studies with people, again and again the same."""

import csv
import json
from dataclasses import replace
from statistics import fmean
from types import SimpleNamespace

import pytest

from bbq_torchrl.people.study.__main__ import main
from bbq_torchrl.people.study.conversations import RATING_RULE, drawn_ratings, simulate
from bbq_torchrl.people.study.database import SCALES, StoreError
from bbq_torchrl.people.study.export import export
from bbq_torchrl.people.study.outcomes import read_outcomes
from bbq_torchrl.people.study.report import report
from bbq_torchrl.people.study.storage import Store

from .conftest import STUDY
from .fakes import FakeTalker, script

FILES = ("sessions.csv", "exchanges.csv", "sessions.jsonl")


def make_users(study):
    """Users who say what is on their goal cards, satisfied once they have said all but bye."""

    def make(goal, seed):
        lines = script(study.domain, study.domain.goals[goal - 1])
        texts = [*lines[: 1 + seed % len(lines)], "bye"]
        return SimpleNamespace(say=lambda _: texts.pop(0), satisfied=len(texts) > len(lines))

    return make


def played(study, folder, talker=None, seed=1):
    """Returns the files of a report of the study, simulated with data in a folder."""
    folder.mkdir(exist_ok=True)
    study = replace(study, path=folder / "study.yaml")
    simulate(study, talker or FakeTalker(study.domain), make_users(study), seed=seed)
    outcomes = read_outcomes(study.data)
    export(folder, outcomes)
    return {name: (folder / name).read_text(encoding="utf-8") for name in FILES}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("simulated")


@pytest.fixture(scope="module")
def whole(loaded, folder):
    """The files of a simulation that nothing stopped."""
    return played(loaded, folder)


def test_everybody_takes_part_and_all_is_called_simulated(study, whole, folder):
    files, outcomes = whole, read_outcomes(folder / "study.sqlite")
    assert len(outcomes.sessions) == 2 * study.terms.participants
    assert {session.success for session in outcomes.sessions} == {True, False}
    assert {session.verdict for session in outcomes.sessions} == {True, False}
    assert outcomes.open == 0
    assert not any("too fast" in flag for flags in outcomes.flags().values() for flag in flags)
    written = str(report(outcomes))
    assert written.startswith("# Tickets (simulated users)\n")
    assert RATING_RULE in written
    for name in ("sessions.csv", "exchanges.csv"):
        assert {row["simulated"] for row in csv.DictReader(files[name].splitlines())} == {"1"}
    assert all(json.loads(line)["simulated"] for line in files["sessions.jsonl"].splitlines())


def test_a_simulation_that_was_stopped_goes_on_as_if_it_had_not(
    study, whole, tmp_path, monkeypatch
):
    talker = FakeTalker(study.domain)
    for step in ("add_exchange", "rate"):
        own, calls = getattr(Store, step), iter(range(100))

        def stopped(store, *given, own=own, calls=calls):
            if next(calls) == 5:
                raise KeyboardInterrupt
            return own(store, *given)

        with monkeypatch.context() as patch:
            patch.setattr(Store, step, stopped)
            with pytest.raises(KeyboardInterrupt):
                played(study, tmp_path / "stopped", talker)
    files = played(study, tmp_path / "stopped", talker)
    assert files == whole
    assert talker.calls == files["exchanges.csv"].count("\n")  # one was answered twice


def test_another_seed_is_another_study_and_neither_goes_on_with_the_other_or_with_people(
    study, whole, folder, tmp_path
):
    assert played(study, tmp_path / "two", seed=2)["sessions.csv"] != whole["sessions.csv"]
    with pytest.raises(StoreError, match="it was begun with another seed"):
        played(study, folder, seed=2)
    Store(study, FakeTalker(study.domain)).close()
    with pytest.raises(StoreError, match="either people or simulated users, not both"):
        played(study, tmp_path)


def test_ratings_are_drawn_by_the_rule_that_reports_tell():
    def mean(satisfied, messages):
        drawn = [drawn_ratings(satisfied, messages, seed) for seed in range(500)]
        assert {scale for ratings in drawn for scale in ratings} == set(SCALES)
        assert {rating for ratings in drawn for rating in ratings.values()} <= {1, 2, 3, 4, 5}
        return fmean(ratings["overall"] for ratings in drawn)

    # Far from the ends the cut takes little.
    assert mean(False, 5) == pytest.approx(2.0, abs=0.15)
    assert mean(True, 15) == pytest.approx(3.5, abs=0.15)
    assert mean(True, 5) > mean(True, 10) > mean(False, 5) > mean(False, 15)


def test_the_command_leaves_the_study_to_people(tmp_path, monkeypatch, capsys):
    (tmp_path / "tickets.yaml").write_text(STUDY, encoding="utf-8")
    command = ["simulate", str(tmp_path / "tickets.yaml"), "--seed", "4"]
    command += ["--talker", f"{__package__}.fakes:make"]
    monkeypatch.setattr("bbq_torchrl.people.study.__main__.USERS", f"{__name__}:make_users")
    assert main(command) == 0
    told = capsys.readouterr().out
    assert "5 of 5 simulated users" in told
    assert "10 ended sessions" in told
    made = {path.name for path in tmp_path.iterdir()} - {"tickets.yaml"}
    assert all(name.startswith("tickets-simulated") for name in made)
    assert (tmp_path / "tickets-simulated-report" / "report.md").is_file()
    assert main(["report", str(tmp_path / "tickets.yaml")]) == 2
