"""The shipped scenes: what their scripts write, valid, and composed as promised."""

import json
from pathlib import Path
from typing import Any

import pytest

from scenes import make_demo, make_mini_cornell
from tracer.scene import Mesh, MeshAsset, PerspectiveCamera, View, parse_scene, transform_rows

NEEDS_DATA = pytest.mark.skipif(
    not (make_mini_cornell.DATA / make_mini_cornell.GEOMETRY).is_file(),
    reason="no seed data: set SMALTI_DATA (files of github.com/WhoFama24/cse6413-raytracer, commit 167f0b0)",
)


def test_the_demo_is_what_its_script_writes_and_needs_no_file() -> None:
    doc = parse_scene(make_demo.OUTPUT.read_bytes(), require_hashes=True)
    assert doc == parse_scene(json.loads(json.dumps(make_demo.document())))
    assert not doc.assets
    kinds = {thing.type for thing in doc.objects} | {light.type for light in doc.lights}
    assert kinds == {"mesh", "plane", "sphere", "box", "disk", "cylinder", "ambient", "directional", "point", "spot"}


@NEEDS_DATA
def test_the_mini_is_what_its_script_writes() -> None:
    doc = parse_scene(make_mini_cornell.OUTPUT.read_bytes())
    assert doc == parse_scene(make_mini_cornell.document())
    assert (doc.image.width, doc.image.height, doc.sampling.samples) == (3840, 2160, 16)
    assert doc.integrator.max_depth == 3
    assert doc.integrator.shadows


def test_the_mini_has_a_material_for_each_of_its_32_groups() -> None:
    doc = parse_scene(make_mini_cornell.OUTPUT.read_bytes())
    car = doc.objects[-1]
    assert isinstance(car, MeshAsset)
    assert car.materials is not None
    assert len(car.materials) == 32
    used = [doc.materials[name] for name in car.materials.values()]
    assert sum(material.diffuse_texture is not None for material in used) == 12
    assert all(doc.materials[name].kr > (0.3,) * 3 for name in ("Body Chrome", "Mirrors", "Front Driver Rim"))
    assert doc.materials["Windows"].kt > (0.5,) * 3
    assert all(asset.sha256 for asset in doc.assets.values())


def test_the_walls_of_the_box_face_inwards() -> None:
    doc = parse_scene(make_mini_cornell.OUTPUT.read_bytes())
    inside = (0.0, make_mini_cornell.HEIGHT / 2, -make_mini_cornell.DEPTH / 2)
    walls = [thing for thing in doc.objects if isinstance(thing, Mesh)]
    assert [wall.name for wall in walls] == ["Floor", "Ceiling", "Back", "Left", "Right"]
    for wall in walls:
        assert wall.normals is not None
        for face in wall.faces:
            a, b, c = (wall.positions[index] for index in face)
            ab, ac = ([y - x for x, y in zip(a, corner, strict=True)] for corner in (b, c))
            normal = (ab[1] * ac[2] - ab[2] * ac[1], ab[2] * ac[0] - ab[0] * ac[2], ab[0] * ac[1] - ab[1] * ac[0])
            assert sum(n * (i - p) for n, i, p in zip(normal, inside, a, strict=True)) > 0, wall.name
            assert sum(n * m for n, m in zip(normal, wall.normals[face[0]], strict=True)) > 0, wall.name


def _projected(point: tuple[float, ...], view: View) -> tuple[float, float]:
    """Place in the picture, 0 to 1 from the left and from the top [farmer2019 eq. 1]."""
    d = [p - e for p, e in zip(point, view.eye, strict=True)]
    x, y, z = (sum(a * b for a, b in zip(d, axis, strict=True)) for axis in (view.u, view.v, view.w))
    x, y = (coordinate * view.distance / -z for coordinate in (x, y))
    return (x - view.left) / (view.right - view.left), (view.top - y) / (view.top - view.bottom)


@NEEDS_DATA
def test_the_mini_stands_in_the_box_and_spans_three_fifths_of_the_picture() -> None:
    doc = parse_scene(make_mini_cornell.OUTPUT.read_bytes())
    data: dict[str, Any] = json.loads((make_mini_cornell.DATA / make_mini_cornell.GEOMETRY).read_text())
    numbers = data["vertexdata"]
    rows = transform_rows(doc.objects[-1].transform)
    points = [
        tuple(sum(a * b for a, b in zip(row, (*numbers[i : i + 3], 1.0), strict=True)) for row in rows[:3])
        for i in range(0, len(numbers), 8)
    ]
    half, height, depth = make_mini_cornell.WIDTH / 2, make_mini_cornell.HEIGHT, make_mini_cornell.DEPTH
    assert min(y for _, y, _ in points) == pytest.approx(0.0, abs=1e-5)
    assert all(-half < x < half and y < height and -depth < z < 0 for x, y, z in points)
    assert isinstance(doc.camera, PerspectiveCamera)
    view = doc.camera.view(doc.image.width, doc.image.height)
    seen = [_projected(point, view) for point in points]
    lefts, tops = [x for x, _ in seen], [y for _, y in seen]
    assert max(lefts) - min(lefts) > 0.60
    assert min(lefts) > 0.0
    assert max(lefts) < 1.0
    assert min(tops) > 0.0
    assert max(tops) < 1.0


def test_the_scripts_say_what_is_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(make_mini_cornell, "DATA", tmp_path)
    with pytest.raises(SystemExit, match="SMALTI_DATA"):
        make_mini_cornell.main()
