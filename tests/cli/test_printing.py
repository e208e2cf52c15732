"""Output that cannot be printed."""

import os
import sys

import pytest

from bbq_torchrl.utils import output


@pytest.fixture
def standard_output(monkeypatch):
    """Puts a file in the place of standard output, buffered."""
    opened = []

    def put(descriptor, encoding="utf-8"):
        opened.append(open(descriptor, "w", encoding=encoding))  # noqa: SIM115
        monkeypatch.setattr(sys, "stdout", opened[-1])

    yield put
    for file in opened:
        file.close()  # raises where something is still to be written and cannot be


def without_reader():
    read, write = os.pipe()
    os.close(read)
    return write


def test_a_command_that_nobody_reads_ends_without_a_word(standard_output, capsys):
    standard_output(without_reader())
    with pytest.raises(SystemExit) as end:
        output.write("text")
    assert end.value.code == output.NO_READER
    assert not capsys.readouterr().err


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_what_a_full_disk_takes_no_more_is_a_sentence(standard_output, capsys):
    standard_output(os.open("/dev/full", os.O_WRONLY))
    with pytest.raises(SystemExit) as end:
        output.write("text")
    assert end.value.code == output.NOT_WRITTEN
    error = capsys.readouterr().err
    assert error == "error: standard output cannot be written: No space left on device\n"


def test_an_encoding_without_a_character_is_no_error(standard_output, tmp_path):
    standard_output(tmp_path / "file", encoding="ascii")
    output.write("1 ± 2\n")
    assert (tmp_path / "file").read_text() == "1 \\xb1 2\n"
