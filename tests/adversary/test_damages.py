"""Damaged checkpoints: they run no code, show no traceback, and never load other weights."""

import json
import shutil

import pytest
import torch
from archives import rewritten

from bbq_torchrl.runs.folders import config_fingerprint, load_config
from bbq_torchrl.runs.train import build_trainer
from bbq_torchrl.trainers import CheckpointDamagedError, CheckpointMismatchError

from .cases import DAMAGES

pytestmark = pytest.mark.slow


def cut(content, rng):
    return content[: rng.randrange(len(content))]


def flip(content, rng):
    changed = bytearray(content)
    for _ in range(rng.choice([1, 1, 1, 10, 1000])):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def zero(content, rng):
    start = rng.randrange(len(content))
    length = min(rng.choice([1, 512, 4096, 65536]), len(content) - start)
    return content[:start] + bytes(length) + content[start + length :]


BYTES = (cut, flip, zero)
"""Damages of a disk: the saved state is restored, or the checkpoint before it."""


def leave_out(members, rng):
    del members[rng.choice(sorted(members))]


def swap(members, rng):
    one, other = rng.sample(sorted(members), 2)
    members[one], members[other] = members[other], members[one]


VALUES = (None, -1, 0, 1e308, 10**30, "", "x", [], [[]], {}, {"kind": "path", "value": "/"}, True)


def change_json(members, rng):
    """Replaces one value in the JSON of an archive."""
    name = rng.choice([item for item in sorted(members) if item.endswith(".json")])
    tree = json.loads(members[name])
    node = tree
    while isinstance(node, dict | list) and node:
        key = rng.choice(sorted(node) if isinstance(node, dict) else range(len(node)))
        if not isinstance(node[key], dict | list) or not node[key] or rng.random() < 0.2:
            node[key] = rng.choice(VALUES)
            break
        node = node[key]
    members[name] = json.dumps(tree).encode()


def nest(members, rng):
    name = rng.choice([item for item in sorted(members) if item.endswith(".json")])
    members[name] = b"[" * 100_000 + b"]" * 100_000


FORGERIES = (leave_out, swap, change_json, change_json, nest)
"""Damages by somebody who corrects the checksums."""


@pytest.fixture(scope="module")
def run(references):
    return references("replicas").folder


@pytest.fixture(scope="module")
def trainer(run, tmp_path_factory):
    config = load_config(run / "config.yaml")
    built, _ = build_trainer(config, tmp_path_factory.mktemp("trainer"))
    return built, config_fingerprint(config)


def restored(trainer, folder):
    """The checkpoint resumed from, and checksums of the restored state; None if refused."""
    built, fingerprint = trainer
    built.checkpoints.folder = folder
    try:
        built.checkpoints.newest(fingerprint, "replay")
        rounds = built.checkpoints.restore(fingerprint)
    except (CheckpointDamagedError, CheckpointMismatchError):
        return None, None
    parts = [
        built.learner.loss.state_dict(),
        built.replay.state_dict(),
        built.learner.optimizer.state_dict(),
    ]
    leaves = torch.utils._pytree.tree_leaves(parts)
    return f"round-{rounds:06d}.torchrl", [
        leaf.double().sum() for leaf in leaves if isinstance(leaf, torch.Tensor)
    ]


def test_damaged_bytes_are_found_or_do_no_harm(run, trainer, tmp_path, rng, record_property):
    names = sorted(path.name for path in (run / "checkpoint").iterdir())
    expected = {}
    for name in names:
        folder = tmp_path / f"whole-{name}"
        folder.mkdir()
        shutil.copy(run / "checkpoint" / name, folder)
        found, sums = restored(trainer, folder)
        assert found == name
        expected[name] = sums
    found_out = 0
    for number in range(DAMAGES // 2):
        folder = tmp_path / f"damaged-{number}"
        shutil.copytree(run / "checkpoint", folder)
        newest = folder / names[-1]
        damage = rng.choice(BYTES)
        newest.write_bytes(damage(newest.read_bytes(), rng))

        name, sums = restored(trainer, folder)

        assert name in names, damage
        assert all(map(torch.equal, sums, expected[name])), damage
        found_out += name != names[-1]
        shutil.rmtree(folder)
    assert found_out > DAMAGES // 8
    what = "damaged bytes of a checkpoint"
    record_property(f"{what}: found, the checkpoint before was taken", found_out)
    record_property(f"{what}: without effect on what was saved", DAMAGES // 2 - found_out)


def test_a_forged_checkpoint_is_restored_or_refused(run, trainer, tmp_path, rng, record_property):
    refused = 0
    for number in range(DAMAGES - DAMAGES // 2):
        folder = tmp_path / f"forged-{number}"
        folder.mkdir()
        newest = shutil.copy(max((run / "checkpoint").iterdir()), folder)
        forgery = rng.choice(FORGERIES)
        rewritten(newest, lambda members, forgery=forgery: forgery(members, rng))

        refused += restored(trainer, folder)[0] is None
        shutil.rmtree(folder)
    assert refused > DAMAGES // 8
    tried = DAMAGES - DAMAGES // 2
    record_property("checkpoints forged with right checksums: refused", refused)
    record_property("checkpoints forged with right checksums: of tensors alone", tried - refused)
