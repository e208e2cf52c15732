"""Checkpoints: only tensors and JSON are loaded, and damage falls back to the previous one."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from pathlib import Path

import pytest
from planted import plant, rewritten, runs_code
from torch import nn

from bbq_torchrl.trainers import CheckpointDamagedError, CheckpointFolder, CheckpointMismatchError

NETWORK = "components/0000-network"
META = f"{NETWORK}/state/meta.json"


def network(value: float = 0.0) -> nn.Linear:
    net = nn.Linear(3, 2)
    nn.init.constant_(net.weight, value)
    return net


def save(folder, *rounds: int):
    """Saves a network whose weights are the round's number after each of the rounds."""
    for number in rounds:
        path = CheckpointFolder(folder, network=network(number)).save(number, {"seed": 7})
    return path


def restored(folder) -> float:
    """The number of the round whose weights are restored."""
    net = network()
    CheckpointFolder(folder, network=net).restore({})
    (weight,) = net.weight.unique().tolist()
    return weight


def test_the_last_two_are_kept_and_the_newest_is_restored_with_its_metadata(tmp_path):
    assert CheckpointFolder(tmp_path / "absent").newest() is None
    folder = CheckpointFolder(tmp_path, network=network())
    assert folder.restore({}) is None
    save(tmp_path, 0, 10, 20)
    folder.save(25, {}, name="failed-round-000025")  # outside the rotation

    path, metadata = folder.newest()

    assert metadata == {"round": 20, "seed": 7}
    assert restored(tmp_path) == 20
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("failed-round-000025.torchrl", "round-000010.torchrl", path.name)
    ]


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs Linux's /proc")
def test_a_folder_may_have_a_name_that_is_no_text(tmp_path):
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    assert save(folder, 10, 20).parent == folder
    assert restored(folder) == 20
    assert len(list(folder.iterdir())) == 2


def cut(share):
    return lambda path: path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])


def linked_to_nothing(path):
    path.unlink()
    path.symlink_to("nowhere")


def flipped(member):
    """Flips a bit in the middle of a member's content."""

    def flip(path):
        content = bytearray(path.read_bytes())
        with zipfile.ZipFile(path) as archive:
            info = archive.getinfo(member)
        # The local header is 30 bytes, the name (and no extra field).
        content[info.header_offset + 30 + len(info.filename) + info.file_size // 2] ^= 1
        path.write_bytes(content)

    return flip


def changed(member, change):
    """Replaces the JSON of a member, with the right checksum."""

    def damage(path):
        def put(members):
            members[member] = json.dumps(change(json.loads(members[member]))).encode()

        rewritten(path, put)

    return damage


def with_file(name, *, is_listed=False):
    """Adds a file to the network's, in the manifest too if it is to be listed."""

    def add(path):
        rewritten(path, lambda members: members.update({f"{NETWORK}/{name}": b"x"}))
        if is_listed:
            changed("manifest.json", lists)(path)

    def lists(manifest):
        manifest["components"]["network"]["files"].append(name)
        return manifest

    return add


def of_round(number):
    return changed("manifest.json", lambda found: {**found, "metadata": {"round": number}})


def compressed(path):
    """A small compressed file may be arbitrarily large when unpacked."""
    with zipfile.ZipFile(path) as old:
        members = {name: old.read(name) for name in old.namelist()}
    members[f"{NETWORK}/state/tensor_00000001.memmap"] = bytes(10_000_000)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name, content in members.items():
            new.writestr(name, content)


FOREIGN = ("state.pt", "state/notes.txt")
DAMAGES = {
    **{f"cut to {share}": (cut(share), "") for share in (0.0, 0.5, 0.999)},
    "a link to nothing": (linked_to_nothing, "No such file"),
    **{
        f"a bit of {name}": (flipped(name), f"{name} in it does not match its checksum")
        for name in ("manifest.json", META, f"{NETWORK}/state/tensor_00000001.memmap")
    },
    "no tensors": (changed(META, lambda meta: {**meta, "_type": "x"}), "describes no tensors"),
    "no round": (changed("manifest.json", lambda found: {**found, "metadata": {}}), "round"),
    "a round below 0": (of_round(-5), "its metadata name no round, but -5"),
    "another round": (of_round(10**30), "it is of round 1000000000"),
    "compressed": (compressed, "its contents take 1000"),
    "a list": (changed("manifest.json", lambda manifest: [manifest]), "list"),
    **{
        f"with {name}": (with_file(name), f"{name} is missing in it, or belongs to no checkpoint")
        for name in FOREIGN
    },
    **{
        f"with {name} listed": (with_file(name, is_listed=True), f"{name} in it belongs to no")
        for name in FOREIGN
    },
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_one_is_named_and_the_one_before_is_taken(tmp_path, caplog, damage):
    newest = save(tmp_path, 10, 20)
    harm, reason = DAMAGES[damage]
    harm(newest)

    assert restored(tmp_path) == 10
    assert f"checkpoint is damaged and not used: {newest.name}: " in caplog.text
    assert reason in caplog.text
    (tmp_path / "round-000010.torchrl").unlink()
    with pytest.raises(
        CheckpointDamagedError,
        match=rf"every checkpoint in .* is damaged \({newest.name}.*{reason}",
    ):
        restored(tmp_path)


@pytest.mark.parametrize("file", ["other.pickle", "pickle.pkl"])
def test_a_pickle_in_an_archive_is_never_loaded(tmp_path, file):
    marker = tmp_path / "marker"
    saved = save(tmp_path / "checkpoint", 4)
    plant(saved, marker, file)
    folder = CheckpointFolder(saved.parent, network=network())

    with pytest.raises(CheckpointDamagedError):
        folder.restore({})
    # Nor where the check is passed over.
    with pytest.raises(CheckpointMismatchError, match="Refusing to load pickled"):
        folder.load(saved)
    assert not marker.exists()

    runs_code(saved, tmp_path / "extracted")
    assert marker.exists(), "the archive would have run code"


def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    save(tmp_path, 4)
    folder = CheckpointFolder(tmp_path, network=network())

    assert folder.restore({"seed": 7, "of a later version": 1}) is not None
    with pytest.raises(CheckpointMismatchError, match=r"seed must be 7, as in the checkpoint .* 8"):
        folder.restore({"seed": 8})
    other = CheckpointFolder(tmp_path, network=nn.Linear(5, 2))
    with pytest.raises(CheckpointMismatchError, match=r"another configuration: .*network"):
        other.restore({})


def test_a_checkpoint_of_a_device_that_is_absent_is_restored(tmp_path):
    def on_another(members):
        schema = f"{NETWORK}/state.json"
        assert b'"device":"cpu"' in members[schema]
        members[schema] = members[schema].replace(b'"device":"cpu"', b'"device":"cuda:7"')

    rewritten(save(tmp_path, 20), on_another)

    assert restored(tmp_path) == 20


def test_a_checkpoint_that_vanishes_while_it_is_opened_means_the_next_one(tmp_path, monkeypatch):
    """The training process saves a newer checkpoint and removes this one."""
    saved, newer = save(tmp_path / "run", 4), save(tmp_path / "newer", 5)
    load = CheckpointFolder.load

    def removed_first(self, path):
        if path == saved:
            saved.unlink()
            shutil.copy(newer, saved.parent)
        load(self, path)

    monkeypatch.setattr(CheckpointFolder, "load", removed_first)

    assert restored(saved.parent) == 5


def test_what_a_killed_process_left_behind_is_removed_and_nothing_else(tmp_path):
    save(tmp_path, 10)
    folder = CheckpointFolder(tmp_path)
    kinds = ("stage", "archive", "backup")
    left = [tmp_path / f".round-000020.torchrl.{kind}-{'0a' * 16}" for kind in kinds]
    left.append(tmp_path / "kept.torchrl")
    left[0].mkdir()
    for file in (left[0] / "part", *left[1:], tmp_path / ".notes"):
        file.write_text("x")

    assert folder.newest()[0].name == "round-000010.torchrl"
    assert all(path.exists() for path in left), "they may be what a living process just saves"
    folder.remove_leftovers()

    assert {path.name for path in tmp_path.iterdir()} == {"round-000010.torchrl", ".notes"}


def test_what_is_kept_of_a_finished_run_is_read_but_not_gone_on_from(tmp_path):
    parts = {"network": network(3.0), "buffer": nn.Linear(30, 20)}
    folder = CheckpointFolder(tmp_path, **parts)
    folder.save(1, {"seed": 7})
    path = folder.save(2, {"seed": 7})
    size = path.stat().st_size

    folder.keep_only("network")
    folder.keep_only("network")

    assert [item.name for item in tmp_path.iterdir()] == ["round-000002.torchrl"]
    assert path.stat().st_size < size - 30 * 20 * 4
    assert CheckpointFolder(tmp_path).newest()[1] == {"round": 2, "seed": 7}
    assert restored(tmp_path) == 3
    with pytest.raises(CheckpointDamagedError, match="keep_checkpoints=last"):
        folder.restore({})


@pytest.mark.parametrize("is_killed", [True, False])
def test_a_whole_checkpoint_is_there_whenever_others_go(tmp_path, monkeypatch, is_killed):
    newest = save(tmp_path, 1, 2)
    newest.write_bytes(b"damaged")
    folder = CheckpointFolder(tmp_path, network=network())
    replace = os.replace

    def replace_unless_killed(source, target):
        if is_killed and Path(source).name == "kept.torchrl":
            raise KeyboardInterrupt
        replace(source, target)

    monkeypatch.setattr("os.replace", replace_unless_killed)
    try:
        folder.keep_only("network")
    except KeyboardInterrupt:
        folder.remove_leftovers()

    assert newest.exists() == is_killed
    assert restored(tmp_path) == 1
