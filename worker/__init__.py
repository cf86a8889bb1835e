"""The farm: job states, store, queue, leases, tasks, assembler and supervisor.

The store is the truth; Redis is an index that can be rebuilt from it at any moment.
"""

import sys

# structlog imports rich where it is installed, for logs in colours that the farm does not write: a third of the start
# of each of its processes.
_RICH_IS_ABSENT = "rich" not in sys.modules
if _RICH_IS_ABSENT:
    sys.modules["rich"] = None  # type: ignore[assignment]  # "cannot be imported"

import structlog  # noqa: E402, F401

if _RICH_IS_ABSENT:
    del sys.modules["rich"]
