"""Reports and exported data, also of studies in which nothing or always the same happens."""

import csv
import json
import re
from dataclasses import replace

import pytest

from bbq_torchrl.people.study.database import SCALES
from bbq_torchrl.people.study.outcomes import compare_pairs, participant_mean, read_outcomes
from bbq_torchrl.people.study.report import report, write_report
from bbq_torchrl.people.study.storage import Store

from .fakes import FakeTalker

WON, LOST = (), ("wishes", "no ticket")


@pytest.fixture
def fill(study, clock):
    """Makes a study of people, given what each thinks of the first and the second agent."""

    def make(people, *, terms=study.terms, text="two tickets", pause=10.0, **settings):
        talker = FakeTalker(study.domain)
        terms = replace(terms, participants=max(1, len(people)))
        store = Store(replace(study, terms=terms), talker, clock=lambda: clock.now, **settings)
        store.rows("PRAGMA synchronous = OFF")  # a test waits for no disk
        for number, ratings in enumerate(people):
            for session in store.sessions(store.enroll(f"nonce-{number:020d}")):
                rating = ratings[list(terms.agents).index(session.agent)]
                for turn in range(1, 4):
                    clock.now += pause
                    reply = talker.reply(session.agent, None, text, 0)
                    store.add_exchange(session, turn, f"nonce-{turn:020d}", text, reply, None)
                store.end(session, "person", WON if rating > 3 else LOST)
                clock.now += pause
                scales = dict.fromkeys(SCALES, rating)
                store.rate(session, "nonce", scales, rating > 2)
        store.close()
        return read_outcomes(study.data)

    return make


def test_every_number_of_a_small_study(fill):
    outcomes = fill([(5, 1), (4, 2), (5, 3), (2, 3), (4, 5)])
    text = str(report(outcomes))
    assert "5 people enrolled of 5 wanted; 10 sessions ended, 10 of them rated" in text
    [success], [rating] = (compare_pairs(outcomes, name) for name in ("success", "rating"))
    assert success.people == 5
    assert success.mean.value == pytest.approx(0.6)  # 4 of 5 against 1 of 5
    # Three people differ, all in one direction: 2 / 2³.
    assert success.p == success.holm == 0.25
    assert rating.mean.value == pytest.approx((4 + 2 + 2 - 1 - 1) / 5)
    assert rating.p == rating.holm == 0.375  # 12 of 2⁵ ways
    assert "| secret-bbqn | 5 | 0.80 [0.38, 0.96] |" in text
    assert "| secret-bbqn | 0 | 1 | 0 | 2 | 2 |" in text
    assert "| secret-dqn | 4 | 4 |" in text  # the reasons
    assert "Nobody is conspicuous." in text
    # Verdict and judge agree in 8 of 10 sessions, and would by chance in .7 × .5 + .3 × .5.
    assert "differ in 2 of 10 sessions: 2 are a success by people's own verdict alone, 0 " in text
    assert re.search(r"Cohen's κ 0\.60 \[\S+, \S+\]", text)


def test_peoples_names_tell_nothing_of_who_came_when(fill):
    outcomes = fill([(5, 1)] * 8, secret="of this test")
    names = list(dict.fromkeys(session.person for session in outcomes.sessions))
    assert names != sorted(names) == [f"P{number}" for number in range(1, 9)]


def test_a_warning_is_told_from_what_comes_with_length(fill):
    outcomes = fill([(5, 1), (4, 2), (1, 5), (2, 5)])

    def in_doubt(session):
        """Failures continue for an answer in doubt; at first they look like the others."""
        last = session.exchanges[-1]
        more = replace(last, beliefs={**last.beliefs, "entropy": 2.0})
        return replace(session, exchanges=(*session.exchanges, more))

    sessions = [item if item.success else in_doubt(item) for item in outcomes.sessions]
    text = str(report(replace(outcomes, sessions=sessions)))
    assert "| entropy of the first 3 answers | length |" in text
    for agent in outcomes.terms.agents:
        assert re.search(rf"\| {agent} \| 4 \| 1.00 \[.+\] \| 0.50 \[.+\] \| 1.00 \[.+\] \|", text)


def test_flagged_people_are_shown_and_counted(fill):
    outcomes = fill([(5, 1), (4, 4), (3, 3)], pause=1.0)
    text = str(report(outcomes))
    assert len(outcomes.flags()) == 3
    assert "too fast" in text
    assert "always the same rating" in text
    assert "Without the 3 people who are flagged below" in text
    assert [pair.people for pair in compare_pairs(outcomes, "success")] == [3]
    assert compare_pairs(outcomes, "success", ["P1"])[0].people == 2


def test_a_report_of_no_session_or_one_agent_says_so(fill, study, tmp_path):
    write_report(tmp_path / "out", fill([]))
    assert "No session has ended yet" in (tmp_path / "out" / "report.md").read_text()
    study.data.unlink()
    terms = replace(study.terms, agents={"secret-dqn": "x"}, pairs=(), sessions=1)
    assert "No pair was declared" in str(report(fill([(5,), (3,)], terms=terms)))


@pytest.mark.parametrize("rating", [1, 5])
def test_a_report_in_which_all_are_equal_has_no_difference(fill, rating):
    outcomes = fill([(rating, rating)] * 3)
    for shown in ("κ is undefined", str(participant_mean([[rating]] * 3, (1, 5)))):
        assert shown in str(report(outcomes))
    [success], [rating] = (compare_pairs(outcomes, name) for name in ("success", "rating"))
    assert success.mean == participant_mean([[0.0]] * 3, (-1, 1))
    assert rating.mean == participant_mean([[0.0]] * 3, (-4, 4))
    p_values = [success.p, rating.p, *success.classical.values(), *rating.classical.values()]
    assert list(map(str, p_values)) == ["1.000", "1.000", "1.000", "–", "1.000"]


def test_the_figures_and_the_data_are_written(fill, tmp_path):
    write_report(tmp_path, fill([(5, 1), (4, 3)], text="=cmd() my name is Ann"))
    for figure in ("success.png", "differences.png", "ratings.png"):
        assert (tmp_path / figure).read_bytes().startswith(b"\x89PNG")

    def read(name):
        text = (tmp_path / name).read_text("utf-8")
        assert text.startswith("\ufeffsession,")  # Excel reads é by this mark
        return list(csv.DictReader(text[1:].splitlines()))

    for file in ("exchanges.csv", "sessions.jsonl"):  # nor in what the agent understood and repeats
        assert "Ann" not in (tmp_path / file).read_text()
    rows = read("exchanges.csv")
    assert len(rows) == 2 * 2 * 3
    assert {row["text"] for row in rows} == {"'=cmd() my name is [name]"}
    assert [row["seconds"] for row in rows[:3]] == ["0.0", "10.0", "20.0"]
    lines = [json.loads(line) for line in (tmp_path / "sessions.jsonl").read_text().splitlines()]
    assert {line["person"] for line in lines} == {"P1", "P2"}
    assert lines[0]["exchanges"][0]["text"] == "=cmd() my name is [name]"
    assert lines[0]["exchanges"][0]["beliefs"]["entropy"] == 0.5625
    assert "state" not in lines[0]["exchanges"][0]
    rows = read("sessions.csv")
    judged = {(row["overall"], row["success"], row["own_verdict"]) for row in rows}
    assert judged == {("5", "1", "1"), ("1", "0", "0"), ("4", "1", "1"), ("3", "0", "1")}
    alike = {(row["exchanges"], row["entropy"], row["simulated"]) for row in rows}
    assert alike == {("3", "0.5625", "0")}
