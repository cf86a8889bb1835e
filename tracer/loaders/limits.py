"""Bounds of what a loader accepts, each with its reason. All of them are checked before memory is taken."""

from typing import Final, NamedTuple

MAX_COORDINATE: Final = 1e30
"""The scene document's own bound of a coordinate; beyond it, products of lengths leave float64."""

MAX_TEXTURE_COORDINATE: Final = 1e9
"""The scene document's own bound of u and v."""

MAX_COLOR: Final = 1e6
"""The scene document's own bound of a colour."""

IN_PROCESS_JSON_BYTES: Final = 4 << 20
"""Vertex-data JSON up to this size is read without a process of its own: Python's JSON reader takes at most about
30 bytes for each byte of text (120 MB), does no harm on bad text, and a process costs half a second. The MINI has
0.5 MB."""

SHARED_FACES: Final = 4_096
SAVED_FACES: Final = 2**18
"""A mesh of a glTF file of at least so many triangles, whose repeated uses would take so many more, is stored once: as
the renderer shares equal meshes (:mod:`tracer.render.parts`)."""

MESH_SUFFIXES: Final = (".obj", ".ply", ".stl", ".glb", ".gltf", ".off", ".json")
"""What can be loaded. trimesh reads far more, archives among them; what is not listed never reaches it."""

IMAGE_FORMATS: Final = ("PNG", "JPEG", "BMP", "TGA", "WEBP")
"""Pillow's names of the image formats that are decoded."""


class LoadLimits(NamedTuple):
    """Bounds of one load; `cpu_s` and `wall_s` are for a whole batch of files."""

    file_bytes: int = 1 << 30
    """Of one file. An OBJ of 10 million triangles has about 700 MB."""

    vertices: int = 20_000_000
    faces: int = 10_000_000
    """After instancing. A compiled triangle takes about 250 bytes, so this is 2.5 GB: what a render host can hold."""

    image_pixels: int = 8192 * 8192
    """Of one image: 0.8 GB once it is float32."""

    memory_bytes: int = 6 << 30
    """Address space of the loading process, libraries (0.5 GB) included."""

    cpu_s: int = 120
    """A million triangles of OBJ take 6 s."""

    wall_s: float = 300.0
    """The machine may be busy: the workers run at low priority."""


DEFAULT_LIMITS: Final = LoadLimits()
