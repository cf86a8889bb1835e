"""Small whole models and documents, and ways to damage them, for N24.

Invariant: what becomes of a file or a document depends on the generator alone.
"""

import base64
import copy
import json
import struct

import numpy as np

from tests.tracer.loaders.loader_files import UVS, Gltf, png_bytes

_OBJ = """mtllib a.mtl
o Thing
v -1 0 0
v 1 0 0
v 1 1 0
v -1 1 0.5
v 0 2 0.25
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
vn 0.1 0 1
g Door
usemtl m
f 1/1/1 2/2/1 3/3/2 4/4/1
g Roof Top
usemtl n
s 1
f 4//1 3//2 -1//-1
f 1 2 5
"""
_MTL = """newmtl m
Ka 0.1 0.1 0.1
Kd 0.8 0.2 0.2
Ks 0.5 0.5 0.5
Ns 30
map_Kd t.png
newmtl n
Kd 0.2 0.8 0.2
Ke 0.1 0 0
d 0.5
Tr 0.5
Ni 1.5
illum 7
"""
_PLY_HEADER = """ply
format {} 1.0
comment made by hand
element vertex 4
property float x
property float y
property float z
property float nx
property float ny
property float nz
property uchar red
property uchar green
property uchar blue
element face 2
property list uchar int vertex_indices
end_header
"""
_SQUARE = ((-1, -1, 0), (1, -1, 0), (1, 1, 0.5), (-1, 1, 0))
_STL = """solid thing
facet normal 0 0 1
outer loop
vertex -1 -1 0
vertex 1 -1 0
vertex 1 1 0.5
endloop
endfacet
facet normal 0 0 1
outer loop
vertex -1 -1 0
vertex 1 1 0.5
vertex -1 1 0
endloop
endfacet
endsolid thing
"""
_OFF = "OFF\n# made by hand\n5 2 0\n-1 -1 0\n1 -1 0\n1 1 0.5\n-1 1 0\n0 2 0\n4 0 1 2 3\n3 3 2 4 255 0 0\n"


def _gltf():
    """Two nodes with transforms, indices, texture coordinates, colours, a material with a texture."""
    gltf = Gltf().with_triangle()
    attributes = gltf.primitive["attributes"]
    attributes["TEXCOORD_0"] = gltf.add(UVS)
    attributes["COLOR_0"] = gltf.add(np.array([[255, 0, 0, 255]] * 3, np.uint8), normalized=True)
    gltf.primitive["indices"] = gltf.add(np.array([0, 1, 2], np.uint16))
    gltf.primitive["material"] = 0
    uri = "data:image/png;base64," + base64.b64encode(png_bytes()).decode()
    gltf.tree |= {
        "images": [{"uri": uri}],
        "textures": [{"source": 0}],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0.5, 1], "baseColorTexture": {"index": 0}}}
        ],
        "nodes": [
            {"mesh": 0, "children": [1], "scale": [1, 2, 1], "rotation": [0, 0, 0, 1]},
            {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0.5, 0, 0.2, 1]},
        ],
    }
    return gltf


def small_models():
    """A model of each format: the files of its folder, the model first."""
    rows = [(*corner, 0, 0, 1, 255, 0, 9) for corner in _SQUARE]
    text = "".join(" ".join(map(str, row)) + "\n" for row in rows) + "3 0 1 2\n3 0 2 3\n"
    binary = b"".join(struct.pack("<6f3B", *row) for row in rows) + struct.pack("<B3iB3i", 3, 0, 1, 2, 3, 0, 2, 3)
    corners = [struct.pack("<12fH", 0, 0, 1, *_SQUARE[0], *_SQUARE[k], *_SQUARE[k + 1], 0) for k in (1, 2)]
    vertices = [number for corner in _SQUARE for number in (*corner, 0, 0, 1, 0.5, 0.5)]
    groups = {"Body": [0, 1], "Roof": [1, 2]}
    return [
        {"a.obj": _OBJ.encode(), "a.mtl": _MTL.encode(), "t.png": png_bytes()},
        {"a.ply": (_PLY_HEADER.format("ascii") + text).encode()},
        {"a.ply": _PLY_HEADER.format("binary_little_endian").encode() + binary},
        {"a.stl": _STL.encode()},
        {"a.stl": b"made by hand".ljust(80) + struct.pack("<I", 2) + b"".join(corners)},
        {"a.off": _OFF.encode()},
        {"a.glb": _gltf().glb()},
        {"a.gltf": _gltf().gltf().encode()},
        {"a.json": json.dumps({"vertexdata": vertices, "indexdata": [0, 1, 2, 0, 2, 3], "groups": groups}).encode()},
    ]


_TOKENS = [b"nan", b"inf", b"-inf", b"1e400", b"-1e39", b"1e-320", b"0", b"-0", b"-1", b"255", b"4294967296", b"1e9"]
_TOKENS += [b"99999999999999999999", b"0x10", b"1,5", b"", b"f", b"v", b"\xff\xfe", b"\x00", b"../../x", b"9" * 400]
_WORDS = [0, 1, 0x7F800000, 0xFF800000, 0x7FC00000, 0x7F7FFFFF, 0xFFFFFFFF, 0x80000000, 0x00000001, 0x10000]


def _replace_token(data, rng):
    """Another word in the place of one between blanks or commas."""
    ends = [k for k, byte in enumerate(data) if byte in b' \n,:/[]{}"'] or [0]
    at = int(rng.integers(len(ends)))
    begin, end = ends[at] + 1, ends[at + 1] if at + 1 < len(ends) else len(data)
    return data[:begin] + _TOKENS[rng.integers(len(_TOKENS))] + data[end:]


def _damage_once(data, rng):
    n = len(data)
    if n == 0:
        return bytes(rng.integers(0, 256, rng.integers(1, 40), dtype=np.uint8))
    a, b = np.sort(rng.integers(0, n + 1, 2)).tolist()
    b = min(b, a + int(rng.choice([1, 4, 40, 400])))
    match int(rng.integers(0, 8)):
        case 0:  # bits
            spoiled = bytearray(data)
            for at in rng.integers(0, n, rng.integers(1, 6)).tolist():
                spoiled[at] ^= 1 << int(rng.integers(8))
            return bytes(spoiled)
        case 1:
            return data[:a] + data[b:]
        case 2:
            return data[:b] + data[a:b] * int(rng.choice([1, 2, 50])) + data[b:]
        case 3:
            return data[:a]
        case 4:  # a number of a binary format
            return data[:a] + struct.pack("<I", _WORDS[rng.integers(len(_WORDS))]) + data[a + 4 :]
        case 5:  # two lines change places
            lines = data.split(b"\n")
            i, j = rng.integers(0, len(lines), 2)
            lines[i], lines[j] = lines[j], lines[i]
            return b"\n".join(lines)
        case _:
            return _replace_token(data, rng)


def damaged_bytes(data, rng):
    """One to four damages, any kind."""
    for _ in range(int(rng.choice([1, 1, 2, 4]))):
        data = _damage_once(data, rng)
    return data


def places(value, path=()):
    """Paths of all members and items below a value; rows of numbers longer than 16 by their first ones."""
    members = value.items() if isinstance(value, dict) else enumerate(value[:16]) if isinstance(value, list) else ()
    return [found for key, member in members for found in [(*path, key), *places(member, (*path, key))]]


def value_at(document, path):
    """What a path leads to."""
    for token in path:
        document = document[token]
    return document


_ODD = [
    None,
    True,
    "",
    "0",
    "\ud800",
    [],
    {},
    [[]],
    [1, 2, 3],
    [0, 0, 0],
    {"type": "sphere"},
    10**400,
    float("nan"),
    -1,
]
_INF = float("inf")
_NUMBERS = [0, -0.0, 1, -1, 0.5, 90, 179.999, 1e-30, -1e-30, 9e-31, 1e30, -1e30, 1.1e30, 1e6, 1.1e6, 1e9, 1e-6]
_NUMBERS += [1e-310, 5e-324, 1e154, 1e300, -1e308, _INF, -_INF, 2**31, 2**32 - 1, 2**53 + 1, 65_536, 32, 100, 0.01]
_REACHES = ((-30, 30), (-12, 6), (-3, 3), (-30, 0), (0, 30))  # powers of ten


def _stretch(document, rng):
    """Put another number, however far from it, in the place of one that is not whole; or another vector of three."""
    found = [path for path in places(document) if isinstance(value_at(document, path), float)]
    if not found:
        return
    path = found[rng.integers(len(found))]
    parent, key = value_at(document, path[:-1]), path[-1]
    if isinstance(parent, list) and len(parent) == 3 and rng.random() < 0.25:
        kind, axis, size = rng.integers(0, 4), rng.integers(0, 3), float(10.0 ** rng.uniform(-30, 30))
        flat = [0.0 if k == axis else number for k, number in enumerate(parent)]
        parent[:] = ([0.0] * 3, [size] * 3, [size * (k == axis) for k in range(3)], flat)[kind]
    elif rng.random() < 0.3:
        parent[key] = _NUMBERS[rng.integers(len(_NUMBERS))]
    else:
        parent[key] = float(parent[key] * 10.0 ** rng.uniform(*_REACHES[rng.integers(len(_REACHES))]))


def _change(document, rng):
    """Change one place of a document."""
    found = places(document)
    path = found[rng.integers(len(found))]
    parent, key = value_at(document, path[:-1]), path[-1]
    value = parent[key]
    match int(rng.integers(0, 6)):
        case 0:
            del parent[key]
        case 1 if isinstance(parent, dict):
            parent[f"{key}{rng.choice(['', ' ', 'x', '/~'])}"] = parent.pop(key)
        case 2 if isinstance(parent, list):
            parent.insert(int(rng.integers(len(parent) + 1)), copy.deepcopy(value))
        case 3:
            parent[key] = copy.deepcopy(value_at(document, found[rng.integers(len(found))]))
        case 4 if isinstance(value, list) and value:
            scale = 10.0 ** rng.uniform(-30, 30)
            parent[key] = [item * scale if isinstance(item, float) else item for item in value]
        case _:
            parent[key] = copy.deepcopy(_ODD[rng.integers(len(_ODD))])


def damaged_document(document, rng):
    """A copy with one to eight changes: in most, of numbers alone, so that they are asked whether they can be rendered."""
    document = copy.deepcopy(document)
    change = _stretch if rng.random() < 0.75 else _change
    for _ in range(int(rng.choice([1, 2, 4, 8]))):
        if document:
            change(document, rng)
    return document
