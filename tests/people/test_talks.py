"""The people of scripts/measure_talks.py, and what is counted of their conversations."""

import pytest
from acts import Acts

from bbq_torchrl.domains.frames import ANY
from bbq_torchrl.people.chat import Partner
from bbq_torchrl.people.dialogue.judge import Judge
from bbq_torchrl.people.language import Frame, Unclear, Understood
from scripts.talks.counts import COUNTS, SHARES, read, save, shares
from scripts.talks.person import PEOPLE, Person, suits
from scripts.talks.talk import Talk


class Ears(Acts):
    """An understander of what ``person`` means, less what ``change`` takes away."""

    def __call__(self, text, question=None):
        said = self.person.last
        if said.unknown:
            return Understood(Frame("inform"), 0.9, (Unclear(said.unknown, "casablanca"),))
        if said.act == "nothing" or said.never:
            return Understood(Frame("not_sure"), 0.1)
        acts = {"yes": "confirm_answer", "no": "deny", "bye": "closing"}
        if said.act in acts:
            return Understood(Frame(acts[said.act]), 0.9)
        if said.act == "any":
            asked = question.requests[:1] if question else ()
            return Understood(Frame("inform", dict.fromkeys(asked, ANY)), 0.9)
        requests = ("ticket",) if said.act == "book" else said.requests
        act = "request" if requests else "inform"
        return Understood(self.change(Frame(act, said.informs, requests)), 0.9)


@pytest.fixture(scope="module")
def talks(agents, mouth, spelling):
    """Plays conversations of a kind, with goals that can be met, and yields them."""
    judge, ears = Judge(spelling.domain), Ears()
    partner = Partner(agents["bbqn"], ears, mouth, spelling)
    goals = [goal for goal in spelling.domain.goals if judge.is_attainable(goal)]

    def talks(kind, change=lambda frame: frame, count=2):
        fit = [goal for goal in goals if suits(kind, goal)]
        for seed, goal in enumerate(fit[:: len(fit) // count]):
            ears.person, ears.change = Person(kind, goal, spelling.domain, seed, {}), change
            talk = Talk(partner, ears.person)
            talk.play(seed)
            yield talk

    return talks


@pytest.mark.parametrize("kind", PEOPLE["kinds"])
def test_who_is_understood_rightly_is_served_rightly_even_by_an_agent_that_learned_nothing(
    talks, kind
):
    for talk in talks(kind):
        count = talk.counts
        assert not count["dropped"] + count["wrong"] + count["turned_round"], talk.lines
        assert count["reported"] == count["unknown"]
        assert count["yes_ends"] == count["yes"]
        if "says" not in PEOPLE["kinds"][kind]:
            assert count["answered"] == count["questions"], talk.lines
        if "voice" in PEOPLE["kinds"][kind]:
            continue
        for said, _ in talk.said:  # a text has the values that it means
            if said.act != "yes" and ANY not in said.informs.values():
                values = {said.informs[slot] for slot in said.informs if slot != "state"}
                assert all(value.lower() in said.text.lower() for value in values), said


def test_values_and_questions_that_are_not_heard_are_counted(talks):

    def deaf(frame):
        return Frame("greeting", {}, ("price",) if frame.requests else ())

    for talk in talks("terse", deaf):
        lost = [set(said.informs) - set(answer.answered.requests) for said, answer in talk.said]
        assert 0 < talk.counts["dropped"] <= sum(map(len, lost))
        assert talk.counts["answered"] == 0
        acted = [said for said, answer in talk.said if answer.acted]
        assert talk.counts["wrong"] == sum(bool(said.requests) for said in acted)


def test_a_table_keeps_the_sums_of_each_label_and_agent(tmp_path):
    file = tmp_path / "talks.csv"
    row = {"kind": "terse", **dict.fromkeys(COUNTS, 1)}
    save(file, [row, row], "before", "a")
    save(file, [row], "after", "a")
    save(file, [row, row, row], "before", "a")
    kept = read(file)
    assert [(part["label"], part["talks"]) for part in kept] == [("after", "1"), ("before", "3")]
    assert shares(kept) == dict.fromkeys(SHARES, "1.000")
