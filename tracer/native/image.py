"""An image of kernels: its file, and calls into it without a compiler.

::

    8 bytes magic, 8 bytes length of the index, 32 bytes SHA-256 of all that follows
    the index (JSON): key, entries, and what `tracer.native.link` left to the loader
    from the next multiple of 4096 on: code and data, mapped as they are

Invariants: pages of code are never written and are shared by all processes; a file under its name is whole; what is
damaged or made for something else is refused before it is mapped.
"""

import ctypes
import hashlib
import json
import mmap
import os
import struct
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from tracer.native.link import PAGE, Linked
from tracer.remembered import Remembered

_MAGIC: Final = b"SMKERN\x01\n"
_PREFIX: Final = struct.Struct("<8sQ32s")
_READ_AND_EXECUTE: Final = 5  # PROT_READ | PROT_EXEC
_AS_WORD: Final = struct.Struct("<q")
_AS_FLOAT: Final = struct.Struct("<d")


class ImageError(Exception):
    """The image is damaged, of another key, or does not find what it calls."""


class ArgumentTypeError(TypeError):
    """An argument is not of the type that the entry was compiled for."""


class Door(NamedTuple):
    """A kernel of an image, called like the Python function that it was compiled from."""

    function: Callable[[Any], int]
    kinds: list[Any]
    n_results: int
    n_words: int
    memory: mmap.mmap  # what the function lies in: mapped as long as anyone can call it

    def __call__(self, *arguments: Any) -> Any:
        """Call the kernel, without the GIL.

        Raises
        ------
        ArgumentTypeError
            An argument is of another type.
        MemoryError
            The kernel found no memory.
        """
        values: list[int] = []
        _pack(values, self.kinds, arguments)
        words = (ctypes.c_int64 * self.n_words)(*values)
        if self.function(words):
            raise MemoryError("a kernel found no memory")
        if self.n_results == 1:
            return words[0]
        return tuple(words[: self.n_results]) if self.n_results else None


def _pack(values: list[int], kinds: list[Any], arguments: Any) -> None:
    """Append the words of arguments: numbers, and the address and lengths of arrays."""
    if len(kinds) != len(arguments):
        raise ArgumentTypeError(f"{len(arguments)} arguments, expected {len(kinds)}")
    for kind, argument in zip(kinds, arguments, strict=True):
        if isinstance(kind, list):
            values += _words_of(kind, argument)
        elif kind == "i":
            values.append(int(argument))
        elif kind == "d":
            values += _AS_WORD.unpack(_AS_FLOAT.pack(argument))
        else:
            dtype, n_dimensions = kind
            flags = argument.flags
            if argument.dtype != dtype or argument.ndim != n_dimensions or not (flags.c_contiguous and flags.aligned):
                raise ArgumentTypeError(
                    f"{argument.dtype} {argument.shape}, expected {dtype} {n_dimensions}-d, C order"
                )
            values.append(argument.__array_interface__["data"][0])
            values += argument.shape


# Kinds, arrays and words of the tuple of arrays packed last: a scene is packed once, not for each of its tiles.
_packed: tuple[list[Any], Remembered, list[int]] = ([], Remembered(()), [])


def _words_of(kinds: list[Any], arguments: Any) -> list[int]:
    """Return the words of a tuple of arguments."""
    global _packed  # noqa: PLW0603 - one value, replaced as a whole
    last = _packed
    if last[0] is kinds and last[1].are(arguments):
        return last[2]
    values: list[int] = []
    _pack(values, kinds, arguments)
    if not any(isinstance(kind, (str, list)) for kind in kinds):
        _packed = kinds, Remembered(arguments), values
    return values


class Image(NamedTuple):
    """A mapped image."""

    path: Path
    n_bytes: int
    doors: dict[str, Door]


def door_name(name: str) -> str:
    """Symbol of an entry's door."""
    return f"smalti_{name.replace('.', '_')}"


def save_image(path: Path, key: str, linked: Linked, entries: Mapping[str, Mapping[str, Any]]) -> int:
    """Write an image under its name, whole.

    Parameters
    ----------
    path
        Its folder exists.
    key
        Of the kernels' sources, compiler and CPU.
    linked
        The code.
    entries
        Of each entry: "arguments" and "results".

    Returns
    -------
    int
        Bytes of the file.
    """
    index = {
        "key": key,
        "entries": {name: {**one, "offset": linked.exports[door_name(name)]} for name, one in entries.items()},
        "constant": linked.n_constant,
        "imports": linked.imports,
        "addresses": linked.addresses,
        "bytes": len(linked.content),
    }
    text = json.dumps(index).encode()
    padding = bytes(-(_PREFIX.size + len(text)) % PAGE)
    content = text + padding + linked.content
    descriptor, temporary = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(_PREFIX.pack(_MAGIC, len(text), hashlib.sha256(content).digest()))
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
            os.fchmod(file.fileno(), 0o644)  # as numba's own files: others may map what one user has compiled
        Path(temporary).replace(path)
    except BaseException:
        with suppress(OSError):
            Path(temporary).unlink()
        raise
    return _PREFIX.size + len(content)


def load_image(path: Path, key: str) -> Image:
    """Check and map an image.

    Parameters
    ----------
    path
        What :func:`save_image` wrote.
    key
        Key of this process's kernels.

    Returns
    -------
    Image

    Raises
    ------
    FileNotFoundError
        There is none.
    ImageError
        It cannot be used; the message says why.
    """
    with path.open("rb") as file:
        data = file.read()
        if len(data) < _PREFIX.size:
            raise ImageError(f"{path} is cut short")
        magic, n_text, digest = _PREFIX.unpack_from(data)
        if magic != _MAGIC:
            raise ImageError(f"{path} is not an image of kernels, or of another version")
        if hashlib.sha256(memoryview(data)[_PREFIX.size :]).digest() != digest:
            raise ImageError(f"{path} is damaged")
        index = json.loads(data[_PREFIX.size : _PREFIX.size + n_text])
        if index["key"] != key:
            raise ImageError(f"{path} holds kernels of {index['key']}, not of {key}")
        start = -(-(_PREFIX.size + n_text) // PAGE) * PAGE
        memory = mmap.mmap(
            file.fileno(),
            index["bytes"],
            flags=mmap.MAP_PRIVATE,
            prot=mmap.PROT_READ | mmap.PROT_WRITE,
            offset=start,
        )
    process = ctypes.CDLL(None, use_errno=True)
    base = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    for name, place in index["imports"].items():
        try:
            address = ctypes.cast(getattr(process, name), ctypes.c_void_p).value
        except AttributeError:
            raise ImageError(f"{path} calls {name}, which this system lacks") from None
        _AS_WORD.pack_into(memory, place, address)
    for place, target in index["addresses"]:
        _AS_WORD.pack_into(memory, place, base + target)
    if process.mprotect(ctypes.c_void_p(base), ctypes.c_size_t(index["constant"]), _READ_AND_EXECUTE):
        raise ImageError(f"{path} may not be run: {os.strerror(ctypes.get_errno())}")
    prototype = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)
    doors = {}
    for name, one in index["entries"].items():
        kinds = [_parsed(kind) for kind in one["arguments"]]
        n_words = max(_count_words(kinds), one["results"], 1)
        doors[name] = Door(prototype(base + one["offset"]), kinds, one["results"], n_words, memory)
    return Image(path, len(data), doors)


def _parsed(kind: Any) -> Any:
    """Return an argument's kind as `_pack` reads it: arrays as (dtype, dimensions)."""
    if isinstance(kind, list):
        return [_parsed(field) for field in kind]
    if kind in {"i", "d"}:
        return kind
    dtype, _, n_dimensions = kind.partition(":")
    return np.dtype(dtype), int(n_dimensions)


def _count_words(kinds: list[Any]) -> int:
    """Words that arguments take."""
    return sum(
        _count_words(kind) if isinstance(kind, list) else 1 + kind[1] if isinstance(kind, tuple) else 1
        for kind in kinds
    )
