"""Files that a model file names: material libraries, textures, glTF buffers and images. Standard library only.

Invariants: nothing outside the model's folder is ever opened, by `..`, by an absolute name or through a symbolic link;
a damaged model has no companions here, and the service says what is wrong with it.
Sources: Wavefront OBJ/MTL by Alias (`mtllib`, `map_*` with options), glTF 2.0 sections 3.6 and 4.4 (URIs, GLB chunks).
"""

import json
import mmap
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

LARGEST_TEXT_BYTES = 64 << 20  # of a material library or the JSON of a glTF: beyond this it is no such file
PLY_HEADER_BYTES = 64 << 10

_MTLLIB = re.compile(rb"(?m)^[ \t]*mtllib[ \t]+([^\r\n]+)")
_MAP = re.compile(r"(?mi)^[ \t]*(?:map_\w+|bump|disp|decal|refl|norm)[ \t]+([^\r\n]+)")
_MAP_OPTION = re.compile(
    r"-(?:(?:blendu|blendv|cc|clamp|bm|boost|texres|imfchan|type|colorspace)[ \t]+\S+"
    r"|mm[ \t]+\S+[ \t]+\S+"
    r"|[ost](?:[ \t]+[-+]?[\d.]+(?:[eE][-+]?\d+)?){1,3})[ \t]+",
    re.IGNORECASE,
)
_PLY_TEXTURE = re.compile(rb"(?m)^comment[ \t]+TextureFile[ \t]+([^\r\n]+)")
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.\-]+:")  # two letters at least: one is a drive


class RemoteUriError(ValueError):
    """A model names a file on the network; Smalti fetches nothing."""


@dataclass(slots=True)
class Companions:
    """What a model file names.

    Attributes
    ----------
    files : dict
        Plain relative name with `/` → the file, or None when it is not there.
    warnings : list of str
        Names that were left out, and why.
    """

    files: dict[str, Path | None] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


class _Folder:
    """The model's folder: looks names up in it and nowhere else."""

    def __init__(self, model: Path, found: Companions) -> None:
        self.root = model.parent.resolve()
        self.model_name = model.name
        self.found = found

    def plain(self, name: str) -> str | None:
        """Return the name with `/`, or None when it leads out of the folder."""
        name = name.strip().strip('"').replace("\\", "/")
        parts = PurePosixPath(name).parts
        if not parts or "\0" in name or name.startswith("/") or ".." in parts or re.match(r"[A-Za-z]:", name):
            return None
        return "/".join(parts)

    def path(self, plain: str) -> Path | None:
        """Return the file of a plain name, if it exists and lies in the folder."""
        try:
            path = (self.root / plain).resolve()
            if path.is_file() and path.is_relative_to(self.root):
                return path
        except OSError:  # a name too long, a loop of links: no such file
            return None
        return None

    def add(self, *candidates: str) -> Path | None:
        """Record the first candidate that exists, else the first one as missing."""
        plain = [name for name in map(self.plain, candidates) if name is not None]
        if not plain:
            self.found.warnings.append(
                f"{self.model_name} names {candidates[0]!r}, which is outside its folder: left out, never read"
            )
            return None
        for name in plain:
            path = self.path(name)
            if path is not None:
                self.found.files[name] = path
                return path
        self.found.files[plain[0]] = None
        self.found.warnings.append(f"{self.model_name} names {plain[0]!r}, which is not in its folder: goes without")
        return None


def discover_companions(model: Path) -> Companions:
    """Find the files that a model file names.

    Parameters
    ----------
    model : Path
        OBJ, glTF, GLB or PLY file; other kinds have no companions.

    Raises
    ------
    RemoteUriError
        When the model names a file on the network.
    """
    found = Companions()
    folder = _Folder(model, found)
    readers = {".obj": _read_obj, ".mtl": _read_mtl_model, ".gltf": _read_gltf, ".glb": _read_gltf, ".ply": _read_ply}
    reader = readers.get(model.suffix.lower())
    if reader is not None:
        reader(model, folder)
    return found


def _refuse_remote(name: str, model: str) -> None:
    if name.startswith("//") or _SCHEME.match(name):
        raise RemoteUriError(f"{model} names {name[:200]!r} on the network; save that file beside the model instead")


def _read_obj(model: Path, folder: _Folder) -> None:
    for raw in _find_in_file(_MTLLIB, model):
        line = raw.decode("utf-8", "replace").strip()
        _refuse_remote(line, model.name)
        # The format allows several names on a line, exporters write one name with spaces: take what exists.
        names = line.split()
        whole = folder.plain(line)
        if len(names) > 1 and (whole is None or folder.path(whole) is None):
            plain = [folder.plain(name) for name in names]
            if any(name is not None and folder.path(name) for name in plain):
                for name in names:
                    _read_mtl(folder.add(name), name, folder)
                continue
        _read_mtl(folder.add(line), line, folder)


def _read_mtl_model(model: Path, folder: _Folder) -> None:
    _read_mtl(model, model.name, folder)


def _read_mtl(library: Path | None, library_name: str, folder: _Folder) -> None:
    if library is None or library.stat().st_size > LARGEST_TEXT_BYTES:
        return
    parent = PurePosixPath(library_name.replace("\\", "/")).parent.as_posix()
    for match in _MAP.finditer(library.read_text("utf-8", "replace")):
        line = match[1].strip()
        without_options = line
        while option := _MAP_OPTION.match(without_options):
            without_options = without_options[option.end() :].strip()
        _refuse_remote(without_options, library_name)
        names = list(dict.fromkeys([without_options, line]))
        if parent != ".":  # beside the library first, then beside the model: exporters do both
            names = [f"{parent}/{name}" for name in names] + names
        folder.add(*names)


def _read_gltf(model: Path, folder: _Folder) -> None:
    for uri in _gltf_uris(_gltf_json(model)):
        if uri.lower().startswith("data:"):
            continue
        _refuse_remote(uri, model.name)
        # A URI is percent-encoded by the standard; many exporters leave it plain.
        folder.add(*dict.fromkeys([unquote(uri), uri]))


def _gltf_json(model: Path) -> object:
    with model.open("rb") as file:
        head = file.read(20)
        if head[:4] == b"glTF" and len(head) == 20:
            length, kind = struct.unpack("<I4s", head[12:])
            text = file.read(length) if kind == b"JSON" and length <= LARGEST_TEXT_BYTES else b""
        else:
            text = head + file.read(LARGEST_TEXT_BYTES)
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


def _gltf_uris(document: object) -> Iterator[str]:
    if not isinstance(document, dict):
        return
    for kind in ("buffers", "images"):
        entries = document.get(kind)
        for entry in entries if isinstance(entries, list) else ():
            uri = entry.get("uri") if isinstance(entry, dict) else None
            if isinstance(uri, str) and uri:
                yield uri


def _read_ply(model: Path, folder: _Folder) -> None:
    with model.open("rb") as file:
        header = file.read(PLY_HEADER_BYTES).partition(b"end_header")[0]
    for match in _PLY_TEXTURE.finditer(header):
        name = match[1].decode("utf-8", "replace")
        _refuse_remote(name, model.name)
        folder.add(name)


def _find_in_file(pattern: re.Pattern[bytes], path: Path) -> list[bytes]:
    """First groups of all matches, without reading a large file into memory."""
    if path.stat().st_size == 0:  # an empty file cannot be mapped
        return []
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return [match[1] for match in pattern.finditer(data)]
