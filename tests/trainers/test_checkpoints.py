"""Checkpoints: only tensors and JSON are loaded, and damage falls back to the previous one."""

import io
import zipfile
from pathlib import Path

import pytest
import torch
from archives import rewritten
from tensordict import TensorDict
from torch import nn

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.trainers import CheckpointDamagedError, CheckpointFolder, CheckpointMismatchError

NETWORK = "components/0000-network"
STATE = f"{NETWORK}/state.pt"


def network(value=0.0):
    net = nn.Linear(3, 2)
    nn.init.constant_(net.weight, value)
    return net


def save(folder, *rounds):
    """Saves a network whose weights are the round's number after each of the rounds."""
    for number in rounds:
        path = CheckpointFolder(folder, network=network(number)).save(number, {"seed": 7})
    return path


def restored(folder):
    """The number of the round whose weights are restored."""
    net = network()
    CheckpointFolder(folder, network=net).restore()
    (weight,) = net.weight.unique().tolist()
    return weight


def test_the_last_two_are_kept_and_the_newest_is_restored_with_its_fingerprint(tmp_path):
    assert CheckpointFolder(tmp_path / "absent").newest() is None
    folder = CheckpointFolder(tmp_path, network=network())
    assert folder.restore() is None
    save(tmp_path, 0, 10, 20)
    folder.save(25, {}, name="failed-round-000025")  # outside the rotation

    path, fingerprint = folder.newest()

    assert fingerprint == {"seed": 7}
    assert restored(tmp_path) == 20
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("failed-round-000025.torchrl", "round-000010.torchrl", path.name)
    ]


def test_a_state_is_saved_without_the_rest_of_a_storage_it_is_a_view_of(tmp_path):
    replay = ReplicaReplay(100_000, keys=["x"])
    replay.extend([TensorDict({"x": torch.ones(3)}, [3])])
    assert CheckpointFolder(tmp_path, replay=replay).save(0, {}).stat().st_size < 50_000


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


def with_file(path):
    rewritten(path, lambda members: members.update({f"{NETWORK}/notes.txt": b"x"}))


DAMAGES = {
    **{f"cut to {share}": cut(share) for share in (0.0, 0.5, 0.999)},
    "a link to nothing": linked_to_nothing,
    **{f"a bit of {name}": flipped(name) for name in ("manifest.json", STATE)},
    "another file": with_file,
    "no file": lambda path: rewritten(path, lambda members: members.pop(STATE)),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_one_is_named_and_the_one_before_is_taken(tmp_path, caplog, damage):
    newest = save(tmp_path, 10, 20)
    DAMAGES[damage](newest)

    assert restored(tmp_path) == 10
    assert newest.name in caplog.text
    (tmp_path / "round-000010.torchrl").unlink()
    with pytest.raises(CheckpointDamagedError, match=newest.name):
        restored(tmp_path)


class Payload:
    """Unpickling it touches a file."""

    def __init__(self, marker):
        self.marker = marker

    def __reduce__(self):
        return Path.touch, (self.marker,)


def test_a_pickle_in_an_archive_is_never_loaded(tmp_path):
    marker, content = tmp_path / "marker", io.BytesIO()
    torch.save(Payload(marker), content)
    saved = save(tmp_path / "checkpoint", 4)
    rewritten(saved, lambda members: members.update({STATE: content.getvalue()}))

    with pytest.raises(CheckpointDamagedError):
        restored(saved.parent)
    assert not marker.exists()

    content.seek(0)
    torch.load(content, weights_only=False)
    assert marker.exists(), "the archive would have run code"


def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    save(tmp_path, 4)
    folder = CheckpointFolder(tmp_path, network=network())

    assert folder.restore({"seed": 7}) == 4
    for other in ({"seed": 8}, {"seed": 7, "agent.lr": 1}):
        with pytest.raises(CheckpointMismatchError, match=next(reversed(other))):
            folder.restore(other)
        with pytest.raises(CheckpointMismatchError):
            folder.newest(other, "network")
    other = CheckpointFolder(tmp_path, network=nn.Linear(5, 2))
    with pytest.raises(CheckpointMismatchError, match="network"):
        other.restore()


def test_what_a_killed_process_left_behind_is_removed_and_nothing_else(tmp_path):
    save(tmp_path, 10)
    folder = CheckpointFolder(tmp_path)
    kinds = ("stage", "archive", "backup")
    left = [tmp_path / f".round-000020.torchrl.{kind}-{'0a' * 16}" for kind in kinds]
    left.append(tmp_path / "reduced.torchrl")
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
    assert CheckpointFolder(tmp_path).newest()[1] == {"seed": 7}
    assert restored(tmp_path) == 3
    with pytest.raises(CheckpointDamagedError, match="buffer"):
        folder.restore()


def test_the_one_before_a_damaged_one_is_kept_of_a_finished_run(tmp_path):
    newest = save(tmp_path, 1, 2)
    newest.write_bytes(b"damaged")
    CheckpointFolder(tmp_path, network=network()).keep_only("network")
    assert not newest.exists()
    assert restored(tmp_path) == 1
