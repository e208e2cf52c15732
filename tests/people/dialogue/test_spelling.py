"""One value in several spellings: heard, looked up, offered and judged as one."""

from types import SimpleNamespace

import pytest
from chat.test_chat_command import play
from study.test_players import Letters
from tables import pairs, rows

from bbq_torchrl.domains import Goal, build_vocabulary
from bbq_torchrl.people.language import Frame
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.people.study import players


def test_spellings_are_one_where_their_keys_are(movie, spelling):
    lexicon = Lexicon(movie)
    merged = 0
    for slot, values in zip(movie.slots, build_vocabulary(movie), strict=True):
        own = {value: spelling.of({slot: value})[slot] for value in values}
        assert all(own[one] == one for one in own.values())
        if slot in lexicon.slots:
            assert all(lexicon.key(slot, one) == lexicon.key(slot, v) for v, one in own.items())
            keys = {lexicon.key(slot, value) for value in values}
            assert len(set(own.values())) == len(keys)
            merged += len(values) - len(keys)
        else:
            assert list(own) == list(own.values())
    assert merged > 0


@pytest.mark.parametrize(("slot", "one", "other"), rows(__file__, "spellings.txt"))
def test_a_wish_in_another_spelling_is_looked_up_offered_and_judged(
    partner, decided, spelling, slot, one, other
):
    record = next(
        record
        for record in spelling.domain.records
        if {"moviename", "theater"} <= set(record)
        and (record.get(slot) == one or slot in spelling.domain.free_slots)
    )
    goal = Goal({"moviename": record["moviename"], slot: one}, ("theater",))
    decided(partner.agent, "inform(theater)", "inform(taskcomplete)", "thanks")
    wishes = f"moviename={record['moviename']}, {slot}={other}"
    lines = [f"request(theater) inform({wishes})", "request(ticket)", "thanks"]
    success, shown = play(partner, goal, lines)
    assert success is True, shown
    assert "find out: theater" in shown
    assert "Success: you have got what your goal card says." in shown


def test_a_simulated_user_takes_an_offer_in_another_spelling(movie, spelling, monkeypatch):
    monkeypatch.setattr(players, "Generator", lambda _: Letters())
    make_user = players.make_users(SimpleNamespace(domain=movie))
    pairs = enumerate(zip(movie.goals, spelling.domain.goals, strict=True), start=1)
    differ = [(number, raw, own) for number, (raw, own) in pairs if raw != own]
    assert len(differ) >= 5
    for number, raw, own in differ[:5]:
        wrong = dict.fromkeys(own.constraints, "another")
        for offered in (raw.constraints, own.constraints, wrong):
            user = make_user(number, 0)
            user.say(None)
            told = Frame("inform", {**offered, movie.complete_slot: "ticket available"})
            assert (Frame.parse(user.say(told)).act == "deny") == (offered is wrong)


@pytest.mark.parametrize(("text", "heard", "told", "meant"), rows(__file__, "times.txt"))
def test_a_time_or_day_is_the_one_that_records_have(spelling, text, heard, told, meant):
    found = spelling.understood(text, pairs(heard), pairs(told))
    assert found == (spelling.of(pairs(meant)), ())


@pytest.mark.parametrize("text", ["10:05", "five past ten"])
def test_a_time_that_is_shown_in_the_morning_and_at_night_is_asked_about(spelling, text):
    informs, (unclear,) = spelling.understood(text, {"starttime": "10:05 pm", "city": "reno"}, {})
    assert informs == {"city": "reno"}
    assert (unclear.slot, unclear.candidates) == ("starttime", ("10:05am", "10:05 pm"))


def test_an_unknown_name_is_the_title_of_which_a_text_has_more_words(spelling):
    title = "puss in boots: the last wish"
    for text, is_part in (("the Wish one, with the cat in boots", True), ("a wish in reno", False)):
        _, (unclear,) = spelling.understood(text, {"moviename": "wish"}, {})
        assert (title in unclear.candidates) == is_part


def test_a_record_is_on_the_day_of_its_time(spelling):
    days = {
        (record["date"], record["starttime"])
        for record in spelling.domain.records
        if {"date", "starttime"} <= record.keys()
    }
    assert ("today", "10:05am") in days
    assert ("tonight", "10:05am") not in days
    assert ("tonight", "8:55 pm") in days
