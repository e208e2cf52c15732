"""Checkpoints: nothing half-written is read, and a damaged one falls back to the one before."""

from __future__ import annotations

import logging
import zipfile

import pytest
from planted import rewritten
from torch import nn

from bbq_torchrl.trainers import (
    CheckpointDamagedError,
    CheckpointFolder,
    CheckpointMismatchError,
)


def network(value: float) -> nn.Linear:
    net = nn.Linear(3, 2)
    nn.init.constant_(net.weight, value)
    return net


def folder_with(path, *rounds: int) -> CheckpointFolder:
    """Saves a network whose weights are the round's number after each of the rounds."""
    for number in rounds:
        CheckpointFolder(path, network=network(float(number))).save(number, {"seed": 7})
    return CheckpointFolder(path, network=network(0.0))


def restored(path) -> float:
    net = network(0.0)
    folder = CheckpointFolder(path, network=net)
    newest, _ = folder.newest()
    folder.load(newest)
    assert net.weight.unique().numel() == 1
    return float(net.weight.detach()[0, 0])


def test_the_last_two_are_kept_and_the_newest_is_restored_with_its_metadata(tmp_path):
    assert CheckpointFolder(tmp_path / "absent").newest() is None
    assert CheckpointFolder(tmp_path).newest() is None
    folder = folder_with(tmp_path, 0, 10, 20)
    # under a name of its own: outside the rotation
    folder.save(25, {}, name="failed-round-000025")

    path, metadata = folder.newest()

    assert path.name == "round-000020.torchrl"
    assert metadata == {"round": 20, "seed": 7}
    assert restored(tmp_path) == 20.0
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("failed-round-000025.torchrl", "round-000010.torchrl", "round-000020.torchrl")
    ]


@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_a_truncated_one_falls_back_with_a_warning(tmp_path, caplog, share):
    folder = folder_with(tmp_path, 10, 20)
    newest = tmp_path / "round-000020.torchrl"
    newest.write_bytes(newest.read_bytes()[: int(share * newest.stat().st_size)])

    with caplog.at_level(logging.WARNING, "bbq_torchrl"):
        path, _ = folder.newest()

    assert path.name == "round-000010.torchrl"
    assert "round-000020.torchrl" in caplog.text
    assert "damaged and not used" in caplog.text
    assert restored(tmp_path) == 10.0


def test_every_byte_of_the_contents_is_checked(tmp_path):
    folder = folder_with(tmp_path, 10, 20)
    newest = tmp_path / "round-000020.torchrl"
    good = newest.read_bytes()
    with zipfile.ZipFile(newest) as archive:
        members = [info for info in archive.infolist() if info.file_size]
    for info in members:
        # The local header is 30 bytes, the name (and no extra field).
        middle = info.header_offset + 30 + len(info.filename) + info.file_size // 2
        newest.write_bytes(good[:middle] + bytes([good[middle] ^ 1]) + good[middle + 1 :])
        assert folder.newest()[0].name == "round-000010.torchrl", info.filename


def test_if_every_one_is_damaged_it_says_so(tmp_path):
    folder = folder_with(tmp_path, 10, 20)
    for path in tmp_path.iterdir():
        path.write_bytes(b"not a checkpoint")

    with pytest.raises(
        CheckpointDamagedError, match=r"every checkpoint in .* is damaged \(round-000020"
    ):
        folder.newest()


def test_a_checkpoint_of_other_parts_is_refused_whole(tmp_path):
    folder_with(tmp_path, 10)
    other = nn.Linear(5, 2)
    folder = CheckpointFolder(tmp_path, network=other)
    path, _ = folder.newest()

    with pytest.raises(CheckpointMismatchError, match=r"another configuration: .*network"):
        folder.load(path)


def test_what_a_killed_process_left_behind_is_removed_and_nothing_else(tmp_path):
    folder = folder_with(tmp_path, 10)
    left = [
        tmp_path / f".round-000020.torchrl.{kind}-{'0a' * 16}"
        for kind in ("stage", "archive", "backup")
    ]
    left[0].mkdir()
    (left[0] / "part").write_text("x")
    left.append(tmp_path / "kept.torchrl")
    for file in left[1:]:
        file.write_text("x")
    kept = tmp_path / ".notes"
    kept.write_text("mine")

    assert folder.newest()[0].name == "round-000010.torchrl"
    assert all(path.exists() for path in left), "they may be what a living process just saves"
    folder.remove_leftovers()

    assert not any(path.exists() for path in left)
    assert kept.exists()


def test_a_checkpoint_of_a_device_that_is_absent_is_restored(tmp_path):
    folder_with(tmp_path, 20)

    def on_another(members):
        (name,) = (name for name in members if name.endswith("state.json"))
        assert b'"device":"cpu"' in members[name]
        members[name] = members[name].replace(b'"device":"cpu"', b'"device":"cuda:7"')

    rewritten(tmp_path / "round-000020.torchrl", on_another)

    assert restored(tmp_path) == 20.0
