"""A checkpoint is tensors and JSON: whatever else is in an archive, nothing of it is loaded."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from pathlib import Path

import pytest
import torch
from planted import plant, rewritten, runs_code
from torch import nn

from bbq_torchrl.trainers import CheckpointDamagedError, CheckpointFolder, CheckpointMismatchError


@pytest.fixture
def saved(tmp_path):
    """A checkpoint of a small network."""
    folder = tmp_path / "checkpoint"
    return CheckpointFolder(folder, network=nn.Linear(3, 2)).save(4, {"seed": 7})


def changed(archive, member, change):
    """Rewrites a member of an archive, and everything else as it was."""

    def changes(members):
        members[member] = json.dumps(change(json.loads(members[member]))).encode()

    rewritten(archive, changes)


@pytest.mark.parametrize("file", ["other.pickle", "pickle.pkl"])
def test_a_pickle_in_an_archive_is_never_loaded(tmp_path, saved, file, caplog):
    marker = tmp_path / "marker"
    plant(saved, marker, file)
    folder = CheckpointFolder(saved.parent, network=nn.Linear(3, 2))

    with pytest.raises(CheckpointDamagedError, match=r"every checkpoint in .* is damaged"):
        folder.restore({})
    assert not marker.exists()
    # Nor where the check is passed over.
    with pytest.raises(CheckpointMismatchError, match="Refusing to load pickled"):
        folder.load(saved)
    assert not marker.exists()

    runs_code(saved, tmp_path / "extracted")
    assert marker.exists(), "the archive would have run code"


@pytest.mark.parametrize("name", ["state.pt", "state/notes.txt"])
def test_a_file_that_no_checkpoint_has_is_refused_listed_or_not(saved, name):
    with zipfile.ZipFile(saved, "a") as archive:
        archive.writestr(f"components/0000-network/{name}", b"x")
    folder = CheckpointFolder(saved.parent)
    with pytest.raises(CheckpointDamagedError, match=f"{name} is missing in it, or belongs to no"):
        folder.newest()

    def listed(manifest):
        manifest["components"]["network"]["files"].append(name)
        return manifest

    changed(saved, "manifest.json", listed)
    with pytest.raises(CheckpointDamagedError, match=f"{name} in it belongs to no checkpoint"):
        folder.newest()


@pytest.mark.parametrize(
    ("member", "change", "message"),
    [
        (
            "components/0000-network/state/meta.json",
            lambda meta: {**meta, "_type": "<class 'x'>"},
            "describes no tensors",
        ),
        ("manifest.json", lambda manifest: {**manifest, "metadata": {}}, "round"),
        ("manifest.json", lambda manifest: [manifest], "list"),
    ],
)
def test_metadata_of_another_kind_are_refused(saved, member, change, message):
    changed(saved, member, change)

    with pytest.raises(CheckpointDamagedError, match=f"every checkpoint in .*{message}"):
        CheckpointFolder(saved.parent, network=nn.Linear(3, 2)).restore({})


def test_a_checkpoint_that_vanishes_while_it_is_opened_means_the_next_one(
    tmp_path, monkeypatch, saved
):
    """The process that trains saves a newer one and removes this one."""
    network = nn.Linear(3, 2)
    newer = CheckpointFolder(tmp_path / "newer", network=network).save(5, {})
    load = CheckpointFolder.load

    def removed_first(self, path):
        if path == saved:
            saved.unlink()
            shutil.copy(newer, saved.parent)
        load(self, path)

    monkeypatch.setattr(CheckpointFolder, "load", removed_first)
    other = nn.Linear(3, 2)

    path, _ = CheckpointFolder(saved.parent, network=other).restore({})

    assert path.name == "round-000005.torchrl"
    assert torch.equal(other.weight, network.weight)


def test_a_link_to_nothing_is_damage_and_not_a_reason_to_wait(saved):
    (saved.parent / "round-000009.torchrl").symlink_to("nowhere")

    path, _ = CheckpointFolder(saved.parent, network=nn.Linear(3, 2)).newest()

    assert path == saved


def test_a_checkpoint_of_other_metadata_is_refused(saved):
    folder = CheckpointFolder(saved.parent, network=nn.Linear(3, 2))

    with pytest.raises(CheckpointMismatchError, match=r"seed must be 7, as in the checkpoint .* 8"):
        folder.restore({"seed": 8})
    assert folder.restore({"seed": 7, "of a later version": 1}) is not None


def test_what_is_kept_of_a_finished_run_is_read_but_not_gone_on_from(tmp_path):
    parts = {"network": nn.Linear(3, 2), "buffer": nn.Linear(30, 20)}
    folder = CheckpointFolder(tmp_path, **parts)
    folder.save(1, {"seed": 7})
    path = folder.save(2, {"seed": 7})
    size = path.stat().st_size

    folder.keep_only("network")
    folder.keep_only("network")

    assert [item.name for item in tmp_path.iterdir()] == ["round-000002.torchrl"]
    assert path.stat().st_size < size - 30 * 20 * 4
    network = nn.Linear(3, 2)
    assert CheckpointFolder(tmp_path, network=network).restore({"seed": 7})[1]["round"] == 2
    assert torch.equal(network.weight, parts["network"].weight)
    with pytest.raises(CheckpointDamagedError, match="keep_checkpoints=last"):
        folder.restore({})


@pytest.mark.parametrize("is_killed", [True, False])
def test_a_whole_checkpoint_is_there_whenever_others_go(tmp_path, monkeypatch, is_killed):
    folder = CheckpointFolder(tmp_path, network=nn.Linear(3, 2))
    for number in (1, 2):
        newest = folder.save(number, {})
    newest.write_bytes(b"damaged")
    if is_killed:
        replace = os.replace

        def replace_unless_killed(source, target):
            if Path(source).name == "kept.torchrl":
                raise KeyboardInterrupt
            replace(source, target)

        monkeypatch.setattr("os.replace", replace_unless_killed)
        with pytest.raises(KeyboardInterrupt):
            folder.keep_only("network")
        monkeypatch.undo()
        folder.remove_leftovers()
    else:
        folder.keep_only("network")
        assert not newest.exists()

    assert CheckpointFolder(tmp_path, network=nn.Linear(3, 2)).restore({})[1]["round"] == 1
