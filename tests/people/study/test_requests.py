"""Requests that no browser of an honest person sends."""

import asyncio
from concurrent.futures import ThreadPoolExecutor

import pytest

FORM = {"content-type": "application/x-www-form-urlencoded"}


def talk(site):
    link = site.enroll()
    return link, site.form(link, text="city=philly")


def test_wrong_guessed_and_other_links_get_the_same_page(site):
    token = site.enroll().removeprefix("/p/")
    other = site.researcher.removeprefix("/r/")
    paths = (
        f"/p/{token[:-1]}{'A' if token[-1] != 'A' else 'B'}",
        *("/p/1", f"/p/{'x' * 5_000}", f"/p/{other}", f"/r/{token}", f"/join/{token}"),
        *("/p/%00", "/p/%ff%fe", "/", "/nothing", "/static/../study.sqlite", "/static/nothing"),
        *("/static", "/static/", f"/r/{token}/1"),
        *(f"/r/{other}/{session}" for session in ("999", "9" * 5_000, "-1", "one", "%D9%A1")),
    )
    pages = [site.client.get(path) for path in paths]
    assert {page.status_code for page in pages} == {404}
    assert len({page.text for page in pages}) == 1
    assert len({tuple(sorted(page.headers)) for page in pages}) == 1


@pytest.mark.parametrize("step", ["say", "end", "rate"])
def test_a_form_of_no_session_of_theirs_or_without_a_nonce_is_refused(site, step):
    link, form = talk(site)
    wrong = [{"session": session} for session in ("0", "2", "99", "-1", "one", "")]
    wrong += [{"nonce": nonce} for nonce in ("", "short", "x" * 41, "ä" * 22)]
    for changed in wrong:
        page = site.client.post(f"{link}/{step}", data={**form, **changed})
        assert page.status_code == 400
        assert ("incomplete" in page.text) == ("nonce" in changed)
    assert site.talker.calls == 0


def test_what_is_no_form_of_ours_is_refused(site):
    link, form = talk(site)
    assert site.client.post(f"{link}/delete", data=form).status_code == 404
    assert site.client.put(link, data=form).status_code == 405
    large = {"content": b"text=" + b"x" * 10_000_000, "headers": FORM}
    for sent, status in ((large, 413), ({"json": form}, 400), ({"files": {"text": b"x"}}, 400)):
        assert site.client.post(f"{link}/say", **sent).status_code == status
    assert site.talker.calls == 0


PART = {"type": "http.request", "body": b"text=x", "more_body": True}
END = {"type": "http.request", "body": b"", "more_body": False}
GONE = {"type": "http.disconnect"}


@pytest.mark.parametrize(
    ("messages", "seconds", "headers", "status"),
    [
        # To its end: else the connection is reset, and a proxy such as Caddy loses the answer.
        ([PART, END], 0.0, {"origin": "http://evil.example"}, 403),
        ([PART] * 9, 0.02, {}, 408),
        ([PART, GONE], 0.0, {}, 400),
    ],
    ids=["foreign", "slow", "half"],
)
def test_a_form_is_read_to_its_end_in_time_or_not_taken(
    site, monkeypatch, messages, seconds, headers, status
):
    monkeypatch.setattr("bbq_torchrl.people.study.web.BODY_SECONDS", 0.05)
    left, sent = list(messages), []

    async def receive():
        await asyncio.sleep(seconds)
        return left.pop(0)

    async def send(message):
        sent.append(message)

    scope = {
        **{"type": "http", "method": "POST", "path": f"{site.enroll()}/say", "query_string": b""},
        "headers": [(name.encode(), value.encode()) for name, value in (FORM | headers).items()],
    }
    asyncio.run(asyncio.wait_for(site.client.app(scope, receive, send), 5))
    assert sent[0]["status"] == status
    assert (left == []) == (status != 408)
    assert site.talker.calls == 0


def test_every_answer_has_the_security_headers_and_nothing_inline_or_of_other_hosts(site):
    link, form = talk(site)
    evil = {"origin": "http://evil.example"}
    answers = [
        site.client.post(f"{link}/say", data=form, follow_redirects=False),
        site.client.post(f"{link}/say", data=form, headers=evil),
        site.client.get("/nothing"),
        *map(site.client.get, (link, "/static/study.css", site.join)),
        site.client.get(f"{site.researcher}/{site.session(link).id}"),
    ]
    assert [answer.status_code for answer in answers] == [303, 403, 404, 200, 200, 200, 200]
    for answer in answers:
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'none'")
        assert "unsafe" not in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert "set-cookie" not in answer.headers
        for text in ("<style", " style=", "<script>", " onclick", "http://", "https://"):
            assert text not in answer.text


def test_many_enrollments_at_once_fill_the_places_and_no_more(site):
    forms = [site.form(site.join, consent="yes") for _ in range(40)]
    with ThreadPoolExecutor(20) as pool:
        answers = list(pool.map(lambda form: site.client.post(site.join, data=form), forms))
    counts = {status: [a.status_code for a in answers].count(status) for status in (200, 409)}
    assert counts == {200: 5, 409: 35}
    places = site.store.rows("SELECT place FROM person ORDER BY place")
    assert places == [(place,) for place in range(5)]


def test_a_double_click_is_one_message_and_one_answer(site):
    link, form = talk(site)
    site.talker.seconds = 0.05
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda _: site.client.post(f"{link}/say", data=form), range(8)))
    assert {answer.status_code for answer in answers} == {200}
    assert site.talker.calls == 1
