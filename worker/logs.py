"""Logs of the farm's processes: one line an event, JSON for machines or plain for a terminal.

Job: configure structlog once for a process.
Invariant: nobody but `main` calls this; modules only ask for a logger.
"""

import logging
import sys
from pathlib import Path
from typing import Any

import structlog


def configure_logs(level: str = "INFO", file: Path | None = None, **context: Any) -> None:
    """Send this process' logs to a file (appending) or to stderr; `context` is added to each line."""
    stream = sys.stderr if file is None else file.open("a", buffering=1, encoding="utf-8")
    renderer: structlog.typing.Processor = (
        structlog.dev.ConsoleRenderer(colors=False)
        if file is None and stream.isatty()
        else structlog.processors.JSONRenderer()
    )
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.getLevelNamesMapping()[level.upper()]),
        logger_factory=structlog.PrintLoggerFactory(file=stream),
        cache_logger_on_first_use=True,
    )
    structlog.contextvars.bind_contextvars(**context)
    if context:
        # contextvars do not reach other threads; what is true of the process goes into a processor instead.
        processors = structlog.get_config()["processors"]
        processors.insert(0, lambda _logger, _method, event: {**context, **event})
