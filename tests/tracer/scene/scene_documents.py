"""Scene documents for the tests: one that uses every field, and a hypothesis strategy for valid ones."""

import copy
from typing import Any

import pytest
from hypothesis import strategies as st

from tracer.scene import SceneError, parse_scene

HASH = "0" * 63 + "a"

MINIMAL: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "perspective", "fov_deg": 40},
    "image": {"width": 4, "height": 3},
}

FULL: dict[str, Any] = {
    "version": 1,
    "name": "every field",
    "camera": {
        "type": "perspective",
        "fov_deg": 40,
        "fov_axis": "horizontal",
        "look_at": {"eye": [0, 1, 5], "target": [0, 1, 0], "up": [0, 1, 0]},
    },
    "image": {"width": 640, "height": 360, "crop": {"x": 10, "y": 20, "width": 30, "height": 40}},
    "integrator": {"type": "blinn_phong", "max_depth": 4, "shadows": False, "min_throughput": 0.001},
    "sampling": {
        "samples": 4,
        "sampler": "stratified",
        "seed": 7,
        "adaptive": {"min_samples": 2, "threshold": 0.02},
    },
    "materials": {
        "red": {"type": "blinn_phong", "kd": [0.8, 0.1, 0.1], "ka": 0.1, "ks": 0.5, "exponent": 50},
        "a/b~c": {
            "ke": 1,
            "kr": 0.5,
            "kt": [0.9, 0.9, 1],
            "eta": 1.5,
            "attenuation": {"a": 1, "b": 0.5, "c": 0.25},
            "diffuse_texture": {"asset": "wood", "wrap": "clamp", "color_space": "linear", "filter": "nearest"},
            "two_sided": False,
        },
    },
    "lights": [
        {"type": "ambient", "intensity": 0.1},
        {"type": "directional", "direction": [-1, -1, -1], "ambient": 0.1, "diffuse": [1, 1, 0.9], "specular": 0.5},
        {"type": "point", "position": [0, 2, 0]},
        {"type": "spot", "position": [0, 2, 0], "direction": [0, -1, 0], "inner_angle_deg": 10, "outer_angle_deg": 20},
    ],
    "objects": [
        {
            "type": "mesh",
            "name": "two triangles",
            "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]],
            "faces": [[0, 1, 2], [1, 3, 2]],
            "normals": [[0, 0, 1], [0, 0, 1], [0, 0, 2], [0, 0, 1]],
            "uvs": [[0, 0], [1, 0], [0, 1], [1, 1]],
            "colors": [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]],
            "groups": {"first": [0, 1], "second": [1, 2]},
            "material": "red",
            "materials": {"second": "a/b~c"},
            "transform": [
                {"type": "translate", "by": [1, 2, 3]},
                {"type": "rotate", "axis": [0, 0, 1], "angle_deg": 90},
                {"type": "scale", "by": [1, 2, -3]},
                {"type": "matrix", "rows": [[1, 0, 0, 4], [0, 1, 0, 5], [0, 0, 1, 6], [0, 0, 0, 1]]},
            ],
        },
        {"type": "mesh_asset", "asset": "car", "materials": {"Body": "red"}, "normals": "smooth"},
        {"type": "plane", "point": [0, 0, 0], "normal": [0, 1, 0], "material": "red"},
        {"type": "sphere", "center": [0, 1, 0], "radius": 1, "transform": [{"type": "scale", "by": 2}]},
        {"type": "box", "min": [-1, 0, -1], "max": [1, 2, 1]},
        {"type": "disk", "center": [0, 0, 0], "normal": [0, 1, 0], "radius": 2},
        {"type": "cylinder", "start": [0, 0, 0], "end": [0, 2, 0], "radius": 0.5, "capped": False},
    ],
    "background": [0.1, 0.2, 0.3],
    "assets": {
        "wood": {"file": "wood.png", "sha256": HASH},
        "car": {"file": "car.obj", "sha256": HASH, "companions": {"parts/car.mtl": HASH}},
    },
}


def full() -> dict[str, Any]:
    """A fresh copy of the document that uses every field."""
    return copy.deepcopy(FULL)


coordinates = st.floats(-1e30, 1e30, allow_nan=False) | st.integers(-1000, 1000)
lengths = st.floats(1e-30, 1e30) | st.integers(1, 1000)
parts = st.floats(0, 1e6) | st.integers(0, 3)
vectors = st.lists(coordinates, min_size=3, max_size=3)
colors = parts | st.lists(parts, min_size=3, max_size=3)
directions = st.lists(st.integers(-5, 5), min_size=3, max_size=3).filter(any)
names = st.text(st.characters(min_codepoint=32, exclude_categories=["Cs", "Cc"]), min_size=1, max_size=8)


def _record(required: dict[str, Any], optional: dict[str, Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries(required, optional=optional)


cameras = st.one_of(
    _record(
        {"type": st.just("perspective"), "fov_deg": st.floats(1e-6, 179.9)},
        {"fov_axis": st.sampled_from(["vertical", "horizontal"])},
    ),
    _record(
        {"type": st.just("view_plane"), "distance": lengths}
        | {"left": st.integers(-9, 0), "right": st.floats(1, 9), "bottom": st.just(-1), "top": st.just(0.5)},
        {"look_at": st.just({"eye": [1, 2, 3], "target": [0, 0, 0], "up": [0, 0, 1]})},
    ),
    _record(
        {"type": st.just("orthographic"), "height": lengths},
        {"matrix": st.just([[0, 2, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]])},
    ),
)
materials = _record(
    {},
    {"ka": colors, "kd": colors, "ks": colors, "ke": colors, "kr": colors, "kt": colors, "two_sided": st.booleans()}
    | {"exponent": st.floats(0, 1e6), "eta": st.floats(0.01, 100), "attenuation": st.just({"a": 2, "c": 1})},
)
shares = {"ambient": colors, "diffuse": colors, "specular": colors}
lights = st.one_of(
    _record({"type": st.just("ambient"), "intensity": colors}, {}),
    _record({"type": st.just("directional"), "direction": directions}, shares),
    _record({"type": st.just("point"), "position": vectors}, shares),
    _record(
        {"type": st.just("spot"), "position": vectors, "direction": directions},
        shares | {"inner_angle_deg": st.floats(0, 30), "outer_angle_deg": st.floats(30, 90)},
    ),
)
steps = st.one_of(
    _record({"type": st.just("translate"), "by": st.lists(st.integers(-9, 9), min_size=3, max_size=3)}, {}),
    _record({"type": st.just("rotate"), "axis": directions, "angle_deg": st.floats(-720, 720)}, {}),
    _record({"type": st.just("scale"), "by": st.floats(0.1, 10)}, {}),
)


@st.composite
def meshes(draw: st.DrawFn) -> dict[str, Any]:
    """Inline meshes with any of the optional arrays."""
    n = draw(st.integers(1, 5))
    rows = draw(st.lists(vectors, min_size=n, max_size=n))
    index = st.integers(0, n - 1)
    faces = draw(st.lists(st.lists(index, min_size=3, max_size=3), min_size=1, max_size=5))
    mesh: dict[str, Any] = {"type": "mesh", "positions": rows, "faces": faces}
    if draw(st.booleans()):
        mesh["normals"] = draw(st.lists(directions, min_size=n, max_size=n))
    if draw(st.booleans()):
        mesh["uvs"] = draw(st.lists(st.lists(st.floats(-9, 9), min_size=2, max_size=2), min_size=n, max_size=n))
    if draw(st.booleans()):
        mesh["groups"] = {draw(names): [0, len(faces)]}
    return mesh


shapes = st.one_of(
    meshes(),
    _record({"type": st.just("sphere"), "center": vectors, "radius": lengths}, {}),
    _record({"type": st.just("plane"), "point": vectors, "normal": directions}, {}),
    _record({"type": st.just("disk"), "center": vectors, "normal": directions, "radius": lengths}, {}),
    _record({"type": st.just("box"), "min": st.just([0, 0, 0]), "max": st.just([1, 2, 3])}, {}),
    _record(
        {"type": st.just("cylinder"), "start": st.just([0, 0, 0]), "end": directions, "radius": lengths},
        {"capped": st.booleans()},
    ),
)


@st.composite
def documents(draw: st.DrawFn) -> dict[str, Any]:
    """Valid scene documents."""
    table = draw(st.dictionaries(names, materials, max_size=3))
    things = draw(st.lists(shapes, max_size=4))
    for thing in things:
        if table and draw(st.booleans()):
            thing["material"] = draw(st.sampled_from(sorted(table)))
        if draw(st.booleans()):
            thing["transform"] = draw(st.lists(steps, max_size=3))
    document = {
        "version": 1,
        "camera": draw(cameras),
        "image": {"width": draw(st.integers(1, 5000)), "height": draw(st.integers(1, 5000))},
        "materials": table,
        "lights": draw(st.lists(lights, max_size=3)),
        "objects": things,
        "background": draw(colors),
    }
    if draw(st.booleans()):
        document["sampling"] = {"samples": draw(st.integers(1, 4096)), "seed": draw(st.integers(0, 2**32 - 1))}
        if draw(st.booleans()) and document["sampling"]["samples"] > 2:
            document["sampling"]["adaptive"] = {"threshold": draw(st.floats(0, 1e6))}
    if draw(st.booleans()):
        document["name"] = draw(names)
    return document


def faults_of(document: Any, **options: bool) -> dict[str, tuple[str, str]]:
    """Pointer to message and expectation of all faults."""
    with pytest.raises(SceneError) as caught:
        parse_scene(document, **options)
    return {fault.pointer: (fault.message, fault.expected) for fault in caught.value.faults}
