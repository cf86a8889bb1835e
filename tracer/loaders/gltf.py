"""glTF 2.0, as `.gltf` with its files beside it and as `.glb`.

trimesh decodes the accessors; the scene graph, materials and images are read here: trimesh drops what hangs below
a camera, joins names, loses texture coordinates of parts without a material, and does not look at the extensions.

Invariants: the document is checked before trimesh sees it (no loops, no lengths beyond the buffers, nothing fetched);
each instance of a mesh is baked by its own transform, normals by the inverse transpose, mirrored ones turned round, or
is a use of the mesh in its own space where that saves much.
Source: the glTF 2.0 specification; the extensions that are read are KHR_materials_transmission, _ior,
_emissive_strength and _specular (factors only).
"""

import base64
import binascii
import io
import json
import struct
from collections import Counter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tracer.loaders import limits
from tracer.loaders.colors import linear_colors
from tracer.loaders.files import CompanionError, ModelFile
from tracer.loaders.gltf_materials import GltfMaterials
from tracer.loaders.mesh import MeshData, MeshGroup, MeshPart, PartUse, Rows, join_parts
from tracer.loaders.uses import bake, may_place, rows_of

_GLB_MAGIC: Final = 0x46546C67
_CHUNK_JSON: Final = 0x4E4F534A
_CHUNK_BIN: Final = 0x004E4942
_COMPONENT_BYTES: Final = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_TRIANGLES, _STRIP = 4, 5
_VALIDATE: Final = "what a glTF validator finds in it must be mended"
# What a file may require without being drawn wrongly: materials that fall back, lights that the scene brings itself.
_HARMLESS: Final = ("KHR_materials_", "KHR_lights_punctual", "KHR_texture_transform", "KHR_xmp", "EXT_texture_webp")

Tree = dict[str, Any]


def load_gltf(file: ModelFile, data: bytes) -> MeshData:
    """Read a model of either form.

    Raises
    ------
    LoadError
    """
    text, binary = _split_glb(file, data) if file.suffix == ".glb" else (data, None)
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise file.error(f"is not JSON inside ({str(error)[:100]})", "export it as glTF 2.0 again") from None
    if not isinstance(tree, dict) or not isinstance(tree.get("asset"), dict):
        raise file.error("is not glTF: it has no asset", "export it as glTF 2.0")
    if not str(tree["asset"].get("version", "")).startswith("2."):
        raise file.error("is not of glTF version 2", "export it as glTF 2.0")
    for name in tree.get("extensionsRequired", []):
        if not str(name).startswith(_HARMLESS):
            raise file.error(f"needs the extension {str(name)[:60]}, which is not supported", "export it without that")
    try:
        buffers = [_buffer(file, index, entry, binary) for index, entry in enumerate(tree.get("buffers", []))]
        primitives = _check(file, tree, buffers)
        instances = _instances(file, tree)
        materials = GltfMaterials(file, tree, buffers)
        return _bake(file, tree, _decode(tree, buffers, primitives), primitives, instances, materials)
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, AssertionError, OverflowError) as error:
        # The document's tables refer to each other in dozens of places; any of them may be wrong.
        raise file.error(f"is not valid glTF ({type(error).__name__}: {str(error)[:100]})", _VALIDATE) from None


def _split_glb(file: ModelFile, data: bytes) -> tuple[bytes, bytes | None]:
    """Return the JSON and the binary chunk."""
    if len(data) < 20 or struct.unpack_from("<I", data)[0] != _GLB_MAGIC:
        raise file.error("does not begin as GLB files do", "export it again")
    position = 12
    chunks: dict[int, bytes] = {}
    while position + 8 <= len(data):
        length, kind = struct.unpack_from("<II", data, position)
        position += 8
        if position + length > len(data):
            raise file.error("is cut short: a chunk is longer than the file", "export it again")
        chunks.setdefault(kind, data[position : position + length])
        position += length + (-length % 4)
    if _CHUNK_JSON not in chunks:
        raise file.error("has no JSON in it", "export it again")
    return chunks[_CHUNK_JSON], chunks.get(_CHUNK_BIN)


def _buffer(file: ModelFile, index: int, entry: Tree, binary: bytes | None) -> bytes:
    """Return one buffer's bytes."""
    uri = entry.get("uri")
    if uri is None:
        if index != 0 or binary is None:
            raise file.error(f"has a buffer {index} without data", "export it again")
        data = binary
    else:
        try:
            data = read_uri(file, str(uri))
        except CompanionError as error:
            raise file.error(
                f"cannot be read without its buffer: {error}", "put the file beside it, or export as .glb"
            ) from None
    length = entry["byteLength"]
    if not isinstance(length, int) or not 0 <= length <= len(data):
        raise file.error(f"has a buffer {index} of {length} bytes, and its data has {len(data)}", "export it again")
    return data[:length]


def read_uri(file: ModelFile, uri: str) -> bytes:
    """Return the bytes of a data URI or of a file beside the model; `CompanionError` says why not."""
    if uri[:5].lower() == "data:":
        head, comma, payload = uri.partition(",")
        if not comma or not head.endswith(";base64"):
            raise CompanionError("a data URI that is not base64")
        try:
            return base64.b64decode(payload, validate=True)
        except (binascii.Error, ValueError):
            raise CompanionError("a data URI that is damaged") from None
    return file.read_companion(uri)


def _check(file: ModelFile, tree: Tree, buffers: list[bytes]) -> list[list[Tree]]:
    """Hold views and accessors against the buffers; return each mesh's primitives that are triangles."""
    views = tree.get("bufferViews", [])
    for index, view in enumerate(views):
        offset, length = view.get("byteOffset", 0), view["byteLength"]
        if min(offset, length) < 0 or offset + length > len(buffers[_natural(view["buffer"])]):
            raise file.error(f"has a buffer view {index} that reaches beyond its buffer", "export it again")
    for index, accessor in enumerate(tree.get("accessors", [])):
        if "sparse" in accessor:
            raise file.error(f"has a sparse accessor ({index}), which is not supported", "export it without those")
        count = _natural(accessor["count"])
        item = _COMPONENT_BYTES[accessor["componentType"]] * _COMPONENTS[accessor["type"]]
        if "bufferView" not in accessor:
            # The specification says zeros; a file that says so may claim any number of them.
            raise file.error(f"has an accessor {index} without data", "export it without compression")
        view = views[_natural(accessor["bufferView"])]
        stride = view.get("byteStride", item)
        if stride < item or (
            count and accessor.get("byteOffset", 0) + (count - 1) * stride + item > view["byteLength"]
        ):
            raise file.error(
                f"has an accessor {index} of {count} items that reaches beyond its buffer view", "export it again"
            )
    meshes = []
    for mesh in tree.get("meshes", []):
        kept = []
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", _TRIANGLES)
            if mode not in (_TRIANGLES, _STRIP):
                file.warn("points, lines or triangle fans are left out")
            elif "POSITION" not in primitive["attributes"]:
                file.warn("a part without positions is left out")
            else:
                if "targets" in primitive:
                    file.warn("morph targets are ignored")
                kept.append(primitive)
        meshes.append(kept)
    if tree.get("skins"):
        file.warn("skins are ignored: the model is shown in its rest pose")
    return meshes


def _natural(value: Any) -> int:
    """Return an index or a count; a negative one would count from the end."""
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise IndexError(f"{str(value)[:40]} is not an index")
    return value


def _instances(file: ModelFile, tree: Tree) -> list[tuple[int, tuple[str, ...], NDArray[np.float64]]]:
    """Walk the scene graph; return (mesh, names, object-to-world 4 x 4) of each node that has a mesh."""
    nodes = tree.get("nodes", [])
    scenes = tree.get("scenes", [])
    number = tree.get("scene", 0)
    if not isinstance(number, int) or not 0 <= number < len(scenes):
        raise file.error(f"shows scene {number}, and there are {len(scenes)} scenes", "export it again")
    visited: set[int] = set()
    found: list[tuple[int, tuple[str, ...], NDArray[np.float64]]] = []
    queue = [(_natural(root), np.eye(4)) for root in reversed(scenes[number].get("nodes", []))]
    while queue:
        index, parent = queue.pop()
        if index in visited:
            raise file.error(f"has a node {index} that is its own ancestor or has two parents", "export it again")
        visited.add(index)
        node = nodes[index]
        world = _product(parent, _local_matrix(file, node))
        if "mesh" in node:
            mesh = _natural(node["mesh"])
            names = [node.get("name"), tree["meshes"][mesh].get("name")]
            found.append((mesh, tuple(str(name) for name in names if name), world))
        queue += [(_natural(child), world) for child in reversed(node.get("children", []))]
    return found


def _local_matrix(file: ModelFile, node: Tree) -> NDArray[np.float64]:
    """Return a node's own transform: its matrix, or translation x rotation x scale."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], np.float64).reshape(4, 4).T
    else:
        x, y, z, w = (float(number) for number in node.get("rotation", (0.0, 0.0, 0.0, 1.0)))
        length = x * x + y * y + z * z + w * w
        s = 2.0 / length if length > 0.0 else 0.0
        rotation = np.array(
            [
                [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
                [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
                [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
            ]
        )
        matrix = np.eye(4)
        matrix[:3, :3] = rotation * np.array(node.get("scale", (1.0, 1.0, 1.0)), np.float64).reshape(1, 3)
        matrix[:3, 3] = np.array(node.get("translation", (0.0, 0.0, 0.0)), np.float64).reshape(3)
    if not np.isfinite(matrix).all() or (matrix[3] != (0.0, 0.0, 0.0, 1.0)).any():
        raise file.error("has a node whose transform is not finite and affine", "export it again")
    return matrix


def _product(left: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return left @ right, summed in one order on every machine."""
    return (left[:, :, np.newaxis] * right[np.newaxis, :, :]).cumsum(axis=1)[:, -1, :]


def _decode(tree: Tree, buffers: list[bytes], primitives: list[list[Tree]]) -> list[list[Tree]]:
    """Let trimesh decode each primitive; returns its keyword arguments for each mesh and primitive."""
    from trimesh.exchange.gltf import load_glb

    # A file of our own that holds the geometry alone: one buffer, one mesh a primitive, one dummy material a
    # primitive (without one, trimesh leaves texture coordinates out), names that keep the order.
    offsets = np.cumsum([0] + [len(buffer) + (-len(buffer) % 4) for buffer in buffers])
    views = [
        {**view, "buffer": 0, "byteOffset": view.get("byteOffset", 0) + int(offsets[view["buffer"]])}
        for view in tree.get("bufferViews", [])
    ]
    flat = [primitive for mesh in primitives for primitive in mesh]
    geometry: Tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": int(offsets[-1])}],
        "bufferViews": views,
        "accessors": tree.get("accessors", []),
        "materials": [{}],
        "meshes": [
            {
                "name": f"primitive{index}",
                "primitives": [
                    {
                        "attributes": {
                            name: primitive["attributes"][name]
                            for name in ("POSITION", "NORMAL", "TEXCOORD_0")
                            if name in primitive["attributes"]
                        },
                        **{key: primitive[key] for key in ("indices", "mode") if key in primitive},
                        "material": 0,
                    }
                ],
            }
            for index, primitive in enumerate(flat)
        ],
    }
    # Colours come beside the visuals only where there is no material, so they get primitives of their own.
    geometry["meshes"] += [
        {
            "name": f"color{index}",
            "primitives": [
                {
                    "attributes": {name: primitive["attributes"][name] for name in ("POSITION", "COLOR_0")},
                    **{key: primitive[key] for key in ("indices", "mode") if key in primitive},
                }
            ],
        }
        for index, primitive in enumerate(flat)
        if "COLOR_0" in primitive["attributes"]
    ]
    text = json.dumps(geometry).encode()
    text += b" " * (-len(text) % 4)
    binary = b"".join(buffer + bytes(-len(buffer) % 4) for buffer in buffers)
    chunks = struct.pack("<II", len(text), _CHUNK_JSON) + text + struct.pack("<II", len(binary), _CHUNK_BIN) + binary
    loaded = load_glb(io.BytesIO(struct.pack("<III", _GLB_MAGIC, 2, 12 + len(chunks)) + chunks))["geometry"]
    decoded = iter(range(len(flat)))
    return [
        [
            {**loaded[f"primitive{index}"], "colors": loaded.get(f"color{index}", {}).get("vertex_colors")}
            for _, index in zip(mesh, decoded, strict=False)
        ]
        for mesh in primitives
    ]


def _bake(
    file: ModelFile,
    tree: Tree,
    decoded: list[list[Tree]],
    primitives: list[list[Tree]],
    instances: list[tuple[int, tuple[str, ...], NDArray[np.float64]]],
    materials: GltfMaterials,
) -> MeshData:
    """Put every instance of every primitive into the file's world, but for large meshes that are used often."""
    sizes = [sum(len(part["faces"]) for part in mesh) for mesh in decoded]
    n_faces = sum(sizes[mesh] for mesh, _, _ in instances)
    if n_faces > file.limits.faces:
        raise file.error(f"draws {n_faces} triangles, more than the {file.limits.faces} allowed", "simplify it")
    often = _worth_sharing(sizes, [mesh for mesh, _, _ in instances])
    reach = {mesh: max(float(np.abs(part["vertices"]).max(initial=0.0)) for part in decoded[mesh]) for mesh in often}
    can_stay = [mesh in often and may_place(world, reach[mesh]) for mesh, _, world in instances]
    shared = _worth_sharing(sizes, [mesh for (mesh, _, _), stays in zip(instances, can_stay, strict=True) if stays])
    parts: list[MeshPart] = []
    groups: list[MeshGroup] = []
    kept: list[tuple[int, tuple[int, int], Rows]] = []  # mesh, groups, matrix
    for (mesh, names, world), stays in zip(instances, can_stay, strict=True):
        first = len(groups)
        for primitive in primitives[mesh]:
            material = materials.find(primitive.get("material"))
            own_name = (materials.materials[material].name,) if material >= 0 else ()
            groups.append(MeshGroup(tuple(dict.fromkeys(name for name in (*names, *own_name) if name)), material))
        if stays and mesh in shared:
            kept.append((mesh, (first, len(groups)), rows_of(world)))
            continue
        for number, (kwargs, primitive) in enumerate(zip(decoded[mesh], primitives[mesh], strict=True)):
            parts.append(_part(tree, kwargs, primitive, world, first + number))
    stored: dict[int, tuple[int, int]] = {}  # parts of a mesh
    for mesh in shared:
        first = len(parts)
        for number, (kwargs, primitive) in enumerate(zip(decoded[mesh], primitives[mesh], strict=True)):
            parts.append(_part(tree, kwargs, primitive, None, number))
        stored[mesh] = first, len(parts)
    uses = [PartUse(stored[mesh], some, rows) for mesh, some, rows in kept]
    return join_parts(file, parts, groups, materials.materials, materials.images, uses)


def _worth_sharing(sizes: list[int], uses: list[int]) -> list[int]:
    """Return the meshes that are large enough, and used often enough, to be stored once."""
    return [
        mesh
        for mesh, n in Counter(uses).items()
        if sizes[mesh] >= limits.SHARED_FACES and (n - 1) * sizes[mesh] >= limits.SAVED_FACES
    ]


def _part(tree: Tree, kwargs: Tree, primitive: Tree, world: NDArray[np.float64] | None, group: int) -> MeshPart:
    """Put one primitive into the file's space; without a matrix it stays in its own."""
    positions = np.asarray(kwargs["vertices"], np.float64)
    faces = np.asarray(kwargs["faces"], np.int64).reshape(-1, 3)
    normals = kwargs.get("vertex_normals")
    if world is not None:
        positions, normals, faces = bake(world, positions, normals, faces)
    uvs = getattr(kwargs.get("visual"), "uv", None)
    if uvs is not None:
        uvs = _restored_uvs(tree["accessors"][primitive["attributes"]["TEXCOORD_0"]], np.asarray(uvs))
    colors = kwargs["colors"]
    return MeshPart(
        positions,
        faces,
        normals,
        uvs,
        None if colors is None else linear_colors(np.asarray(colors), is_srgb=False),
        group,
    )


def _restored_uvs(accessor: Tree, uvs: NDArray[Any]) -> NDArray[np.float64]:
    """Return texture coordinates with v upwards; trimesh flips v, and wraps around when they are stored as integers."""
    top = {5121: 255, 5123: 65535}.get(accessor["componentType"])
    if top is None:
        return uvs.astype(np.float64)
    stored_v = (1 - uvs[:, 1].astype(np.int64)) % (top + 1)
    scale = top if accessor.get("normalized") else 1
    return np.stack([uvs[:, 0] / scale, 1.0 - stored_v / scale], axis=1)
