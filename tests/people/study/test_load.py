"""Many people at once on one server, also with the real agents and understanding."""

from __future__ import annotations

import asyncio
import random
import re
import time

import pytest

from bbq_torchrl.people.study.database import opened

from .conftest import STUDY, hidden
from .served import Server

aiohttp = pytest.importorskip("aiohttp", reason="needs the package aiohttp")

PEOPLE = 200
THINKING = (2.0, 6.0)  # seconds between an answer and the next message
SAID = (
    "two tickets for wonka in tampa please",
    "friday night, for the four of us",
    "no, not that one, something at nine pm",
    "where is it, and what does it cost",
)
AGENTS = 'agents: {secret-bbqn: "shipped:bbqn_map", secret-dqn: "shipped:dqn"}'


@pytest.mark.slow
@pytest.mark.parametrize(
    "talker", ["study.fakes:make", "bbq_torchrl.people.study.players:make_talker"]
)
def test_two_hundred_people_at_once_are_answered_within_a_second(tmp_path, talker):
    study = STUDY.replace("participants: 5", f"participants: {PEOPLE}")
    if "agents" in talker:
        pytest.importorskip("pycrfsuite", reason="needs the extra chat")
        study = re.sub("^agents.*$", AGENTS, study, flags=re.MULTILINE)
    (tmp_path / "study.yaml").write_text(study)
    with Server(tmp_path / "study.yaml", talker=talker) as server:
        seconds, acknowledged = asyncio.run(everybody(server))
    with opened(tmp_path / "study.sqlite") as connection:
        stored = {text for (text,) in connection.execute("SELECT text FROM exchange")}
    assert len(acknowledged) > PEOPLE  # some agents end a conversation before the last message
    assert set(acknowledged) == stored
    seconds.sort()
    p95 = seconds[int(0.95 * len(seconds))]
    print(f"median {seconds[len(seconds) // 2]:.3f} s, p95 {p95:.3f} s, max {seconds[-1]:.3f} s")
    assert p95 < 1.0


async def everybody(server):
    seconds, acknowledged = [], []
    limit = aiohttp.TCPConnector(limit=0, keepalive_timeout=30)
    async with aiohttp.ClientSession(connector=limit) as client:
        people = [person(client, server, number, seconds, acknowledged) for number in range(PEOPLE)]
        await asyncio.gather(*people)
    return seconds, acknowledged


async def person(client, server, number, seconds, acknowledged):
    await asyncio.sleep(random.uniform(0, THINKING[1]))
    join = server.links["for people"]
    async with client.get(join) as answer:
        form = {**hidden(await answer.text()), "consent": "yes"}
    async with client.post(join, data=form) as answer:
        assert answer.status == 200
        link, page = str(answer.url), await answer.text()
    for message, said in enumerate(SAID):
        await asyncio.sleep(random.uniform(*THINKING))
        text = f"{said} (person {number}, message {message})"
        began = time.perf_counter()
        async with client.post(f"{link}/say", data={**hidden(page), "text": text}) as answer:
            page = await answer.text()
            assert answer.status == 200
        seconds.append(time.perf_counter() - began)
        assert text in page
        acknowledged.append(text)
        if 'name="text"' not in page:
            return  # the conversation has ended
