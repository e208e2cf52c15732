"""Runs of one setting are a group, whose label tells it from the others."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given, strategies as st

from bbq_torchrl.evaluation.finished_runs import Replica, agent_name
from bbq_torchrl.evaluation.groups import grouped, read_groups, references


def test_runs_that_differ_in_their_seed_alone_are_one_group(add):
    other = add([0.1], agent="dqn")
    bbqn, dqn = read_groups([add([0.5, 0.6], seed=0), other, add([0.7], seed=1)])
    assert (bbqn.label, dqn.label) == ("BBQN-MAP", "DQN")
    assert bbqn.final == [0.5, 0.6, 0.7]
    assert bbqn.cumulative == pytest.approx([0.25, 0.3, 0.35])
    assert bbqn.success.tolist() == [[0.25, 0.3, 0.35]] * 3
    assert (bbqn.reward, bbqn.turns, bbqn.dialogues) == (10, 8, 150)
    assert dqn.final == [0.1]


def test_replicas_with_values_of_their_own_are_groups_of_their_own(add):
    stds = [0.05, 0.05, 0.2]
    values = [{"agent.prior_std": std} for std in stds]
    run = add([0.5, 0.6, 0.9], values=values, prior_std=stds)
    small, large = read_groups([run, add([0.7], seed=1, prior_std=0.2)])
    assert (small.label, large.label) == ("BBQN-MAP", "BBQN-MAP, agent.prior_std=0.2")
    assert (small.final, large.final) == ([0.5, 0.6], [0.9, 0.7])
    assert small.success.tolist() == [[0.25, 0.3]] * 3
    assert large.success.tolist() == [[0.45, 0.35]] * 3


@pytest.mark.parametrize(
    ("others", "labels"),
    [
        ([{"prior_std": 0.05}], ["BBQN-MAP, agent.prior_std=0.05"]),
        ([{"target": "mc"}], ["BBQN-MC"]),
        ([{"rounds": 2}], ["BBQN-MAP, protocol.rounds=2"]),
        ([{"changes": {"explore.per": None}}], ["BBQN-MAP, explore.per=null"]),
        # An option is named instead of its keys, unless two settings of it are there.
        (
            [{"explore": "epsilon_greedy"}, {"explore": "epsilon_greedy", "eps": 1}],
            ["BBQN-MAP, explore=epsilon_greedy", "BBQN-MAP, explore=epsilon_greedy, agent.eps=1"],
        ),
        (
            [{"explore": "greedy", "changes": {"explore.per": per}} for per in ("a", "b")],
            ["BBQN-MAP, explore=greedy", "BBQN-MAP, explore=greedy, explore.per=b"],
        ),
        # The first of another agent is told by its name alone, whatever its own keys are.
        (
            [{"agent": "dqn"}, {"agent": "dqn", "dropout": 0.1}],
            ["DQN", "DQN, agent.dropout=0.1"],
        ),
    ],
)
def test_a_label_says_what_tells_a_group_from_the_first(add, others, labels):
    first, *found = read_groups([add([0.5]), *(add([0.5], **other) for other in others)])
    assert first.label == "BBQN-MAP"
    assert [group.label for group in found] == labels


def settings_of(group, *keys):
    """A group's keys and values: the name of its option, and keys that another may lack."""
    values = {key: st.sampled_from([None, 0.1, 2, "step"]) for key in keys}
    return st.tuples(
        st.just(group), st.fixed_dictionaries({"name": st.sampled_from("ab")}, optional=values)
    )


CONFIGS = st.tuples(
    settings_of("agent", "lr", "hidden"),
    settings_of("explore", "per", "shared"),
    settings_of("intrinsic"),
    settings_of("env", "start"),
    settings_of("protocol", "batch"),
).map(dict)


@given(st.lists(CONFIGS, min_size=1, max_size=6))
def test_labels_of_different_settings_differ(configs):
    result = SimpleNamespace(rounds=3, per_replica=[SimpleNamespace(values={})])
    replicas = [
        Replica(Path(str(number)), 0, config, SimpleNamespace(**vars(result), seed=number), None)
        for number, config in enumerate(configs)
    ]
    groups = grouped(replicas)
    assert len({group.label for group in groups}) == len(groups)
    assert len(groups) == len({str(sorted(one.setting.items(), key=str)) for one in replicas})


@pytest.mark.parametrize("stds", [[0.2, 0.2], [0.05, 0.2]])
def test_one_training_does_not_count_as_two_seeds(add, stds):
    one = add([0.7], seed=4, prior_std=0.2)
    values = [{"agent.prior_std": std} for std in stds]
    other = add([0.5, 0.6], seed=4, values=values, prior_std=stds)
    with pytest.raises(ValueError, match="seed"):
        read_groups([one, other])


def test_metrics_and_result_must_be_of_one_run(add):
    run, other = add([0.5]), add([0.5], rounds=2)
    (other / "metrics.csv").replace(run / "metrics.csv")
    with pytest.raises(ValueError, match="metrics"):
        read_groups([run])


@pytest.mark.parametrize("text", [None, "- 1\n", "seed: 1\n", "agent: {}\nexplore: {name: a}\n"])
def test_a_configuration_that_is_none_is_refused(add, text):
    file = add([0.5]) / "config.yaml"
    file.unlink()
    if text is not None:
        file.write_text(text)
    with pytest.raises(ValueError, match=r"config\.yaml"):
        read_groups([file.parent])


def test_references_are_drawn_where_all_runs_have_the_same_users(add):
    known, privileged = (
        {"clairvoyant": 0.8},
        "clairvoyant (privileged: it reads what no agent is shown)",
    )
    first = add([0.5], references=known, scripted={"rule": 0.2, "repair": 0.7})
    other = add([0.5], seed=1, references={"clairvoyant": 0.7}, scripted={"rule": 0.3})
    fewer = add([0.5], seed=2)
    harder = add([0.5], references=known, changes={"env.slot_error_prob": 0.3})
    script = {"repair (best script measured)": pytest.approx(0.7)}
    assert references(read_groups([first, other])) == {privileged: pytest.approx(0.75), **script}
    assert references(read_groups([first, other, fewer])) == script
    assert references(read_groups([first, harder])) == {}


@pytest.mark.parametrize(
    ("agent", "explore", "others", "name"),
    [
        # a target and a gain that differ are both named
        *(
            ({"name": "bbqn", "target": target}, explore, {"name": "vime", "weights": "map"}, name)
            for target, explore, name in (
                ("mc", "thompson", "BBQN-MC-VIME-MAP"),
                ("map", "thompson_boltzmann", "Soft BBQN-VIME-MAP"),
                ("map", "greedy", "BBQN-VIME-MAP, explore=greedy"),
                ("map", "boltzmann", "BBQN-VIME-MAP, explore=boltzmann"),
            )
        ),
        ({"name": "dqn", "double": True}, "boltzmann", {"name": "none"}, "Double DQN-Boltzmann"),
        ({"name": "dqn", "noisy": True}, "noisy", {"name": "none"}, "Noisy DQN"),
        (
            *({"name": "dqn", "noisy": True}, "epsilon_greedy", {"name": "none"}),
            "Noisy DQN, explore=epsilon_greedy",
        ),
        ({"name": "bootstrap"}, "greedy", {"name": "none"}, "DQN-Bootstrap, explore=greedy"),
        # a name leaves out the keys of a user's options
        (
            {"name": "polyak", "target": 0.005, "noisy": 0.1},
            *("boltzmann", {"name": "none"}, "POLYAK, explore=boltzmann"),
        ),
        (
            *({"name": "bbqn", "target": "mc"}, "thompson", {"name": "novelty", "weights": "mc"}),
            "BBQN-MC-NOVELTY",
        ),
    ],
)
def test_an_agent_is_named_by_the_keys_that_the_paper_has(agent, explore, others, name):
    config = {"agent": agent, "explore": {"name": explore}, "intrinsic": others}
    assert agent_name(config) == name
