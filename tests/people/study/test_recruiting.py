"""People who come by a link with an id, and are paid by it; and files of before there were ids."""

from __future__ import annotations

import csv
import re
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from starlette.testclient import TestClient

import bbq_torchrl
from bbq_torchrl.people.study.__main__ import main
from bbq_torchrl.people.study.database import reading
from bbq_torchrl.people.study.export import backup, forget
from bbq_torchrl.people.study.plan import Terms
from bbq_torchrl.people.study.records import current
from bbq_torchrl.people.study.report import write_report
from bbq_torchrl.people.study.results import read_results
from bbq_torchrl.people.study.store import Store
from bbq_torchrl.people.study.web import application

from .conftest import RATED, Site, hidden
from .fakes import FakeTalker, prints

RECRUITING = {
    "join_parameters": ("PROLIFIC_PID", "STUDY_ID"),
    "completion_code": "C<1>23",
    "completion_url": 'https://pay.example/done?cc=C123&x="',
}
ID = "5f1a0c3b9d8e7f6a5b4c3d2e"


@pytest.fixture
def recruiting(study):
    study = replace(study, terms=replace(study.terms, **RECRUITING))
    with closing(Store(study.data, study.terms, prints(study))) as store:
        app = application(study, store, talker := FakeTalker(study.domain))
        with TestClient(app, raise_server_exceptions=False) as client:
            yield Site(study, client, store, talker)


def join(site, query):
    """Goes through the consent page of a link, as a browser does: a form without an address."""
    link = f"{site.join}?{query}"
    page = site.client.get(link)
    assert page.status_code == 200
    form = page.text[page.text.index("<form") : page.text.index("</form>")]
    assert "action" not in form
    return site.client.post(link, data={**hidden(page.text), "consent": "yes"})


def finish(site, link):
    for _ in range(2):
        site.say(link, "bye")
        page = site.take(link, "rate", **RATED)
    return page


def test_the_same_id_is_one_person_with_one_link_from_any_browser(recruiting):
    site = recruiting
    first = join(site, f"PROLIFIC_PID={ID}&STUDY_ID=s1&other=x")
    site.say(first.url.path, "city=philly")
    again = join(site, f"STUDY_ID=s2&PROLIFIC_PID={ID}")
    assert again.url.path == first.url.path
    assert "city=philly" in again.text
    assert site.store.progress()[0]["enrolled"] == 1
    stored = site.store.rows("SELECT participant, ids FROM recruited")
    assert stored == [(ID, f'{{"PROLIFIC_PID": "{ID}", "STUDY_ID": "s1"}}')]
    assert join(site, "PROLIFIC_PID=another").url.path != first.url.path


def test_one_id_from_many_browsers_at_once_gets_one_place(recruiting):
    site = recruiting
    link = f"{site.join}?PROLIFIC_PID={ID}"
    forms = [{**hidden(site.client.get(link).text), "consent": "yes"} for _ in range(12)]
    with ThreadPoolExecutor(12) as pool:
        answers = list(pool.map(lambda form: site.client.post(link, data=form), forms))
    assert {answer.status_code for answer in answers} == {200}
    assert len({answer.url.path for answer in answers}) == 1
    assert site.store.rows("SELECT COUNT(*) FROM person") == [(1,)]
    assert site.store.rows("SELECT COUNT(*) FROM recruited") == [(1,)]


@pytest.mark.parametrize(
    ("query", "problem"),
    [
        ("", "PROLIFIC_PID is missing"),
        ("STUDY_ID=s1", "PROLIFIC_PID is missing"),
        ("PROLIFIC_PID=", "PROLIFIC_PID is missing"),
        ("prolific_pid=a", "PROLIFIC_PID is missing"),
        ("PROLIFIC_PID=a&PROLIFIC_PID=b", "PROLIFIC_PID comes more than once"),
        ("PROLIFIC_PID=a&STUDY_ID=b&STUDY_ID=b", "STUDY_ID comes more than once"),
        *(
            (f"PROLIFIC_PID={value}", "PROLIFIC_PID is no id of up to 128 letters, digits and")
            for value in ("x" * 129, "x" * 10_240, "a b", "%00", "%F0%9F%8E%AC", "-1", "%3Dcmd()")
        ),
        ("PROLIFIC_PID={{%25PROLIFIC_PID%25}}", "PROLIFIC_PID is no id"),
        ("PROLIFIC_PID=<script>", "PROLIFIC_PID is no id"),
        (f"PROLIFIC_PID=a&STUDY_ID={'x' * 129}", "STUDY_ID is no id"),
    ],
)
def test_a_link_without_a_usable_id_is_refused_in_a_page_and_takes_no_place(
    recruiting, query, problem
):
    site = recruiting
    form = {**hidden(join_page(site)), "consent": "yes"}
    link = f"{site.join}?{query}"
    for answer in (site.client.get(link), site.client.post(link, data=form)):
        assert answer.status_code == 400
        assert f"In the link to this page {problem}" in answer.text
        assert "open the study once more from where you were invited" in answer.text
        assert "<form" not in answer.text
        assert len(answer.text) < 2_000
    assert site.store.progress()[0]["enrolled"] == 0


def join_page(site):
    return site.client.get(f"{site.join}?PROLIFIC_PID=a").text


@pytest.mark.parametrize("value", [ID, "x" * 128, "ann.lee%2Bstudy@lab.example", "_1~2:3=4-5"])
def test_ids_of_panels_and_labs_are_taken(recruiting, value):
    assert "/p/" in str(join(recruiting, f"PROLIFIC_PID={value}").url)


def test_code_and_link_come_at_the_end_and_no_sooner(recruiting):
    site = recruiting
    pages = [site.client.get(f"{site.join}?PROLIFIC_PID={ID}")]
    pages.append(join(site, f"PROLIFIC_PID={ID}"))
    link = pages[-1].url.path
    pages += [site.say(link, "bye"), site.take(link, "rate", **RATED), site.say(link, "bye")]
    for page in pages:
        assert "C&lt;1&gt;23" not in page.text
        assert "pay.example" not in page.text
    for page in (site.take(link, "rate", **RATED), join(site, f"PROLIFIC_PID={ID}")):
        assert "<code>C&lt;1&gt;23</code>" in page.text
        [url] = re.findall(r'<a href="([^"]*)" rel="noreferrer">', page.text)
        assert url == "https://pay.example/done?cc=C123&amp;x=&#34;"
        assert "You can close this page" not in page.text


def test_a_study_without_code_and_link_ends_as_before(site):
    page = finish(site, site.enroll()).text
    assert "You can close this page." in page
    assert "code" not in page
    assert "<a " not in page


def test_people_are_told_which_parameters_are_stored(recruiting):
    page = join_page(recruiting)
    assert "with it PROLIFIC_PID, STUDY_ID of the link that brought you here" in page


def test_no_page_agent_or_report_has_an_id(recruiting, tmp_path):
    site, seen = recruiting, []
    reply = site.talker.reply
    site.talker.reply = lambda *given: seen.append(repr(given)) or reply(*given)
    page = join(site, f"PROLIFIC_PID={ID}&STUDY_ID=s1secret")
    link, number = page.url.path, site.session(page.url.path).id
    pages = [page, finish(site, link), site.client.get(site.researcher)]
    pages.append(site.client.get(f"{site.researcher}/{number}"))
    write_report(tmp_path / "report", read_results(site.study.data))
    texts = [page.text for page in pages] + seen
    texts += [file.read_bytes().decode("latin-1") for file in (tmp_path / "report").iterdir()]
    assert len(texts) > 8
    assert not any(ID in text or "s1secret" in text for text in texts)


def rows(file):
    return list(csv.DictReader(file.read_text(encoding="utf-8-sig").splitlines()))


def test_the_researcher_learns_who_has_finished(recruiting, tmp_path, capsys):
    site = recruiting
    finish(site, join(site, f"PROLIFIC_PID={ID}&STUDY_ID=s1").url.path)
    join(site, "PROLIFIC_PID=another")
    forgotten = site.session(join(site, "PROLIFIC_PID=forgotten").url.path).person
    forget(site.study.data, forgotten)
    assert main(["participants", str(site.study.path)]) == 0
    file = tmp_path / "study-participants.csv"
    assert f"2 people: {file}" in capsys.readouterr().out
    assert file.stat().st_mode & 0o777 == 0o600
    one, other = rows(file)
    name = read_results(site.study.data).sessions[0].person
    shown = ("person", "name_in_report", *RECRUITING["join_parameters"], "rated", "finished")
    assert [one[key] for key in shown] == ["1", name, ID, "s1", "2", "1"]
    assert [other[key] for key in shown][2:] == ["another", "", "0", "0"]
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", one["joined"])


def test_a_list_of_people_replaces_no_other_file(recruiting, capsys):
    file = recruiting.study.data
    assert main(["participants", str(recruiting.study.path), "--out", str(file)]) == 2
    assert "--out: it must be a file that ends with .csv, got " in capsys.readouterr().err
    join(recruiting, "PROLIFIC_PID=a")


def test_of_a_forgotten_person_no_id_is_left_and_they_may_come_again(recruiting):
    site = recruiting
    link = join(site, f"PROLIFIC_PID={ID}").url.path
    forget(site.study.data, link)
    for file in site.study.data.parent.glob("study.sqlite*"):
        assert ID.encode() not in file.read_bytes()
    assert site.client.get(link).status_code == 404
    again = join(site, f"PROLIFIC_PID={ID}").url.path
    assert site.session(again).person == "2"


@pytest.fixture
def old(study):
    """A study of version 1 of its file, in the midst of its conversations."""
    script = Path(__file__).with_name("version_1.sql").read_text(encoding="utf-8")
    with closing(sqlite3.connect(study.data)) as connection:
        connection.executescript(script)
        connection.execute("UPDATE study SET package = ?", (bbq_torchrl.__version__,))
        connection.commit()
        [terms] = connection.execute("SELECT terms FROM study").fetchone()
    return replace(study, terms=Terms.of(terms))


def version(data):
    with closing(sqlite3.connect(data)) as connection:
        return connection.execute("PRAGMA user_version").fetchone()[0]


def test_an_old_study_goes_on_and_may_recruit_from_now_on(old):
    terms = replace(old.terms, **RECRUITING, url="https://lab.example/study/")
    token = "f7PoE-H2A_Og5sN8JeDiM_mypyiN8H4o"
    with closing(Store(old.data, terms, prints(old))) as store:
        session = current(store.sessions(token))
        assert (session.position, session.person) == (2, "1")
        assert [said.text for said in store.exchanges(1)] == ["city=philly", "bye"]
        assert store.enroll("nonce-number-0000000000") == token
        new = store.enroll("nonce-number-0000000099", {"PROLIFIC_PID": ID})
        assert store.sessions(new)[0].person == "3"
    assert version(old.data) == 2
    with closing(Store(old.data, terms, prints(old))) as store:
        assert store.enroll("another-nonce-0000000099", {"PROLIFIC_PID": ID}) == new


def test_an_old_study_is_read_copied_and_people_are_deleted_from_it_as_it_is(old, tmp_path):
    backup(old.data, tmp_path / "copy.sqlite")
    assert main(["participants", str(old.path)]) == 0
    listed = rows(tmp_path / "study-participants.csv")
    assert [(row["person"], row["rated"], row["finished"]) for row in listed] == [
        *(("1", "1", "0"), ("2", "0", "0"))
    ]
    assert len(read_results(old.data).sessions) == 1
    assert forget(old.data, "1") == 1
    assert read_results(old.data).sessions == ()
    assert version(old.data) == 1
    with reading(tmp_path / "copy.sqlite") as connection:
        assert connection.execute("SELECT COUNT(*) FROM exchange").fetchone() == (3,)
