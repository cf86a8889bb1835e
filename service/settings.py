"""Settings of the API process, from arguments or the environment (prefix ``SMALTI_``).

Job: the farm's settings and the few that only HTTP needs; one frozen object, built in `create_app`.
Invariant: nothing else in `service` reads the environment.
"""

import ipaddress

from pydantic import Field

from worker.settings import FarmSettings


class ServiceSettings(FarmSettings):
    """The farm's settings, and the limits of the HTTP API."""

    max_body_bytes: int = Field(
        default=64 << 20, ge=1024, description="Largest JSON body; the scene document's own limit is 64 MB."
    )
    allowed_hosts: str = Field(
        default="",
        description="Names, separated by commas, that Host may hold beside the loopback names; * allows all. "
        "Empty: none when the API listens on loopback, all otherwise.",
    )

    def host_names(self) -> frozenset[str]:
        """Return the names that ``Host`` may hold beside the loopback names.

        A service on loopback answers to loopback names only: a page elsewhere whose name suddenly resolves to 127.0.0.1
        (DNS rebinding) could otherwise read and cancel jobs through a visitor's browser.
        """
        if self.allowed_hosts:
            return frozenset(name.strip().lower() for name in self.allowed_hosts.split(",") if name.strip())
        return frozenset() if is_loopback(self.host) else frozenset({"*"})


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach a server that listens on `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
