"""The address of an SQLite file for libraries that open it through SQLAlchemy."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


def sqlite_url(file: Path) -> str:
    """Returns SQLAlchemy's address of a file, whatever characters its path has.

    A path that is put into such an address as it is leads elsewhere if it has a ``%``, ``#`` or
    ``?``. As a file URI it is read alike by SQLAlchemy 2.0, which leaves the name of a database as
    it is, and by 2.1, which quotes it.

    Args:
        file: an absolute path.

    Examples:
        >>> from pathlib import Path
        >>> sqlite_url(Path("/runs/a?b.db"))  # doctest: +ELLIPSIS
        'sqlite+pysqlite:///file...uri=true'
    """
    from sqlalchemy.engine import URL  # comes with Optuna and with MLflow

    # The driver is named because MLflow makes folders of an address that begins with "sqlite:///".
    url = URL.create("sqlite+pysqlite", database=file.as_uri(), query={"uri": "true"})
    return url.render_as_string()
