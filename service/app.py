"""The app factory: `uvicorn --factory service.app:create_app`.

Job: put settings, store, queue and routes together into one ASGI app.
Invariant: nothing heavy is imported, not even lazily: numba, numpy, trimesh and OpenImageIO belong to workers.
"""

import asyncio
import signal
import threading
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from types import FrameType
from typing import Any

import structlog
from fastapi import Depends, FastAPI
from starlette.routing import BaseRoute

from service.context import Context, build_context
from service.handlers import install_handlers
from service.middleware import SurroundMiddleware
from service.openapi import DESCRIPTION, build_openapi
from service.parameters import refuse_unknown
from service.routes import assets, events, jobs, pages, results, service
from service.settings import ServiceSettings
from service.version import VERSION
from service.wakeups import Wakeups
from worker.logs import configure_logs
from worker.queue import Queue
from worker.store import Store

log = structlog.get_logger()

ROUTERS = (jobs.router, events.router, results.router, assets.router, service.router, pages.router)


def create_app(
    settings: ServiceSettings | None = None, *, store: Store | None = None, queue: Queue | None = None
) -> FastAPI:
    """Return the app.

    Parameters
    ----------
    settings
        From the environment (prefix ``SMALTI_``) if not given.
    store, queue
        In place of the real ones, for tests.
    """
    settings = settings or ServiceSettings()
    configure_logs(settings.log_level, settings.log_file, role="api")
    context = build_context(settings, store, queue)

    @asynccontextmanager
    async def live(_app: FastAPI) -> AsyncIterator[None]:
        context.wakeups.start()
        _end_streams_on_signals(context.wakeups)
        log.info("service started", version=VERSION)
        yield
        await context.wakeups.stop()
        context.queue.close()
        log.info("service stopped")

    app = FastAPI(
        title="Smalti",
        version=VERSION,
        summary="A ray-tracing render service",
        description=DESCRIPTION,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,  # a redirect for a slash too many hides mistakes: 404 tells them
        lifespan=live,
        telemetry=None,
    )
    app.state.context = context
    routes: list[BaseRoute] = []
    for router in ROUTERS:
        app.include_router(router, dependencies=[Depends(refuse_unknown)])
        routes += router.routes
    install_handlers(app, [*app.routes, *routes])
    app.add_middleware(SurroundMiddleware, metrics=context.metrics, allowed_hosts=settings.host_names())
    _serve_own_openapi(app, routes)
    return app


def _end_streams_on_signals(wakeups: Wakeups) -> None:
    """Let event streams and waiting requests end as soon as the server is told to stop.

    The server waits for open connections before it tells the app that it stops, so without this every open stream
    would hold up a restart until it is cut off.
    """
    if threading.current_thread() is not threading.main_thread():
        return  # a server in a thread has no signals
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        before = signal.getsignal(number)
        if not callable(before):
            continue

        def stop(
            received: int, frame: FrameType | None, before: Callable[[int, FrameType | None], Any] = before
        ) -> None:
            with suppress(RuntimeError):  # the loop is closed already
                loop.call_soon_threadsafe(wakeups.close)
            before(received, frame)

        signal.signal(number, stop)


def _serve_own_openapi(app: FastAPI, routes: Sequence[BaseRoute]) -> None:
    """Replace the app's OpenAPI document by the completed one, built at its first use (about 0.2 s)."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = build_openapi(app, routes)
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def context_of(app: FastAPI) -> Context:
    """Return an app's context, for tests."""
    context: Context = app.state.context
    return context
