"""Entry of the farm's processes: ``python -m worker.main ROLE``.

Job: turn settings (environment, prefix ``SMALTI_``) and arguments into one running process.
Invariant: only here are logs configured and signals caught.

::

    worker --name NAME     render until SIGTERM
    steward, assembler     one of each a host
    supervisor             all of them, with a Valkey of its own unless SMALTI_REDIS_URL is set
    tile JOB [TILE]        do one tile (or only the preparation) again in the foreground, to see why it failed
    audit                  compare store and index; exit status 1 if they differ
"""

import argparse
import json
import os
import secrets
import signal
import socket
import sys
from collections.abc import Callable

import structlog

from worker.logs import configure_logs
from worker.settings import FarmSettings

log = structlog.get_logger()


def main(arguments: list[str] | None = None) -> int:
    """Run one role; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m worker.main", description="A process of the farm.")
    roles = parser.add_subparsers(dest="role", required=True)
    worker = roles.add_parser("worker", help="render until SIGTERM")
    worker.add_argument("--name", help="unique name; made up if absent")
    roles.add_parser("steward", help="janitor and reconciler")
    roles.add_parser("assembler", help="tiles to pictures")
    roles.add_parser("supervisor", help="all of the farm")
    roles.add_parser("audit", help="compare store and index")
    tile = roles.add_parser("tile", help="do one tile again in the foreground")
    tile.add_argument("job")
    tile.add_argument("tile", type=int, nargs="?")
    options = parser.parse_args(arguments)

    settings = FarmSettings()
    configure_logs(settings.log_level, settings.log_file, role=options.role, pid=os.getpid())
    if options.role == "supervisor":
        from worker.supervisor import Supervisor

        return Supervisor(settings).run()
    if options.role == "tile":
        return _run_tile(settings, options.job, options.tile)
    if settings.redis_url is None:
        parser.error("SMALTI_REDIS_URL is not set: only the supervisor starts a server of its own")
    if options.role == "worker":
        return _run_worker(settings, options.name)
    return {"steward": _run_steward, "assembler": _run_assembler, "audit": _run_audit}[options.role](settings)


def _run_worker(settings: FarmSettings, name: str | None) -> int:
    from worker.backends import load_backend
    from worker.context import WorkerContext
    from worker.control import ControlThread, SignalThread
    from worker.errors import QueueError, WrongStoreError
    from worker.identity import check_store
    from worker.queue import Queue
    from worker.store import Store
    from worker.worker import FarmWorker

    name = name or f"{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(2)}"
    structlog.contextvars.bind_contextvars(worker=name)
    backend = load_backend(settings.backend)
    backend.warm()
    context = WorkerContext(settings, name, Store(settings.store), Queue(str(settings.redis_url)), backend)
    try:
        check_store(context.store, context.queue)
    except WrongStoreError as error:
        log.error("not started", error=str(error))  # noqa: TRY400 - the message says it all
        return 1
    except QueueError:
        pass  # the control thread looks again each second
    worker = FarmWorker(context)
    SignalThread(context).start()
    signal.signal(signal.SIGTERM, worker.request_stop)
    signal.signal(signal.SIGINT, worker.request_stop)
    context.state = "idle"
    control = ControlThread(context)
    control.start()
    try:
        worker.work(logging_level="WARNING")
    finally:
        control.stop()
        context.release()
    return 0


def _run_until_signal(stop: Callable[[], None], run: Callable[[], None]) -> int:
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop())
    run()
    return 0


def _run_steward(settings: FarmSettings) -> int:
    from worker.queue import Queue
    from worker.steward import Steward
    from worker.store import Store

    steward = Steward(Store(settings.store), Queue(str(settings.redis_url)), f"steward@{socket.gethostname()}")
    return _run_until_signal(steward.stop, steward.run)


def _run_assembler(settings: FarmSettings) -> int:
    from worker.assembler import Assembler
    from worker.queue import Queue
    from worker.store import Store

    # Two on one host must not take each other's claims for their own.
    owner = f"assembler@{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(2)}"
    assembler = Assembler(Store(settings.store), Queue(str(settings.redis_url)), owner)
    return _run_until_signal(assembler.stop, assembler.run)


def _run_audit(settings: FarmSettings) -> int:
    from worker.audit import audit
    from worker.queue import Queue
    from worker.store import Store

    findings = audit(Store(settings.store), Queue(str(settings.redis_url)))
    for finding in findings:
        print(finding)  # noqa: T201 - this is the command's answer
    return 1 if findings else 0


def _run_tile(settings: FarmSettings, job_id: str, tile: int | None) -> int:
    from worker.backends import load_backend
    from worker.context import WorkerContext
    from worker.queue import Queue
    from worker.store import Store
    from worker.tasks import render_alone

    queue = Queue(settings.redis_url or "redis://localhost")  # never spoken to
    context = WorkerContext(settings, "foreground", Store(settings.store), queue, load_backend(settings.backend))
    print(json.dumps(render_alone(context, job_id, tile), indent=1, default=str))  # noqa: T201 - the command's answer
    return 0


if __name__ == "__main__":
    sys.exit(main())
