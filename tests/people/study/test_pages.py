"""The pages that people see, from the first to the last."""

from __future__ import annotations

import re
from contextlib import closing
from dataclasses import replace
from html import escape
from urllib.parse import urlencode

import pytest
from starlette.testclient import TestClient

from bbq_torchrl.people.study.records import SCALES
from bbq_torchrl.people.study.store import Store
from bbq_torchrl.people.study.web import JOIN, application

from .conftest import RATED
from .fakes import FakeTalker, prints, script

HOSTILE = (
    "<script>alert(1)</script>",
    "{{ 7 * 7 }} {% raw %}",
    "\u202egnirts a\u202c אבג",
    "🎬🍿",
    "nul\x00inside",
    "lone \ud800 surrogate",
)


def test_a_person_goes_from_consent_to_thanks(site):
    consent = site.client.get(site.join).text
    assert "What you write is stored." in consent
    assert "2 conversations" in consent
    link = site.enroll()
    for number in (1, 2):
        page = site.client.get(link).text
        assert f"Conversation {number} of 2" in page
        assert "You speak first" in page
        assert (
            "has ended" in site.say(link, *script(site.talker.domain, site.goal(link)), "bye").text
        )
        site.take(link, "rate", **RATED)
    assert "Thank you" in site.client.get(link).text
    rows = site.store.rows("SELECT ended_by, success, reasons FROM session LIMIT 2")
    assert rows == [("agent", 1, "[]")] * 2


def test_the_goal_card_shows_wishes_and_questions_as_the_talker_spells_and_calls_them(site):
    link, labels = site.enroll(), site.talker.labels
    page, goal = site.client.get(link).text, site.goal(link)
    for slot, value in goal.constraints.items():
        assert f"<dt>{labels.get(slot, slot)}</dt>" in page
        assert f"{escape(value).replace('&#x27;', '&#39;')}</dd>" in page
    for slot in goal.requests:
        assert labels.get(slot, slot) in page


def test_no_answer_names_agent_weights_or_values(site):
    answers = [site.client.get(site.join)]
    link = site.enroll()
    answers += [site.client.get(link), *(site.say(link, text) for text in ("city=philly", "crash"))]
    answers += [site.say(link, "bye"), *(site.take(link, "rate", **form) for form in ({}, RATED))]
    for answer in answers:
        everything = answer.text + repr(answer.headers)
        for secret in ("secret", "vault", "bbqn", "dqn", "0.5625", "1.25", "inform("):
            assert secret not in everything


def rules(css, selector):
    """The declarations of a selector in the style sheet."""
    css = re.sub(r"/\*.*?\*/", "", css, flags=re.DOTALL)
    found = re.findall(rf"^{re.escape(selector)} {{(.*?)}}", css, flags=re.DOTALL | re.MULTILINE)
    pairs = (part.split(":", 1) for text in found for part in text.split(";") if part.strip())
    return {name.strip(): value.strip() for name, value in pairs}


def test_the_goal_card_stays_in_sight_and_can_be_closed(site):
    css = site.client.get("/static/study.css").text
    card = rules(css, "details.card")
    assert (card["position"], card["top"], card["overflow-y"]) == ("sticky", "0", "auto")
    assert 20 <= int(card["max-height"].removesuffix("vh")) <= 50  # leaves room for messages
    assert rules(css, ".card")["background"] == "#fff"  # messages do not shine through
    link = site.enroll()
    site.say(link, "city=philly", "bye")
    for page in (site.client.get(site.enroll()).text, site.client.get(link).text):
        opened = '<details class="card" open data-conversation="1">'
        [inside] = re.findall(rf"{opened}(.*?)</details>", page, flags=re.DOTALL)
        assert "<summary><h2>Your goal</h2></summary>" in inside
        assert "<dl>" in inside
        # Sticks to the top of all of the page: nothing around it is shorter than that.
        assert page.index("<main>") < page.index(opened)
        assert "<div" not in page[page.index("<main>") : page.index(opened)]


def test_a_scale_is_one_line(site):
    css = site.client.get("/static/study.css").text
    assert rules(css, ".scale")["display"] == "flex"
    assert "flex-wrap" not in rules(css, ".scale")
    assert rules(css, ".scale label")["flex-direction"] == "column"  # a number below its button
    link = site.enroll()
    page = site.say(link, "bye").text
    scales = re.findall(r'<div class="scale"><span>worst</span>(.*?)</div>', page, flags=re.DOTALL)
    values = [re.findall(r'name="(\w+)" value="(\d)"', scale) for scale in scales]
    assert values == [[(name, value) for value in "12345"] for name in SCALES]


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_text_is_stored_and_shown_as_text(site, text):
    link = site.enroll()
    page = site.client.post(
        f"{link}/say",
        content=urlencode(site.form(link, text=text), errors="surrogatepass"),
        headers={"content-type": "application/x-www-form-urlencoded"},
    )
    assert page.status_code == 200
    assert "Which city?" in page.text
    assert "<script>alert" not in page.text
    [stored] = site.store.exchanges(site.session(link).id)
    assert "\x00" not in stored.text
    if text.isprintable():
        assert stored.text == text


@pytest.mark.parametrize(
    ("said", "step", "given", "status", "sentence"),
    [
        *(
            (
                [],
                "say",
                {"text": text},
                422,
                "Your message was not sent: a message must have at least one word",
            )
            for text in ("", "   ", "\x00", "\u202e")
        ),
        (
            [],
            "say",
            {"text": "x" * 1_001},
            422,
            "may have at most 1,000 characters, this one has 1,001",
        ),
        ([], "end", {}, 409, "Please say something to the assistant before you end."),
        (["city=philly"], "rate", RATED, 409, "Please end the conversation before you rate it."),
        (["bye"], "say", {"text": "more"}, 409, "That conversation has ended"),
        (["bye"], "rate", {**RATED, "verdict": ""}, 422, "got what you wanted: yes or no"),
        *(
            (["bye"], "rate", {**RATED, "coherence": given}, 422, f"coherence by a whole {told}")
            for given in ("0", "6", "4.0", "٣", "")
            if (told := f"number from 1 to 5, got {given or 'nothing'}.")
        ),
    ],
)
def test_a_step_that_cannot_be_taken_is_refused_in_a_sentence_and_changes_nothing(
    site, said, step, given, status, sentence
):
    link = site.enroll()
    for text in said:
        site.say(link, text)
    before = site.session(link)
    page = site.take(link, step, **given)
    assert (page.status_code, 'role="alert"' in page.text) == (status, True)
    assert sentence in page.text
    assert page.text.count(" checked") == (4 if status == 422 and said else 0)  # what was right
    assert site.session(link) == before
    assert site.talker.calls == len(said)


def test_a_second_window_is_told_that_the_conversation_went_on(site):
    link = site.enroll()
    stale = site.form(link, text="from the other window")
    site.say(link, "city=philly")
    page = site.client.post(f"{link}/say", data=stale)
    assert page.status_code == 409
    assert "continued in another window" in page.text
    assert 'value="from the other window"' in page.text
    assert site.session(link).messages == 1
    assert site.say(link, "from the other window").status_code == 200
    assert site.session(link).messages == 2


def test_a_text_of_an_earlier_conversation_is_not_put_into_the_next(site):
    link = site.enroll()
    stale = site.form(link, text="too late")
    site.say(link, "bye")
    site.take(link, "rate", **RATED)
    page = site.client.post(f"{link}/say", data=stale)
    assert "Conversation 2 of 2" in page.text
    assert "too late" not in page.text


@pytest.mark.parametrize(("text", "status"), [("crash", 500), ("city=philly", 503)])
def test_an_agent_out_of_order_and_a_full_disk_lose_no_text(site, text, status):
    link = site.enroll()
    form = site.form(link, text=text)
    site.store.rows("PRAGMA query_only = ON")  # nothing can be written
    page = site.client.post(f"{link}/say", data=form)
    site.store.rows("PRAGMA query_only = OFF")
    assert page.status_code == status
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
    assert site.store.rows("SELECT overall, verdict FROM rating") == [(4, 1)]


def test_who_consents_is_enrolled_once(site):
    form = site.form(site.join)
    assert site.client.post(site.join, data=form).status_code == 422
    assert site.store.progress()[0]["enrolled"] == 0
    links = {str(site.client.post(site.join, data={**form, "consent": "yes"}).url) for _ in "12"}
    assert len(links) == 1
    assert site.store.progress()[0]["enrolled"] == 1


@pytest.mark.parametrize("retention", ["", "until the end of 2027"])
def test_the_consent_page_tells_what_is_stored_for_how_long_and_how_it_is_deleted(study, retention):
    store = Store(study.data, terms := replace(study.terms, retention=retention), prints(study))
    app = application(replace(study, terms=terms), store, FakeTalker(study.domain))
    with closing(store), TestClient(app) as client:
        page = client.get(f"/join/{store.key(JOIN)}").text
    assert "Stored are what you write" in page
    assert "deleted, send them your own link" in page
    kept = "They are kept until the end of 2027." if retention else "know how long they are kept"
    assert kept in page


def test_who_wants_to_join_with_too_many_is_told_to_wait(site):
    site.store._terms = replace(site.study.terms, joins_per_minute=1)
    site.enroll()
    form = site.form(site.join, consent="yes")
    page = site.client.post(site.join, data=form)
    assert page.status_code == 429
    assert "Please begin again in a minute." in page.text
    assert "<button>Begin</button>" in page.text
    site.store.rows("UPDATE person SET enrolled = enrolled - 60")
    assert "/p/" in str(site.client.post(site.join, data=form).url)


def test_the_researcher_sees_progress_and_beliefs_turn_by_turn(site):
    link = site.enroll()
    number, agent = site.session(link).id, site.session(link).agent
    steps = [("say", {"text": "city=philly"}), ("say", {"text": "bye"}), ("rate", RATED)]
    for (step, given), begun_ended_rated in zip(steps, ("100", "110", "111"), strict=True):
        site.take(link, step, **given)
        page = site.client.get(site.researcher).text
        counts = re.findall(r'row">(secret-\w+)</th><td>(\d)</td><td>(\d)</td><td>(\d)</td>', page)
        other = next(name for name in site.study.terms.agents if name != agent)
        assert {name: "".join(row) for name, *row in counts} == {
            agent: begun_ended_rated,
            other: "000",
        }
    turn = site.client.get(f"{site.researcher}/{number}").text
    assert "Your goal" not in turn
    ratings = [f"<dt>{scale}</dt><dd>4 of 5</dd>" for scale in SCALES]
    person = ("The person's goal", "<dt>own verdict</dt><dd>yes</dd>", *ratings)
    for shown in (
        *person,
        "inform(city=philly)",
        "request(city)",
        "0.562",
        "1.00 to 1.50",
        "0.750",
    ):
        assert shown in turn
    for wrong in ("999", "9" * 20, "9" * 5_000, "-1", "one", "1.0", "%D9%A1"):
        assert site.client.get(f"{site.researcher}/{wrong}").status_code == 404


def test_the_researcher_is_told_what_is_counted(site):
    link = site.enroll()
    assert "<dd>1 <small>have not, and did something in the last 60 minutes<" in (
        site.client.get(site.researcher).text
    )
    site.store.rows("UPDATE person SET active = 0")
    assert re.search(
        r"<dt>left</dt><dd>1 <small>.*their places are free", site.client.get(site.researcher).text
    )
    number = site.session(link).id
    assert "<dt>ratings</dt><dd>not yet</dd>" in site.client.get(f"{site.researcher}/{number}").text
