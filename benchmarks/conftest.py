"""One thread, and freed memory kept as in training, for every benchmark."""

from __future__ import annotations

import logging

import pytest
import torch

from bbq_torchrl.trainers import keep_freed_memory
from benchmarks.parts.timing import Timer


@pytest.fixture(autouse=True)
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    keep_freed_memory()
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it tells of every storage
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def timer() -> Timer:
    return Timer()
