r"""Stream a film, row by row, into an EXR, a PNG and a hash.

Invariants: memory is four bands of 64 rows, whatever the picture's height; the bytes of both files and the hash
depend on the pixels and the metadata alone, never on how the rows were cut or on the number of threads; a file under
its final name is whole and on disk (temporary name, fsync, rename).

The EXR is written by one thread (which has OpenEXR compress with as many as it is given) and hash and PNG by another,
while the caller gathers the next rows.

The EXR is float32, linear, in 64 x 64 tiles, with the crop as data window inside the full picture as display window;
the PNG has the crop's size, 8 bits, clamped. `film_sha256` is SHA-256 over `smalti-film-1\n`,
`<width> <height> R,G,B\n` and the row-major little-endian float32 pixels of the crop.
"""

import contextlib
import hashlib
import os
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from tracer.film.develop import ColorSpace, encode_8bit
from tracer.film.errors import ImageWriteError
from tracer.film.tile import Rect

BAND_ROWS: Final = 64
"""Rows handed to the encoders at once: the height of an EXR tile."""

N_BANDS: Final = 4
"""Bands on their way: enough that neither thread waits for the other at each band. At 3840 px 3 MB each."""

EXR_COMPRESSION: Final = "zip:1"
"""Every reader knows zip. The MINI at 3840 x 2160 (`python -m benchmarks.film`): level 1 takes 0.83 s of CPU for
25.3 MB, OpenEXR's level 4 takes 1.21 s for 25.1 MB, none 0.30 s for 99.6 MB."""

PNG_COMPRESSION_LEVEL: Final = 1
PNG_FILTER: Final = 0x10
"""libpng's PNG_FILTER_SUB alone. The same picture: 0.18 s of CPU and 2.3 MB; with the choice of all filters 0.38 s
and 2.3 MB; level 6 with all filters 0.61 s and 1.9 MB."""

_PNG_END: Final = b"\0\0\0\0IEND\xaeB\x60\x82"
"""A PNG's last chunk. OpenImageIO does not see an error of the last flush, so we look whether the end is there; OpenEXR
writes its table of tiles last, into room that it took at the start."""

_FIXED_DATE: Final = "2000:01:01 00:00:00"
"""OpenImageIO would write the time of day otherwise, and no two renders would have the same bytes."""


class FilmHash:
    """The running `film_sha256` of a picture whose rows come from top to bottom."""

    def __init__(self, width: int, height: int) -> None:
        self._hash = hashlib.sha256(f"smalti-film-1\n{width} {height} R,G,B\n".encode())

    def update(self, rows: NDArray[np.float32]) -> None:
        """Add rows, float32 (n, width, 3)."""
        self._hash.update(np.ascontiguousarray(rows, dtype="<f4").data)

    def hexdigest(self) -> str:
        """Return the 64 hex digits."""
        return self._hash.hexdigest()


def film_sha256(pixels: NDArray[np.float32]) -> str:
    """Hash a whole picture, float32 (height, width, 3)."""
    film_hash = FilmHash(pixels.shape[1], pixels.shape[0])
    film_hash.update(pixels)
    return film_hash.hexdigest()


class FilmWriter:
    """Writes rows into an EXR and a PNG as they come.

    Parameters
    ----------
    exr_path, png_path : Path or None
        Final names; their folders exist. None leaves that file out.
    width, height : int
        Size of the rendered part (the crop, or the whole picture) in pixels.
    crop_origin : (int, int)
        Absolute pixel (x, y) of its top left corner.
    display_size : (int, int) or None
        (width, height) of the whole picture; None when nothing was cropped.
    png_color_space : "srgb" or "linear"
        Transfer curve of the PNG; the EXR is always linear.
    metadata : mapping of str to str
        Put into both files; the same metadata give the same bytes.
    threads : int
        Threads that compress the EXR.

    Raises
    ------
    ImageWriteError
        Here or later, when a file cannot be written; it names the file. Nothing is left under the final names.
    """

    def __init__(
        self,
        exr_path: Path | None,
        png_path: Path | None,
        width: int,
        height: int,
        *,
        crop_origin: tuple[int, int] = (0, 0),
        display_size: tuple[int, int] | None = None,
        png_color_space: ColorSpace = "srgb",
        metadata: Mapping[str, str] | None = None,
        threads: int = 1,
    ) -> None:
        window = Rect(*crop_origin, width, height)
        display = display_size or (crop_origin[0] + width, crop_origin[1] + height)
        self._width, self._height = width, height
        self._color_space = png_color_space
        self._hash = FilmHash(width, height)
        n_bands = min(N_BANDS, -(-height // BAND_ROWS))
        self._bands = np.empty((n_bands, min(BAND_ROWS, height), width, 3), np.float32)
        self._pending: list[list[Future[None]]] = [[] for _ in range(n_bands)]
        self._band = 0
        self._n_buffered = 0
        self._n_written = 0
        self._exr: _ImageFile | None = None
        self._png: _ImageFile | None = None
        if n_bands == 1:  # a thread costs half a millisecond, and there is nothing to do meanwhile
            self._lanes: tuple[Executor, Executor] = (_AtOnce(), _AtOnce())
            threads = 1
        else:
            self._lanes = (ThreadPoolExecutor(1, "exr"), ThreadPoolExecutor(1, "png"))
        try:
            if exr_path is not None:
                self._exr = _ImageFile(exr_path, _exr_spec(window, display, metadata or {}), "exr", threads)
            if png_path is not None:
                self._png = _ImageFile(png_path, _png_spec(window, png_color_space, metadata or {}), "png", threads)
        except BaseException:
            self.abandon()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.abandon()  # does nothing after close()

    def write_rows(self, rows: NDArray[np.float32]) -> None:
        """Add the next rows.

        Parameters
        ----------
        rows : float32 (n, width, 3)
            Linear, any n.
        """
        if rows.shape[1:] != (self._width, 3) or rows.dtype != np.float32:
            raise ValueError(f"rows are {rows.dtype} {rows.shape}, not float32 (n, {self._width}, 3)")
        if self._n_written + self._n_buffered + rows.shape[0] > self._height:
            raise ValueError(f"more rows than the picture's {self._height}")
        taken = 0
        while taken < rows.shape[0]:
            band = self._bands[self._band]
            n = min(band.shape[0] - self._n_buffered, rows.shape[0] - taken)
            if self._n_buffered == 0:
                self._await_band()
            band[self._n_buffered : self._n_buffered + n] = rows[taken : taken + n]
            self._n_buffered += n
            taken += n
            if self._n_buffered == band.shape[0] or self._n_written + self._n_buffered == self._height:
                self._flush()

    def _await_band(self) -> None:
        """Wait until the encoders have done with what was in the current band before."""
        pending, self._pending[self._band] = self._pending[self._band], []
        try:
            for future in pending:
                future.result()
        except BaseException:
            self.abandon()
            raise

    def _flush(self) -> None:
        """Hand one band to the encoders."""
        band = self._bands[self._band][: self._n_buffered]
        y0, y1 = self._n_written, self._n_written + self._n_buffered
        pending = self._pending[self._band]
        if self._exr is not None:
            pending.append(self._lanes[0].submit(self._exr.write_tiles, y0, y1, band))
        pending.append(self._lanes[1].submit(self._write_png, y0, y1, band))
        self._n_written, self._n_buffered = y1, 0
        self._band = (self._band + 1) % len(self._bands)

    def _write_png(self, y0: int, y1: int, band: NDArray[np.float32]) -> None:
        self._hash.update(band)
        if self._png is not None:
            self._png.write_scanlines(y0, y1, encode_8bit(band, self._color_space))

    def close(self) -> str:
        """Finish both files and give them their names.

        Returns
        -------
        str
            `film_sha256`.
        """
        if self._n_written != self._height:
            raise ValueError(f"only {self._n_written + self._n_buffered} of {self._height} rows were written")
        try:
            last = [future for pending in self._pending for future in pending]
            if self._exr is not None:
                last.append(self._lanes[0].submit(self._exr.finish))
            if self._png is not None:
                last.append(self._lanes[1].submit(self._png.finish))
            for future in last:
                future.result()
            for image in (self._exr, self._png):
                if image is not None:
                    image.publish()
        except BaseException:
            self.abandon()
            raise
        self._exr = self._png = None
        self.abandon()
        return self._hash.hexdigest()

    def abandon(self) -> None:
        """Drop what was written; nothing appears under the final names."""
        for lane in self._lanes:
            lane.shutdown(wait=True, cancel_futures=True)  # an output must not be closed under a thread that writes
        for image in (self._exr, self._png):
            if image is not None:
                image.discard()
        self._exr = self._png = None


class _AtOnce(Executor):
    """Runs what it is given in the caller's thread."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **options: Any) -> Future[Any]:
        """Call the function; its error is raised here."""
        future: Future[Any] = Future()
        future.set_result(function(*args, **options))
        return future


class _ImageFile:
    """One OpenImageIO output under a temporary name."""

    def __init__(self, path: Path, spec: Any, file_format: str, threads: int) -> None:
        import OpenImageIO

        # Both settings are of the process; -1 is no thread beside the caller's.
        OpenImageIO.attribute("threads", 1)
        OpenImageIO.attribute("exr_threads", threads if threads > 1 else -1)
        self._path = path
        self._temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        self._spec = spec
        output = OpenImageIO.ImageOutput.create(file_format)
        if output is None:
            raise ImageWriteError(f"cannot write {path.name}: no {file_format} writer ({OpenImageIO.geterror()})")
        self._output = output
        self._is_discarded = False
        self._check(self._output.open(str(self._temporary), spec))

    def _check(self, succeeded: bool) -> None:
        """Raise the output's error, with the file's name in front."""
        if succeeded and not self._output.has_error:
            return
        lines = self._output.geterror().replace(str(self._temporary), self._path.name).strip().splitlines()
        self.discard()
        raise ImageWriteError(f"cannot write {self._path.name}: {lines[0] if lines else 'is the disk full?'}")

    def write_tiles(self, y0: int, y1: int, rows: NDArray[np.float32]) -> None:
        """Write rows y0..y1 of the data window as one row of tiles."""
        x, y = self._spec.x, self._spec.y
        if not self._is_discarded:  # a band that was on its way when an earlier one failed
            self._check(self._output.write_tiles(x, x + rows.shape[1], y + y0, y + y1, 0, 1, rows))

    def write_scanlines(self, y0: int, y1: int, rows: NDArray[np.uint8]) -> None:
        """Write rows y0..y1."""
        if not self._is_discarded:
            self._check(self._output.write_scanlines(y0, y1, 0, rows))

    def finish(self) -> None:
        """Close the file and bring it to the disk."""
        self._check(self._output.close())
        try:
            with self._temporary.open("rb") as file:
                os.fsync(file.fileno())
                file.seek(-min(len(_PNG_END), file.seek(0, os.SEEK_END)), os.SEEK_END)
                is_whole = self._output.format_name() != "png" or file.read() == _PNG_END
        except OSError as error:
            self.discard()
            raise ImageWriteError(f"cannot write {self._path.name}: {error.strerror}") from error
        if not is_whole:
            self.discard()
            raise ImageWriteError(f"cannot write {self._path.name}: its end is missing, is the disk full?")

    def publish(self) -> None:
        """Give the finished file its name."""
        try:
            self._temporary.replace(self._path)
        except OSError as error:
            raise ImageWriteError(f"cannot write {self._path.name}: {error.strerror}") from error

    def discard(self) -> None:
        """Close and remove the temporary file."""
        self._is_discarded = True
        self._output.close()
        with contextlib.suppress(OSError):
            self._temporary.unlink()


def _exr_spec(window: Rect, display: tuple[int, int], metadata: Mapping[str, str]) -> Any:
    """Describe the EXR: data window, display window, tiles, compression."""
    import OpenImageIO

    spec = OpenImageIO.ImageSpec(window.width, window.height, 3, OpenImageIO.FLOAT)
    spec.x, spec.y = window.x, window.y
    spec.full_x, spec.full_y, spec.full_width, spec.full_height = 0, 0, *display
    spec.tile_width, spec.tile_height, spec.tile_depth = BAND_ROWS, BAND_ROWS, 1
    spec.attribute("compression", EXR_COMPRESSION)
    spec.attribute("oiio:ColorSpace", "lin_rec709_scene")
    _add_metadata(spec, metadata)
    return spec


def _png_spec(window: Rect, color_space: ColorSpace, metadata: Mapping[str, str]) -> Any:
    """Describe the PNG; a PNG has no display window, so the crop's origin is not in it."""
    import OpenImageIO

    spec = OpenImageIO.ImageSpec(window.width, window.height, 3, OpenImageIO.UINT8)
    spec.attribute("png:compressionLevel", PNG_COMPRESSION_LEVEL)
    spec.attribute("png:filter", PNG_FILTER)
    spec.attribute("oiio:ColorSpace", "srgb_rec709_scene" if color_space == "srgb" else "lin_rec709_scene")
    _add_metadata(spec, metadata)
    return spec


def _add_metadata(spec: Any, metadata: Mapping[str, str]) -> None:
    """Put metadata in, in one order, and the fixed date."""
    spec.attribute("DateTime", _FIXED_DATE)
    for name in sorted(metadata):
        spec.attribute(name, metadata[name])
