"""What the service answers, as frozen dataclasses.

Invariant: unknown fields are ignored and absent ones have defaults, so a newer service does not break an older client;
`raw` keeps the whole answer for `--json`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

TERMINAL_STATES = frozenset({"succeeded", "failed", "canceled", "expired"})
"""States that never change again."""


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _integer(value: Any) -> int:
    number = _number(value)
    return int(number) if number is not None else 0


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a job is.

    Attributes
    ----------
    tiles_done, tiles_total : int
        Film tiles; the total is 0 until the job is planned.
    fraction : float
        Part done, 0 to 1.
    rays : int
        Rays traced so far, of all kinds.
    rays_per_s, eta_s : float or None
        Speed, and seconds to go; None while unknown.
    """

    tiles_done: int = 0
    tiles_total: int = 0
    fraction: float = 0.0
    rays: int = 0
    rays_per_s: float | None = None
    eta_s: float | None = None

    @classmethod
    def parse(cls, data: Any) -> "Progress":
        """Read the `progress` member of a job; anything malformed reads as unknown."""
        if not isinstance(data, Mapping):
            return cls()
        done, total = _integer(data.get("tiles_done")), _integer(data.get("tiles_total"))
        fraction = _number(data.get("fraction"))
        if fraction is None:
            fraction = done / total if total else 0.0
        return cls(
            tiles_done=done,
            tiles_total=total,
            fraction=min(max(fraction, 0.0), 1.0),
            rays=_integer(data.get("rays")),
            rays_per_s=_number(data.get("rays_per_s")),
            eta_s=_number(data.get("eta_s")),
        )


@dataclass(frozen=True, slots=True)
class Job:
    """One job as the service sees it now (JobView)."""

    id: str
    state: str
    name: str = ""
    created_at: str = ""
    updated_at: str = ""
    progress: Progress = field(default_factory=Progress)
    problem: Mapping[str, Any] | None = None
    raw: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @property
    def is_terminal(self) -> bool:
        """Whether the state can no longer change."""
        return self.state in TERMINAL_STATES

    @classmethod
    def parse(cls, data: Mapping[str, Any]) -> "Job":
        """Read a JobView.

        Raises
        ------
        ValueError
            When `id` or `state` is missing: the answer is not from a Smalti service.
        """
        if not isinstance(data, Mapping) or not data.get("id") or not data.get("state"):
            raise ValueError("this is not a job: it has no id or state")
        problem = data.get("problem")
        return cls(
            id=str(data["id"]),
            state=str(data["state"]),
            name=str(data.get("name") or ""),
            created_at=str(data.get("created_at") or ""),
            updated_at=str(data.get("updated_at") or ""),
            progress=Progress.parse(data.get("progress")),
            problem=problem if isinstance(problem, Mapping) else None,
            raw=data,
        )


@dataclass(frozen=True, slots=True)
class JobPage:
    """One page of the list of jobs, newest first; `next_cursor` is None on the last page."""

    jobs: tuple[Job, ...]
    next_cursor: str | None = None
