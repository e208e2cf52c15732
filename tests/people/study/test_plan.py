"""Study files: what is allowed, and every fault in one sentence."""

import pytest
from tables import rows

from bbq_torchrl.people.study import StudyError, load_study

GOOD = {
    "name": "Tickets",
    "consent": "You agree.",
    "contact": "ann@lab.example",
    "agents": "{one: runs/1, two: runs/2}",
    "pairs": "[[one, two]]",
    "participants": "12",
}


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
    study = load_study(write(ask_below="{one: 1, two: .9}", control="{two: [book]}"))
    assert study.terms.sessions == 2
    assert study.terms.pairs == [["one", "two"]]
    assert study.domain.name == restaurant.name
    assert load_study(write(domain="hotel")).domain.name == "hotel"
    assert set(study.terms.goals) <= set(range(1, len(restaurant.goals) + 1))
    assert study.data.name == "study.sqlite"
    assert study.terms.ask_below == {"one": 1, "two": 0.9}


@pytest.mark.parametrize(("key", "value"), rows(__file__, "faults.txt"))
def test_each_fault_is_a_sentence_that_begins_with_its_key(write, key, value):
    [found] = faults(write(**{key: value or None}))
    assert found.startswith(f"{key} ")


def test_goals_that_no_record_can_meet_are_refused_by_number(movie, write):
    from bbq_torchrl.people.dialogue.judge import Judge

    judge = Judge(movie)
    hopeless = [n for n, goal in enumerate(movie.goals, 1) if not judge.is_attainable(goal)]
    assert hopeless
    [found] = faults(write(domain="movie", goals=f"[1, 2, {hopeless[0]}]"))
    assert str(hopeless[0]) in found


def test_all_faults_come_at_once(write):
    assert len(faults(write(name="''", participants="no", color="red"))) == 3
    assert len(faults(write(pairs="[[one, three]]", sessions="3", ask_below="{four: 1}"))) == 3


@pytest.mark.parametrize(
    "content",
    [b"", b"- a\n- b", b"a: [", b"\xff\xfe\x00", b"name: x\nname: y", b"[" * 500, b"\x00"],
)
def test_a_file_that_is_no_study_is_one_sentence(tmp_path, content):
    file = tmp_path / "study.yaml"
    file.write_bytes(content)
    [found] = faults(file)
    assert len(found) < 1_000
