"""Options that several commands share, and the parsing of their values."""

import os
import re
from collections.abc import Iterable, Mapping
from copy import deepcopy
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from client.errors import UsageError


class ColorSpace(StrEnum):
    """Encoding of a PNG."""

    SRGB = "srgb"
    LINEAR = "linear"


class ResultKind(StrEnum):
    """What `get` fetches."""

    PNG = "png"
    EXR = "exr"
    PREVIEW = "preview"
    REPORT = "report"


Url = Annotated[
    str | None,
    typer.Option("--url", help="Address of the service.  [env: SMALTI_URL; default: http://127.0.0.1:8000]"),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON for scripts.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No notes and no progress.")]
Scene = Annotated[str, typer.Argument(metavar="SCENE", help="Scene document (JSON); - reads standard input.")]
JobId = Annotated[str, typer.Argument(metavar="JOB", help="Id of the job.")]
JobIds = Annotated[list[str], typer.Argument(metavar="JOB...", help="Ids of the jobs.")]
Outputs = Annotated[
    list[Path] | None,
    typer.Option(
        "--output", "-o", metavar="FILE", help="File to write: .png, .exr, or .json for the report. Repeatable."
    ),
]
Samples = Annotated[int | None, typer.Option(min=1, help="Samples per pixel, instead of the scene's.")]
Size = Annotated[str | None, typer.Option(metavar="WxH", help="Image size in pixels, instead of the scene's.")]
TileSize = Annotated[int | None, typer.Option(min=16, max=512, help="Edge of a tile in pixels, a multiple of 16.")]
Png = Annotated[ColorSpace, typer.Option("--png", help="Encoding of the PNG.")]
Timeout = Annotated[float | None, typer.Option(metavar="SECONDS", min=0, help="Give up waiting after this time.")]


def check_targets(paths: Iterable[Path]) -> None:
    """Look whether files can be written at these places, before any work is done for them.

    Raises
    ------
    UsageError
        A folder does not exist or cannot be written to, or a folder has the file's name.
    """
    for path in paths:
        folder = path.parent
        if not folder.is_dir():
            raise UsageError(
                f"cannot write {path}: there is no folder {folder}", hint=f"make it first: mkdir -p {folder}"
            )
        if not os.access(folder, os.W_OK | os.X_OK):
            raise UsageError(f"cannot write {path}: the folder {folder} cannot be written to")
        if path.is_dir():
            raise UsageError(f"cannot write {path}: it is a folder", hint="give the name of a file")


def parse_size(text: str) -> tuple[int, int]:
    """Read `WIDTHxHEIGHT`.

    Raises
    ------
    UsageError
        When it is not that.
    """
    match = re.fullmatch(r"\s*(\d{1,6})\s*[xX×]\s*(\d{1,6})\s*", text)  # noqa: RUF001 - people paste this sign, too
    if match is None or not (int(match[1]) and int(match[2])):
        raise UsageError(f"--size {text!r} is not a size such as 640x360")
    return int(match[1]), int(match[2])


def override(document: Mapping[str, Any], *, samples: int | None = None, size: str | None = None) -> dict[str, Any]:
    """Return a scene document with other samples or image size.

    Raises
    ------
    UsageError
        When the scene is cropped: what part of another size is meant is not clear.
    """
    changed = deepcopy(dict(document))
    if samples is not None:
        sampling = changed.get("sampling")
        changed["sampling"] = {**(sampling if isinstance(sampling, dict) else {}), "samples": samples}
    if size is not None:
        width, height = parse_size(size)
        image = changed.get("image")
        if isinstance(image, dict) and image.get("crop") is not None:
            raise UsageError("--size does not go with a scene that has image.crop: change them in the scene")
        changed["image"] = {**(image if isinstance(image, dict) else {}), "width": width, "height": height}
    return changed


def output_options(png: ColorSpace, tile_size: int | None) -> dict[str, Any]:
    """Return the `output` member of a job request.

    Raises
    ------
    UsageError
        When the tile size is not a multiple of 16.
    """
    options: dict[str, Any] = {"png_color_space": str(png)}
    if tile_size is not None:
        if tile_size % 16:
            raise UsageError(f"--tile-size {tile_size} is not a multiple of 16")
        options["tile_size"] = tile_size
    return options
