"""The pages that people see, from the first to the last."""

import re
from html import escape
from urllib.parse import urlencode

import pytest

from bbq_torchrl.people.study.database import SCALES

from .conftest import RATED
from .fakes import script

HOSTILE = ("<script>alert(1)</script>", "{{ 7 * 7 }} {% raw %}", "\u202egnirts a\u202c אבג", "🎬🍿")


def test_a_person_goes_from_consent_to_thanks(site):
    consent = site.client.get(site.join).text
    assert "What you write is stored." in consent
    assert "2 conversations" in consent
    link, labels = site.enroll(), site.talker.labels
    for number in (1, 2):
        page, goal = site.client.get(link).text, site.goal(link)
        assert f"Conversation {number} of 2" in page
        assert "You speak first" in page
        for slot, value in goal.constraints.items():  # as the talker calls and spells them
            assert f"<dt>{labels.get(slot, slot)}</dt>" in page
            assert f"{escape(value).replace('&#x27;', '&#39;')}</dd>" in page
        assert all(labels.get(slot, slot) in page for slot in goal.requests)
        page = site.say(link, *script(site.talker.domain, goal), "bye")
        assert "has ended" in page.text
        site.take(link, "rate", **RATED)
    thanks = site.client.get(link).text
    assert "You can close this page." in thanks
    assert "code" not in thanks  # without one in the study file
    sessions = site.store.sessions(link.removeprefix("/p/"))
    assert [(item.ended_by, item.success) for item in sessions] == [("agent", True)] * 2


def test_no_answer_names_agent_weights_or_values(site):
    answers = [site.client.get(site.join)]
    link = site.enroll()
    answers += [site.client.get(link), *(site.say(link, text) for text in ("city=philly", "crash"))]
    answers += [site.say(link, "bye"), *(site.take(link, "rate", **form) for form in ({}, RATED))]
    for answer in answers:
        everything = answer.text + repr(answer.headers)
        for secret in ("secret", "vault", "bbqn", "dqn", "0.5625", "1.25", "inform("):
            assert secret not in everything


def test_hostile_text_is_stored_and_shown_as_text(site):
    link = site.enroll()
    for text in (*HOSTILE, "nul\x00inside", "lone \ud800 surrogate", "🎬" * 1_000):
        page = site.client.post(
            f"{link}/say",
            content=urlencode(site.form(link, text=text), errors="surrogatepass"),
            headers={"content-type": "application/x-www-form-urlencoded"},
        )
        assert page.status_code == 200
        assert "<script>alert" not in page.text
    stored = [said.text for said in site.store.exchanges(site.session(link).id)]
    assert [stored[0], stored[1], stored[3]] == [HOSTILE[0], HOSTILE[1], HOSTILE[3]]
    assert "\x00" not in stored[4]


@pytest.mark.parametrize(
    ("said", "step", "given", "status"),
    [
        *(([], "say", {"text": text}, 422) for text in ("", "   ", "\x00", "\u202e", "x" * 1_001)),
        ([], "end", {}, 409),
        (["city=philly"], "rate", RATED, 409),
        (["bye"], "say", {"text": "more"}, 409),
        (["bye"], "rate", {**RATED, "verdict": ""}, 422),
        *((["bye"], "rate", {**RATED, "coherence": n}, 422) for n in ("0", "6", "4.0", "٣", "")),
    ],
)
def test_a_step_that_cannot_be_taken_is_refused_in_a_sentence_and_changes_nothing(
    site, said, step, given, status
):
    link = site.enroll()
    for text in said:
        site.say(link, text)
    before = site.session(link)
    page = site.take(link, step, **given)
    assert (page.status_code, 'role="alert"' in page.text) == (status, True)
    assert page.text.count(" checked") == (4 if status == 422 and said else 0)  # what was right
    assert site.session(link) == before
    assert site.talker.calls == len(said)


def test_a_second_window_is_told_that_the_conversation_went_on(site):
    link = site.enroll()
    stale = site.form(link, text="from the other window")
    site.say(link, "city=philly")
    page = site.client.post(f"{link}/say", data=stale)
    assert page.status_code == 409
    assert 'value="from the other window"' in page.text
    assert site.session(link).messages == 1
    site.say(link, "bye")
    site.take(link, "rate", **RATED)
    page = site.client.post(f"{link}/say", data=stale)
    assert "Conversation 2 of 2" in page.text
    assert "the other window" not in page.text  # no text goes into the next conversation


@pytest.mark.parametrize("text", ["crash", "city=philly"])
def test_an_agent_out_of_order_and_a_full_disk_lose_no_text(site, text):
    link = site.enroll()
    form = site.form(link, text=text)
    site.store.rows("PRAGMA query_only = ON")  # nothing can be written
    page = site.client.post(f"{link}/say", data=form)
    site.store.rows("PRAGMA query_only = OFF")
    assert page.status_code == 503
    assert f'value="{text}"' in page.text
    again = {**form, "text": "city=philly"}  # by the same nonce
    assert f'value="{form["nonce"]}"' in page.text
    assert site.client.post(f"{link}/say", data=again).status_code == 200


@pytest.mark.parametrize(
    ("texts", "ended_by", "reasons"),
    [
        (["city=philly"], "person", {"no offer"}),
        (["bye"], "agent", {"no offer"}),
        (["hello"] * 20, "turns", {"no offer", "out of turns"}),
    ],
)
def test_a_conversation_is_ended_once_by_agent_person_or_length(site, texts, ended_by, reasons):
    link = site.enroll()
    page = site.say(link, *texts)
    assert ("has ended" in page.text) == (ended_by != "person")
    assert "has ended" in site.take(link, "end").text
    session = site.session(link)
    assert (session.ended_by, session.success) == (ended_by, False)
    assert reasons <= set(session.reasons)


def test_a_rating_counts_once(site):
    link = site.enroll()
    site.say(link, "bye")
    one, other = (site.form(link, **RATED) for _ in range(2))
    forms = (one, one, {**other, "overall": "1", "verdict": "no"})
    answers = [site.client.post(f"{link}/rate", data=form) for form in forms]
    assert [answer.status_code for answer in answers] == [200, 200, 409]
    rated = site.store.sessions(link.removeprefix("/p/"))[0]
    assert (rated.ratings["overall"], rated.verdict) == (4, True)


def test_who_consents_is_enrolled_once(site):
    form = site.form(site.join)
    assert site.client.post(site.join, data=form).status_code == 422
    site.store.rows("PRAGMA query_only = ON")  # nothing can be written
    assert site.client.post(site.join, data={**form, "consent": "yes"}).status_code == 503
    site.store.rows("PRAGMA query_only = OFF")
    assert site.store.progress()[0]["enrolled"] == 0
    links = {str(site.client.post(site.join, data={**form, "consent": "yes"}).url) for _ in "12"}
    assert len(links) == 1
    assert site.store.progress()[0]["enrolled"] == 1


def test_the_researcher_sees_progress_and_beliefs_turn_by_turn(site):
    link = site.enroll()
    number, agent = site.session(link).id, site.session(link).agent
    assert "<dt>ratings</dt><dd>not yet</dd>" in site.client.get(f"{site.researcher}/{number}").text
    assert "<dd>1 <small>have not, and did something" in site.client.get(site.researcher).text
    site.store.rows("UPDATE person SET active = 0")
    assert "<dt>left</dt><dd>1 <small>" in site.client.get(site.researcher).text
    steps = [("say", {"text": "city=philly"}), ("say", {"text": "bye"}), ("rate", RATED)]
    for (step, given), begun_ended_rated in zip(steps, ("100", "110", "111"), strict=True):
        site.take(link, step, **given)
        page = site.client.get(site.researcher).text
        rows = re.findall(r'row">(secret-\w+)</th><td>(\d)</td><td>(\d)</td><td>(\d)</td>', page)
        counts = {name: "".join(row) for name, *row in rows}
        assert counts.pop(agent) == begun_ended_rated
        assert list(counts.values()) == ["000"]
    turn = site.client.get(f"{site.researcher}/{number}").text
    assert "Your goal" not in turn
    ratings = [f"<dt>{scale}</dt><dd>4 of 5</dd>" for scale in SCALES]
    person = ("The person's goal", "<dt>own verdict</dt><dd>yes</dd>", *ratings)
    agent = ("inform(city=philly)", "request(city)", "0.562", "1.00 to 1.50", "0.750")
    for shown in (*person, *agent):
        assert shown in turn
