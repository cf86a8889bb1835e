"""HTTP with retries: every call of the client goes through `Transport`.

Invariants: a request is sent again only if that is harmless: GET, PUT, DELETE, a POST with an `Idempotency-Key`, or any
request whose connection never came about. `Retry-After` is respected (RFC 9110, 10.2.3). Answers that are not 2xx leave
as errors of `client.errors`.
"""

import email.utils
import random
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from client.errors import ApiError, NotReachableError, SmaltiError, UsageError, error_from_problem
from client.http import httpx

RETRIED_STATUSES = frozenset({429, 502, 503, 504})
FIRST_BACKOFF_S = 0.2  # doubled each time: 0.2 + 0.4 + 0.8 + 1.6 s bridges the restart of an API process (about 1 s)
LONGEST_BACKOFF_S = 8.0
LONGEST_RETRY_AFTER_S = 60.0  # a service that asks for more is treated as not reachable now
CONNECT_TIMEOUT_S = 5.0
CHUNK_BYTES = 1 << 20


def is_loopback(url: str) -> bool:
    """Whether a URL names this machine; such requests must not go through a proxy of the environment."""
    host = urlsplit(url).hostname or ""
    return host in {"localhost", "::1"} or host.startswith("127.")


def retry_after_s(value: str | None, *, now: float) -> float | None:
    """Read a `Retry-After` header: seconds, or an HTTP date; None when absent or malformed.

    Parameters
    ----------
    value : str or None
        Header value.
    now : float
        Unix time in seconds, for dates.
    """
    if value is None:
        return None
    text = value.strip()
    if text.isdigit():
        return float(text)
    try:
        moment = email.utils.parsedate_to_datetime(text)
    except ValueError:
        return None
    return max(0.0, moment.timestamp() - now)


class Transport:
    """A connection pool to one service.

    Parameters
    ----------
    base_url : str
        Such as `http://127.0.0.1:8000`.
    retries : int
        How often a request is sent again at most.
    timeout_s : float
        Longest wait for an answer to begin or to go on.
    http : httpx.BaseTransport, optional
        For tests.
    sleep : callable
        For tests.
    """

    def __init__(
        self,
        base_url: str,
        *,
        retries: int = 4,
        timeout_s: float = 30.0,
        http: httpx.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        parts = urlsplit(base_url)
        if parts.scheme not in {"http", "https"} or not parts.hostname:
            raise UsageError(f"not an http:// or https:// address: {base_url!r}")
        self.base_url = base_url.rstrip("/")
        self._retries = retries
        self._timeout_s = timeout_s
        self.sleep = sleep
        self._client = httpx.Client(
            base_url=self.base_url,
            timeout=httpx.Timeout(timeout_s, connect=CONNECT_TIMEOUT_S),
            transport=http,
            trust_env=not is_loopback(base_url),
            headers={"User-Agent": "smalti-client/0.1", "Accept": "application/json, application/problem+json"},
        )

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def timeout(self, read_s: float | None) -> httpx.Timeout:
        """Time limits with another wait for reading; None is the usual one."""
        return httpx.Timeout(self._timeout_s if read_s is None else read_s, connect=CONNECT_TIMEOUT_S)

    def not_reachable(self, cause: Exception | str) -> NotReachableError:
        """Return the error for a service that does not answer."""
        return NotReachableError(
            f"no answer from a Smalti service at {self.base_url} ({cause})",
            hint="start one with `smalti serve`, or name another with --url or SMALTI_URL",
        )

    def request(
        self,
        method: str,
        path: str,
        *,
        params: Mapping[str, Any] | None = None,
        json: Any = None,
        body: Callable[[], Iterable[bytes]] | None = None,
        headers: Mapping[str, str] | None = None,
        read_timeout_s: float | None = None,
        gone_is_done: bool = False,
        retries: int | None = None,
    ) -> httpx.Response:
        """Send a request, again when harmless, and return a 2xx or 304 answer.

        Parameters
        ----------
        body : callable, optional
            Makes the body anew for each try.
        gone_is_done : bool
            A second try that is answered 404 counts as done by the first (DELETE).
        retries : int, optional
            Other than the transport's own number.

        Raises
        ------
        SmaltiError
            Of the class that fits the answer; `NotReachableError` without one.
        """
        sent_headers = dict(headers or {})
        may_repeat = method in {"GET", "PUT", "DELETE", "HEAD"} or "Idempotency-Key" in sent_headers
        failure: SmaltiError
        retries = self._retries if retries is None else retries
        for attempt in range(retries + 1):
            wait_s = None
            try:
                response = self._client.request(
                    method,
                    path,
                    params=params,
                    json=json,
                    content=body() if body else None,
                    headers=sent_headers,
                    timeout=self.timeout(read_timeout_s),
                )
            except httpx.TransportError as error:
                failure = self.not_reachable(error)
                failure.__cause__ = error
                if not (may_repeat or isinstance(error, httpx.ConnectError | httpx.ConnectTimeout)):
                    break
            else:
                if response.is_success or response.status_code == 304:
                    return response
                if gone_is_done and attempt > 0 and response.status_code == 404:
                    return response
                failure = self.error_of(response)
                wait_s = retry_after_s(response.headers.get("Retry-After"), now=time.time())
                in_flight = response.status_code == 409 and wait_s is not None
                if not (in_flight or (may_repeat and response.status_code in RETRIED_STATUSES)):
                    break
                if wait_s is not None and wait_s > LONGEST_RETRY_AFTER_S:
                    break
            if attempt < retries:
                self.pause(attempt, wait_s)
        raise failure

    def pause(self, attempt: int, wait_s: float | None = None) -> None:
        """Wait before the next try: as the service asked, else doubling with jitter."""
        backoff_s = min(LONGEST_BACKOFF_S, FIRST_BACKOFF_S * 2**attempt) * random.uniform(0.5, 1.0)
        self.sleep(backoff_s if wait_s is None else wait_s)

    @contextmanager
    def stream(
        self, path: str, *, headers: Mapping[str, str], read_timeout_s: float | None = None
    ) -> Iterator[httpx.Response]:
        """GET as a stream, one try; an answer that is not 2xx is raised as its error.

        Raises
        ------
        httpx.TransportError
            When the connection breaks: the caller knows how to go on from where it was.
        """
        with self._client.stream("GET", path, headers=headers, timeout=self.timeout(read_timeout_s)) as response:
            if not response.is_success:
                response.read()
                raise self.error_of(response)
            yield response

    def error_of(self, response: httpx.Response) -> SmaltiError:
        """Return the error for an answer that is not 2xx, with its problem document."""
        problem: Any = None
        if "json" in response.headers.get("Content-Type", ""):
            try:
                problem = response.json()
            except ValueError:
                problem = None
        if not isinstance(problem, Mapping):
            problem = {"title": f"HTTP {response.status_code} {response.reason_phrase}".strip()}
            error = error_from_problem(problem, response.status_code)
            error.hint = f"this is not how Smalti answers: is another program at {self.base_url}?"
            return error
        return error_from_problem(problem, response.status_code)

    def json_object(self, response: httpx.Response) -> dict[str, Any]:
        """Return the JSON object of an answer.

        Raises
        ------
        ApiError
            When it is something else: then another program answers at this address.
        """
        try:
            data = response.json()
        except ValueError:
            data = None
        if not isinstance(data, dict):
            raise ApiError(f"what answers at {self.base_url} is not a Smalti service: it sent no JSON object")
        return data
