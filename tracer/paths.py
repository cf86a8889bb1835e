"""Where this host keeps what Smalti caches. Imports nothing: every process may ask, the API's too."""

import os
from pathlib import Path


def cache_root() -> Path:
    """Directory of everything that Smalti caches on this host.

    Returns
    -------
    Path
        ``$SMALTI_CACHE``, else ``$XDG_CACHE_HOME/smalti``, else ``~/.cache/smalti``.
    """
    own = os.environ.get("SMALTI_CACHE")
    if own:
        return Path(own)
    shared = os.environ.get("XDG_CACHE_HOME")
    return (Path(shared) if shared else Path.home() / ".cache") / "smalti"
