"""People who come by a link with an id, and are paid by it."""

import csv
import json
import re

import pytest
from tables import rows

from bbq_torchrl.people.study.__main__ import main
from bbq_torchrl.people.study.export import forget
from bbq_torchrl.people.study.outcomes import read_outcomes
from bbq_torchrl.people.study.report import write_report

from .conftest import RATED, hidden, published

RECRUITING = {
    "join_parameters": ["PROLIFIC_PID", "STUDY_ID"],
    "completion_code": "C<1>23",
    "completion_url": 'https://pay.example/done?cc=C123&x="',
}
ID = "5f1a0c3b9d8e7f6a5b4c3d2e"


@pytest.fixture
def recruiting(study):
    with published(study, **RECRUITING) as site:
        yield site


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
    [(stored,)] = site.store.rows("SELECT ids FROM person")
    assert json.loads(stored) == {"PROLIFIC_PID": ID, "STUDY_ID": "s1"}
    assert join(site, "PROLIFIC_PID=another").url.path != first.url.path


@pytest.mark.parametrize(("query", "name"), rows(__file__, "links.txt"))
def test_a_link_without_a_usable_id_is_refused_in_a_page_and_takes_no_place(
    recruiting, query, name
):
    site = recruiting
    form = {**hidden(site.client.get(f"{site.join}?PROLIFIC_PID=a").text), "consent": "yes"}
    link = f"{site.join}?{query.replace('LONG', 'x' * 129)}"
    for answer in (site.client.get(link), site.client.post(link, data=form)):
        assert answer.status_code == 400
        assert name in answer.text
        assert "<form" not in answer.text
        assert len(answer.text) < 2_000
    assert site.store.progress()[0]["enrolled"] == 0


@pytest.mark.parametrize("value", [ID, "x" * 128, "ann.lee%2Bstudy@lab.example", "_1~2:3=4-5"])
def test_ids_of_panels_and_labs_are_taken(recruiting, value):
    assert "/p/" in str(join(recruiting, f"PROLIFIC_PID={value}").url)


def test_code_and_link_come_at_the_end_and_no_sooner(recruiting):
    site = recruiting
    pages = [site.client.get(f"{site.join}?PROLIFIC_PID={ID}")]
    assert "invitation knows you (PROLIFIC_PID, STUDY_ID)" in pages[0].text
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


def test_no_page_agent_or_report_has_an_id(recruiting, tmp_path):
    site, seen = recruiting, []
    reply = site.talker.reply
    site.talker.reply = lambda *given: seen.append(repr(given)) or reply(*given)
    page = join(site, f"PROLIFIC_PID={ID}&STUDY_ID=s1secret")
    link, number = page.url.path, site.session(page.url.path).id
    pages = [page, finish(site, link), site.client.get(site.researcher)]
    pages.append(site.client.get(f"{site.researcher}/{number}"))
    write_report(tmp_path / "report", read_outcomes(site.study.data))
    texts = [page.text for page in pages] + seen
    texts += [file.read_bytes().decode("latin-1") for file in (tmp_path / "report").iterdir()]
    assert len(texts) > 8
    assert not any(ID in text or "s1secret" in text for text in texts)


def test_the_researcher_learns_who_has_finished(recruiting, tmp_path, capsys):
    site = recruiting
    finish(site, join(site, f"PROLIFIC_PID={ID}&STUDY_ID=s1").url.path)
    join(site, "PROLIFIC_PID=another")
    forgotten = site.session(join(site, "PROLIFIC_PID=unwanted").url.path).person
    forget(site.study.data, forgotten)
    for file in tmp_path.glob("study.sqlite*"):
        assert b"unwanted" not in file.read_bytes()
    command = ["participants", str(site.study.path)]
    assert main(command) == 0
    file = tmp_path / "study-participants.csv"
    assert f"2 people: {file}" in capsys.readouterr().out
    one, other = csv.DictReader(file.read_text(encoding="utf-8-sig").splitlines())
    name = read_outcomes(site.study.data).sessions[0].person
    shown = ("person", "name_in_report", *RECRUITING["join_parameters"], "rated", "finished")
    assert [one[key] for key in shown] == ["1", name, ID, "s1", "2", "1"]
    assert [other[key] for key in shown][2:] == ["another", "", "0", "0"]
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", one["joined"])
