"""Addresses: where a server listens, where people reach it, whose forms it takes."""

from __future__ import annotations

import re
import socket
from contextlib import closing, contextmanager
from dataclasses import replace

import pytest
from starlette.testclient import TestClient

from bbq_torchrl.people.study.__main__ import main
from bbq_torchrl.people.study.address import Address, listen
from bbq_torchrl.people.study.store import Store
from bbq_torchrl.people.study.web import application

from .conftest import RATED, Site, hidden
from .fakes import FakeTalker, prints
from .served import free_port

URL = "https://lab.example/study/"


@contextmanager
def published(study, url, **client):
    """The study at a URL, as a proxy passes requests on."""
    terms = replace(study.terms, url=url)
    with closing(Store(study.data, terms, prints(study))) as store:
        talker = FakeTalker(study.domain)
        app = application(replace(study, terms=terms), store, talker)
        with TestClient(app, raise_server_exceptions=False, **client) as client:
            yield Site(study, client, store, talker)


@pytest.mark.parametrize(
    ("url", "origin", "prefix"),
    [
        ("https://lab.example", "https://lab.example", ""),
        ("HTTPS://Lab.Example:443/Study/", "https://lab.example", "/Study"),
        ("http://10.0.0.5:80", "http://10.0.0.5", ""),
        ("http://[::1]:8000/a/b-c_d.e~f", "http://[::1]:8000", "/a/b-c_d.e~f"),
    ],
)
def test_an_address_is_read_as_browsers_write_its_origin(url, origin, prefix):
    assert Address.of(url) == Address(origin, prefix)


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("127.0.0.1", "http://127.0.0.1:81"),
        ("localhost", "http://localhost:81"),
        ("::1", "http://[::1]:81"),
        ("::", "http://[::1]:81"),
        ("0.0.0.0", "http://127.0.0.1:81"),
        ("", "http://127.0.0.1:81"),
    ],
)
def test_links_without_a_url_can_be_opened_on_this_machine(host, origin):
    assert Address.local(host, 81).link("/p/x") == f"{origin}/p/x"


@pytest.mark.parametrize(
    ("origin", "host", "is_own"),
    [
        ("http://x", "x", True),
        ("https://x", "x:443", True),
        ("http://x", "x:80", True),
        ("https://x:443", "x", True),
        ("http://X:8000", "x:8000", True),
        ("http://[::1]:8000", "[::1]:8000", True),
        ("https://x", "x:80", False),
        ("http://x:8000", "x", False),
        ("http://x.evil", "x", False),
        ("http://none", None, False),
        ("null", "null", False),
        ("", "", False),
        ("ftp://x", "x", False),
        ("http://x", "x\n", False),
    ],
)
def test_without_a_url_a_form_comes_from_the_host_that_it_is_sent_to(origin, host, is_own):
    assert Address().is_own(origin, host) == is_own


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "lab.example", None])
def test_with_a_url_a_form_may_come_from_it_whatever_the_proxy_makes_of_the_host(host):
    address = Address.of(URL)
    assert address.is_own("https://lab.example", host)
    assert not address.is_own("https://evil.example", host)


@pytest.mark.parametrize("strips", [True, False], ids=["prefix stripped", "prefix kept"])
def test_a_person_and_the_researcher_go_all_their_ways_behind_a_prefix(study, strips):
    """Follows only links, forms and redirects of the pages, as a browser does."""
    with published(study, URL, base_url="http://127.0.0.1:8000", follow_redirects=False) as site:

        def get(path):
            assert path.startswith("/study/")
            answer = site.client.get(path.removeprefix("/study") if strips else path)
            assert answer.status_code == 200
            for link in re.findall(r'(?:href|src|action)="(/[^"]*)"', answer.text):
                assert link.startswith("/study/")
            return answer.text

        def post(path, form):
            path = path.removeprefix("/study") if strips else path
            origin = {"origin": "https://lab.example"}
            answer = site.client.post(path, data=form, headers=origin)
            assert answer.status_code == 303
            return answer.headers["location"]

        def act(page):
            return re.search(r'action="([^"]*)"', page)[1]

        join = f"/study{site.join}"
        page = get(join)
        link = post(join, {**hidden(page), "consent": "yes"})
        page = get(link)
        link = post(act(page), {**hidden(page), "text": "bye"})
        page = get(link)
        assert "Conversation 2 of 2" in get(post(act(page), {**hidden(page), **RATED}))
        for file in re.findall(r'(?:href|src)="([^"]*)"', page):
            assert get(file)
        progress = get(f"/study{site.researcher}")
        assert "The person's goal" in get(re.search(r'<a href="([^"]*)"', progress)[1])


@pytest.mark.parametrize("url", ["", URL])
def test_a_slash_at_the_end_leads_to_the_same_page_without_a_redirect(study, url):
    with published(study, url, follow_redirects=False) as site:
        prefix = "/study" if url else ""
        for path in (site.researcher, site.join):
            answer = site.client.get(f"{prefix}{path}/")
            assert answer.status_code == 200
        for path in ("/static", "/static/", "/", ""):
            assert site.client.get(f"{prefix}{path}").status_code == 404


def test_a_proxy_that_drops_the_host_is_told_of_once(study, caplog):
    with published(study, "", base_url="http://127.0.0.1:8000") as site:
        form = site.form(site.join, consent="yes")
        for _ in range(3):
            answer = site.client.post(site.join, data=form, headers={"origin": "https://a.example"})
            assert answer.status_code == 403
            assert "This form was sent from another site." in answer.text
        assert site.store.progress()[0]["enrolled"] == 0
    [told] = [record.getMessage() for record in caplog.records]
    assert "'https://a.example'" in told
    assert "set url in the study file" in told


def test_the_url_may_change_while_a_study_is_under_way(study):
    with published(study, "") as site:
        join = site.join
    with published(study, URL) as site:
        assert site.join == join


def test_a_port_in_use_is_a_sentence_before_anything_loads(tmp_path, capsys):
    with closing(listen("127.0.0.1", port := free_port())):
        # Neither the study nor the talker is there.
        command = ["serve", str(tmp_path / "no.yaml"), "--talker", "no:no", "--port", str(port)]
        assert main(command) == 2
    said = capsys.readouterr()
    told = f"error: --port {port} is in use at 127.0.0.1: end what listens there, or name another"
    assert (said.out, said.err) == ("", f"{told}\n")


@pytest.mark.parametrize("host", ["no.such.host.invalid", "192.0.2.1", "x" * 300, "..", "1::zz"])
def test_a_host_that_is_not_this_machine_is_a_sentence(host, capsys):
    assert main(["serve", "no.yaml", "--host", host]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"error: --host must be an address of this machine, got '{host[:9]}")
    assert told.count("\n") == 1


def test_who_connects_while_the_agents_load_waits_and_is_served():
    with closing(listen("127.0.0.1", port := free_port())):
        socket.create_connection(("127.0.0.1", port), timeout=5).close()


def test_a_proxy_that_names_the_port_of_https_is_the_same_site(study):
    with published(study, "", base_url="http://127.0.0.1:8000") as site:
        form, names = site.form(site.join, consent="yes"), {"host": "x:443", "origin": "https://x"}
        answer = site.client.post(site.join, data=form, headers=names, follow_redirects=False)
        assert answer.status_code == 303
        assert answer.headers["location"].startswith("/p/")
