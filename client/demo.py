"""`smalti demo`: the whole service once through, from start to shut down.

Invariant: whatever happens (Ctrl-C, a failed job, a service that does not start), nothing is left running.
"""

import contextlib
import time
from pathlib import Path

from client.assets import prepare_scene, read_scene
from client.formats import format_bytes, format_duration
from client.launch import service
from client.report import print_report
from client.terminal import Terminal


def run_demo(scene: Path, output: Path, *, workers: int | None, terminal: Terminal) -> None:
    """Render a scene through a service of its own.

    Parameters
    ----------
    scene : Path
        Scene document.
    output : Path
        Folder for `NAME.png` and `NAME.exr`, named like the scene.
    workers : int, optional
        Worker processes; one for each core by default.

    Raises
    ------
    SmaltiError
        Whatever went wrong.
    """
    started = time.monotonic()
    prepared = prepare_scene(*read_scene(scene))
    for warning in prepared.warnings:
        terminal.warn(warning)
    terminal.note("starting the service")

    def tell_slow() -> None:
        terminal.note("it compiles its kernels first; this is needed once and takes about a minute")

    def load_client() -> None:
        import client.api  # noqa: F401 - half a second, while the service's first process leaves cores idle

    with service(workers=workers, slow=tell_slow, meanwhile=load_client) as running, contextlib.ExitStack() as stack:
        from client.api import Client, require_success
        from client.progress import show_progress

        client = stack.enter_context(Client(running.url))
        terminal.note(f"the service is up at {running.url} after {format_duration(running.start_s)}")
        posted = time.monotonic()
        job = client.submit(prepared, name=prepared.document.get("name"))
        with show_progress(scene.stem, quiet=terminal.quiet) as view:
            for seen in client.watch(job.id):
                job = seen
                view.update(job.state, job.progress)
        require_success(job)
        for suffix in (".png", ".exr"):
            target = output / f"{scene.stem}{suffix}"
            size = client.get(job.id, target)
            terminal.out(f"wrote {target} ({format_bytes(size)})")
        done_s = time.monotonic() - posted
        report = client.report(job.id)
        terminal.out("")
        print_report(terminal, report)
        terminal.note(f"from the request to the pictures on disk: {format_duration(done_s)}")
        terminal.note("shutting down")
    terminal.note(f"all done in {format_duration(time.monotonic() - started)}")
