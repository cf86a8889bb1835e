"""httpx, without its own command line: that brings rich, click and pygments, half of what httpx takes to import."""

import sys

_COMMAND_LINE = "httpx._main"
_ABSENT = _COMMAND_LINE not in sys.modules
if _ABSENT:
    sys.modules[_COMMAND_LINE] = None  # type: ignore[assignment]  # "cannot be imported": httpx does without

import httpx  # noqa: E402

if _ABSENT:
    del sys.modules[_COMMAND_LINE]

__all__ = ["httpx"]
