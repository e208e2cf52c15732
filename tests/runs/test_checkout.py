"""The commit that a run says it was made by."""

import subprocess

import pytest

from bbq_torchrl.runs.build import Checkout, checkout


def git(folder, *command):
    person = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    done = subprocess.run(["git", *person, *command], cwd=folder, check=True, capture_output=True)
    return done.stdout.decode().strip()


@pytest.fixture
def package(tmp_path):
    """A package in a checkout of its own, with a commit."""
    folder = tmp_path / "project" / "package"
    folder.mkdir(parents=True)
    (folder / "__init__.py").touch()
    git(folder.parent, "init")
    git(folder.parent, "add", ".")
    git(folder.parent, "commit", "-m", "begin")
    return folder


def test_a_checkout_has_a_commit_and_is_clean_until_something_changes(package):
    commit = git(package, "rev-parse", "HEAD")
    assert checkout(package) == Checkout(commit, clean=True)
    (package / "new.py").touch()  # untracked
    assert checkout(package) == Checkout(commit, clean=True)
    git(package, "add", ".")
    git(package, "commit", "-m", "go on")
    after = git(package, "rev-parse", "HEAD")
    assert after != commit
    assert checkout(package) == Checkout(after, clean=True)
    (package / "new.py").write_text("changed = True\n")
    assert checkout(package) == Checkout(after, clean=False)


def test_code_outside_a_checkout_of_its_own_has_no_commit(package, tmp_path):
    installed = package.parent / "venv" / "package"
    installed.mkdir(parents=True)
    (installed / "__init__.py").touch()
    assert checkout(installed) == checkout(tmp_path) == Checkout(None, None)
    git(tmp_path, "init")  # without a commit
    assert checkout(tmp_path) == Checkout(None, None)


def test_the_environment_changes_nothing_unless_git_is_missing(package, monkeypatch):
    found = checkout(package)
    monkeypatch.setenv("GIT_DIR", "/nowhere")
    assert checkout(package) == found
    monkeypatch.setenv("PATH", "")
    assert checkout(package) == Checkout(None, None)
