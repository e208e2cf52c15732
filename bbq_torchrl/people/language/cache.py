"""An understander that is trained once for a domain and kept in the user's cache folder."""

from __future__ import annotations

import errno
import hashlib
import os
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from bbq_torchrl.people.language.phrases import LANGUAGE_FILE
from bbq_torchrl.people.language.training_lines import DRILLED_FILE, LEARNED_FILE, read_lines
from bbq_torchrl.people.language.understander import TICKS, Understander

if TYPE_CHECKING:
    from collections.abc import Callable

    from bbq_torchrl.domains import Domain


def cached_understander(
    domain: Domain,
    labeled: Path | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Understander:
    """Returns the understander of a domain, and trains it if it is not in the cache folder.

    Its file is named after a hash of everything that it is made from.

    Args:
        domain: the domain, with its phrases in its folder; otherwise with the generic phrases.
        labeled: the user's labeled lines, to learn from as well.
        tell: called with a message when training begins, which takes a minute; a terminal shows a
            progress bar.

    Raises:
        ValueError or OSError: a file that cannot be used.
        ModuleNotFoundError: the extra ``language`` is not installed.
    """
    lines = [] if labeled is None else read_lines(labeled, domain)
    kept = _cache_folder() / "bbq-torchrl" / f"{language_key(domain, labeled)}.npz"
    with suppress(OSError, ValueError):
        _make_private(kept.parent)
        return Understander.load(kept, domain)
    tell("Learning the language of the domain, once; it takes about a minute ...")
    with tqdm(total=TICKS, desc="learning", disable=None, leave=False) as bar:  # on a terminal
        own = Understander.train(domain, labeled=lines, tick=bar.update)
    with suppress(OSError):  # without a cache folder it is trained each time
        _make_private(kept.parent)
        own.save(kept)
    return own


def _cache_folder() -> Path:
    """Returns the user's cache folder; without a home folder, a path that cannot store files."""
    if given := os.environ.get("XDG_CACHE_HOME"):
        return Path(given)
    try:
        return Path.home() / ".cache"
    except RuntimeError:  # neither HOME nor a user name, as in some containers
        return Path(os.devnull)


def _make_private(folder: Path) -> None:
    """Creates a folder if needed, and restricts it to its user: its files are trusted.

    Raises:
        OSError: it cannot be made, or is another user's.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
        raise PermissionError(errno.EPERM, "is another user's", os.fspath(folder))
    folder.chmod(0o700)


def language_key(domain: Domain, labeled: Path | None = None) -> str:
    """Returns a hash of everything that the understander and the sentences are made from.

    Args:
        domain: the domain.
        labeled: the user's labeled lines.
    """
    digest = hashlib.sha256(f"{version('bbq-torchrl')} {domain!r}".encode())
    sources = sorted(Path(__file__).parent.glob("*.*"))
    files = (LANGUAGE_FILE, LEARNED_FILE, DRILLED_FILE)
    own = [] if domain.folder is None else [domain.folder / name for name in files]
    for path in (*sources, *own, *([labeled] if labeled is not None else [])):
        if path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()[:24]
