"""Importing a corpus in MiuLab's format: the domain folder loads, plays and trains."""

import pickle
import re

import pytest
from tiny import TINY, composed

from bbq_torchrl.cli import calibrate
from bbq_torchrl.domains import Goal, load_domain
from bbq_torchrl.domains.domain import REQUIRED_ACTS
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.runs.train import run
from bbq_torchrl.trainers import evaluate

SLOTS = ["pickup", "dropoff", "car", "cost", "people", "greeting", "color", "taxi", "taskcomplete"]
SLOTS += ["mc_list", "mc_list"]
PICKUPS, DROPOFFS, CARS = ("airport", "harbor", "zoo"), ("hotel", "station"), ("van", "sedan")
KB = {
    100 + 10 * i + j: {"pickup": pickup, "dropoff": dropoff, "car": CARS[(i + j) % 2], "cost": "9"}
    for i, pickup in enumerate(PICKUPS)
    for j, dropoff in enumerate(DROPOFFS)
}


def goal(pickup, dropoff, asked=("car",), **more):
    return {
        "diaact": "request",
        "inform_slots": {"pickup": pickup, "dropoff": dropoff, "people": "2", **more},
        "request_slots": dict.fromkeys((*asked, "taxi"), "UNK"),
    }


GOALS = [goal(pickup, dropoff) for pickup in PICKUPS for dropoff in DROPOFFS]
VALUES = {"pickup": [*PICKUPS], "dropoff": [*DROPOFFS], "car": [*CARS], "people": ["2", "3"]}
CHOICES = ["--ticket", "taxi", "--essential", "pickup,dropoff,people", "--free", "people"]


@pytest.fixture
def imported(tmp_path, capsys):
    """Imports the taxi corpus, with other contents of some files; returns code, out and err."""

    def write(*choices, kb=KB, goals=GOALS, values=VALUES, slots=SLOTS, acts=REQUIRED_ACTS):
        for name, content in {"kb": kb, "goals": goals, "values": values}.items():
            text = pickle.dumps(content, 0).replace(b"\n", b"\r\n")
            (tmp_path / f"{name}.p").write_bytes(text)
        (tmp_path / "slots.txt").write_text("\n".join(slots), encoding="utf-8-sig")
        (tmp_path / "acts.txt").write_text("\r\n".join(acts))
        files = [str(tmp_path / name) for name in ("slots.txt", "acts.txt", "kb.p", "goals.p")]
        given = [*files, str(tmp_path / "values.p"), str(tmp_path / "taxi"), *choices]
        code = calibrate.main(["import", *given])
        return code, *capsys.readouterr()

    return write


def played(domain, policy):
    env = DialogueEnv(domain, batch_size=(1, 500), slot_error_prob=0.0, seed=0)
    return evaluate(env, scripted_policy(policy, env), 500, seed=1).success.double().mean().item()


def test_a_corpus_of_taxis_is_imported_plays_and_trains(imported, tmp_path):
    code, out, err = imported(*CHOICES, "--opening", "pickup")
    assert (code, err) == (0, "")
    assert f"{tmp_path / 'taxi'}: 6 records, 6 goals, 10 slots" in out
    domain = load_domain(tmp_path / "taxi")
    assert domain.name == "taxi"
    assert domain.slots == tuple(dict.fromkeys(SLOTS))
    assert (domain.ticket_slot, domain.complete_slot) == ("taxi", "taskcomplete")
    assert domain.essential == ("pickup", "dropoff", "people", "taxi", "taskcomplete")
    assert domain.extension_order == ("car", "cost")
    assert domain.free_slots == ("people", "taxi", "taskcomplete")
    assert domain.opening_slots == ("pickup",)
    assert domain.records == tuple(KB[row] for row in sorted(KB))
    wanted = {"pickup": "airport", "dropoff": "hotel", "people": "2"}
    assert domain.goals[0] == Goal(wanted, ("car",))
    assert {"request(people)", "inform(car)", "inform(taxi)"} <= set(domain.action_names)
    assert "inform(people)" not in domain.action_names  # no record has it
    assert played(domain, "rule") == 0.0  # every user asks for the car
    assert played(domain, "careful") == played(domain, "repair") == 1.0
    where = ["domain=folder", f"domain.path={tmp_path / 'taxi'}", "env.max_turn=40"]
    assert run(composed(*TINY, *where, "protocol.rounds=1"), tmp_path / "run").rounds == 1


def test_what_is_left_out_or_changed_is_said_by_file(imported, tmp_path):
    kb = {**KB, 7: {"pickup": "zoo ", "color": "red", "taxi": "a taxi", "id": "77"}}
    goals = [
        *GOALS,
        goal("zoo", "hotel", greeting="hi"),
        goal("zoo", "hotel", asked=("pickup",)),
        goal("the\u00a0moon", "hotel"),
    ]
    code, out, _ = imported(*CHOICES, "--without", "greeting", kb=kb, goals=goals)
    assert code == 0
    for words in (
        ("2 values of pickup are respelled",),
        ("kb.p, row 7: ", "'id'"),
        ("goals.p, goal 7: ", "['pickup']"),
        ("values.json: ", "1 values of pickup"),
    ):
        assert any(all(word in line for word in words) for line in out.splitlines())
    domain = load_domain(tmp_path / "taxi")
    assert domain.records[0] == {"pickup": "zoo", "color": "red"}
    assert len(domain.goals) == 8
    assert domain.error_values["pickup"] == (*PICKUPS, "the moon")


REFUSED = {
    "an unknown essential slot": ([*CHOICES[:3], "from"], {}, "essential .*pickup, .* 'from'"),
    "no slot": (CHOICES, {"slots": [""]}, r"slots\.txt"),
}


@pytest.mark.parametrize(("choices", "contents", "message"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_imported_is_refused_and_leaves_no_folder(
    imported, tmp_path, choices, contents, message
):
    code, out, err = imported(*choices, **contents)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert re.search(message, err)
    assert not (tmp_path / "taxi").exists()
