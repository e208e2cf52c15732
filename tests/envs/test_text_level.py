"""Dialogues whose users speak in sentences, with an exact nlu."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from bbq_torchrl.domains import Goal, tensorize
from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule, text_channel
from bbq_torchrl.envs.text_channel import TextChannel, count_errors, save_errors
from bbq_torchrl.people.language import Frame, Understood
from bbq_torchrl.simulator import MeasuredErrors
from bbq_torchrl.simulator.measured_errors import ERRORS_FILE, load_errors

PLACES = 40


class Letters:
    """Says frames as transcripts write them, understands them, and forgets what it is told to.

    ``hears`` makes another frame of what is left. ``unsure`` says of some words how often it
    mishears them, and knows that it does.
    """

    def __init__(self, forgets=(), unsure=lambda words: 0, hears=lambda frame: frame):
        self.lexicon = SimpleNamespace(key=lambda slot, value: value.replace(" ", ""))
        self.forgets, self.unsure, self.hears = forgets, unsure, hears
        self.said = []

    def user(self, frame, question=None, *, session=0, turn=0):
        self.frame = frame
        self.sure = 1.0 if turn >= self.unsure(session) else 0.5
        self.said.append((str(frame), str(question), session, turn))
        return str(frame)

    def asks(self, understood):
        return understood.confidence < 0.7

    def __call__(self, text, question=None):
        assert text == str(self.frame)
        if self.sure < 1:
            return Understood(Frame("deny", {}, ("zip",)), self.sure)
        informs = {s: v for s, v in self.frame.informs.items() if s not in self.forgets}
        requests = tuple(s for s in self.frame.requests if s not in self.forgets)
        return Understood(self.hears(Frame(self.frame.act, informs, requests)), self.sure)


def channel_of(domain, **settings):
    letters = Letters(**settings)
    return TextChannel(tensorize(domain), letters, letters), letters


def begun(domain, channel, **settings):
    """Returns an environment and the observation of the openings."""
    env = DialogueEnv(domain, batch_size=(PLACES,), channel=channel, seed=1, **settings)
    return env, env.reset()


def say(env, told, name):
    """Plays an action in all dialogues. Returns the observation."""
    action = torch.full(env.batch_size, env.domain.action_index(name))
    return env.step(told.set("action", action))["next"]


def played(domain, channel, turns=12):
    """Yields the state after the opening and after each turn of random actions."""
    env = DialogueEnv(domain, batch_size=(2, PLACES), channel=channel, seed=1)
    told = env.reset()
    yield env.dialogues
    # A user who is offered no values does not care, and the tracker cannot know whether it still
    # has questions: the only case in which both differ.
    acts = [n for n, action in enumerate(domain.actions) if action.act != "multiple_choice"]
    for _ in range(turns):
        told["action"] = torch.tensor(acts)[torch.randint(len(acts), env.batch_size)]
        told = env.step(told)["next"]
        yield env.dialogues


@pytest.mark.parametrize("name", ["movie", "restaurant"])
def test_who_is_understood_by_the_letter_is_seen_as_at_the_level_of_acts(name, request):
    domain = request.getfixturevalue(name)
    for state in played(domain, channel_of(domain)[0]):
        going = ~state["done"]
        assert torch.equal(state["heard_act"], state["user_act"])
        assert torch.equal(state["user_informs"], state["meant_informs"])
        assert torch.equal(state["heard_requests"][going], state["pending"][going])
    assert int(state["turn"].max()) > 10


def test_a_request_that_is_heard_once_is_kept_until_it_is_answered_whatever_is_not_heard(movie):
    channel, letters = channel_of(movie)
    env, told = begun(movie, channel)
    asked, theater = env.dialogues["pending"].clone(), movie.slots.index("theater")
    assert asked[:, theater].any()
    letters.forgets = movie.slots  # nothing is understood from now on
    told = say(env, told, "greeting")
    assert torch.equal(env.dialogues["heard_requests"], asked)
    told = say(env, told, "inform(theater)")
    asked[:, theater] = False
    assert torch.equal(env.dialogues["heard_requests"], asked)
    say(env, told, "request(city)")
    assert env.dialogues["meant_informs"].any()
    assert not env.dialogues["user_informs"].any()


@pytest.mark.parametrize("action", ["greeting", "request(city)"])
def test_who_is_asked_again_is_understood_and_takes_turns(movie, action):
    channel, letters = channel_of(movie, unsure=lambda words: words % 3)
    env, told = begun(movie, channel)
    rewards = torch.zeros(PLACES)
    for _ in range(env.max_agent_turns):
        before = env.dialogues
        assert torch.equal(before["user_informs"], before["meant_informs"])
        assert torch.equal(before["heard_act"], before["user_act"])
        told = say(env, told, action)
        # A dialogue without an end has one more act of each side than max_turn.
        spent = before["turn"] + 2 * before["repeats"]
        assert torch.equal(env.dialogues["done"], before["done"] | (spent + 2 > 40))
        rewards += told["reward"].squeeze(-1)
    assert told["done"].all()
    # All turns but the last cost 1, and so do repetitions; failing costs 10.
    cost = told["turns"].squeeze(-1) - 1 + env.dialogues["repeats"] + 10
    assert torch.equal(rewards, -cost.float())
    asked = {(words % 3, turn) for _, _, words, turn in letters.said}
    assert asked == {(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)}


def test_after_asking_twice_it_acts_on_what_it_has(movie):
    channel, letters = channel_of(movie, unsure=lambda words: 3)
    env, _ = begun(movie, channel)
    assert (env.dialogues["repeats"] == 2).all()
    assert (env.dialogues["heard_act"] == movie.acts.index("deny")).all()  # although misheard
    assert {turn for *_, turn in letters.said} == {0, 1, 2}


def test_a_slot_that_is_not_active_is_not_heard(movie):
    channel, _ = channel_of(movie, hears=lambda _: Frame("inform", {"genre": "comedy"}, ("zip",)))
    env, _ = begun(movie, channel, schedule=ExtensionSchedule())
    assert not env.dialogues["user_informs"].any()
    assert not env.dialogues["heard_requests"].any()
    env.set_round(1_000)
    env.reset()
    assert env.dialogues["user_informs"].any()
    assert env.dialogues["heard_requests"].any()


@pytest.fixture
def counted(monkeypatch, tmp_path):
    """Counts errors with an exact nlu, and returns the counts after writing and reading them."""

    def call(domain, **settings):
        channel, _ = channel_of(domain, **settings)
        monkeypatch.setattr(text_channel, "text_channel", lambda _: channel)
        monkeypatch.setattr(text_channel, "_BATCH", 60)
        text = save_errors(tmp_path, count_errors(domain, 200)).read_text()
        assert max(map(len, text.splitlines())) < 3_000
        return json.loads(text)

    return call


def test_errors_are_counted_and_drawn_again(movie, counted):
    counts = counted(movie, forgets=("date",))
    assert counts["turns"] >= 200
    values = counts["values"]["asked"]
    assert all(set(heard) == {""} for heard in values["date"].values())
    assert all(set(heard) == {f"city={said}"} for said, heard in values["city"].items())
    env, _ = begun(movie, MeasuredErrors(tensorize(movie), counts))
    said, heard = env.dialogues["meant_informs"], env.dialogues["user_informs"]
    date = torch.tensor([slot == "date" for slot in movie.slots])
    assert said[:, date].any()
    assert torch.equal(heard, said * ~date)


@pytest.mark.parametrize(
    ("heard", "manner", "city", "new"),
    [
        (Frame("inform", {"state": "wa"}, ("date",)), "asking", "state=wa", []),  # moved
        (Frame("inform", {"city": "reno", "genre": "comedy"}), "silent", "city=reno", ["comedy"]),
        (Frame("deny", {"genre": "comedy", "state": "wa"}), "silent", "", ["comedy"]),
    ],
    ids=["moved", "changed and another added", "lost among several"],
)
def test_what_is_misheard_is_counted_by_what_was_said(movie, counted, heard, manner, city, new):
    goal = Goal({"city": "seattle"}, ("theater",))  # all dialogues open by request(city; theater)
    counts = counted(
        replace(movie, goals=(goal,)),
        hears=lambda frame: heard if "theater" in frame.requests else frame,
    )
    openings = counts["inserted"]["opening"].pop("turns")
    assert openings % 60 == 0
    assert counts["inserted"]["opening"] == {f"genre={value}": openings for value in new}
    assert counts["acts"][f"opening request {manner}"] == {heard.act: openings}
    assert counts["values"]["opening"] == {"city": {"seattle": {city: openings}}}
    assert counts["requests"]["1 said opening"] == {"theater": [0, openings]}
    unsaid = {slot: [openings * (slot in heard.requests), openings] for slot in movie.slots}
    del unsaid["theater"]
    assert counts["requests"]["1 unsaid opening"] == unsaid


def test_a_domain_without_counts_is_told_how_to_make_them(restaurant):
    with pytest.raises(ValueError, match=r"errors\.json"):
        load_errors(restaurant)


def test_counts_that_are_damaged_or_of_other_slots_are_refused(movie, tmp_path):
    for content in ('{"values": {"opening": 3}}', "[" * 100_000, "{", "[]"):
        (tmp_path / ERRORS_FILE).write_text(content, encoding="utf-8")
        with pytest.raises(ValueError, match=str(tmp_path)):
            load_errors(replace(movie, folder=tmp_path))
    assert movie.slots[-1] == "mc_list"
    for slots in (movie.slots[:-1], (*movie.slots, "seats")):
        with pytest.raises(ValueError, match="slots"):
            load_errors(replace(movie, slots=slots))
