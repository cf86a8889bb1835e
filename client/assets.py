"""Scene files and the files they name: found, hashed, and made ready to upload.

Invariants: the document that leaves here names files by their base names and SHA-256 alone, so no path of this machine
reaches the service; a given hash is checked, never replaced; nothing is fetched from the network.
"""

import hashlib
import os
import re
import sys
from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from client.companions import RemoteUriError, discover_companions
from client.errors import AssetError, Fault, UsageError

DEFAULT_DATA = "../shared"
SEED_REPOSITORY = "WhoFama24/cse6413-raytracer"
SEED_FILES = frozenset(
    {
        "mini_geometry.json",
        "mini_material.json",
        "mini_body_diffuse.png",
        "bounding_box.json",
        "bounding_material.json",
        "reference_scenes.json",
    }
)
_SHA256 = re.compile(r"[0-9a-f]{64}")
_HASH_CHUNK_BYTES = 1 << 20


@dataclass(slots=True)
class PreparedScene:
    """A scene document without paths, and the files behind its hashes.

    Attributes
    ----------
    document : dict
        The document for the service: every asset with `file` (a base name), `sha256` and `companions`.
    files : dict
        Asset name → its file here; assets that are only known by hash are missing from it.
    uploads : dict
        SHA-256 → a file with these bytes.
    absent : dict
        SHA-256 → the fault to report if the service does not have these bytes either.
    warnings : list of str
        What was left out.
    """

    document: dict[str, Any]
    files: dict[str, Path] = field(default_factory=dict)
    uploads: dict[str, Path] = field(default_factory=dict)
    absent: dict[str, Fault] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def data_folder() -> Path:
    """Return the folder of data outside the repository: `SMALTI_DATA`, else `../shared` of the current folder."""
    return Path(os.environ.get("SMALTI_DATA") or DEFAULT_DATA)


def pointer_to(*keys: str) -> str:
    """JSON pointer (RFC 6901) to nested keys."""
    return "".join("/" + key.replace("~", "~0").replace("/", "~1") for key in keys)


def sha256_file(path: Path) -> str:
    """SHA-256 of a file, in hex."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_HASH_CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()


def read_scene(source: Path | str) -> tuple[dict[str, Any], Path]:
    """Read a scene file, or standard input for `-`.

    Returns
    -------
    document : dict
        The JSON object as written; the service checks what it means.
    folder : Path
        Where its relative file names start.

    Raises
    ------
    UsageError
        When the file cannot be read.
    SceneInvalidError
        When it is not a JSON object, names a key twice, or holds NaN or Infinity: with every fault of the document.
    """
    path = Path(source)
    try:
        text = sys.stdin.buffer.read() if str(source) == "-" else path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read the scene {source}: {error.strerror or error}") from error
    folder = Path() if str(source) == "-" else path.parent
    return parse_document(text, str(source)), folder


def parse_document(text: bytes | str, label: str = "scene") -> dict[str, Any]:
    """Parse a scene document strictly, with the tracer's parser; see `read_scene` for the errors."""
    from client.local import parse_text

    return parse_text(text, label)


def prepare_scene(document: Mapping[str, Any], folder: Path | None = None) -> PreparedScene:
    """Resolve the files of a scene document.

    Parameters
    ----------
    document : Mapping
        Scene document; only `assets` is looked at.
    folder : Path, optional
        Where relative names start, before the data folder; the current folder by default.

    Raises
    ------
    AssetError
        With one fault for each file that is missing, changed or not allowed.
    """
    prepared = PreparedScene(document=deepcopy(dict(document)))
    assets = prepared.document.get("assets")
    faults: list[Fault] = []
    if isinstance(assets, dict):
        for name, asset in assets.items():
            if isinstance(asset, dict) and isinstance(asset.get("file"), str):
                faults += _prepare_asset(prepared, name, asset, [folder or Path(), data_folder()])
    if faults:
        hint = _data_hint() if any(_is_seed(fault.message) for fault in faults) else ""
        count = "a file" if len(faults) == 1 else f"{len(faults)} files"
        raise AssetError(f"{count} of the scene cannot be used", faults=faults, hint=hint)
    return prepared


def _prepare_asset(prepared: PreparedScene, name: str, asset: dict[str, Any], folders: list[Path]) -> list[Fault]:
    """Fill in one entry of the `assets` table; returns its faults."""
    file = asset["file"]
    given = asset.get("sha256")
    pointer = pointer_to("assets", name, "file")
    if re.match(r"[A-Za-z][A-Za-z0-9+.\-]+:", file) or file.startswith("//"):
        return [Fault(pointer, f"{file[:200]!r} is a URL; Smalti fetches nothing", "the name of a local file")]
    path = _find(file, folders)
    asset["file"] = re.split(r"[/\\]", file)[-1] or file
    if path is None:
        searched = ", ".join(str(folder.resolve()) for folder in dict.fromkeys(folders))
        fault = Fault(pointer, f"{file!r} is in none of the folders searched: {searched}", "a file that exists")
        if isinstance(given, str) and _SHA256.fullmatch(given):
            prepared.absent[given] = fault  # the service may have these bytes from before
            return []
        return [fault]
    from client.local import asset_suffixes

    if path.suffix.lower() not in asset_suffixes():  # a scene from elsewhere must not carry off other files
        message = f"{file[:200]!r} is no model or image by its ending: never read, never sent"
        return [Fault(pointer, message, f"a file that ends in {', '.join(asset_suffixes())}")]
    if not any(Path(os.path.abspath(path)).is_relative_to(os.path.abspath(one)) for one in folders):  # noqa: PTH100
        prepared.warnings.append(f"{pointer}: {file[:200]!r} lies outside the scene's folder and the data folder")
    digest = sha256_file(path)
    if given is not None and given != digest:
        message = f"{path} has other bytes than the scene expects: their SHA-256 is {digest}"
        return [Fault(pointer_to("assets", name, "sha256"), message, f"a file with SHA-256 {given}")]
    asset["sha256"] = digest
    prepared.files[name] = path
    prepared.uploads[digest] = path
    return _prepare_companions(prepared, name, asset, path)


def _prepare_companions(prepared: PreparedScene, name: str, asset: dict[str, Any], path: Path) -> list[Fault]:
    """Fill in, or check, the companions of one asset; returns their faults."""
    given = asset.get("companions")
    if isinstance(given, dict):
        # Known to be missing (null) is for readers of the document; what is rendered is what has a hash.
        asset["companions"] = {key: digest for key, digest in given.items() if digest is not None}
        return _check_companions(prepared, name, asset["companions"], path)
    try:
        found = discover_companions(path)
    except RemoteUriError as error:
        return [Fault(pointer_to("assets", name, "file"), str(error), "a model whose files are all local")]
    prepared.warnings += found.warnings
    present = {key: file for key, file in sorted(found.files.items()) if file is not None}
    if present:
        asset["companions"] = {key: sha256_file(file) for key, file in present.items()}
        prepared.uploads |= {asset["companions"][key]: file for key, file in present.items()}
    return []


def _check_companions(prepared: PreparedScene, name: str, given: dict[str, Any], path: Path) -> list[Fault]:
    faults = []
    root = path.parent.resolve()
    for key, digest in given.items():
        pointer = pointer_to("assets", name, "companions", key)
        file = (root / key).resolve()
        if not file.is_relative_to(root):
            faults.append(Fault(pointer, f"{key!r} leads out of the model's folder", "a plain relative name"))
        elif not file.is_file():
            prepared.absent[str(digest)] = Fault(pointer, f"{key!r} is not in {root}", "a file that exists")
        elif (actual := sha256_file(file)) != digest:
            message = f"{file} has other bytes than the scene expects: their SHA-256 is {actual}"
            faults.append(Fault(pointer, message, f"a file with SHA-256 {digest}"))
        else:
            prepared.uploads[actual] = file
    return faults


def _find(file: str, folders: list[Path]) -> Path | None:
    if "\0" in file or not file:
        return None
    for folder in folders:
        try:
            if (folder / file).is_file():
                return folder / file
        except OSError:  # the name is too long for this file system
            continue
    return None


def _is_seed(text: str) -> bool:
    return any(name in text for name in SEED_FILES) or "seed/" in text


def _data_hint() -> str:
    return (
        f"this file is from the public GitHub repository {SEED_REPOSITORY}: put it into {data_folder() / 'seed'}, "
        "or set SMALTI_DATA to the folder that holds 'seed'"
    )


def absent_error(prepared: PreparedScene, hashes: Iterable[str], *, asked: bool = True) -> AssetError:
    """Return the error for files that are not on this machine, nor, where it was `asked`, at the service."""
    faults = [prepared.absent[digest] for digest in hashes]
    hint = _data_hint() if any(_is_seed(fault.message) for fault in faults) else ""
    place = "neither here nor at the service" if asked else "not here"
    return AssetError(f"a file of the scene is {place}", faults=faults, hint=hint)
