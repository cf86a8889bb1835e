"""What the command line prints: lines, tables, errors, JSON.

Invariants: results go to standard output, everything else to standard error; control codes go to terminals only; text
from a scene or a service never reaches a terminal with its control characters.
"""

import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, TextIO

from client.errors import SmaltiError


def clean(text: str) -> str:
    """Replace control characters: a job's name or a problem's detail is somebody else's text."""
    return "".join(character if character.isprintable() else "\ufffd" for character in text)


def is_live(stream: TextIO) -> bool:
    """Whether a stream is a terminal that understands control codes."""
    return stream.isatty() and os.environ.get("TERM", "") not in {"", "dumb"}


class Terminal:
    """Standard output and standard error of one command.

    Parameters
    ----------
    as_json : bool
        Machine-readable output: JSON on standard output, and errors as JSON on standard error.
    quiet : bool
        Without notes and progress.
    """

    def __init__(self, *, as_json: bool = False, quiet: bool = False) -> None:
        self.as_json = as_json
        self.quiet = quiet or as_json

    def out(self, text: str) -> None:
        """Print a line of the result."""
        print(text, file=sys.stdout, flush=True)  # noqa: T201 - this is the place that prints

    def note(self, text: str) -> None:
        """Print a line about the result; not with `--json` or `--quiet`."""
        if not self.quiet:
            print(text, file=sys.stderr, flush=True)  # noqa: T201

    def warn(self, text: str) -> None:
        """Print a warning; also with `--quiet`, on standard error."""
        print(f"warning: {clean(text)}", file=sys.stderr, flush=True)  # noqa: T201

    def json(self, data: Any) -> None:
        """Print a JSON document."""
        self.out(json.dumps(data, indent=2, ensure_ascii=False))

    def table(
        self,
        header: Sequence[str],
        rows: Sequence[Sequence[str]],
        *,
        title: str = "",
        right: Sequence[int] = (),
    ) -> None:
        """Print a table: with lines on a terminal, in plain aligned columns elsewhere.

        Parameters
        ----------
        header : sequence of str
            Names of the columns; all empty for a table without.
        rows : sequence of sequences of str
            Cells.
        title : str
            Line above it.
        right : sequence of int
            Columns that are set to the right.
        """
        cells = [[clean(cell) for cell in row] for row in rows]
        to_right = [column in right for column in range(len(header))]
        if is_live(sys.stdout):
            self._rich_table(header, cells, to_right, title)
            return
        if title:
            self.out(title)
        lines = [list(header), *cells] if any(header) else cells
        widths = [max((len(line[column]) for line in lines), default=0) for column in range(len(header))]
        for line in lines:
            parts = [
                cell.rjust(width) if right else cell.ljust(width)
                for cell, width, right in zip(line, widths, to_right, strict=True)
            ]
            self.out("  ".join(parts).rstrip())

    def _rich_table(
        self, header: Sequence[str], rows: Sequence[Sequence[str]], to_right: Sequence[bool], title: str
    ) -> None:
        from rich import box
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        table = Table(title=title or None, title_justify="left", box=box.SIMPLE_HEAD, show_header=any(header))
        for name, right in zip(header, to_right, strict=True):
            table.add_column(name, justify="right" if right else "left", overflow="fold")
        for row in rows:
            table.add_row(*[Text(cell) for cell in row])
        Console().print(table)

    def error(self, error: SmaltiError) -> None:
        """Print an error: what, where, and what to do about it."""
        if self.as_json:
            document: dict[str, Any] = {"error": error.message, "exit_code": int(error.exit_code)}
            if error.faults:
                document["faults"] = [asdict(fault) for fault in error.faults]
            if error.hint:
                document["hint"] = error.hint
            if isinstance(error.problem, Mapping):
                document["problem"] = dict(error.problem)
            print(json.dumps(document, indent=2), file=sys.stderr, flush=True)  # noqa: T201
            return
        lines = [f"error: {clean(error.message)}"]
        for fault in error.faults:
            place = fault.pointer or "(whole document)"
            expected = f" (expected: {fault.expected})" if fault.expected else ""
            lines.append(f"  {clean(place)}: {clean(fault.message)}{clean(expected)}")
        if error.hint:
            lines.append(f"hint: {clean(error.hint)}")
        print("\n".join(lines), file=sys.stderr, flush=True)  # noqa: T201
