"""What one place of the document says of another: names, indices, lengths, budgets.

Invariant: works on the plain values, before and beside the models, and takes nothing for granted, so that these faults
are told together with all others. What has the wrong type is skipped here: the models tell it.
"""

import math
from collections.abc import Iterator
from itertools import chain, pairwise
from typing import Any

from tracer.scene.faults import Fault, closest, one_of, pointer_of, quoted
from tracer.scene.limits import MAX_ROW_FAULTS, MAX_TOTAL_SAMPLES

Plain = dict[str, Any]


def reference_faults(document: Plain) -> Iterator[Fault]:
    """Faults of a document's references, in the order of its tables."""
    materials, assets = _table(document, "materials"), _table(document, "assets")
    yield from _budget_faults(document)
    yield from _material_faults(document, materials, assets)
    for index, thing in enumerate(_list(document, "objects")):
        if isinstance(thing, dict):
            yield from (fault.below(f"/objects/{index}") for fault in _object_faults(thing, materials, assets))


def _table(document: Plain, name: str) -> Plain:
    table = document.get(name)
    return table if isinstance(table, dict) else {}


def _list(document: Plain, name: str) -> list[Any]:
    table = document.get(name)
    return table if isinstance(table, list) else []


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _unknown(pointer: str, what: str, name: str, table: Plain) -> Fault:
    return Fault(pointer, f"names the unknown {what} {quoted(name)}{closest(name, table)}", one_of(table))


def _budget_faults(document: Plain) -> Iterator[Fault]:
    """Pixels times samples must stay in the budget."""
    image, sampling = _table(document, "image"), _table(document, "sampling")
    crop = image.get("crop")
    size = crop if isinstance(crop, dict) else image
    width, height, samples = size.get("width"), size.get("height"), sampling.get("samples", 16)
    factors = [value for value in (width, height, samples) if isinstance(value, int) and value > 0]
    total = math.prod(factors)
    if len(factors) == 3 and total > MAX_TOTAL_SAMPLES:
        message = f"makes {total} samples in the whole picture"
        yield Fault("/sampling/samples", message, f"at most {MAX_TOTAL_SAMPLES} pixels times samples")


def _material_faults(document: Plain, materials: Plain, assets: Plain) -> Iterator[Fault]:
    """Textures name assets; a directional light needs a constant term of the attenuation."""
    directional = next(
        (
            index
            for index, light in enumerate(_list(document, "lights"))
            if isinstance(light, dict) and light.get("type") == "directional"
        ),
        None,
    )
    for name, material in materials.items():
        if not isinstance(material, dict):
            continue
        asset = _table(material, "diffuse_texture").get("asset")
        if isinstance(asset, str) and asset not in assets:
            yield _unknown(pointer_of("materials", name, "diffuse_texture", "asset"), "asset", asset, assets)
        attenuation = _table(material, "attenuation")
        a = attenuation.get("a")
        rest = (attenuation.get("b", 0), attenuation.get("c", 0))
        if directional is not None and a == 0 and not isinstance(a, bool) and rest != (0, 0):
            message = f"is 0, but the directional light /lights/{directional} is attenuated by 1/a"
            yield Fault(pointer_of("materials", name, "attenuation", "a"), message, "a number > 0")


def _object_faults(thing: Plain, materials: Plain, assets: Plain) -> Iterator[Fault]:
    """Faults of one object; pointers are relative to it."""
    name = thing.get("material")
    if isinstance(name, str) and name not in materials:
        yield _unknown("/material", "material", name, materials)
    for group, chosen in _table(thing, "materials").items():
        if isinstance(chosen, str) and chosen not in materials:
            yield _unknown(pointer_of("materials", group), "material", chosen, materials)
    if thing.get("type") == "mesh_asset":
        asset = thing.get("asset")
        if isinstance(asset, str) and asset not in assets:
            yield _unknown("/asset", "asset", asset, assets)
    elif thing.get("type") == "mesh":
        yield from _mesh_faults(thing)
        yield from _texture_faults(thing, materials)


def _mesh_faults(mesh: Plain) -> Iterator[Fault]:
    """Lengths, vertex indices and groups of an inline mesh."""
    positions, faces = mesh.get("positions"), mesh.get("faces")
    for name, rows in (("positions", positions), ("faces", faces)):
        if isinstance(rows, list) and not rows:
            yield Fault("/" + name, "is empty", "at least one item")
    if isinstance(positions, list):
        for name in ("normals", "uvs", "colors"):
            rows = mesh.get(name)
            if isinstance(rows, list) and len(rows) != len(positions):
                yield Fault("/" + name, f"has {len(rows)} items", f"{len(positions)} items, one per position")
        if isinstance(faces, list):
            yield from _index_faults(faces, len(positions))
    yield from _normal_faults(mesh.get("normals"))
    if isinstance(faces, list):
        yield from _group_faults(mesh, len(faces))


def _index_faults(faces: list[Any], n_positions: int) -> Iterator[Fault]:
    """Vertex indices beyond the positions (the models tell negative ones)."""
    try:
        if not faces or max(chain.from_iterable(faces)) < n_positions:
            return
    except (TypeError, ValueError):  # wrong types or empty rows among them: look at each
        pass
    found = (
        Fault(f"/faces/{row}/{column}", f"is {index}", f"a vertex index from 0 to {n_positions - 1}")
        for row, face in enumerate(faces)
        if isinstance(face, list)
        for column, index in enumerate(face)
        if _is_whole(index) and index >= n_positions
    )
    for _, fault in zip(range(MAX_ROW_FAULTS), found, strict=False):
        yield fault


def _normal_faults(normals: object) -> Iterator[Fault]:
    """Vertex normals without a direction."""
    if not isinstance(normals, list) or [0, 0, 0] not in normals:
        return
    zero = (row for row, normal in enumerate(normals) if normal == [0, 0, 0])
    for _, row in zip(range(MAX_ROW_FAULTS), zero, strict=False):
        yield Fault(f"/normals/{row}", "has no direction: its length is zero", "three numbers, not all zero")


def _group_faults(mesh: Plain, n_faces: int) -> Iterator[Fault]:
    """Ranges of groups lie inside the faces and do not overlap; materials name groups."""
    groups = _table(mesh, "groups")
    ranges: list[tuple[int, int, str]] = []
    for name, bounds in groups.items():
        if not (isinstance(bounds, list) and len(bounds) == 2 and all(map(_is_whole, bounds))):
            continue
        first, end = bounds
        if not 0 <= first <= end <= n_faces:
            expected = f"[first, end) with 0 <= first <= end <= {n_faces}"
            yield Fault(pointer_of("groups", name), f"is [{first}, {end}]", expected)
        elif first < end:
            ranges.append((first, end, name))
    ranges.sort()
    for (_, end, name), (first, _, other) in pairwise(ranges):
        if first < end:
            yield Fault(pointer_of("groups", other), f'overlaps the group "{name}"', "ranges that do not overlap")
    if isinstance(mesh.get("groups", {}), dict | None):
        for name in _table(mesh, "materials"):
            if name not in groups:
                yield _unknown(pointer_of("materials", name), "group", name, groups)


def _texture_faults(mesh: Plain, materials: Plain) -> Iterator[Fault]:
    """Tell textured materials on an inline mesh that lacks texture coordinates."""
    if mesh.get("uvs") is not None:
        return
    used = [("/material", mesh.get("material"))]
    used += [(pointer_of("materials", group), name) for group, name in _table(mesh, "materials").items()]
    for pointer, name in used:
        material = materials.get(name) if isinstance(name, str) else None
        if isinstance(name, str) and isinstance(material, dict) and material.get("diffuse_texture") is not None:
            yield Fault(pointer, f"names the textured material {quoted(name)}", "uvs in the mesh, or no texture")


# --- what the service asks of assets ------------------------------------------------------------------------------


def asset_faults(document: Plain) -> Iterator[Fault]:
    """Faults of the assets table where hashes are required and names must be plain and relative."""
    for name, asset in _table(document, "assets").items():
        if isinstance(asset, dict):
            yield from (fault.below(pointer_of("assets", name)) for fault in _hashed_asset_faults(asset))


def _hashed_asset_faults(asset: Plain) -> Iterator[Fault]:
    file = asset.get("file")
    if isinstance(file, str) and (problem := file_name_problem(file, folders=False)):
        yield Fault("/file", problem, "a plain file name without folders; the content is named by sha256")
    if asset.get("sha256") is None:
        yield Fault("/sha256", "is missing", "the SHA-256 of the file, 64 lower-case hex digits")
    companions = _table(asset, "companions")
    folders = {name[:end] for name in companions for end, letter in enumerate(name) if letter == "/"}
    if isinstance(file, str) and file in folders:
        yield Fault("/file", "is a file here and a folder of a companion", "another name")
    for companion, digest in companions.items():
        pointer = pointer_of("companions", companion)
        if problem := file_name_problem(companion, folders=True):
            yield Fault(pointer, problem, 'a relative name such as "textures/wood.png"')
        elif companion == file:
            yield Fault(pointer, "has the name of the file itself", "another name")
        elif companion in folders:
            yield Fault(pointer, "is a file here and a folder elsewhere", "another name")
        if digest is None:
            yield Fault(pointer, "has no hash", "the SHA-256 of the file, 64 lower-case hex digits")


def file_name_problem(name: str, *, folders: bool) -> str | None:
    """Why a name may not be used for a file in a job's folder, or None.

    Parameters
    ----------
    name : str
        Name from the document.
    folders : bool
        Whether "/" may separate folders.

    """
    if "\\" in name or ":" in name:
        return 'holds "\\" or ":"; schemes and drives are not accepted'
    if any(ord(character) < 32 or ord(character) == 127 for character in name):
        return "holds a control character"
    if name.startswith("/"):
        return "is an absolute path"
    parts = name.split("/")
    if len(parts) > 1 and not folders:
        return "has folders"
    if any(part in {"", ".", ".."} for part in parts):
        return 'has an empty part, "." or ".."'
    if any(len(part.encode()) > 255 for part in parts):
        return "has a part longer than 255 bytes"
    return None
