"""Tables of sentences, in text files beside the tests."""

from pathlib import Path


def rows(file, name):
    """Returns the columns of a table beside a file."""
    lines = Path(file).with_name(name).read_text("utf-8").splitlines()
    return [[part.strip() for part in line.split("|")] for line in lines if line[:1] not in "#"]


def pairs(text):
    """Returns values, as a column of a table has them: "city=reno, date=friday"."""
    return dict(pair.split("=") for pair in text.split(", ") if pair)
