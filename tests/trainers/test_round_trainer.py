"""The round trainer on an environment of a few lines."""

from __future__ import annotations

import csv
from itertools import count
from typing import TYPE_CHECKING, Any

import pytest
import torch
from torch.optim import Adam
from torchrl.envs import ExcludeTransform, TransformedEnv
from trainer_parts import GuessEnv, make_trainer, random_policy

from bbq_torchrl.options import ProtocolOption
from bbq_torchrl.trainers import NonFiniteLossError, Spike, TrainingError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from tensordict import TensorDictBase


def test_it_learns(tmp_path):
    trainer = make_trainer(tmp_path, places=50, rounds=12, capacity=400, checkpoint_every=12)

    rows = trainer.train()

    first = [row["success_rate"] for row in rows[:6]]
    last = [row["success_rate"] for row in rows[-15:]]
    # Guessing at random succeeds in half of the dialogues; who has learned to wait for the hint,
    # in 127 of 128 (7 turns). The last five rounds are 750 dialogues: standard error .011 at .9.
    assert sum(first) / len(first) < 0.7
    assert sum(last) / len(last) > 0.9


def test_metrics_have_a_row_for_every_round_and_replica(tmp_path):
    trainer = make_trainer(tmp_path, rounds=4, replicas=2)

    rows = trainer.train()

    assert [(row["round"], row["replica"]) for row in rows] == [
        (r, i) for r in range(4) for i in (0, 1)
    ]
    with (tmp_path / "metrics.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [{k: float(v) for k, v in line.items()} for line in table] == rows
    assert list(rows[0]) == [
        *("round", "replica", "dialogues", "success_rate", "reward", "turns"),
        *("td_error", "q_value", "loss", "buffer", "updates", "epsilon"),
        *("seconds", "seconds_collect", "seconds_learn"),
    ]


def test_metrics_are_what_was_played_and_learned(tmp_path):
    trainer = make_trainer(tmp_path, rounds=3, replicas=2, spike=None)
    trainer.env = GuessEnv(2, places=3)  # a round's eight dialogues are played in three batches

    rows = trainer.train()

    for replica in range(2):
        own = rows[replica::2]
        turns = [round(row["turns"] * row["dialogues"]) for row in own]
        assert [row["buffer"] for row in own] == [sum(turns[: i + 1]) for i in range(3)]
        assert [row["updates"] for row in own] == [4 * -(-int(row["buffer"]) // 16) for row in own]
        assert trainer.loss.num_data[0][replica] == own[0]["buffer"]
        assert int(trainer.replay.buffers[replica][:]["next", "done"].sum()) == 3 * 8
    assert all(0.0 <= row["success_rate"] <= 1.0 for row in rows)


@pytest.mark.parametrize("name", ["round", "success_rate", "buffer", "td_error", "seconds"])
def test_a_metric_of_the_policy_takes_no_column_of_another(tmp_path, name):
    trainer = make_trainer(tmp_path, rounds=1)
    trainer.round_metrics = {name: lambda: 3.0}

    with pytest.raises(TrainingError, match=f"'{name}' is a metric of .*the policy"):
        trainer.train()

    assert not (tmp_path / "metrics.csv").exists()


@pytest.mark.parametrize("name", ["replica", "reward", "updates"])
def test_an_entry_of_the_loss_takes_no_column_of_another(tmp_path, name):
    trainer = make_trainer(tmp_path, rounds=1)
    forward = trainer.loss.forward
    trainer.loss.forward = lambda batch: forward(batch).set(name, torch.ones(3))

    with pytest.raises(TrainingError, match=f"'{name}' is a metric of .*the loss"):
        trainer.train()


def test_rounds_follow_the_protocol_and_move_schedules_and_environment(tmp_path):
    trainer = make_trainer(tmp_path, rounds=2, replicas=1)
    events: list[str] = []
    freeze, loss_forward = trainer.target_updater.step, trainer.loss.forward

    def frozen() -> None:
        events.append("freeze")
        freeze()

    def learned(batch: TensorDictBase) -> TensorDictBase:
        events.append("update")
        return loss_forward(batch)

    trainer.target_updater.step = frozen
    trainer.loss.forward = learned

    rows = trainer.train()

    expected: list[str] = []
    for row in rows:
        expected += 2 * ["freeze", *["update"] * (int(row["updates"]) // 2)]
    assert events == expected
    assert [row["epsilon"] for row in rows] == pytest.approx([0.8, 0.4])
    assert trainer.policy[-1].module.resampled == 2
    assert trainer.env.rounds_seen == [0, 0, 1]  # the spike plays in the state of round 0


@pytest.mark.parametrize("dialogues", [8, 13])
def test_the_spike_fills_every_replica_with_dialogues_of_its_own(tmp_path, dialogues):
    trainer = make_trainer(tmp_path, spike=Spike(random_policy, dialogues))

    trainer.begin()

    assert trainer.replay.protected == trainer.replay.lengths
    seen: set[tuple[float, ...]] = set()
    for buffer in trainer.replay.buffers:
        assert int(buffer[:]["next", "done"].sum()) == dialogues
        own = set(map(tuple, buffer[:]["observation"].tolist()))
        assert seen.isdisjoint(own)
        seen |= own


def test_a_spike_without_a_success_is_told(tmp_path, caplog):
    def second_guesses(tensordict: TensorDictBase) -> TensorDictBase:
        action = random_policy(tensordict)["action"]
        action[[0, 2]] = 1
        return tensordict

    for name, policy in {"guess": random_policy, "second guesses": second_guesses}.items():
        make_trainer(tmp_path / name, capacity=400, spike=Spike(policy, 20)).begin()
    # TorchRL tells of every storage if another test let it.
    told = [r.getMessage() for r in caplog.records if r.name.startswith("bbq_torchrl")]
    assert told == ["none of the 20 spiked dialogues of replica 0, 2 is a success"]


def test_the_spike_is_protected_by_default_and_evicted_otherwise(tmp_path):
    for protect in (True, False):
        spike = Spike(random_policy, 5, protect=protect)
        trainer = make_trainer(tmp_path / str(protect), rounds=6, capacity=40, spike=spike)
        trainer.begin()
        spiked = [buffer[:]["observation"].clone() for buffer in trainer.replay.buffers]
        while trainer.rounds_done < 6:
            trainer.train_round()

        assert trainer.replay.lengths == (40, 40, 40)
        for buffer, rows in zip(trainer.replay.buffers, spiked, strict=True):
            left = set(map(tuple, buffer[:]["observation"].tolist()))
            assert left.issuperset(map(tuple, rows.tolist())) == protect
            assert protect or left.isdisjoint(map(tuple, rows.tolist()))


@pytest.mark.parametrize("threshold", [0.1, 0.6])  # .1: passed as soon as there are three rounds
def test_the_spike_is_dropped_where_the_mean_success_passes_the_threshold(tmp_path, threshold):
    spike = Spike(random_policy, 5, drop_above=threshold, drop_window=3)
    trainer = make_trainer(tmp_path, rounds=12, capacity=400, spike=spike)
    protected: list[tuple[int, ...]] = []
    trainer.callbacks = (lambda t, rows: protected.append(t.replay.protected),)

    rows = trainer.train()

    dropped = 0
    for replica in range(3):
        rates = [row["success_rate"] for row in rows[replica::3]]
        passed = [r >= 2 and sum(rates[r - 2 : r + 1]) / 3 > threshold for r in range(12)]
        expected = [not any(passed[: r + 1]) for r in range(12)]
        assert [p[replica] > 0 for p in protected] == expected
        dropped += not all(expected)
    assert dropped > 0


def test_a_spike_that_fills_the_capacity_is_refused(tmp_path):
    trainer = make_trainer(tmp_path, capacity=40, spike=Spike(random_policy, 80))

    with pytest.raises(
        ValueError, match="of 80 spiked dialogues must be fewer than the capacity 40"
    ):
        trainer.train()
    assert not (tmp_path / "checkpoint").exists()


def test_a_loss_that_is_not_finite_stops_with_the_state_saved(tmp_path):
    trainer = make_trainer(tmp_path, rounds=6)
    forward, calls = trainer.loss.forward, count(1)

    def broken(batch: TensorDictBase) -> TensorDictBase:
        out = forward(batch)
        if next(calls) > 40:
            out["loss_value"][1] = torch.nan
        return out

    trainer.loss.forward = broken

    with pytest.raises(NonFiniteLossError, match="replica 1 is not finite in round"):
        trainer.train()

    saved = tmp_path / "checkpoint" / f"failed-round-{trainer.rounds_done:06d}.torchrl"
    assert len(trainer.metrics.rows) == 3 * trainer.rounds_done
    other = make_trainer(tmp_path / "other")
    other.checkpoints.load(saved)
    for name, value in trainer.loss.state_dict().items():
        assert torch.equal(other.loss.state_dict()[name], value)


def test_a_loss_without_its_value_per_replica_is_refused(tmp_path):
    trainer = make_trainer(tmp_path)
    forward = trainer.loss.forward
    trainer.loss.forward = lambda batch: forward(batch).exclude("loss_value")

    with pytest.raises(TrainingError, match=r"must return loss_value of shape \[3\]"):
        trainer.train()


def test_an_environment_that_tells_no_success_is_refused(tmp_path):
    env = TransformedEnv(GuessEnv(3, 8), ExcludeTransform("success"))
    with pytest.raises(TrainingError, match=r"must write \('next', 'success'\)"):
        make_trainer(tmp_path, env=env, rounds=1, spike=None).train()


def test_a_folder_that_holds_a_training_is_not_overwritten(tmp_path):
    make_trainer(tmp_path, rounds=1).train()
    before = (tmp_path / "metrics.csv").read_text()

    with pytest.raises(ValueError, match="holds a training already"):
        make_trainer(tmp_path, rounds=1).train()

    assert (tmp_path / "metrics.csv").read_text() == before


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"env": GuessEnv(2, 8)}, r"must be \[3, places\] for 3 replicas, got \[2, 8\]"),
        ({"optimizer": Adam([torch.ones(1)])}, "as ReplicaAdam does, got Adam"),
        ({"rounds": 0}, "rounds must be at least 1, got 0"),
        ({"batch_size": -1}, "batch_size must be at least 1, got -1"),
        ({"keep_checkpoints": 0}, "keep_checkpoints must be at least 1, got 0"),
    ],
)
def test_parts_and_numbers_that_do_not_fit_are_refused(tmp_path, changed, message):
    with pytest.raises(ValueError, match=message):
        make_trainer(tmp_path, **changed)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"dialogues": 0}, "dialogues must be at least 1, got 0"),
        ({"drop_above": 1.5}, r"drop_above must be in \[0, 1\) or None, got 1.5"),
        ({"drop_above": 0.5, "protect": False}, "drop_above needs protect=True"),
        ({"drop_window": 0}, "drop_window must be at least 1, got 0"),
    ],
)
def test_a_spike_that_makes_no_sense_is_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        Spike(**{"policy": random_policy, "dialogues": 5, **changed})


def weights_after(folder: Path, stops: Sequence[int], **protocol: Any) -> list[torch.Tensor]:
    """Returns the weights after each of the rounds in which the training stopped."""
    seen = []
    for stop in stops:
        trainer = make_trainer(folder, rounds=4, checkpoint_every=1, **protocol)
        trainer.begin(resume=folder.exists())
        while trainer.rounds_done < stop:
            trainer.train_round()
        seen.append(trainer.optimizer.parameters[0].detach().clone())
    return seen


def test_the_learning_rate_falls_after_its_share_of_the_rounds_resumed_or_not(tmp_path):
    constant = weights_after(tmp_path / "constant", (2, 4))
    lr_share = ProtocolOption(rounds=4, lr_final=0.0, lr_decay_from=0.5).lr_share
    falls = weights_after(tmp_path / "falls", (2, 3, 4), lr_share=lr_share)
    (through,) = weights_after(tmp_path / "through", (3,), lr_share=lr_share)

    assert torch.equal(falls[0], constant[0])
    assert not torch.equal(falls[1], falls[0])  # at half of the rate
    assert torch.equal(falls[1], through)
    assert torch.equal(falls[2], falls[1])  # at 0: nothing moves in the last round
    assert not torch.equal(constant[1], falls[2])
