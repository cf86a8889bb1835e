r"""The only way by which a loader opens a file that another file names.

Invariants: a companion lies inside the model's own folder; names with a scheme, a drive, a leading slash, a backslash
or `..` that leaves the folder are never opened; nothing is ever fetched. When a list of companions is given, nothing
else is opened, so that what is loaded depends on the scene document alone.
"""

import os
import posixpath
import re
from collections.abc import Collection
from pathlib import Path
from urllib.parse import unquote

from tracer.loaders.errors import LoadError
from tracer.loaders.limits import LoadLimits

_SCHEME = re.compile(r"^[A-Za-z][A-Za-z0-9+.-]*:")


class CompanionError(Exception):
    """A companion file cannot be opened; the message says why, and names the companion."""


class ModelFile:
    """A file and the folder of its companions.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        Its name as its owner knows it, for messages.
    companions : collection of str or None
        Relative names that may be opened beside it; None allows everything in its folder.
    limits : LoadLimits
    """

    def __init__(self, path: Path, name: str, companions: Collection[str] | None, limits: LoadLimits) -> None:
        self.name = name
        self.limits = limits
        self.suffix = Path(name).suffix.lower()
        self._path = path
        self._folder = path.parent
        self._allowed = None if companions is None else {posixpath.normpath(companion) for companion in companions}
        self.warnings: list[str] = []

    def error(self, reason: str, mend: str) -> LoadError:
        """Return an error that names this file."""
        return LoadError(self.name, reason, mend)

    def warn(self, text: str) -> None:
        """Note something that the owner should know; at most 50 are kept."""
        if len(self.warnings) < 50 and text not in self.warnings:
            self.warnings.append(text)

    def read(self) -> bytes:
        """Return the file's bytes.

        Raises
        ------
        LoadError
            When it is absent, empty or larger than the limit.
        """
        try:
            size = self._path.stat().st_size
            if size > self.limits.file_bytes:
                raise self.error(
                    f"has {size} bytes, more than the {self.limits.file_bytes} allowed", "make it smaller or split it"
                )
            data = self._path.read_bytes()
        except OSError as error:
            raise self.error(
                f"cannot be read ({os.strerror(error.errno or 0)})", "put it there, or name another file"
            ) from None
        if not data:
            raise self.error("is an empty file", "export it again, or name another file")
        return data

    def read_companion(self, name: str) -> bytes:
        """Return the bytes of a file that this file names.

        Raises
        ------
        CompanionError
            When it may not be opened or cannot be read.
        """
        shown = name if len(name) <= 100 else name[:97] + "..."
        if _SCHEME.match(name) or name.startswith(("/", "\\")):
            raise CompanionError(f"{shown!r} is an address or an absolute path, which is never opened")
        # glTF encodes names with percent signs, and many exporters do not, or name a file that has one.
        candidates = list(dict.fromkeys(_relative(text, shown) for text in (unquote(name), name)))
        try:
            for relative in candidates:
                path = self._folder / relative
                if (self._allowed is not None and relative not in self._allowed) or not path.is_file():
                    continue
                if path.stat().st_size > self.limits.file_bytes:
                    raise CompanionError(f"{shown!r} is larger than {self.limits.file_bytes} bytes")
                return path.read_bytes()
        except OSError as error:
            raise CompanionError(f"{shown!r} cannot be read ({os.strerror(error.errno or 0)})") from None
        raise CompanionError(f"{shown!r} is missing")


def _relative(text: str, shown: str) -> str:
    """Return the name of a file in the model's folder, as the system spells it."""
    relative = posixpath.normpath(text.replace("\\", "/").strip())
    if relative.startswith(("../", "/")) or relative in {"..", "."} or _SCHEME.match(relative) or "\0" in relative:
        raise CompanionError(f"{shown!r} lies outside the model's folder and is never opened")
    return relative
