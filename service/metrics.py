"""Prometheus metrics of the API process, in a registry of their own.

Job: count requests and jobs accepted; show what the queue and the store say at the moment of the scrape.
Invariant: label values come from the code (route templates, states), never from a client, so series stay few.
"""

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest

# From a cached answer (under a millisecond) to a long Prefer: wait (60 s).
_LATENCY_BUCKETS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH"})


class Metrics:
    """The counters of one app; two apps in one process do not share them."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        self.requests = Counter(
            "smalti_http_requests", "Requests answered.", ("method", "route", "status"), registry=self.registry
        )
        self.latency_s = Histogram(
            "smalti_http_request_seconds",
            "Seconds from a request to the end of its answer.",
            ("method", "route"),
            buckets=_LATENCY_BUCKETS_S,
            registry=self.registry,
        )
        self.jobs_accepted = Counter("smalti_jobs_accepted", "Jobs made durable and answered.", registry=self.registry)
        self.jobs_replayed = Counter(
            "smalti_jobs_replayed", "Requests answered from their Idempotency-Key.", registry=self.registry
        )
        self.asset_bytes = Counter("smalti_asset_bytes", "Bytes of assets stored.", registry=self.registry)
        self.event_streams = Gauge("smalti_event_streams", "Event streams open now.", registry=self.registry)
        self.workers = Gauge("smalti_workers_alive", "Live workers in the registry.", registry=self.registry)
        self.queue_up = Gauge("smalti_queue_up", "1 when Redis answers, else 0.", registry=self.registry)
        self.queued_tasks = Gauge("smalti_queued_tasks", "Tasks waiting in the queue.", registry=self.registry)
        self.store_free_bytes = Gauge("smalti_store_free_bytes", "Free space of the store.", registry=self.registry)

    def observe_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count one answered request."""
        known_method = method if method in _METHODS else "other"
        self.requests.labels(known_method, route, str(status)).inc()
        self.latency_s.labels(known_method, route).observe(seconds)

    def render(self) -> bytes:
        """Return the text format of Prometheus."""
        return generate_latest(self.registry)
