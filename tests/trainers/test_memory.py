"""Memory that is freed stays with the process."""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys

import pytest

from bbq_torchrl.trainers import memory

# What glibc's mallinfo2 tells: bytes of the heap, and of blocks from the kernel of their own.
PROGRAM = """
import ctypes, json, runpy, sys
import torch

class Info(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in (
        "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    ).split()]

libc = ctypes.CDLL(None)
libc.mallinfo2.restype = Info
assert runpy.run_path(sys.argv[1])["keep_freed_memory"]()  # without importing torchrl
before = libc.mallinfo2()
block = torch.ones(5_000_000)
during = libc.mallinfo2()
del block
after = libc.mallinfo2()
print(json.dumps({"own": during.hblkhd - before.hblkhd, "kept": after.arena - before.arena}))
"""


@pytest.mark.skipif(
    not sys.platform.startswith("linux") or not hasattr(ctypes.CDLL(None), "mallinfo2"),
    reason="is about glibc",
)
def test_a_tensors_memory_is_kept_for_the_next_one():
    command = [sys.executable, "-c", PROGRAM, memory.__file__]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)

    # 20 MB from the heap, which keeps it; by default they are the kernel's and go back at once.
    assert told["own"] == 0
    assert told["kept"] >= 20_000_000
