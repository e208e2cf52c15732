"""Runs of one setting are a group, whose label tells it from the others."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from bbq_torchrl.evaluation.comparison import references
from bbq_torchrl.evaluation.groups import label, read_groups


def test_runs_that_differ_in_their_seed_alone_are_one_group(add):
    other = add([0.1], agent="dqn", explore="epsilon_greedy")
    bbqn, dqn = read_groups([add([0.5, 0.6], seed=0), other, add([0.7], seed=1)])
    assert (bbqn.label, dqn.label) == ("BBQN-MAP", "DQN")
    assert bbqn.final == [0.5, 0.6, 0.7]
    assert bbqn.cumulative == pytest.approx([0.25, 0.3, 0.35])
    assert bbqn.success.tolist() == [[0.25, 0.3, 0.35]] * 3
    assert (bbqn.reward, bbqn.turns) == (10, 8)
    assert dqn.final == [0.1]


def test_replicas_with_values_of_their_own_are_groups_of_their_own(add):
    stds = [0.05, 0.05, 0.2]
    values = [{"agent.prior_std": std} for std in stds]
    run = add([0.5, 0.6, 0.9], values=values, prior_std=stds)
    small, large = read_groups([run, add([0.7], seed=1, prior_std=0.2)])
    assert small.label == "BBQN-MAP, agent.prior_std=0.05"
    assert large.label == "BBQN-MAP, agent.prior_std=0.2"
    assert (small.final, large.final) == ([0.5, 0.6], [0.9, 0.7])
    assert small.success.tolist() == [[0.25, 0.3]] * 3
    assert large.success.tolist() == [[0.45, 0.35]] * 3


@pytest.mark.parametrize(
    ("other", "labels"),
    [
        ({"prior_std": 0.05}, ("BBQN-MAP, agent.prior_std=0.1", "BBQN-MAP, agent.prior_std=0.05")),
        ({"target": "mc"}, ("BBQN-MAP", "BBQN-MC")),
        ({"rounds": 2}, ("BBQN-MAP, protocol.rounds=3", "BBQN-MAP, protocol.rounds=2")),
        (
            {"explore": "epsilon_greedy"},
            ("BBQN-MAP, explore=thompson", "BBQN-MAP, explore=epsilon_greedy"),
        ),
    ],
)
def test_a_label_says_what_tells_groups_of_an_agent_apart(add, other, labels):
    groups = read_groups([add([0.5]), add([0.5], **other)])
    assert tuple(group.label for group in groups) == labels


def test_a_label_has_the_keys_that_tell_settings_of_one_option_apart(add, report):
    groups = read_groups(
        [
            add([0.5]),
            add([0.6], changes={"explore.per": "round"}),
            add([0.4], explore="greedy", changes={"explore.per": "episode"}),
            add([0.4], agent="dqn", explore="greedy"),
        ]
    )
    one, other, *_ = labels = [group.label for group in groups]
    assert labels == [
        "BBQN-MAP, explore=thompson, explore.per=step",
        "BBQN-MAP, explore=thompson, explore.per=round",
        "BBQN-MAP, explore=greedy",
        "DQN",
    ]
    assert f"| {one} minus {other} | 1 |" in report()


def settings_of(group, *keys):
    """A group's keys and values: the name of its option, and keys that a version may lack."""
    values = {f"{group}.{key}": st.sampled_from([None, 0.1, 2, "step"]) for key in keys}
    named = st.fixed_dictionaries({f"{group}.name": st.sampled_from("ab")}, optional=values)
    return named | st.just({})


SETTINGS = st.tuples(
    settings_of("agent", "lr", "net.name"),
    settings_of("explore", "per", "shared"),
    settings_of("env", "start"),
    settings_of("protocol", "rounds"),
).map(lambda groups: {key: value for group in groups for key, value in group.items()})
NAMED = st.tuples(st.sampled_from(["DQN", "BBQN-MAP"]), SETTINGS)


@given(st.lists(NAMED, min_size=1, max_size=6, unique_by=str))
def test_labels_of_different_settings_differ(settings):
    labels = [label(name, setting, settings) for name, setting in settings]
    assert len({*labels}) == len(labels)


@pytest.mark.parametrize("stds", [[0.2, 0.2], [0.05, 0.2]])
def test_one_training_does_not_count_as_two_seeds(add, stds):
    one = add([0.7], seed=4, prior_std=0.2)
    values = [{"agent.prior_std": std} for std in stds]
    other = add([0.5, 0.6], seed=4, values=values, prior_std=stds)
    with pytest.raises(ValueError, match=r"same setting and seed \(4\)"):
        read_groups([one, other])


def test_metrics_and_result_must_be_of_one_run(add):
    run, other = add([0.5]), add([0.5], rounds=2)
    (other / "metrics.csv").replace(run / "metrics.csv")
    with pytest.raises(ValueError, match="metrics are of 2 rounds and 1 replicas, the result of 3"):
        read_groups([run])


MANY = "agent: {name: dqn}\nexplore: {name: greedy}\nreplicas: many\n"


@pytest.mark.parametrize("text", [None, "- 1\n", "seed: 1\n", MANY])
def test_a_configuration_that_is_none_is_refused(add, text):
    file = add([0.5]) / "config.yaml"
    file.unlink()
    if text is not None:
        file.write_text(text)
    with pytest.raises(ValueError, match=r"config\.yaml (cannot be read|is not the configuration)"):
        read_groups([file.parent])


def test_references_are_drawn_where_all_runs_have_the_same_users(add):
    known, privileged = (
        {"clairvoyant": 0.8},
        "clairvoyant (privileged: it reads what no agent is shown)",
    )
    first = add([0.5], references=known)
    other = add([0.5], seed=1, references={"clairvoyant": 0.7})
    older = add([0.5], seed=2)
    harder = add([0.5], references=known, changes={"env.slot_error_prob": 0.3})
    assert references(read_groups([first, other])) == {privileged: pytest.approx(0.75)}
    assert references(read_groups([first, other, older])) == {}
    assert references(read_groups([first, harder])) == {}


def test_the_best_script_is_drawn_though_not_all_runs_know_it(add):
    rates = (
        {"rule": 0.2, "careful": 0.6},
        {"rule": 0.3, "repair": 0.7},
        {"rule": 0.1, "repair": 0.8},
    )
    runs = [add([0.5], seed=seed, scripted=given) for seed, given in enumerate(rates)]
    found = references(read_groups(runs))
    assert found == {"repair (best script measured)": pytest.approx(0.75)}
