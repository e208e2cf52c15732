"""Processes to harm, and runs that nothing happened to."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from .cases import CONFIGURATIONS, SEED
from .commands import Commands
from .folders import Reference


@pytest.fixture(scope="session")
def commands(tmp_path_factory):
    started = Commands(tmp_path_factory.mktemp("adversary"))
    yield started
    started.close()


@pytest.fixture
def rng(request) -> random.Random:
    print(f"BBQ_SEED={SEED}")
    return random.Random(f"{SEED} {request.node.name}")


@pytest.fixture(scope="session")
def references(commands):
    """Makes, once for each configuration, a run that nothing happened to."""
    made: dict[str, Reference] = {}

    def of(name: str) -> Reference:
        if name not in made:
            folder = Path(commands.folder) / f"reference-{name}"
            ended = commands.run("train", *CONFIGURATIONS[name], f"hydra.run.dir={folder}")
            made[name] = Reference(folder, CONFIGURATIONS[name], ended.seconds)
        return made[name]

    return of
