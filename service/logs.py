"""Structured logs: one JSON object a line on standard error.

Job: configure structlog once per process and hand out loggers.
Invariant: a line holds ids, states, sizes and durations; never a header, a query string, a body or a token. JSON
escapes control characters, so nothing a client sends can forge a line.
"""

import logging
import sys
from typing import Any

import structlog


def configure_logs(level: str = "info") -> None:
    """Set up structlog for this process; later calls change the level only."""
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            structlog.processors.JSONRenderer(),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.getLevelNamesMapping()[level.upper()]),
        # The stream is looked up at each line: test runners and supervisors replace sys.stderr.
        logger_factory=lambda *_: structlog.PrintLogger(sys.stderr),
        cache_logger_on_first_use=False,
    )


def get_logger(name: str) -> Any:
    """Return a logger whose lines carry ``part=name``."""
    return structlog.get_logger(part=name)
