"""Permissions of a study's files, copies of the live file, forgetting people, exported texts."""

import os
import shutil
from contextlib import closing, contextmanager
from dataclasses import replace

import pytest
from tables import rows

from bbq_torchrl.people.study.__main__ import main
from bbq_torchrl.people.study.database import StoreError, current, opened
from bbq_torchrl.people.study.export import backup, defused, forget, without_names
from bbq_torchrl.people.study.outcomes import read_outcomes
from bbq_torchrl.people.study.storage import Store

from .conftest import RATED

TEXT = "city=philly; my secret wish"
STEPS = ("say", "end", "rate")


@pytest.mark.skipif(os.name == "nt", reason="POSIX modes")
def test_all_files_that_a_command_makes_are_for_their_owner_alone(site, study, tmp_path):
    site.say(site.enroll(), TEXT, "bye")
    for command in (["report"], ["participants"], ["backup", str(tmp_path / "copy.sqlite")]):
        assert main([command[0], str(study.path), *command[1:]]) == 0
    made = [tmp_path / name for name in ("study-participants.csv", "copy.sqlite", "study-report")]
    made += (tmp_path / "study-report").iterdir()
    assert {"report.md", "success.png", "sessions.jsonl"} <= {file.name for file in made}
    assert not any(file.stat().st_mode & 0o077 for file in made)


def test_a_backup_of_the_living_file_has_everything_but_tokens_where_a_plain_copy_has_not(
    site, study, tmp_path
):
    link = site.enroll()
    site.say(link, *[TEXT] * 8)
    plain = shutil.copyfile(study.data, tmp_path / "plain.sqlite")
    backup(study.data, copy := tmp_path / "copy.sqlite")
    with opened(copy) as connection:
        assert connection.execute("SELECT text FROM exchange").fetchall() == [(TEXT,)] * 8
    with opened(plain) as connection:
        assert connection.execute("SELECT COUNT(*) FROM exchange").fetchone() < (8,)
    assert not list(tmp_path.glob("copy.sqlite-*"))  # it is one file
    token = link.removeprefix("/p/")
    assert token.encode() not in copy.read_bytes()
    with closing(Store(replace(study, path=copy), site.talker)) as again:
        assert current(again.sessions(token)).messages == 8
        assert f"/join/{again.key('join')}" == site.join


def test_a_backup_restored_beside_the_log_of_an_older_file_is_refused(site, study, tmp_path):
    site.say(link := site.enroll(), TEXT)
    backup(study.data, restored := tmp_path / "restored.sqlite")
    site.say(link, TEXT)
    log = shutil.copyfile(f"{study.data}-wal", f"{restored}-wal")
    for use in (read_outcomes, lambda data: Store(replace(study, path=data), site.talker)):
        with pytest.raises(StoreError):
            use(restored)
    os.remove(log)
    with opened(restored) as connection:
        assert connection.execute("SELECT COUNT(*) FROM exchange").fetchone() == (1,)


@pytest.mark.parametrize(
    "name", ["study.sqlite", "study.sqlite-wal", "./study.sqlite.lock", "link", "old", "no/copy"]
)
def test_a_backup_replaces_nothing_and_needs_a_folder(site, study, tmp_path, capsys, name):
    site.say(link := site.enroll(), TEXT)
    (tmp_path / "old").write_text("an older copy")
    (tmp_path / "link").symlink_to(study.data)
    assert main(["backup", str(study.path), str(tmp_path / name)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert site.say(link, TEXT).status_code == 200
    assert (tmp_path / "old").read_text() == "an older copy"


@pytest.fixture
def careless(monkeypatch):
    """SQLite as most have it: what is deleted stays in free pages."""

    @contextmanager
    def careless(path, mode):
        with opened(path, mode) as connection:
            connection.execute("PRAGMA secure_delete = OFF")
            yield connection

    monkeypatch.setattr("bbq_torchrl.people.study.export.opened", careless)


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
    assert read_outcomes(study.data).enrolled == 1
    for answer in (site.client.get(link), *(site.client.post(f"{link}/{s}") for s in STEPS)):
        assert answer.status_code == 404
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


@pytest.mark.parametrize("given", ["P3", "1.0", "9" * 30, "99", "/p/nobody"])
def test_who_is_nobody_cannot_be_forgotten(site, study, capsys, given):
    link = site.enroll()
    assert main(["forget", str(study.path), given]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert site.client.get(link).status_code == 200


def test_a_report_that_is_being_written_makes_forgetting_wait(site, study, monkeypatch):
    site.say(link := site.enroll(), TEXT)
    monkeypatch.setattr("bbq_torchrl.people.study.database.BUSY_SECONDS", 0.1)
    number = site.session(link).person
    with opened(study.data) as connection:
        connection.execute("SELECT COUNT(*) FROM person").fetchone()
        with pytest.raises(StoreError, match="run the command again"):
            forget(study.data, number)
    assert forget(study.data, number) == int(number)
    for file in study.data.parent.glob("study.sqlite*"):
        assert b"secret wish" not in file.read_bytes()


def test_what_a_spreadsheet_would_run_is_defused_and_nothing_else():
    for text in ("=1+1", "+1", "-1", "@a", " =cmd()", "\t=x", "\r-x"):
        assert defused(text) == f"'{text}"
    for cell in ("two", "a=b", "", -3, 0.5):
        assert defused(cell) == cell


@pytest.mark.parametrize(("text", "kept"), rows(__file__, "names.txt"))
def test_names_that_are_given_as_such_are_replaced(text, kept):
    assert without_names(text) == kept
