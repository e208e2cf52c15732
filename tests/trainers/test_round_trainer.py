"""The round trainer on an environment of a few lines."""

import csv

import pytest
import torch
from torch.optim import Adam
from torchrl.envs import ExcludeTransform, TransformedEnv
from trainer_parts import GuessEnv, make_trainer

from bbq_torchrl.exploration import BatchedEGreedy
from bbq_torchrl.options import ProtocolOption
from bbq_torchrl.trainers import TrainingError, derive_seed


def test_it_learns(tmp_path):
    trainer = make_trainer(tmp_path, places=50, rounds=12, capacity=400, checkpoint_every=12)

    rates = [row["success_rate"] for row in trainer.train()]

    # Guessing at random succeeds in half of the dialogues; who has learned to wait for the hint,
    # in 127 of 128 (7 turns). The last five rounds are 750 dialogues: standard error .011 at .9.
    assert sum(rates[:6]) / 6 < 0.7
    assert sum(rates[-15:]) / 15 > 0.9


def test_metrics_are_what_was_played_and_learned(tmp_path):
    trainer = make_trainer(tmp_path, rounds=3, replicas=2, spike=None)
    trainer.env = GuessEnv(2, places=3)  # a round's eight dialogues are played in three batches

    rows = trainer.train()

    with (tmp_path / "metrics.csv").open(newline="") as file:
        table = [{k: float(v) for k, v in line.items()} for line in csv.DictReader(file)]
    assert table == rows
    assert list(rows[0]) == [
        *("round", "replica", "dialogues", "success_rate", "reward", "turns"),
        *("td_error", "q_value", "loss", "buffer", "updates", "epsilon"),
        *("seconds", "seconds_collect", "seconds_learn"),
    ]
    assert [(row["round"], row["replica"]) for row in rows] == [
        (r, i) for r in range(3) for i in (0, 1)
    ]
    for replica in range(2):
        own = rows[replica::2]
        turns = [round(row["turns"] * row["dialogues"]) for row in own]
        assert [row["buffer"] for row in own] == [sum(turns[: i + 1]) for i in range(3)]
        assert [row["updates"] for row in own] == [4 * -(-int(row["buffer"]) // 16) for row in own]
        assert trainer.learner.loss.num_data[0][replica] == own[0]["buffer"]
        assert int(trainer.replay.buffers[replica][:]["next", "done"].sum()) == 3 * 8
    assert all(0.0 <= row["success_rate"] <= 1.0 for row in rows)


def test_a_round_has_the_updates_that_are_asked_for_from_the_first_to_the_last(
    tmp_path, monkeypatch
):
    trainer = make_trainer(tmp_path, rounds=3, replicas=2, updates_per_round=7)
    events: list[str] = []
    for owner, name in (
        (trainer.learner.target_updater, "step"),
        (trainer.learner.loss, "forward"),
    ):
        noted(monkeypatch, owner, name, events)
    rows = trainer.train()
    assert [row["updates"] for row in rows] == 6 * [7]
    assert events == 3 * ["step", *4 * ["forward"], "step", *3 * ["forward"]]


def test_rounds_follow_the_protocol_and_move_schedules_and_environment(tmp_path, monkeypatch):
    trainer = make_trainer(tmp_path, rounds=2, replicas=1)
    events: list[str] = []
    for owner, name in (
        (trainer.learner.target_updater, "step"),
        (trainer.learner.loss, "forward"),
    ):
        noted(monkeypatch, owner, name, events)

    rows = trainer.train()

    expected: list[str] = []
    for row in rows:
        expected += 2 * ["step", *["forward"] * (int(row["updates"]) // 2)]
    assert events == expected
    assert [row["epsilon"] for row in rows] == pytest.approx([0.8, 0.6])
    assert trainer.policy[-1].resampled == 2
    assert trainer.env.rounds_seen == [0, 0, 1]  # the spike plays in the state of round 0


def test_a_schedule_falls_with_the_success_of_its_replica_resumed_or_not(tmp_path):
    def trainer_in(folder):
        explore = BatchedEGreedy(
            GuessEnv(1, 1).action_spec_unbatched,
            torch.ones(3, 1),
            0.0,
            action_mask_key="action_mask",
            until_success=1.0,
        )
        made = make_trainer(folder, last=[explore], places=1, rounds=5, replicas=3)
        made.round_metrics["by success"] = lambda: explore.eps.squeeze(-1)
        return made

    whole = trainer_in(tmp_path / "whole").train()
    stopped = trainer_in(tmp_path / "stopped")
    stopped.begin()
    for _ in range(2):
        stopped.train_round()
    stopped._save()
    resumed = trainer_in(tmp_path / "stopped").train(resume=True)
    for rows in (whole, resumed):
        mean = dict.fromkeys(range(3), 0.0)
        for row in rows:
            assert row["by success"] == pytest.approx(1 - mean[row["replica"]], abs=1e-6)
            mean[row["replica"]] += 0.2 * (row["success_rate"] - mean[row["replica"]])
    seen = [(row["success_rate"], row["by success"]) for row in whole]
    assert seen == [(row["success_rate"], row["by success"]) for row in resumed]
    assert len(set(seen)) > 3


def noted(monkeypatch, owner, name, events):
    """Records every call of a method by its name."""
    method = getattr(owner, name)

    def called(*arguments):
        events.append(name)
        return method(*arguments)

    monkeypatch.setattr(owner, name, called)


def test_every_phase_and_epoch_of_every_replica_has_a_separate_seed(tmp_path, monkeypatch):
    trainer = make_trainer(tmp_path, rounds=2, replicas=3)
    of_torch, of_env, of_replay = [], [], []
    monkeypatch.setattr(torch, "manual_seed", of_torch.append)
    monkeypatch.setattr(trainer.env, "set_seed", of_env.append)
    monkeypatch.setattr(trainer.replay, "seed", of_replay.extend)
    trainer.train()
    phases = 1 + 2 * (1 + 2 * 2)  # the spike; in a round: collect, two epochs after each freeze
    assert [len(set(seeds)) for seeds in (of_torch, of_env, of_replay)] == [phases, 3, 3 * phases]


def test_seeds_differ_by_run_and_path_and_stay_the_same_in_every_version():
    paths = [(0, 1), (0, "1"), (0, 1, 1), (0, 11), (1, 1), (0, "1", 1), (0, "a", 1), (0, "b", 1)]
    assert len({derive_seed(*path) for path in paths}) == len(paths)
    assert derive_seed(7, "collect", 3) == 3145391869347424827


def test_the_learning_rate_falls_after_its_share_of_the_rounds_resumed_or_not(tmp_path):
    def weights_after(name, *stops, **protocol):
        """The weights after each of the rounds in which the training stops."""
        seen = []
        for stop in stops:
            trainer = make_trainer(tmp_path / name, rounds=4, checkpoint_every=1, **protocol)
            trainer.begin(resume=bool(seen))
            while trainer.rounds_done < stop:
                trainer.train_round()
            seen.append(trainer.learner.optimizer.parameters[0].detach().clone())
        return seen

    lr_share = ProtocolOption(rounds=4, lr_final=0.0, lr_decay_from=0.5).lr_share
    constant = weights_after("constant", 2, 4)
    falls = weights_after("falls", 2, 3, 4, lr_share=lr_share)
    (through,) = weights_after("through", 3, lr_share=lr_share)

    assert torch.equal(falls[0], constant[0])
    assert not torch.equal(falls[1], falls[0])  # at half of the rate
    assert torch.equal(falls[1], through)
    assert torch.equal(falls[2], falls[1])  # at 0: nothing moves in the last round
    assert not torch.equal(constant[1], falls[2])


def of_the_policy(name):
    return lambda trainer: setattr(trainer, "round_metrics", {name: lambda: 3.0})


def of_the_loss(change):
    def put(trainer):
        loss = trainer.learner.loss
        forward = loss.forward
        loss.forward = lambda batch: change(forward(batch))

    return put


REFUSED = {
    **{name: of_the_policy(name) for name in ("round", "buffer", "td_error", "seconds")},
    **{
        name: of_the_loss(lambda out, name=name: out.set(name, torch.ones(3)))
        for name in ("replica", "reward", "updates")
    },
    "loss_value": of_the_loss(lambda out: out.exclude("loss_value")),
    "success": lambda trainer: setattr(
        trainer, "env", TransformedEnv(trainer.env, ExcludeTransform("success"))
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_the_parts_must_not_do_ends_the_first_round(tmp_path, name):
    trainer = make_trainer(tmp_path, rounds=1, spike=None)
    REFUSED[name](trainer)

    with pytest.raises(TrainingError, match=f"'?{name}'?"):
        trainer.train()
    assert not (tmp_path / "metrics.csv").exists()


def test_a_folder_that_contains_a_run_is_not_overwritten(tmp_path):
    make_trainer(tmp_path, rounds=1).train()
    before = (tmp_path / "metrics.csv").read_text()

    with pytest.raises(ValueError, match="contains a run already"):
        make_trainer(tmp_path, rounds=1).train()

    assert (tmp_path / "metrics.csv").read_text() == before


@pytest.mark.parametrize("changed", [{"env": GuessEnv(2, 8)}, {"optimizer": Adam([torch.ones(1)])}])
def test_parts_that_do_not_fit_are_refused(tmp_path, changed):
    with pytest.raises(ValueError, match=r"batch size|optimizer"):
        make_trainer(tmp_path, **changed)
