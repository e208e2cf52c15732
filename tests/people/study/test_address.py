"""Addresses: where a server listens, where people reach it, whose forms it takes."""

import re
import socket
from contextlib import closing

import pytest
from tables import rows

from bbq_torchrl.people.study.__main__ import listen, main
from bbq_torchrl.people.study.plan import ADDRESS, Address

from .conftest import RATED, published
from .served import free_port

URL = "https://lab.example/study/"


TO_SERVER = {"base_url": "http://127.0.0.1:8000", "follow_redirects": False}


@pytest.mark.parametrize(("url", "origin", "prefix"), rows(__file__, "addresses.txt"))
def test_an_address_is_read_as_browsers_write_its_origin_or_refused(url, origin, prefix):
    assert ADDRESS.test(url) == (origin != "refused")
    assert origin == "refused" or Address.of(url) == Address(origin, prefix)


@pytest.mark.parametrize(
    ("url", "origin", "host", "fetched", "status"), rows(__file__, "forms.txt")
)
def test_a_form_is_taken_from_pages_of_the_study_alone(
    study, caplog, url, origin, host, fetched, status
):
    given = {"origin": origin, "host": host, "sec-fetch-site": fetched}
    headers = {name: value.strip("'") for name, value in given.items() if value}
    with published(study, url=url, client=TO_SERVER) as site:
        form = site.form(site.join, consent="yes")
        answer = site.client.post(site.join, data=form, headers=headers)
        assert answer.status_code == int(status)
        assert site.store.progress()[0]["enrolled"] == (status == "303")
    name = "bbq_torchrl.people.study.web"
    told = [text for logger, level, text in caplog.record_tuples if logger == name]
    # Only where url may be missing: such a server has another name than the browser's.
    assert len(told) == (status == "403" and not fetched)


@pytest.mark.parametrize("inner", ["", "/study"], ids=["prefix stripped", "prefix kept"])
def test_all_ways_of_a_person_and_the_researcher_begin_with_the_prefix(study, inner):
    with published(study, url=URL) as site:

        def arrives(way):
            assert way.startswith("/study/")
            return inner + way.removeprefix("/study")

        site.join, site.researcher = f"{inner}{site.join}/", f"{inner}{site.researcher}/"
        link = arrives(site.enroll())
        pages = [site.client.get(site.join), site.client.get(link), site.say(link, "bye")]
        pages += [site.take(link, "rate", **RATED), site.client.get(site.researcher)]
        for page in pages:
            assert page.status_code == 200
            for way in re.findall(r'(?:href|src|action)="(/[^"]*)"', page.text):
                assert site.client.get(arrives(way)).status_code in (200, 405)  # a form is sent
        assert "Conversation 2 of 2" in pages[3].text


def test_a_port_in_use_is_a_sentence_before_anything_loads(tmp_path, capsys):
    with closing(listen("127.0.0.1", port := free_port())):
        # Who connects while the agents load waits, and is served.
        socket.create_connection(("127.0.0.1", port), timeout=5).close()
        # Neither the study nor the talker is there.
        command = ["serve", str(tmp_path / "no.yaml"), "--talker", "no:no", "--port", str(port)]
        assert main(command) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert f"--port {port}" in said.err
