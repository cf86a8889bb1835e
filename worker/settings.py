"""Settings of the farm, from arguments or the environment (prefix ``SMALTI_``).

Job: one frozen object, built in ``main`` and handed down; `child_environment` gives a child process the same one.
Invariant: nothing else in `worker` reads the environment.
"""

import os
from collections.abc import Mapping
from pathlib import Path

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from tracer.paths import cache_root


def count_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class FarmSettings(BaseSettings):
    """Where the farm keeps its things and how many processes it runs."""

    model_config = SettingsConfigDict(env_prefix="SMALTI_", frozen=True, extra="ignore")

    store: Path = Field(default=Path(".smalti/store"), description="Folder of the store: the truth.")
    cache: Path = Field(default_factory=cache_root, description="Folder of this host's caches; may be deleted.")
    redis_url: str | None = Field(
        default=None, description="redis://, rediss:// or unix:// of a server to use; none starts an embedded Valkey."
    )
    host: str = Field(default="127.0.0.1", description="Address that the API listens on.")
    port: int = Field(default=8000, ge=0, le=65535, description="Port of the API; 0 takes a free one.")
    workers: int = Field(
        default_factory=count_cores,
        ge=0,
        le=1024,
        description="Worker processes on this host; default one per core.",
    )
    api: bool = Field(default=True, description="Whether the supervisor runs the HTTP API.")
    steward: bool = Field(default=True, description="Whether the supervisor runs steward and assembler.")
    backend: str = Field(default="cpu", description="Backend that renders; 'fake' is for tests of the farm.")
    nice: int = Field(default=10, ge=0, le=19, description="Niceness of workers: the API answers beside busy kernels.")
    ready_file: Path | None = Field(default=None, description="File that gets {url, redis_url, pid} once all is up.")
    log_file: Path | None = Field(default=None, description="File for the logs instead of stderr.")
    log_level: str = Field(default="INFO", description="Lowest level that is logged.")
    max_asset_bytes: int = Field(default=2 << 30, ge=1, description="Largest file that an upload may have.")

    def child_environment(self, base: Mapping[str, str] | None = None, **changes: object) -> dict[str, str]:
        """Return the environment that makes a child process build these settings, with `changes` applied."""
        environment = dict(os.environ if base is None else base)
        for name, value in {**self.model_dump(mode="json"), **changes}.items():
            key = f"SMALTI_{name.upper()}"
            if value is None:
                environment.pop(key, None)
            else:
                environment[key] = str(value)
        return environment
