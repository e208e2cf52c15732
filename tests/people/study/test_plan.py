"""Study files: what is allowed, and every fault in one sentence, all at once."""

from __future__ import annotations

import pytest

from bbq_torchrl.people.study import StudyError, load_study
from bbq_torchrl.people.study.plan import Terms

GOOD = {
    "name": "Tickets",
    "consent": "You agree.",
    "agents": "{one: runs/1, two: runs/2}",
    "pairs": "[[one, two]]",
    "participants": "12",
}
_IN_QUOTES = "(yes, no, numbers and dates in quotes)"
_TEXTS = f"must be a mapping of one name or more to where the agent is, both text {_IN_QUOTES}"
_OF_TEXT = f"of two agents, both text {_IN_QUOTES}"


@pytest.fixture
def write(tmp_path, restaurant_folder):
    def study(**changed):
        keys = {**GOOD, "domain": str(restaurant_folder), **changed}
        text = "\n".join(f"{key}: {value}" for key, value in keys.items() if value is not None)
        (tmp_path / "study.yaml").write_text(text)
        return tmp_path / "study.yaml"

    return study


def faults(file):
    with pytest.raises(StudyError) as error:
        load_study(file)
    assert str(file) in str(error.value)
    return error.value.faults


def test_a_short_file_is_enough(write, restaurant):
    study = load_study(write())
    assert study.terms.sessions == 2
    assert study.terms.pairs == (("one", "two"),)
    assert study.domain.name == restaurant.name
    assert set(study.terms.goals) <= set(range(1, len(restaurant.goals) + 1))
    assert study.data.name == "study.sqlite"
    assert Terms.of(study.terms.text()) == study.terms


def test_an_agent_may_be_more_cautious_than_another_of_the_same_run(write):
    terms = load_study(
        write(agents="{one: runs/1, two: runs/1}", ask_below="{one: 1, two: .9}")
    ).terms
    # as text: a study that has begun says 1.0 where its file says 1
    assert str(terms.ask_below) == "{'one': 1.0, 'two': 0.9}"
    assert Terms.of(terms.text()) == terms


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"name": "''"}, "name must be text, not blank, got ''"),
        ({"consent": None}, "it lacks the keys consent"),
        (
            {"agents": "{}"},
            "agents must be a mapping of one name or more to where the agent is, both text",
        ),
        ({"agents": "{one: 7}"}, "agents must be a mapping of one name or more"),
        *(
            ({"agents": f"{{{name}: a, two: b}}", "pairs": "[]"}, f"agents {_TEXTS}, got {{{read}")
            for name, read in (("yes", "True"), ("1", "1"), ("2026-01-31", "datetime.date"))
        ),
        ({"pairs": "[[yes, 1]]"}, f"pairs must hold pairs {_OF_TEXT}, got [True, 1]"),
        (
            {"pairs": "[[one, three]]"},
            "pairs must name agents of the study (one, two), got 'three'",
        ),
        ({"pairs": "[[one, one]]"}, "pairs must be of two different agents, got ['one', 'one']"),
        ({"pairs": "[[one, two], [two, one]]"}, "pairs must be declared once, got ['two', 'one']"),
        ({"pairs": "[one]"}, f"pairs must hold pairs {_OF_TEXT}, got 'one'"),
        ({"pairs": "one"}, "pairs must be a list of pairs of agents, [] for none, got 'one'"),
        ({"participants": "0"}, "participants must be an integer from 1 to 10000, got 0"),
        ({"participants": "true"}, "participants must be an integer from 1 to 10000"),
        ({"sessions": "3"}, "sessions must be a multiple of the number of agents (2)"),
        ({"max_turns": "none"}, "max_turns must be an integer from 1 to 500, got 'none'"),
        ({"idle_minutes": "-1"}, "idle_minutes must be an integer from 1 to 10080, got -1"),
        ({"joins_per_minute": "0"}, "joins_per_minute must be an integer from 1 to 10000"),
        ({"retention": "2027-12-31"}, "retention must be text: until when the data are kept, got"),
        *(
            (
                {"url": f"'{url}'"},
                f"url must be an address such as https://lab.example/study/: http or https, host, "
                f"port and path, without user, query and fragment, got '{url}'",
            )
            for url in (
                *("lab.example", "ftp://lab.example", "https://", "https://lab.example/#study"),
                *("https://lab.example/?a=b", "https://me@lab.example", "https://lab.example:0"),
                *("https://lab.example:65536", "https://lab.example/a b", "https://a/../b"),
                *("https://lab.example//study", "https://lab.example/%41", "javascript:alert(1)"),
            )
        ),
        ({"url": "7"}, "url must be an address such as https://lab.example/study/: http or https"),
        (
            {"url": "https://lab.example/static/"},
            "url must have another path than the study's pages (/join, /p, /r, /static), got 'ht",
        ),
        *(
            ({"join_parameters": value}, "join_parameters must be a list of distinct names of pa")
            for value in ("PROLIFIC_PID", "[a, a]", "[1]", "['a b']", "['']", "{a: b}", "[yes]")
        ),
        *(
            (
                {"completion_url": f"'{url}'"},
                "completion_url must be a link that begins with https://, without spaces, got "
                f"'{url}'",
            )
            for url in (
                *("http://pay.example/", "javascript:alert(1)", "https://", "pay.example"),
                *("https://pay.example/a b", "https:///x", "data:text/html,x"),
            )
        ),
        ({"completion_code": "123"}, "completion_code must be text of at most 200 characters"),
        ({"completion_code": "x" * 201}, "completion_code must be text of at most 200 characters"),
        ({"goals": "[0]"}, "goals must be attainable or a list of numbers between 1 and"),
        ({"goals": "[1, 1]"}, "goals must be distinct and at least as many as sessions (2)"),
        ({"domain": "nowhere"}, "domain must be movie or a domain's folder: "),
        ({"domain": "7"}, "domain must be movie or a domain's folder, got 7"),
        (
            {"ask_below": "{three: .9}"},
            "ask_below must be a mapping of agents of the study to numbers between",
        ),
        (
            {"ask_below": "{one: 2}"},
            "ask_below must be a mapping of agents of the study to numbers between",
        ),
        (
            {"control": "{three: []}"},
            "control must be a mapping of agents of the study to lists of yes_ends,",
        ),
        (
            {"control": "{one: [shout]}"},
            "control must be a mapping of agents of the study to lists of yes_ends",
        ),
        ({"color": "red"}, "'color' is not a key of a study; allowed are name, consent"),
    ],
)
def test_each_fault_is_a_sentence_with_key_value_and_what_is_allowed(write, changed, sentence):
    [found] = faults(write(**changed))
    assert found.startswith(sentence)


def test_goals_that_no_record_can_meet_are_refused_by_number(tmp_path, movie, write):
    from bbq_torchrl.people.dialogue.judge import Judge

    judge = Judge(movie)
    hopeless = [n for n, goal in enumerate(movie.goals, 1) if not judge.is_attainable(goal)]
    assert hopeless
    [found] = faults(write(domain="movie", goals=f"[1, 2, {hopeless[0]}]"))
    assert str(hopeless[0]) in found


def test_all_faults_come_at_once(write):
    found = faults(write(name="''", participants="no", pairs="[[one, three]]", color="red"))
    assert len(found) == 4


@pytest.mark.parametrize(
    "content",
    [b"", b"- a\n- b", b"a: [", b"\xff\xfe\x00", b"name: x\nname: y", b"[" * 500, b"\x00"],
)
def test_a_file_that_is_no_study_is_one_sentence(tmp_path, content):
    file = tmp_path / "study.yaml"
    file.write_bytes(content)
    [found] = faults(file)
    assert len(found) < 1_000
