"""The benchmarks run, in sizes that take no time and mean nothing, and count and compare right."""

import pytest
import torch
from tiny import nightly
from torch.utils.flop_counter import FlopCounterMode

from bbq_torchrl.envs import DialogueEnv
from bbq_torchrl.networks import FlatMLP
from benchmarks import compare, gpu
from benchmarks.parts import on_device, processes, timing, updates
from benchmarks.parts.floor import PARAMETERS, UPDATES, turn, valid_share
from benchmarks.parts.host_draws import DrawsOnTheHost
from benchmarks.parts.host_waits import HostWaitError, NeverWaits
from benchmarks.parts.processes import Used
from benchmarks.parts.rows import Row, as_table, keep, read
from benchmarks.parts.sizes import TINY
from benchmarks.parts.yardstick import ACTIONS, FEATURES, HIDDEN, bare_update


@pytest.fixture(autouse=True)
def commands(monkeypatch):
    """Commands are noted, not run: their imports alone take seconds."""
    asked = []

    def python(*arguments):
        asked.append(arguments)
        return Used(wall=3.0, cpu=2.0, peak_bytes=10**9)

    monkeypatch.setattr(processes, "python", python)
    return asked


OTHERS = ("simulator", "update", "agents", "time_to_learn", "floor")


@pytest.mark.parametrize("part", nightly(["round", *OTHERS], ["round"]))
def test_part_gives_positive_figures(part, monkeypatch):
    monkeypatch.setattr(updates, "TARGETS", {"bbqn-map": (1.0, 1.0)})
    rows = compare.PARTS[part](TINY)
    assert rows
    assert all(row.part == part for row in rows)
    assert all(row.measured > 0 for row in rows if row.unit != "%")


@pytest.mark.parametrize("part", nightly(["same", "turns", "updates"], ["turns"]))
def test_the_gpu_benchmark_runs_on_a_cpu_whose_training_equals_itself(part, tmp_path, capsys):
    file = tmp_path / "gpu.csv"
    chosen = ["--device=cpu", "--tiny", f"--file={file}", "--parts", part]
    assert gpu.main(chosen) == 0
    rows = read(file)["cpu"]
    assert {row.part for row in rows} == {part}
    assert all(row.measured == 0 if part == "same" else row.measured > 0 for row in rows)
    assert rows[0].what in capsys.readouterr().out


def test_a_device_whose_training_differs_fails_the_gpu_benchmark(tmp_path, monkeypatch):
    rates = iter([0.5, 0.25])
    trained = lambda *_: [{"success_rate": next(rates), "reward": 1, "turns": 2, "loss": 3}]  # noqa: E731
    monkeypatch.setattr(on_device, "_trained", trained)
    given = ["--device=cpu", "--tiny", "--parts", "same", f"--file={tmp_path / 'gpu.csv'}"]
    assert gpu.main(given) == 1


def test_numbers_of_another_device_are_drawn_by_the_cpus_generator():
    torch.manual_seed(0)
    torch.rand(5), torch.randint(9, (3,))
    expected = torch.get_rng_state()
    torch.manual_seed(0)
    with DrawsOnTheHost():
        drawn = torch.rand(5, device="meta"), torch.randint(9, (3,), device="meta")
    assert torch.equal(torch.get_rng_state(), expected)
    assert [(value.shape, value.device.type) for value in drawn] == [((5,), "meta"), ((3,), "meta")]


def test_figures_are_printed_and_kept_as_a_versions(tmp_path, capsys):
    file = tmp_path / "speed.csv"
    compare.main(["process", "--tiny", "--save=0.2.0", f"--file={file}"])
    line = f"| python train.py --help | s | 3 | ≤ 6 | yes | {torch.__version__} |"
    assert line in capsys.readouterr().out
    assert [row.what for row in read(file)["0.2.0"]][1:] == ["python train.py --help"]


def test_rows_take_the_place_of_the_same_version_and_part(tmp_path):
    file = tmp_path / "speed.csv"
    other = Row("b", "wait", "s", 3.0, 9.0, "lower", True, "1 of 5")
    keep(file, "one", [Row("a", "time", "s", 1.0), other])
    keep(file, "two", [Row("a", "turns", "turns/s", 123456.0, 100.0, "higher")])
    keep(file, "one", [Row("a", "time", "s", 2.0)])
    assert read(file) == {
        "one": [other, Row("a", "time", "s", 2.0)],
        "two": [Row("a", "turns", "turns/s", 123500.0, 100.0, "higher")],
    }


def test_a_table_says_what_is_reached():
    rows = [
        Row("a", "bound", "s", 1.0, 2.0, is_bound=True, remark="1 of 5", torch="2.14.1"),
        Row("a", "speed", "turns/s", 99.0, 100.0, "higher", torch="2.14.1"),
        Row("a", "other", "ms", 3.14159, torch="2.14.1"),
    ]
    assert as_table(rows).splitlines()[2:] == [
        "| bound (1 of 5) | s | > 1 | ≤ 2 | no | 2.14.1 |",
        "| speed | turns/s | 99 | ≥ 100 | no | 2.14.1 |",
        "| other | ms | 3.14 | – | – | 2.14.1 |",
    ]


def test_the_floor_counts_what_torch_and_the_simulator_count(movie):
    update = bare_update()
    with FlopCounterMode(display=False) as counter:
        update()
    assert UPDATES["bare dqn"]["operations"] == counter.get_total_flops()
    network = FlatMLP(FEATURES, ACTIONS, HIDDEN)
    assert sum(p.numel() for p in network.parameters()) == PARAMETERS
    env = DialogueEnv(movie, batch_size=(8,), seed=0)
    draws = env.simulator.draw_turn((1,))
    work = turn(env)
    assert work["uniforms"] == sum(entry.numel() for entry in draws.values())
    assert work["bytes"] > 0
    assert 0 < valid_share(env) <= 1


def test_a_slow_spell_that_hits_both_leaves_the_ratio():
    clock = iter([1.0, 2.0, 1.0, 20.0, 10.0, 20.0, 10.0, 2.0, 1.0])
    result = timing.interleaved(lambda: next(clock), lambda: next(clock), repeats=4)
    # 2 / 1; 20 between 1 and 10; 20 between two of 10; 2 between 10 and 1
    assert result.ratio == pytest.approx((2.0 + 2.0) / 2)
    assert result.seconds == 11.0


WAITING = {
    "a number": lambda x: float(x.sum()),
    "a mask as an index": lambda x: x[x > 0],
    "a mask as an index to write to": lambda x: x.clone().__setitem__(x > 0, x[:1]),
    "places of a mask": lambda x: (x > 0).nonzero(),
    "rows of a mask": lambda x: torch.masked_select(x, x > 0),
    "different values": lambda x: x.unique(),
    "a tensor from a list": lambda x: x + torch.tensor([1.0, 2.0, 3.0]),
    "a comparison": lambda x: torch.equal(x, x),
    "another device": lambda x: x.to("meta"),
}


@pytest.mark.parametrize("what", WAITING)
def test_what_waits_is_refused(what):
    with NeverWaits(), pytest.raises(HostWaitError):
        WAITING[what](torch.arange(3.0))
