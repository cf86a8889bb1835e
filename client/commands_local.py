"""Commands that work on this machine: render, serve, worker, warm, doctor, demo."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from client import options
from client.errors import ExitCode, UsageError
from client.options import ColorSpace
from client.terminal import Terminal

Store = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the store.  [env: SMALTI_STORE]")]
Cache = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of this host's caches.  [env: SMALTI_CACHE]")]
RedisUrl = Annotated[
    str | None,
    typer.Option("--redis-url", help="redis://, rediss:// or unix:// of a Redis or Valkey.  [env: SMALTI_REDIS_URL]"),
]
Workers = Annotated[int | None, typer.Option(min=0, help="Worker processes; one per core if not given.")]
ReadyFile = Annotated[Path | None, typer.Option(metavar="FILE", help="Written once all is up: URL and process id.")]
LogFile = Annotated[Path | None, typer.Option(metavar="FILE", help="Write the log there.")]


COMPILING = "compiling the kernels; this is needed once, and takes about a minute"


def render(
    scene: options.Scene,
    output: options.Outputs = None,
    samples: options.Samples = None,
    size: options.Size = None,
    tile_size: options.TileSize = None,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads; one per core if not given.")] = None,
    png: options.Png = ColorSpace.SRGB,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Render a scene on this machine, without a service."""
    from client.assets import prepare_scene, read_scene
    from client.results import result_kind

    terminal = Terminal(as_json=as_json, quiet=quiet)
    if not output:
        raise UsageError("say where the picture goes: -o out.png or -o out.exr")
    targets = {result_kind(path): path for path in output}
    if len(targets) < len(output):
        raise UsageError("-o is given twice for one format")
    options.check_targets(output)
    options.output_options(png, tile_size)  # checks the tile size
    document, folder = read_scene(scene)
    prepared = prepare_scene(options.override(document, samples=samples, size=size), folder)
    for warning in prepared.warnings:
        terminal.warn(warning)
    from client.formats import format_count, format_duration
    from client.local import render_to_files, warm_kernels

    warming = warm_kernels(lambda: terminal.note(COMPILING))
    outcome = render_to_files(prepared, targets, png_color_space=str(png), threads=threads, quiet=terminal.quiet)
    outcome["seconds"]["kernels"] = warming
    if as_json:
        terminal.json(outcome)
        return
    for path in output:
        terminal.out(f"wrote {path}")
    rays, seconds = outcome["rays"], outcome["seconds"]
    terminal.note(
        f"{format_duration(seconds['total'])}, of these {format_duration(seconds['preparing']['total'])} to prepare; "
        f"{format_count(rays['per_s'], 'rays/s')}, {rays['per_sample']:.2f} rays a sample"
    )


def serve(
    host: Annotated[
        str | None, typer.Option(help="Address to listen on; this machine only if not given.  [env: SMALTI_HOST]")
    ] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Port; 0 takes a free one; 8000 if not given.")
    ] = None,
    workers: Workers = None,
    store: Store = None,
    cache: Cache = None,
    redis_url: RedisUrl = None,
    ready_file: ReadyFile = None,
    log_file: LogFile = None,
) -> None:
    """Run the whole service: API, queue and workers.

    Ctrl-C ends it; jobs that have not ended go on at the next start.
    """
    from client.serve import run_farm

    terminal = Terminal()
    run_farm(
        lambda farm: terminal.note(
            f"Smalti takes jobs at {farm.url} (API reference at {farm.url}/docs); Ctrl-C ends it"
        ),
        host=host,
        port=port,
        workers=workers,
        store=store,
        cache=cache,
        redis_url=redis_url,
        ready_file=ready_file,
        log_file=log_file,
    )


def worker(
    redis_url: RedisUrl = None,
    store: Store = None,
    workers: Workers = None,
    cache: Cache = None,
    steward: Annotated[
        bool | None,
        typer.Option("--steward/--no-steward", help="Whether this host also keeps order and assembles pictures."),
    ] = None,
    ready_file: ReadyFile = None,
    log_file: LogFile = None,
) -> None:
    """Run workers for a service on another machine.

    Its queue and its store must be reachable from here.
    """
    import os

    from client.serve import run_farm

    if redis_url is None and "SMALTI_REDIS_URL" not in os.environ:
        raise UsageError("say which queue: --redis-url or SMALTI_REDIS_URL")
    if store is None and "SMALTI_STORE" not in os.environ:
        raise UsageError("say which store: --store or SMALTI_STORE (the same folder as the service's)")
    run_farm(
        api=False,
        redis_url=redis_url,
        store=store,
        workers=workers,
        cache=cache,
        steward=steward,
        ready_file=ready_file,
        log_file=log_file,
    )


def warm(quiet: options.Quiet = False) -> None:
    """Compile the kernels into the cache ahead of use."""
    from client.formats import format_duration
    from client.local import kernel_cache, warm_kernels

    terminal = Terminal(quiet=quiet)
    seconds = warm_kernels(lambda: terminal.note(COMPILING))
    cache = kernel_cache()
    compiled = f"; compiled in {format_duration(cache.compile_s)}" if cache.compile_s else ""
    terminal.note(f"kernels are ready ({format_duration(seconds)}){compiled}")


def doctor(url: options.Url = None, as_json: options.Json = False) -> None:
    """Look for what could keep Smalti from working.

    Versions, processor, shadowed packages, caches, data, disk, service. Exit code 1 if something is bad.
    """
    from client.doctor import examine

    terminal = Terminal(as_json=as_json)
    findings = examine(url)
    if as_json:
        terminal.json([finding.as_dict() for finding in findings])
    else:
        terminal.table(["", "what", "finding"], [[str(one.level), one.what, one.text] for one in findings])
    if any(one.level == "bad" for one in findings):
        sys.exit(int(ExitCode.UNEXPECTED))


def demo(
    scene: Annotated[Path, typer.Argument(metavar="[SCENE]", help="Scene document.")] = Path("scenes/demo.json"),
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the pictures.")] = Path(
        "out"
    ),
    workers: Workers = None,
    quiet: options.Quiet = False,
) -> None:
    """Start a service, render a scene, shut it down.

    The scene goes over HTTP; at the end a table shows where the time went and what was skipped.
    """
    from client.demo import run_demo

    run_demo(scene, output, workers=workers, terminal=Terminal(quiet=quiet))
