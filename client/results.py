"""The kinds of results, by name; imports no HTTP, because a render on this machine asks here, too."""

from collections.abc import Mapping
from pathlib import Path

from client.errors import UsageError

RESULTS: Mapping[str, str] = {
    "png": "result.png",
    "exr": "result.exr",
    "preview": "preview.png",
    "report": "report",
}
"""Kinds of results → last part of their URL."""


def result_kind(target: Path) -> str:
    """Kind of result for a file name: `.png`, `.exr`, or `.json` for the report.

    Raises
    ------
    UsageError
        For any other extension.
    """
    kinds = {".png": "png", ".exr": "exr", ".json": "report"}
    try:
        return kinds[target.suffix.lower()]
    except KeyError:
        raise UsageError(f"cannot tell the format of {target}: end its name in .png, .exr or .json") from None
