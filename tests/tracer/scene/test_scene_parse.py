"""parse_scene: every fault is told, with a pointer, and nothing but a SceneError ever comes out."""

import json
import math
import pickle
import subprocess
import sys
import time
from typing import Any

import pytest
from scene_documents import FULL, HASH, MINIMAL, faults_of, full

from tracer.scene import SceneError, parse_scene
from tracer.scene.faults import tokens_of
from tracer.scene.limits import MAX_FAULTS


def changed(pointer: str, value: Any) -> dict[str, Any]:
    """The full document with the value at `pointer` set to another one."""
    document = full()
    place: Any = document
    *path, last = tokens_of(pointer)
    for token in path:
        place = place[int(token)] if isinstance(place, list) else place[token]
    place[int(last) if isinstance(place, list) else last] = value
    return document


def test_the_full_and_the_minimal_document_are_valid() -> None:
    doc = parse_scene(json.dumps(FULL).encode(), require_hashes=True)
    assert doc.objects[0].positions[3] == (1.0, 1.0, 0.5)  # type: ignore[union-attr]
    assert doc.objects[0].faces == ((0, 1, 2), (1, 3, 2))  # type: ignore[union-attr]
    assert doc.image.rect == (10, 20, 30, 40)
    assert parse_scene(MINIMAL).image.rect == (0, 0, 4, 3)


def test_one_number_stands_for_three_channels_and_ka_follows_kd() -> None:
    doc = parse_scene({**MINIMAL, "materials": {"a": {"kd": 0.3}, "b": {"kd": [1, 2, 3], "ka": 0}, "c": {}}})
    assert doc.materials["a"].kd == (0.3, 0.3, 0.3) == doc.materials["a"].ka
    assert doc.materials["b"].ka == (0.0, 0.0, 0.0)
    assert doc.materials["c"].ka == doc.materials["c"].kd == (0.8, 0.8, 0.8)


@pytest.mark.parametrize(
    ("pointer", "value", "told"),
    [
        # wrong types, without pydantic's union tags in the pointer
        ("/version", 2, "/version"),
        ("/version", True, "/version"),
        ("/version", 1.0, "/version"),
        ("/image/width", "640", "/image/width"),
        ("/image/width", 640.0, "/image/width"),
        ("/image/width", 0, "/image/width"),
        ("/image/width", 65537, "/image/width"),
        ("/integrator/shadows", 1, "/integrator/shadows"),
        ("/integrator/max_depth", True, "/integrator/max_depth"),
        ("/integrator/max_depth", 33, "/integrator/max_depth"),
        ("/camera/fov_deg", "40", "/camera/fov_deg"),
        ("/camera/fov_deg", True, "/camera/fov_deg"),
        ("/camera/fov_deg", 180, "/camera/fov_deg"),
        ("/camera/type", "fisheye", "/camera/type"),
        ("/camera/fov_axis", "diagonal", "/camera/fov_axis"),
        ("/camera", None, "/camera"),
        ("/objects/0/positions/1", [0, 0], "/objects/0/positions/1"),
        ("/objects/0/positions/1/2", "x", "/objects/0/positions/1/2"),
        ("/objects/0/positions/1/2", True, "/objects/0/positions/1/2"),
        ("/objects/0/positions/1/2", 1e31, "/objects/0/positions/1/2"),
        ("/objects/0/positions", 3, "/objects/0/positions"),
        ("/objects/0/faces/0/1", 1.0, "/objects/0/faces/0/1"),
        ("/objects/0/faces/0/1", -1, "/objects/0/faces/0/1"),
        ("/objects/3/radius", 0, "/objects/3/radius"),
        ("/objects/3/radius", -1, "/objects/3/radius"),
        ("/objects/3/radius", [1], "/objects/3/radius"),
        ("/objects/3", "sphere", "/objects/3"),
        ("/objects/0/transform/0/by", [1, 2], "/objects/0/transform/0/by"),
        ("/objects/0/transform/1/angle_deg", "90", "/objects/0/transform/1/angle_deg"),
        ("/objects/0/groups/first", [0, 1, 2], "/objects/0/groups/first"),
        ("/materials/red/kd", [0.1, -0.2, 0.3], "/materials/red/kd/1"),
        ("/materials/red/kd", -1, "/materials/red/kd"),
        ("/materials/a~1b~0c/eta", 0, "/materials/a~1b~0c/eta"),
        ("/materials/a~1b~0c/attenuation/b", -1, "/materials/a~1b~0c/attenuation/b"),
        ("/materials/a~1b~0c/attenuation/b", 1e-310, "/materials/a~1b~0c/attenuation/b"),
        ("/background", [1, 2], "/background"),
        ("/lights", {}, "/lights"),
        ("/lights/2", [], "/lights/2"),
        ("/sampling/seed", 2**32, "/sampling/seed"),
        ("/sampling/samples", 0, "/sampling/samples"),
        ("/assets/wood/sha256", "A" * 64, "/assets/wood/sha256"),
        ("/assets/wood/sha256", HASH + "\n", "/assets/wood/sha256"),
        ("/name", "", "/name"),
        ("/name", "bell\x07", "/name"),
        ("/name", "x" * 257, "/name"),
        # values that contradict each other
        ("/camera/look_at/target", [0, 1, 5], "/camera/look_at/target"),
        ("/camera/look_at/up", [0, 0, 0], "/camera/look_at/up"),
        ("/camera/look_at/up", [0, 0, -7], "/camera/look_at/up"),
        ("/camera/matrix", FULL["objects"][0]["transform"][3]["rows"], "/camera/matrix"),
        ("/image/crop/x", 620, "/image/crop/width"),
        ("/image/crop/height", 341, "/image/crop/height"),
        ("/lights/1/direction", [0, 0, 0], "/lights/1/direction"),
        ("/lights/1/direction", [1e-200, 0, 0], "/lights/1/direction"),
        ("/lights/3/inner_angle_deg", 21, "/lights/3/inner_angle_deg"),
        ("/materials/a~1b~0c/attenuation", {"a": 0}, "/materials/a~1b~0c/attenuation"),
        ("/materials/a~1b~0c/attenuation/a", 0, "/materials/a~1b~0c/attenuation/a"),
        ("/objects/0/transform/2/by", [1, 0, 1], "/objects/0/transform/2/by/1"),
        ("/objects/0/transform/2/by", 0.0, "/objects/0/transform/2/by"),
        ("/objects/0/transform/1/axis", [0, 0, 0], "/objects/0/transform/1/axis"),
        ("/objects/0/transform/3/rows/3", [0, 0, 1, 1], "/objects/0/transform/3/rows/3"),
        ("/objects/0/transform/3/rows/2", [2, 3, 0, 1], "/objects/0/transform/3/rows"),
        ("/objects/4/max", [1, 0, 1], "/objects/4/max/1"),
        ("/objects/5/normal", [0, 0, 0], "/objects/5/normal"),
        ("/objects/6/end", [0, 0, 0], "/objects/6/end"),
        # references
        ("/objects/2/material", "blue", "/objects/2/material"),
        ("/objects/0/materials/second", "blue", "/objects/0/materials/second"),
        ("/objects/0/materials/third", "red", "/objects/0/materials/third"),
        ("/objects/1/materials/Body", "blue", "/objects/1/materials/Body"),
        ("/objects/1/asset", "bike", "/objects/1/asset"),
        ("/materials/a~1b~0c/diffuse_texture/asset", "oak", "/materials/a~1b~0c/diffuse_texture/asset"),
        ("/objects/0/faces/1/2", 4, "/objects/0/faces/1/2"),
        ("/objects/0/normals", [[0, 0, 1]], "/objects/0/normals"),
        ("/objects/0/normals/2", [0, -0.0, 0], "/objects/0/normals/2"),
        ("/objects/0/uvs", [], "/objects/0/uvs"),
        ("/objects/0/uvs", None, "/objects/0/materials/second"),
        ("/objects/0/colors", [[1, 1, 1]] * 5, "/objects/0/colors"),
        ("/objects/0/groups/second", [1, 3], "/objects/0/groups/second"),
        ("/objects/0/groups/second", [2, 1], "/objects/0/groups/second"),
        ("/objects/0/groups/second", [0, 2], "/objects/0/groups/second"),
        ("/sampling/samples", 65537, "/sampling/samples"),
        ("/sampling/adaptive", True, "/sampling/adaptive"),
        ("/sampling/adaptive/min_samples", 0, "/sampling/adaptive/min_samples"),
        ("/sampling/adaptive/min_samples", 3, "/sampling/adaptive/min_samples"),
        ("/sampling/adaptive/min_samples", 4, "/sampling/adaptive/min_samples"),
        ("/sampling/adaptive/min_samples", 2.0, "/sampling/adaptive/min_samples"),
        ("/sampling/adaptive/threshold", -0.01, "/sampling/adaptive/threshold"),
        ("/sampling/adaptive/treshold", 0.01, "/sampling/adaptive/treshold"),
    ],
)
def test_one_wrong_value_gives_one_fault(pointer: str, value: Any, told: str) -> None:
    faults = faults_of(changed(pointer, value))
    assert list(faults) == [told], faults
    message, expected = faults[told]
    assert message
    assert expected


@pytest.mark.parametrize(
    ("camera", "told"),
    [
        ({"left": 1, "right": 1}, ["/camera/right"]),
        ({"left": 2, "right": 1, "bottom": 0, "top": 0}, ["/camera/right", "/camera/top"]),
        ({"distance": 0}, ["/camera/distance"]),
        ({"matrix": [[1, 0, 0, 0]] * 4}, ["/camera/matrix/3"]),
        ({"matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [1, 1, 0, 0], [0, 0, 0, 1]]}, ["/camera/matrix"]),
        ({"matrix": []}, ["/camera/matrix"]),
    ],
)
def test_view_plane_cameras(camera: dict[str, Any], told: list[str]) -> None:
    base = {"type": "view_plane", "left": -1, "right": 1, "bottom": -1, "top": 1, "distance": 0.1}
    assert list(faults_of({**MINIMAL, "camera": {**base, **camera}})) == told


def test_a_wrong_kd_is_no_fault_of_the_ka_that_was_left_out() -> None:
    document = full()
    document["materials"]["red"] = {"kd": [1, 2]}
    assert list(faults_of(document)) == ["/materials/red/kd"]


def test_missing_and_unknown_members() -> None:
    document = full()
    del document["camera"]["fov_deg"]
    del document["objects"][3]["radius"]
    del document["objects"][2]["type"]
    document["materials"]["red"]["shininess"] = 3
    document["objects"][0]["colour"] = 1
    document["objects"][4]["type"] = "boxx"
    faults = faults_of(document)
    assert faults["/camera/fov_deg"][0] == "is missing"
    assert "number" in faults["/camera/fov_deg"][1]
    assert faults["/objects/3/radius"] == ("is missing", "a number >= 1e-30 and <= 1e+30 (radius, above zero)")
    assert faults["/objects/2/type"][0] == "is missing"
    assert '"kd"' in faults["/materials/red/shininess"][1]
    assert 'did you mean "colors"?' in faults["/objects/0/colour"][0]
    assert faults["/objects/4/type"][0] == 'is the text "boxx" (did you mean "box"?)'
    assert len(faults) == 6


def test_an_empty_mesh_is_a_fault() -> None:
    mesh = {"type": "mesh", "positions": [], "faces": []}
    assert list(faults_of({**MINIMAL, "objects": [mesh]})) == ["/objects/0/positions", "/objects/0/faces"]


def test_all_kinds_of_faults_are_told_together() -> None:
    document = changed("/camera/fov_deg", "wide")  # a type
    document["objects"][0]["positions"][0][0] = math.nan  # a number
    document["objects"][0]["faces"][0][0] = 9  # a reference inside the same mesh
    document["objects"][2]["material"] = "blue"  # a reference across the document
    document["lights"][1]["direction"] = [0, 0, 0]  # a value
    document["assets"]["wood"]["file"] = "../wood.png"  # an asset's name
    assert set(faults_of(document, require_hashes=True)) == {
        "/camera/fov_deg",
        "/objects/0/positions/0/0",
        "/objects/0/faces/0/0",
        "/objects/2/material",
        "/lights/1/direction",
        "/assets/wood/file",
    }


def test_two_faults_at_one_pointer_are_both_told() -> None:
    with pytest.raises(SceneError) as caught:
        parse_scene(changed("/objects/0/materials/third", "blue"))
    assert [fault.pointer for fault in caught.value.faults] == ["/objects/0/materials/third"] * 2


@pytest.mark.parametrize(
    "document",
    [
        {"objects": [{"type": "sphere"}] * 10_000},
        {"objects": [[]] * 300_000},
        {"objects": [1] * 3_000_000},
        {"background": [[1]] * 1_000_000},
        {"objects": [{"type": "mesh", "positions": [["x", None, True]] * 60_000, "faces": [[0, 0, 0]]}]},
        {f"k{i}": 0 for i in range(200_000)},
        {"objects": [{"type": "sphere", **{f"k{i}": 0 for i in range(20)}}] * 10_000},
        {"objects": [{"type": "disk", "material": f"a{i}"} for i in range(9999)]}
        | {"materials": {f"b{i}": {} for i in range(9999)}},
        {"materials": {f"a{i}": 3 for i in range(200_000)}},
        {"assets": {"a": {"file": "b", "companions": {f"a/{i}": None for i in range(1000)}}}},
        {"assets": {"a": {"file": "b", "companions": {"/" * 1_000_000: None}}}},
        {"materials": {"x" * 30_000_000: {f"k{i}": 0 for i in range(200)}}},
    ],
    ids=[
        "missing",
        "lists",
        "numbers",
        "rows",
        "texts",
        "members",
        "extra",
        "names",
        "materials",
        "companions",
        "slashes",
        "key",
    ],
)
def test_floods_are_refused_in_short_time(document: dict[str, Any]) -> None:
    start = time.process_time()
    with pytest.raises(SceneError) as caught:
        parse_scene({**MINIMAL, **document}, require_hashes=True)
    seconds = time.process_time() - start
    assert len(caught.value.faults) <= MAX_FAULTS
    assert len(str(caught.value)) < 1_000_000
    assert seconds < 10.0, f"{seconds:.2f} s; 2 s are usual on a busy machine"


def test_a_mesh_of_100_000_triangles_is_checked_in_about_a_second() -> None:
    side = 224
    positions = [[x / side, y / side, (x * y % 7) / 7] for y in range(side) for x in range(side)]
    corners = [x + side * y for y in range(side - 1) for x in range(side - 1)]
    faces = [[i, i + 1, i + side] for i in corners] + [[i + 1, i + side + 1, i + side] for i in corners]
    mesh = {"type": "mesh", "positions": positions, "normals": [[0, 0, 1]] * side**2, "faces": faces}
    text = json.dumps({**MINIMAL, "objects": [mesh]}).encode()
    start = time.process_time()
    doc = parse_scene(text)
    seconds = time.process_time() - start
    assert len(doc.objects[0].faces) > 99_000  # type: ignore[union-attr]
    assert seconds < 3.0, f"{seconds:.2f} s; 0.5 s is usual, three seconds are too slow even for a busy machine"
    faces[50_000][1] = side**2
    assert list(faults_of({**MINIMAL, "objects": [mesh]})) == ["/objects/0/faces/50000/1"]


def test_the_process_that_validates_never_loads_numpy() -> None:
    code = (
        "import sys, tracer.scene as s\n"
        "s.scene_hash(s.parse_scene(sys.stdin.read())); s.json_schema()\n"
        "print([m for m in ('numpy', 'numba', 'llvmlite', 'trimesh', 'OpenImageIO') if m in sys.modules])"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], input=json.dumps(FULL), capture_output=True, text=True, check=True, timeout=60
    )
    assert run.stdout.strip() == "[]"


def test_documents_and_errors_survive_pickling() -> None:
    doc = parse_scene(FULL)
    assert pickle.loads(pickle.dumps(doc)) == doc
    with pytest.raises(SceneError) as caught:
        parse_scene({})
    again = pickle.loads(pickle.dumps(caught.value))
    assert again.faults == caught.value.faults
    assert str(again) == str(caught.value)


def test_models_are_immutable() -> None:
    doc = parse_scene(FULL)
    with pytest.raises(ValueError, match="frozen"):
        doc.image.width = 3  # type: ignore[misc]
