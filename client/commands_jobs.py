"""Commands that talk to a service: submit, status, watch, get, cancel, delete, list, validate, schema.

Invariant: a command prints its result on standard output; notes, progress and errors go to standard error.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from client import options
from client.options import ColorSpace, ResultKind
from client.terminal import Terminal

if TYPE_CHECKING:  # httpx takes 0.2 s to import: not for `--help`
    from client.api import Client
    from client.models import Job


# What the estimate only guesses says so.
_LABELS = {"cpu_seconds": "CPU seconds, roughly"}


def _connect(url: str | None) -> "Client":
    from client.api import Client

    return Client(url)


def submit(
    scene: options.Scene,
    output: options.Outputs = None,
    wait: Annotated[bool, typer.Option("--wait", help="Wait until the job ends.")] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Wait, and show progress.")] = False,
    name: Annotated[str | None, typer.Option(help="Title of the job.")] = None,
    priority: Annotated[int | None, typer.Option(min=0, max=100, help="Higher is sooner; 50 if not given.")] = None,
    samples: options.Samples = None,
    size: options.Size = None,
    tile_size: options.TileSize = None,
    png: options.Png = ColorSpace.SRGB,
    idempotency_key: Annotated[
        str | None, typer.Option(metavar="KEY", help="The same key and scene give the same job, not a second one.")
    ] = None,
    timeout: options.Timeout = None,
    url: options.Url = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Submit a scene and print the job's id.

    With -o, wait for the end and download.
    """
    from client.assets import prepare_scene, read_scene
    from client.results import result_kind

    terminal = Terminal(as_json=as_json, quiet=quiet)
    targets = [(path, result_kind(path)) for path in output or []]  # a bad name is told before any work
    options.check_targets(output or [])
    document, folder = read_scene(scene)
    prepared = prepare_scene(options.override(document, samples=samples, size=size), folder)
    for warning in prepared.warnings:
        terminal.warn(warning)
    follow = wait or watch or bool(targets)
    with _connect(url) as client:
        job = client.submit(
            prepared,
            output=options.output_options(png, tile_size),
            priority=priority,
            name=name,
            idempotency_key=idempotency_key,
            prefer_wait_s=1 if follow and timeout is None else None,  # a small job is done before a stream is open
        )
        if not follow:
            _print_job(terminal, job, id_only=True)
            terminal.note(f"submitted; follow it with: smalti watch {job.id}")
            return
        terminal.note(f"job {job.id}")
        job = _follow(client, job, terminal, timeout=timeout, bar=watch or bool(targets))
        for path, kind in targets:
            client.get(job.id, path, kind=kind)
            terminal.note(f"wrote {path}")
        _print_job(terminal, job, id_only=True)


def status(job: options.JobIds, url: options.Url = None, as_json: options.Json = False) -> None:
    """Show the state and progress of jobs."""
    terminal = Terminal(as_json=as_json)
    with _connect(url) as client:
        found = [client.status(job_id) for job_id in job]
    if as_json:
        terminal.json(found[0].raw if len(found) == 1 else [one.raw for one in found])
        return
    for number, one in enumerate(found):
        if number:
            terminal.out("")
        _print_job(terminal, one)


def watch(
    job: options.JobId, timeout: options.Timeout = None, url: options.Url = None, as_json: options.Json = False
) -> None:
    """Follow a job until it ends, with a live progress bar."""
    terminal = Terminal(as_json=as_json)
    with _connect(url) as client:
        ended = _follow(client, client.status(job), terminal, timeout=timeout, bar=True)
    _print_job(terminal, ended)


def get(
    job: options.JobId,
    output: options.Outputs = None,
    kind: Annotated[
        ResultKind | None, typer.Option("--kind", help="What to fetch, where the file's ending does not tell.")
    ] = None,
    url: options.Url = None,
    as_json: options.Json = False,
) -> None:
    """Download results: the picture, its preview, the report."""
    from client.formats import format_bytes
    from client.results import result_kind

    terminal = Terminal(as_json=as_json)
    suffix = {ResultKind.EXR: ".exr", ResultKind.REPORT: ".json"}.get(kind or ResultKind.PNG, ".png")
    targets = [(path, str(kind) if kind else result_kind(path)) for path in output or [Path(f"{job}{suffix}")]]
    options.check_targets(path for path, _ in targets)
    written = []
    with _connect(url) as client:
        for path, one in targets:
            size = client.get(job, path, kind=one)
            written.append({"file": str(path), "kind": one, "bytes": size})
            if not as_json:
                terminal.out(f"wrote {path} ({format_bytes(size)})")
    if as_json:
        terminal.json(written)


def cancel(job: options.JobIds, url: options.Url = None, as_json: options.Json = False) -> None:
    """Cancel jobs that have not ended."""
    terminal = Terminal(as_json=as_json)
    with _connect(url) as client:
        answers = [client.cancel(job_id) for job_id in job]
    if as_json:
        terminal.json([one.raw for one in answers])
        return
    for one in answers:
        terminal.out(f"{one.id} {one.state}")


def delete(job: options.JobIds, url: options.Url = None, as_json: options.Json = False) -> None:
    """Delete jobs that have ended, with their results."""
    terminal = Terminal(as_json=as_json)
    with _connect(url) as client:
        for job_id in job:
            client.delete(job_id)
            if not as_json:
                terminal.out(f"{job_id} deleted")
    if as_json:
        terminal.json({"deleted": job})


def list_jobs(
    state: Annotated[str | None, typer.Option(help="Only jobs in this state.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=100, help="Jobs at most.")] = 20,
    everything: Annotated[bool, typer.Option("--all", help="All pages.")] = False,
    url: options.Url = None,
    as_json: options.Json = False,
) -> None:
    """List jobs, newest first."""
    terminal = Terminal(as_json=as_json)
    jobs: list[Job] = []
    with _connect(url) as client:
        page = client.list(state=state, limit=limit)
        jobs += page.jobs
        while everything and page.next_cursor:
            page = client.list(state=state, limit=limit, cursor=page.next_cursor)
            jobs += page.jobs
    if as_json:
        terminal.json([one.raw for one in jobs])
    elif not jobs:
        terminal.note("no jobs")
    else:
        rows = [[one.id, one.state, _done(one), one.created_at[:19], one.name] for one in jobs]
        terminal.table(["job", "state", "done", "created", "name"], rows)
        if page.next_cursor and not everything:
            terminal.note("there are more: --all, or a greater --limit")


def validate(
    scene: options.Scene,
    local: Annotated[bool, typer.Option("--local", help="Check here, without a service.")] = False,
    url: options.Url = None,
    as_json: options.Json = False,
) -> None:
    """Check a scene and its files without rendering it.

    Asks the service, which also estimates the work; where none is reachable and no --url is given, checks here.
    """
    from client.assets import prepare_scene, read_scene
    from client.errors import NotReachableError

    terminal = Terminal(as_json=as_json)
    prepared = prepare_scene(*read_scene(scene))
    for warning in prepared.warnings:
        terminal.warn(warning)
    estimate: dict[str, Any] | None = None
    if not local:
        try:
            with _connect(url) as client:
                estimate = client.validate(prepared)
        except NotReachableError:
            if url is not None:
                raise
            terminal.note("no service is reachable: checked here, without an estimate")
    if estimate is None:
        from client.local import validate_document

        estimate = validate_document(prepared)
    if as_json:
        terminal.json({"valid": True, **estimate})
        return
    terminal.out(f"{scene} is valid")
    rows = [[_LABELS.get(key, key.replace("_", " ")), _plain(value)] for key, value in estimate.items()]
    terminal.table(["", ""], rows)


def schema(url: options.Url = None) -> None:
    """Print the JSON Schema of scene documents.

    That of this installation, or with --url that of a service.
    """
    if url is not None:
        with _connect(url) as client:
            Terminal().json(client.schema())
        return
    from client.local import scene_schema

    Terminal().json(scene_schema())


def _follow(client: "Client", job: "Job", terminal: Terminal, *, timeout: float | None, bar: bool) -> "Job":
    """Follow a job to its end; raises unless it succeeded."""
    from client.api import require_success
    from client.progress import show_progress

    try:
        with show_progress("", quiet=terminal.quiet or not bar) as view:
            for seen in [job] if job.is_terminal else client.watch(job.id, timeout_s=timeout):
                job = seen
                view.update(job.state, job.progress)
    except KeyboardInterrupt:
        terminal.note(f"\njob {job.id} goes on; follow it with `smalti watch`, stop it with `smalti cancel`")
        raise
    require_success(job)
    return job


def _print_job(terminal: Terminal, job: "Job", *, id_only: bool = False) -> None:
    if terminal.as_json:
        terminal.json(job.raw)
        return
    if id_only:
        terminal.out(job.id)
        return
    from client.formats import format_count, format_duration

    progress = job.progress
    rows = [["job", job.id], ["state", job.state]]
    if job.name:
        rows.append(["name", job.name])
    rows.append(["done", _done(job)])
    if progress.rays:
        rows.append(["rays", format_count(progress.rays)])
    if progress.rays_per_s:
        rows.append(["speed", format_count(progress.rays_per_s, "rays/s")])
    if progress.eta_s is not None and not job.is_terminal:
        rows.append(["to go", format_duration(progress.eta_s)])
    rows += [["created", job.created_at], ["updated", job.updated_at]]
    if job.problem:
        rows.append(["problem", str(job.problem.get("detail") or job.problem.get("title") or "")])
    terminal.table(["", ""], rows)


def _done(job: "Job") -> str:
    progress = job.progress
    if not progress.tiles_total:
        return "-"
    return f"{100 * progress.fraction:.0f} % ({progress.tiles_done}/{progress.tiles_total} tiles)"


def _plain(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_plain, value)) or "none"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_plain(one)}" for key, one in value.items())
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int) and value >= 10_000:
        from client.formats import format_count

        return format_count(value)
    return str(value)
