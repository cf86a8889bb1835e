"""What a scene would take, counted by hand."""

from typing import Any

import pytest

from service.estimate import assets_of, estimate, features_of
from tracer.scene import canonical_json, parse_scene, scene_hash

SHA = {letter: letter * 64 for letter in "abcd"}
TRIANGLE = {"type": "mesh", "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}


def scene(**changes: Any) -> Any:
    document = {
        "version": 1,
        "camera": {"type": "perspective", "fov_deg": 40},
        "image": {"width": 100, "height": 40},
        "sampling": {"samples": 4},
        **changes,
    }
    return parse_scene(document, require_hashes=True)


def test_tiles_and_bytes_are_those_of_the_crop() -> None:
    found = scene(image={"width": 1000, "height": 400, "crop": {"x": 30, "y": 0, "width": 40, "height": 20}})
    taken = estimate(found, canonical_json(found), 32)
    assert taken.tiles == 3  # columns 0 to 31, 32 to 63 and 64 to 95 of the absolute grid, one row
    assert taken.samples_total == 40 * 20 * 4
    assert taken.result_bytes == 40 * 20 * 15
    assert taken.scene_sha256 == scene_hash(found)
    assert (taken.image.width, taken.image.height) == (1000, 400)


@pytest.mark.parametrize(
    ("materials", "depth", "shadows", "rays"),
    [
        ({}, 3, True, 1 + 2),  # one point, and a ray from it to each light that is somewhere
        ({}, 3, False, 1),
        ({"m": {"kr": 0.5}}, 0, True, 3),
        ({"m": {"kr": 0.5}}, 2, True, 3 * 3),
        ({"m": {"kr": 0.5}, "n": {"kt": 0.5}}, 2, True, (1 + 2 + 4) * 3),
    ],
)
def test_rays_are_bounded(materials: dict[str, Any], depth: int, shadows: bool, rays: int) -> None:
    found = scene(
        materials=materials,
        integrator={"max_depth": depth, "shadows": shadows},
        lights=[
            {"type": "ambient", "intensity": 1},
            {"type": "point", "position": [0, 1, 0]},
            {"type": "directional", "direction": [0, -1, 0]},
        ],
    )
    assert estimate(found, b"", 64).rays_at_most == 100 * 40 * 4 * rays


@pytest.mark.parametrize(
    ("materials", "depth", "rays"),
    [
        ({}, 3, 1 + 2),
        ({"m": {"kr": 0.5}}, 0, 3),
        ({"m": {"kr": 0.5}}, 2, (1 + 1 / 2 + 1 / 4) * 3),  # each bounce at half of the points
        ({"m": {"kr": 0.5}, "n": {"kt": 0.5}}, 2, (1 + 1 + 1) * 3),
    ],
)
def test_time_goes_by_samples_lights_and_bounces(materials: dict[str, Any], depth: int, rays: float) -> None:
    lights = [{"type": "point", "position": [0, 1, 0]}, {"type": "directional", "direction": [0, -1, 0]}]
    found = scene(
        image={"width": 1000, "height": 500},
        sampling={"samples": 64},
        materials=materials,
        integrator={"max_depth": depth},
        lights=[*lights, {"type": "ambient", "intensity": 1}],
    )
    seconds = 1000 * 500 * 64 * rays / 30e6 + 2 * 0.003  # of a core, and two tiles
    assert estimate(found, b"", 512).cpu_seconds == pytest.approx(seconds, rel=0.05)


def test_memory_grows_with_inline_meshes() -> None:
    one, ten = (estimate(scene(objects=[TRIANGLE] * n), b"", 64).memory_bytes for n in (1, 10))
    # Each: 3 vertices with normal, UV and colour, and indices, nodes and attributes of a triangle.
    assert 9 * (3 * 80 + 200) < ten - one < 9 * 1000


def grid(rows: int, **changes: Any) -> dict[str, Any]:
    """A flat mesh of 2 x rows x 64 triangles."""
    points = [[x, 0.5 * y, 0.0] for y in range(rows + 1) for x in range(65)]
    corners = [y * 65 + x for y in range(rows) for x in range(64)]
    faces = [face for k in corners for face in ([k, k + 1, k + 66], [k, k + 66, k + 65])]
    return {"type": "mesh", "positions": points, "faces": faces, **changes}


def moved(x: float, by: float = 1.0) -> dict[str, Any]:
    return {"transform": [{"type": "scale", "by": [by, 1, 1]}, {"type": "translate", "by": [x, 0, 0]}]}


def test_equal_meshes_count_once_where_the_renderer_places_them() -> None:
    """33 uses of 8,192 triangles save 2^18; 32 do not; nor do meshes that are not equal, or squeezed too far."""
    one = estimate(scene(objects=[grid(64)]), b"", 64).memory_bytes
    none = estimate(scene(), b"", 64).memory_bytes

    def taken(*objects: dict[str, Any]) -> float:
        return (estimate(scene(objects=list(objects)), b"", 64).memory_bytes - none) / (one - none)

    assert taken(*[grid(64, **moved(k)) for k in range(32)]) == 32
    shared = taken(*[grid(64, **moved(k)) for k in range(33)])
    assert 1 < shared < 2  # a material for each triangle of each use, 4 bytes of 400
    assert taken(*[grid(64, **moved(k)) for k in range(33)], grid(64)) < 2
    assert taken(*[grid(64, **moved(k, 1e-9)) for k in range(33)]) == 33
    other = grid(64)
    other["positions"][0] = [0.0, 0.25, 0.0]
    assert taken(*[grid(64, **moved(k)) for k in range(33)], other) == pytest.approx(shared + 1)


def test_what_is_shared_is_what_the_renderer_shares() -> None:
    """The numbers that the service cannot import, for it never loads numpy; and arrays as they come out."""
    from service import estimate as counted
    from tracer.render import parts
    from tracer.render.compile import compile_scene

    for name in ("_SHARED_TRIANGLES", "_SAVED_TRIANGLES", "_MOST_SKEW"):
        assert getattr(counted, name) == getattr(parts, name)
    found = scene(objects=[grid(64, **moved(70.0 * k, 1 + k)) for k in range(33)])
    compiled, stats = compile_scene(found, lambda ref: pytest.fail("no assets"))
    assert stats.n_placements == 33
    taken = estimate(found, b"", 64).memory_bytes - estimate(scene(), b"", 64).memory_bytes
    assert sum(array.nbytes for array in compiled) <= taken


def test_only_used_assets_count_with_their_companions() -> None:
    found = scene(
        objects=[{"type": "mesh_asset", "asset": "car"}],
        materials={"m": {"diffuse_texture": {"asset": "wood"}}},
        assets={
            "car": {"file": "car.obj", "sha256": SHA["a"], "companions": {"car.mtl": SHA["b"]}},
            "wood": {"file": "wood.png", "sha256": SHA["c"]},
            "idle": {"file": "idle.png", "sha256": SHA["d"]},
        },
    )
    assert assets_of(found) == {"car": (SHA["a"], SHA["b"]), "wood": (SHA["c"],)}
    assert estimate(found, b"", 64).assets_never_loaded == ["idle"]


def test_each_feature_is_either_used_or_skipped() -> None:
    used, skipped = features_of(scene(objects=[TRIANGLE], lights=[{"type": "ambient", "intensity": 1}]))
    assert used == ["camera:perspective", "light:ambient", "object:mesh"]
    assert "shadows" in skipped, "an ambient light casts none"
    assert set(used).isdisjoint(skipped)
    mirror = {"materials": {"m": {"kr": 0.5, "kt": 0.5}}}
    assert {"reflection", "transmission"} <= set(features_of(scene(**mirror))[0])
    assert {"reflection", "transmission"} <= set(features_of(scene(**mirror, integrator={"max_depth": 0}))[1])


@pytest.mark.parametrize(
    ("image", "deciding"),
    [
        ({"width": 40, "height": 20}, 40 * 20),
        ({"width": 40, "height": 20, "crop": {"x": 15, "y": 3, "width": 2, "height": 2}}, 32 * 16),
        ({"width": 40, "height": 20, "crop": {"x": 39, "y": 19, "width": 1, "height": 1}}, 8 * 4),
    ],
)
def test_adaptive_sampling_adds_what_decides_to_the_bound(image: dict[str, Any], deciding: int) -> None:
    """All blocks may turn out to need all samples, after the first ones of whole blocks were taken for nothing."""
    fixed, adaptive = (
        estimate(scene(image=image, objects=[TRIANGLE], lights=[], sampling={"samples": 16, **more}), b"", 64)
        for more in ({}, {"adaptive": {"min_samples": 6}})
    )
    assert adaptive.samples_total == fixed.samples_total
    assert adaptive.rays_at_most == fixed.rays_at_most + 6 * deciding
    assert ("adaptive_sampling" in adaptive.features, "adaptive_sampling" in fixed.skipped) == (True, True)
