"""What people see and do, from the first page to the last."""

from __future__ import annotations

import re
from dataclasses import replace
from unittest.mock import Mock

import pytest
from starlette.testclient import TestClient

from bbq_torchrl.study.database import StoreError
from bbq_torchrl.study.records import SCALES
from bbq_torchrl.study.web import application

from .conftest import Site, hidden
from .fakes import script

HOSTILE = (
    "<script>alert(1)</script>",
    "{{ 7 * 7 }} {% raw %}",
    "\u202egnirts a\u202c אבג",
    "🎬🍿",
    "nul\x00inside",
    "lone \ud800 surrogate",
)


def play(site, link, *, end="bye"):
    goal = site.study.domain.goals[site.session(link).goal - 1]
    for text in [*script(site.study.domain, goal), end]:
        page = site.say(link, text)
        assert page.status_code == 200
    return page


def test_a_person_goes_from_consent_to_thanks(site):
    consent = site.client.get(site.join).text
    assert "What you write is stored." in consent
    assert "2 conversations" in consent
    link = site.enroll()
    for number in (1, 2):
        page = site.client.get(link).text
        assert f"Conversation {number} of 2" in page
        assert "You speak first" in page
        assert "has ended" in play(site, link).text
        site.rate(link)
    assert "Thank you" in site.client.get(link).text
    rows = site.store.rows("SELECT ended_by, success, reasons FROM session LIMIT 2")
    assert rows == [("agent", 1, "[]")] * 2


def test_the_goal_card_shows_wishes_by_their_labels_and_questions(site):
    link = site.enroll()
    goal = site.study.domain.goals[site.session(link).goal - 1]
    page = site.client.get(link).text
    for slot, value in goal.constraints.items():
        assert f"<dt>{site.talker.labels.get(slot, slot)}</dt>" in page
        assert value.replace("&", "&amp;").replace("'", "&#39;") in page
    for slot in goal.requests:
        assert site.talker.labels.get(slot, slot) in page


def test_goal_card_and_judge_have_the_talkers_spelling(site):
    def other(values):
        return {slot: f"{value} otherwise" for slot, value in values.items()}

    domain = site.talker.domain
    site.talker.domain = replace(
        domain,
        records=tuple(map(other, domain.records)),
        goals=tuple(replace(goal, constraints=other(goal.constraints)) for goal in domain.goals),
    )
    study, store, talker = site.study, site.store, site.talker
    with TestClient(application(study, store, talker)) as client:
        served = Site(study, client, store, talker, site.clock)
        link = served.enroll()
        goal = talker.domain.goals[served.session(link).goal - 1]
        assert " otherwise</dd>" in client.get(link).text
        for text in (*script(talker.domain, goal), "bye"):
            served.say(link, text)
    assert store.rows("SELECT success FROM session WHERE ended IS NOT NULL") == [(1,)]


def test_no_answer_names_agent_weights_or_values(site):
    answers = [site.client.get(site.join)]
    link = site.enroll()
    answers += [site.client.get(link), site.say(link, "city=philly"), site.say(link, "crash")]
    answers += [site.say(link, "bye"), site.rate(link, overall="9"), site.rate(link)]
    for answer in answers:
        everything = answer.text + repr(answer.headers)
        for secret in ("secret", "vault", "bbqn", "dqn", "0.5625", "1.25", "inform("):
            assert secret not in everything


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_text_is_stored_and_shown_as_text(site, text):
    link = site.enroll()
    body = {**hidden(site.client.get(link).text), "text": text}
    encoded = "&".join(
        f"{key}={''.join(f'%{byte:02x}' for byte in value.encode('utf-8', 'surrogatepass'))}"
        for key, value in body.items()
    )
    kind = {"content-type": "application/x-www-form-urlencoded"}
    page = site.client.post(f"{link}/say", content=encoded, headers=kind)
    assert page.status_code == 200
    assert "Which city?" in page.text
    assert "<script>alert" not in page.text
    [stored] = site.store.exchanges(site.session(link).id)
    assert "\x00" not in stored.text
    if text.isprintable():
        assert stored.text == text


@pytest.mark.parametrize("text", ["", "   ", "\x00", "\u202e", "x" * 1_001])
def test_blank_and_long_texts_are_refused_and_cost_nothing(site, text):
    page = site.say(site.enroll(), text)
    assert page.status_code == 422
    assert 'role="alert"' in page.text
    assert site.talker.calls == 0


def test_a_second_window_is_told_that_the_conversation_went_on(site):
    link = site.enroll()
    stale = hidden(site.client.get(link).text)
    site.say(link, "city=philly")
    page = site.client.post(f"{link}/say", data={**stale, "text": "from the other window"})
    assert page.status_code == 409
    assert "gone on in another window" in page.text
    assert 'value="from the other window"' in page.text
    assert len(site.store.exchanges(site.session(link).id)) == 1
    again = {**hidden(page.text), "text": "from the other window"}
    assert site.client.post(f"{link}/say", data=again).status_code == 200
    assert len(site.store.exchanges(site.session(link).id)) == 2


def test_a_text_of_an_earlier_conversation_is_not_put_into_the_next(site):
    link = site.enroll()
    stale = hidden(site.client.get(link).text)
    site.say(link, "bye")
    site.rate(link)
    page = site.client.post(f"{link}/say", data={**stale, "text": "too late"})
    assert "Conversation 2 of 2" in page.text
    assert "too late" not in page.text


@pytest.mark.parametrize(("text", "status"), [("crash", 500), ("city=philly", 503)])
def test_an_agent_out_of_order_and_a_full_disk_lose_no_text(site, monkeypatch, text, status):
    link = site.enroll()
    form = {**hidden(site.client.get(link).text), "text": text}
    with monkeypatch.context() as patch:
        full = StoreError(site.study.data, "the disk is full")
        patch.setattr(site.store, "add_exchange", Mock(side_effect=full))
        page = site.client.post(f"{link}/say", data=form)
    assert page.status_code == status
    assert f'value="{text}"' in page.text
    assert hidden(page.text)["nonce"] == form["nonce"]
    assert site.say(link, "city=philly").status_code == 200


def test_a_person_may_end_but_not_before_a_word(site):
    link = site.enroll()
    form = hidden(site.client.get(link).text)
    assert site.client.post(f"{link}/end", data=form).status_code == 409
    site.say(link, "city=philly")
    assert "has ended" in site.client.post(f"{link}/end", data=form).text
    assert not site.session(link).success
    assert site.session(link).ended_by == "person"


def test_an_ended_conversation_takes_no_more_messages_and_no_other_end(site):
    link = site.enroll()
    late = hidden(site.client.get(link).text)
    site.say(link, "bye")
    page = site.client.post(f"{link}/say", data={**late, "text": "one more thing"})
    assert page.status_code == 409
    assert "has ended" in page.text
    assert "has ended" in site.client.post(f"{link}/end", data=late).text
    assert site.talker.calls == 1
    assert site.session(link).ended_by == "agent"


def test_a_conversation_runs_out_of_turns(site):
    link = site.enroll()
    for _ in range(site.study.terms.max_turns):
        page = site.say(link, "hello")
    assert "has ended" in page.text
    assert site.session(link).ended_by == "turns"
    assert "out of turns" in site.session(link).reasons


@pytest.mark.parametrize("given", ["0", "6", "five", "", "4.0", "٣"])
def test_a_rating_out_of_range_is_refused_and_the_others_are_kept(site, given):
    link = site.enroll()
    site.say(link, "bye")
    page = site.rate(link, naturalness=given)
    assert page.status_code == 422
    assert "naturalness" in page.text
    assert page.text.count(" checked") == 4
    assert not site.session(link).is_rated


def test_a_rating_counts_once(site):
    link = site.enroll()
    site.say(link, "bye")
    other = hidden(site.client.get(link).text)
    form = {**hidden(site.client.get(link).text), **dict.fromkeys(SCALES, "4"), "verdict": "yes"}
    changed = {**other, **dict.fromkeys(SCALES, "1"), "verdict": "no"}
    answers = [site.client.post(f"{link}/rate", data=data) for data in (form, form, changed)]
    assert [answer.status_code for answer in answers] == [200, 200, 409]
    assert site.store.rows("SELECT overall, verdict FROM rating") == [(4, 1)]


def test_a_conversation_is_not_rated_before_its_end(site):
    link = site.enroll()
    site.say(link, "city=philly")
    assert site.rate(link).status_code == 409


def test_who_consents_is_enrolled_once(site):
    form = hidden(site.client.get(site.join).text)
    assert site.client.post(site.join, data=form).status_code == 422
    assert site.store.progress()[0]["enrolled"] == 0
    links = {str(site.client.post(site.join, data={**form, "consent": "yes"}).url) for _ in "12"}
    assert len(links) == 1
    assert site.store.progress()[0]["enrolled"] == 1


def test_the_researcher_sees_progress_and_beliefs_turn_by_turn(site):
    link = site.enroll()
    site.say(link, "city=philly")
    number, agent = site.session(link).id, site.session(link).agent

    def begun_ended_rated():
        page = site.client.get(site.researcher).text
        rows = re.findall(r'row">(secret-\w+)</th><td>(\d)</td><td>(\d)</td><td>(\d)</td>', page)
        assert len(rows) == 2
        return {name: "".join(counts) for name, *counts in rows if counts != ["0", "0", "0"]}

    assert begun_ended_rated() == {agent: "100"}
    site.say(link, "bye")
    assert begun_ended_rated() == {agent: "110"}
    site.rate(link)
    assert begun_ended_rated() == {agent: "111"}
    turn = site.client.get(f"{site.researcher}/{number}").text
    for shown in ("inform(city=philly)", "request(city)", "0.562", "1.00 to 1.50", "0.750"):
        assert shown in turn
    assert site.client.get(f"{site.researcher}/999").status_code == 404
