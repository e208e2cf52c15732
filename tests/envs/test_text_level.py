"""Dialogues whose users speak in sentences, with somebody who understands by the letter."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from bbq_torchrl.domains import Goal, tensorize
from bbq_torchrl.domains.coding import Coding
from bbq_torchrl.envs import DialogueEnv, SequencePolicy, measured, scripted_policy
from bbq_torchrl.envs.text import TextChannel
from bbq_torchrl.language import Frame, Understood
from bbq_torchrl.simulator import MeasuredErrors

PLACES = 40


class Letters:
    """Says frames as transcripts write them, understands them, and forgets what it is told to.

    ``hears`` makes another frame of what is left. ``unsure`` says of some words how often it
    mishears them, and knows that it does.
    """

    def __init__(self, domain, forgets=(), unsure=lambda words: 0, hears=lambda frame: frame):
        self.lexicon = SimpleNamespace(key=lambda slot, value: value.replace(" ", ""))
        self.forgets, self.unsure, self.hears = forgets, unsure, hears
        self.domain = domain
        self.said = []

    def user(self, frame, question=None, *, session=0, turn=0):
        self.frame = frame
        self.sure = 1.0 if turn >= self.unsure(session) else 0.5
        self.said.append((str(frame), str(question), session, turn))
        return str(frame)

    def asks(self, understood):
        return understood.confidence < 0.7 or bool(understood.unclear)

    def __call__(self, text, question=None):
        assert text == str(self.frame)
        informs = {s: v for s, v in self.frame.informs.items() if s not in self.forgets}
        requests = tuple(s for s in self.frame.requests if s not in self.forgets)
        if self.sure < 1:
            return Understood(Frame("deny", {}, ("zip",)), self.sure)
        return Understood(self.hears(Frame(self.frame.act, informs, requests)), self.sure)


def channel_of(domain, ask_below=None, **settings):
    letters = Letters(domain, **settings)
    return TextChannel(tensorize(domain), letters, letters, ask_below), letters


def played(domain, channel, turns=12):
    """Yields the state after the opening and after each turn of random actions."""
    env = DialogueEnv(domain, batch_size=(2, PLACES), channel=channel, seed=1)
    state = env.reset()
    yield env.dialogues
    generator = torch.Generator().manual_seed(2)
    # Who is offered nothing to choose from does not care, and its tracker cannot know whether it
    # still has questions: the one case in which both differ.
    acts = torch.tensor([action.act != "multiple_choice" for action in domain.actions])
    for _ in range(turns):
        shape = state["action_mask"].shape[:2]
        action = torch.randint(int(acts.sum()), shape, generator=generator)
        state["action"] = acts.nonzero().flatten()[action]
        state = env.step(state)["next"]
        yield env.dialogues


@pytest.mark.parametrize("name", ["movie", "restaurant"])
def test_who_is_understood_by_the_letter_is_seen_as_at_the_level_of_acts(name, request):
    domain = request.getfixturevalue(name)
    channel, _ = channel_of(domain)
    for state in played(domain, channel):
        assert torch.equal(state["heard_act"], state["user_act"])
        assert torch.equal(state["user_informs"], state["meant_informs"])
        is_going = ~state["done"]
        assert torch.equal(state["heard_requests"][is_going], state["pending"][is_going])
    assert int(state["turn"].max()) > 10


def test_a_sentence_is_not_understood_twice_in_one_context(movie):
    channel, letters = channel_of(movie)
    list(played(movie, channel, turns=3))
    said = [*letters.said]
    assert len(said) == len(set(said))
    list(played(movie, channel, turns=3))  # says the same once more
    assert letters.said == said


def test_what_is_not_heard_is_not_held_but_stays_what_the_user_wants(movie):
    channel, _ = channel_of(movie, forgets=("moviename", "theater"))
    place = movie.slots.index("moviename")
    for state in played(movie, channel, turns=2):
        assert not (state["meant_informs"] != state["user_informs"])[..., :place].any()
        assert not state["user_informs"][..., place].any()
        assert not state["heard_requests"][~state["done"]][:, movie.slots.index("theater")].any()
    assert state["constraints"][..., place].any()
    assert state["pending"][..., movie.slots.index("theater")].any()


def test_a_request_that_is_heard_once_is_kept_until_it_is_answered(movie):
    channel, letters = channel_of(movie)
    env = DialogueEnv(movie, batch_size=(PLACES,), channel=channel, seed=1)
    state = env.reset()
    asked = env.dialogues["pending"].clone()
    letters.forgets = movie.slots  # from here on nothing is understood
    for action in ("greeting", "inform(theater)"):
        state["action"] = torch.full((PLACES,), movie.action_index(action))
        state = env.step(state)["next"]
        heard = env.dialogues["heard_requests"]
        if action == "greeting":
            assert torch.equal(heard, asked)
    theater = movie.slots.index("theater")
    assert asked[:, theater].any()
    assert not heard[:, theater].any()
    others = torch.arange(len(movie.slots)) != theater
    assert torch.equal(heard[:, others], asked[:, others])


def test_another_spelling_of_a_value_is_the_value_that_was_said(movie):
    slot, texts = movie.slots.index("starttime"), Coding(tensorize(movie))
    spaced = [text for text in tensorize(movie).vocabulary[slot] if " " in text]
    pairs = [(t, t.replace(" ", "")) for t in spaced]
    said, other = next((a, b) for a, b in pairs if texts.ids({"starttime": b})[slot])
    channel, _ = channel_of(movie, hears=lambda _: Frame("inform", {"starttime": other}))
    heard = channel._hear(Frame("inform", {"starttime": said}), None, 0)
    assert heard[2 + slot] == texts.ids({"starttime": said})[slot]
    assert heard[2 + slot] != texts.ids({"starttime": other})[slot]


def test_one_dialogue_is_heard_as_a_batch_of_one_is(movie):
    states = []
    for batch in ((), (1,)):
        env = DialogueEnv(movie, batch_size=batch, channel=channel_of(movie)[0], seed=1)
        env.rollout(4, scripted_policy("rule", env))
        states.append(env.dialogues.reshape(-1))
    assert (states[0] == states[1]).all()


@pytest.mark.parametrize("action", ["greeting", "request(city)"])
def test_who_is_asked_again_is_understood_and_takes_turns(movie, action):
    channel, letters = channel_of(movie, unsure=lambda words: words % 3)
    env = DialogueEnv(movie, batch_size=(PLACES,), channel=channel, seed=1)
    state, same = env.reset(), movie.action_index(action)
    rewards = torch.zeros(PLACES)
    for _ in range(env.max_agent_turns):
        before = env.dialogues
        assert torch.equal(before["user_informs"], before["meant_informs"])
        assert torch.equal(before["heard_act"], before["user_act"])
        state["action"] = torch.full((PLACES,), same)
        after = env.step(state)["next"]
        # A dialogue that nobody ends has an act of each side more than max_turn allows.
        spent = before["turn"] + 2 * before["repeats"]
        assert torch.equal(env.dialogues["done"], before["done"] | (spent + 2 > 40))
        rewards += after["reward"].squeeze(-1)
        state = after
    repeats = env.dialogues["repeats"]
    assert state["done"].all()
    # All turns but the last cost 1, and so does what was asked again; failing costs 10.
    assert torch.equal(rewards, -(state["turns"].squeeze(-1) - 1 + repeats + 10).float())
    asked = {(words % 3, turn) for _, _, words, turn in letters.said}
    assert asked == {(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)}


def test_after_asking_twice_it_acts_on_what_it_has(movie):
    channel, letters = channel_of(movie, unsure=lambda words: 3)
    repeats, act, *_ = channel._hear(Frame("inform", {"city": "reno"}), None, 0).tolist()
    assert repeats == 2
    assert channel.coding.acts[act] == "deny"  # as misheard as it is
    assert [turn for *_, turn in letters.said] == [0, 1, 2]


def test_a_slot_that_is_not_active_is_not_heard(movie):
    channel, _ = channel_of(movie)
    env = DialogueEnv(movie, batch_size=(PLACES,), channel=channel, seed=1)
    env._active[:] = False
    env.reset()
    assert not env.dialogues["user_informs"].any()
    assert not env.dialogues["heard_requests"].any()


def counted(domain, monkeypatch, turns=500, trained=None, **settings):
    channel, _ = channel_of(domain, **settings)
    monkeypatch.setattr(measured, "text_channel", lambda _: channel)
    monkeypatch.setattr(measured, "_BATCH", 60)
    text = measured.errors_text(measured.count_errors(domain, turns, trained=trained))
    return json.loads(text), text


def test_errors_are_counted_and_drawn_again(movie, monkeypatch):
    counts, text = counted(movie, monkeypatch, forgets=("date",))
    assert counts["turns"] >= 500
    assert max(map(len, text.splitlines())) < 3_000
    values = counts["values"]["asked"]
    assert all(set(heard) == {""} for heard in values["date"].values())
    assert all(set(heard) == {f"city={said}"} for said, heard in values["city"].items())
    env = DialogueEnv(
        movie, batch_size=(200,), channel=MeasuredErrors(tensorize(movie), counts), seed=0
    )
    env.rollout(8, break_when_any_done=False)
    env.reset()
    state = env.dialogues
    date, said = movie.slots.index("date"), state["meant_informs"]
    assert said[:, date].any()
    assert not state["user_informs"][:, date].any()
    others = torch.arange(len(movie.slots)) != date
    assert torch.equal(state["user_informs"][:, others], said[:, others])


@pytest.mark.parametrize(
    ("heard", "manner", "city", "new"),
    [
        (Frame("inform", {"state": "wa"}, ("date",)), "asking", "state=wa", ()),  # moved
        (
            Frame("inform", {"city": "reno", "genre": "comedy"}),
            "silent",
            "city=reno",
            ("genre=comedy",),
        ),
        (Frame("deny", {"genre": "comedy", "state": "wa"}), "silent", "", ("genre=comedy",)),
    ],
)
def test_what_is_misheard_is_counted_by_what_was_said(movie, monkeypatch, heard, manner, city, new):
    goal = Goal({"city": "seattle"}, ("theater",))  # all dialogues open by request(city; theater)
    counts, _ = counted(
        replace(movie, goals=(goal,)),
        monkeypatch,
        hears=lambda frame: heard if "theater" in frame.requests else frame,
    )
    openings = counts["inserted"]["opening"]["turns"]
    assert openings % 60 == 0
    assert counts["inserted"]["opening"] == {"turns": openings, **dict.fromkeys(new, openings)}
    assert counts["acts"][f"opening request {manner}"] == {heard.act: openings}
    assert counts["values"]["opening"] == {"city": {"seattle": {city: openings}}}
    assert counts["requests"]["1 said opening"] == {"theater": [0, openings]}
    assert counts["requests"]["1 unsaid opening"] == {
        slot: [openings * (slot in heard.requests), openings]
        for slot in movie.slots if slot != "theater"
    }  # fmt: skip


def test_who_is_always_understood_is_counted_so(restaurant, monkeypatch):
    counts, _ = counted(restaurant, monkeypatch)
    channel = MeasuredErrors(tensorize(restaurant), counts)
    for state in played(restaurant, channel):
        assert torch.equal(state["user_informs"], state["meant_informs"])
        is_going = ~state["done"]
        assert torch.equal(state["heard_requests"][is_going], state["pending"][is_going])
        assert torch.equal(state["heard_act"], state["user_act"])


def test_trained_agents_play_half_of_what_is_counted(movie, monkeypatch):
    tells = SequencePolicy([movie.action_index("inform(zip)")])  # and never anything else
    counts, _ = counted(movie, monkeypatch, 800, {"own": tells})
    assert counts["trained"] == ["own"]
    told = sum(n for key, found in counts["acts"].items() if key.startswith("inform ")
               for n in found.values())  # fmt: skip
    assert told > 0.35 * counts["turns"]


def test_a_domain_without_counts_is_told_how_to_make_them(restaurant, movie, tmp_path):
    with pytest.raises(ValueError, match=r"language count --domain"):
        measured.load_errors(restaurant)
    for damaged in ('{"values": {"opening": 3}}', "[" * 100_000, "{", "[]"):
        (tmp_path / measured.ERRORS_FILE).write_text(damaged, encoding="utf-8")
        with pytest.raises(ValueError, match=re.escape(f"{tmp_path / measured.ERRORS_FILE} is")):
            measured.load_errors(replace(movie, folder=tmp_path))
    counts = json.loads((movie.folder / measured.ERRORS_FILE).read_text(encoding="utf-8"))
    situation, slot = next(
        (key, name) for key, found in counts["requests"].items() for name in found
    )
    for pair in ([0, 0], [1]):
        counts["requests"][situation][slot] = pair
        (tmp_path / measured.ERRORS_FILE).write_text(json.dumps(counts), encoding="utf-8")
        with pytest.raises(ValueError, match="is damaged"):
            measured.load_errors(replace(movie, folder=tmp_path))


def test_errors_of_a_domain_that_has_other_slots_now_are_refused(movie):
    assert movie.slots[-1] == "mc_list"
    for slots in (movie.slots[:-1], (*movie.slots, "seats")):
        with pytest.raises(ValueError, match=r"counts the errors of another domain.*its slots are"):
            measured.load_errors(replace(movie, slots=slots))
