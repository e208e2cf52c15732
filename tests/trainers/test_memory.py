"""Memory that is freed stays with the process."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

from bbq_torchrl.trainers import memory

PROGRAM = """
import resource, runpy, sys
import torch

if sys.argv[1] == "keep":
    assert runpy.run_path(sys.argv[2])["keep_freed_memory"]()  # without importing torchrl
for _ in range(3):
    torch.ones(800_000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    blocks = [torch.ones(800_000) for _ in range(5)]
    del blocks
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="is about glibc")
def test_blocks_are_allocated_again_without_new_pages():
    faults = {
        mode: int(
            subprocess.run(
                [sys.executable, "-c", PROGRAM, mode, memory.__file__],
                capture_output=True,
                text=True,
                check=True,
            ).stdout
        )
        for mode in ("keep", "as it is")
    }

    # 100 blocks of 781 pages; kept memory needs the pages of the first five blocks only.
    assert faults["keep"] < 10_000
    assert faults["as it is"] > 2 * faults["keep"]
