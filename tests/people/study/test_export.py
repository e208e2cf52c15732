"""Permissions of a study's files, copies of the live file, and forgetting people."""

from __future__ import annotations

import os
import shutil
from contextlib import closing, contextmanager
from dataclasses import replace

import pytest

from bbq_torchrl.people.study.__main__ import main
from bbq_torchrl.people.study.database import StoreError, changing, reading
from bbq_torchrl.people.study.export import backup, forget
from bbq_torchrl.people.study.records import current
from bbq_torchrl.people.study.report import write_report
from bbq_torchrl.people.study.results import read_results
from bbq_torchrl.people.study.store import Store

from .conftest import RATED
from .fakes import prints

TEXT = "city=philly; my secret wish"


def modes(folder):
    return {path.name: path.stat().st_mode & 0o777 for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def open_umask():
    before = os.umask(0o000)
    yield
    os.umask(before)


@pytest.mark.skipif(os.name == "nt", reason="POSIX modes")
def test_all_files_of_a_study_are_for_their_owner_alone(open_umask, site, study, tmp_path):
    site.say(site.enroll(), TEXT, "bye")
    write_report(tmp_path / "report", read_results(study.data))
    backup(study.data, tmp_path / "copy.sqlite")
    found = modes(tmp_path)
    assert {"study.sqlite", "study.sqlite-wal", "study.sqlite.lock", "copy.sqlite"} <= set(found)
    assert {"report.md", "success.png", "ratings.png", "sessions.jsonl"} <= set(found)
    assert {name: f"{mode:o}" for name, mode in found.items()} == dict.fromkeys(found, "600")


@pytest.mark.skipif(os.name == "nt", reason="POSIX modes")
def test_a_file_that_others_could_read_is_made_private(study):
    Store(study.data, study.terms, prints(study)).close()
    study.data.chmod(0o644)
    Store(study.data, study.terms, prints(study)).close()
    assert f"{study.data.stat().st_mode & 0o777:o}" == "600"


def test_a_backup_of_the_living_file_has_everything_where_a_plain_copy_has_not(
    site, study, tmp_path
):
    link = site.enroll()
    site.say(link, *[TEXT] * 8)
    (tmp_path / "plain").mkdir()
    shutil.copyfile(study.data, tmp_path / "plain" / "study.sqlite")
    backup(study.data, copy := tmp_path / "copy.sqlite")
    with reading(copy) as connection:
        assert connection.execute("SELECT text FROM exchange").fetchall() == [(TEXT,)] * 8
    with pytest.raises(StoreError), reading(tmp_path / "plain" / "study.sqlite") as connection:
        assert connection.execute("SELECT COUNT(*) FROM exchange").fetchone() == (8,)
    assert not list(tmp_path.glob("copy.sqlite-*"))  # it is one file
    with closing(Store(copy, study.terms, prints(study))) as again:  # and a study that goes on
        assert current(again.sessions(link.removeprefix("/p/"))).messages == 8
        assert f"/join/{again.key('join')}" == site.join


def told(capsys, *arguments):
    assert main([str(argument) for argument in arguments]) == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    "name", ["study.sqlite", "study.sqlite-wal", "./study.sqlite.lock", "link"]
)
def test_a_backup_onto_the_living_file_is_refused(site, study, tmp_path, capsys, name):
    site.say(link := site.enroll(), TEXT)
    (tmp_path / "link").symlink_to(study.data)
    error = told(capsys, "backup", study.path, tmp_path / name)
    assert "it is of the living study: name another file for the copy" in error
    assert site.session(link).messages == 1


def test_a_backup_replaces_nothing_and_needs_a_folder(site, study, tmp_path, capsys):
    (tmp_path / "old.sqlite").write_text("an older copy")
    os.link(study.data, tmp_path / "hard.sqlite")
    for name in ("old.sqlite", "hard.sqlite"):
        error = told(capsys, "backup", study.path, tmp_path / name)
        assert "it exists already: name a file that does not exist" in error
    error = told(capsys, "backup", study.path, tmp_path / "nowhere" / "copy.sqlite")
    assert "its folder does not exist" in error
    error = told(capsys, "backup", tmp_path / "other.yaml", tmp_path / "copy.sqlite")
    assert "other.sqlite: there is no such file" in error
    assert not (tmp_path / "copy.sqlite").exists()
    assert not list(tmp_path.glob(".*"))
    assert (tmp_path / "old.sqlite").read_text() == "an older copy"


@pytest.fixture
def careless(monkeypatch):
    """SQLite as most have it: what is deleted stays in free pages."""

    @contextmanager
    def opened(path):
        with changing(path) as connection:
            connection.execute("PRAGMA secure_delete = OFF")
            yield connection

    monkeypatch.setattr("bbq_torchrl.people.study.export.changing", opened)


@pytest.mark.parametrize("by", ["number", "link", "whole link"])
def test_of_a_forgotten_person_nothing_is_left_in_the_files(
    careless, site, study, tmp_path, capsys, by
):
    other, link = site.enroll(), site.enroll()
    site.say(other, "city=tampa")
    site.say(link, TEXT, "bye")
    site.take(link, "rate", **RATED)
    number = site.session(link).person
    given = {"number": number, "link": link, "whole link": f"https://lab.example/s{link}"}[by]
    before = site.store.progress()[0]
    assert main(["forget", str(study.path), given]) == 0
    assert f"person {number} is forgotten" in capsys.readouterr().out
    for file in tmp_path.glob("study.sqlite*"):
        assert b"secret wish" not in file.read_bytes()
    counts, sessions = site.store.progress()
    assert counts == {**before, "enrolled": 1, "active": 1}
    assert {session.person for session in sessions} == {site.session(other).person}
    assert site.store.rows("SELECT COUNT(*) FROM rating") == [(0,)]
    assert read_results(study.data).enrolled == 1
    assert site.client.get(link).status_code == 404
    # The others go on; the place is free again, and the number is nobody else's.
    assert site.say(other, "city=tampa").status_code == 200
    assert site.session(site.enroll()).person == "3"
    assert main(["forget", str(study.path), number]) == 0  # again


def test_who_is_typing_when_forgotten_is_told_and_nothing_of_it_becomes_anothers(site, study):
    link = site.enroll()
    site.say(link, "city=philly")
    number = site.session(link).person
    reply, later = site.talker.reply, []

    def forgotten(*given):
        forget(study.data, number)
        later.append(site.enroll())  # has the next numbers of sessions
        return reply(*given)

    site.talker.reply = forgotten
    page = site.take(link, "say", text=TEXT)
    site.talker.reply = reply
    assert page.status_code == 410
    assert "All that you wrote here is deleted" in page.text
    assert site.session(later[0]).messages == 0
    assert site.client.get(link).status_code == 404
    assert site.say(later[0], "city=tampa").status_code == 200


def test_a_form_that_comes_after_its_writer_was_forgotten_is_no_page(site, study):
    link = site.enroll()
    site.say(link, "bye")
    forms = {"say": site.form(link), "rate": site.form(link, **RATED), "end": site.form(link)}
    forget(study.data, link)
    for step, form in forms.items():
        assert site.client.post(f"{link}/{step}", data=form).status_code == 404


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ("P3", "it must be a person's number on your page or their link, got 'P3'"),
        ("1.0", "it must be a person's number on your page or their link, got '1.0'"),
        ("9" * 30, "it must be a person's number on your page or their link, got '999"),
        ("99", "there is nobody of the number given"),
        ("/p/nobody", "there is nobody of the link given"),
    ],
)
def test_who_is_nobody_cannot_be_forgotten(site, study, capsys, given, sentence):
    link = site.enroll()
    assert sentence in told(capsys, "forget", study.path, given)
    assert site.client.get(link).status_code == 200


def test_a_report_that_is_being_written_makes_forgetting_wait(site, study, monkeypatch):
    site.say(link := site.enroll(), TEXT)
    monkeypatch.setattr("bbq_torchrl.people.study.database.BUSY_SECONDS", 0.1)
    with reading(study.data) as connection:
        connection.execute("SELECT COUNT(*) FROM person").fetchone()
        with pytest.raises(StoreError, match="run the command again"):
            forget(study.data, link_number := site.session(link).person)
    assert forget(study.data, link_number) == int(link_number)
    assert b"secret wish" not in b"".join(
        file.read_bytes() for file in study.data.parent.glob("study.sqlite*")
    )


def test_a_study_begun_before_these_keys_goes_on(study):
    Store(study.data, study.terms, prints(study)).close()
    with closing(Store(study.data, study.terms, prints(study))) as store:
        store.rows(
            "UPDATE study SET terms = json_remove(terms, '$.joins_per_minute', '$.retention')"
        )
    Store(study.data, replace(study.terms, joins_per_minute=9), prints(study)).close()
