"""A picture does not show whether meshes share a tree: the same document, shared and baked."""

import json
from pathlib import Path

import numpy as np
import pytest
from compile_scenes import document, sha256

from tests.tracer.accel.meshes import icosphere
from tests.tracer.rays.placements import random_turn, rows_of
from tracer.render import compile_cached, get_backend, parts, render_compiled
from tracer.render.compile import compile_scene

TILES = Path(__file__).parents[3] / "scenes" / "assets" / "tiles.png"


def ball_file(folder, subdivisions=2):
    """A model with normals, texture coordinates and two groups; returns its row of the assets table."""
    vertices, faces = icosphere(subdivisions, np.random.default_rng(3), 0.05)
    normals = vertices / np.linalg.norm(vertices, axis=1)[:, None]
    uvs = np.stack([np.arctan2(vertices[:, 1], vertices[:, 0]), vertices[:, 2]], 1)
    faces = faces[np.argsort(vertices[faces].mean(1)[:, 2], kind="stable")]
    n = len(faces) // 2
    text = json.dumps(
        {
            "vertexdata": np.concatenate([vertices, normals, uvs], 1).ravel().tolist(),
            "indexdata": faces.ravel().tolist(),
            "groups": {"Lower": [0, n], "Upper": [n, len(faces)]},
        }
    )
    (folder / "ball.json").write_text(text)
    return {"file": "ball.json", "sha256": sha256(text.encode())}


def crowd(folder, rng, n=9, size=96):
    """A crowd of balls: mirrored, squeezed, smooth and flat, mirroring, clear and textured, over a floor with shadows."""
    looks = [
        {"material": "red"},
        {"materials": {"Upper": "mirror", "Lower": "red"}},
        {"material": "glass"},
        {"materials": {"Lower": "tiles"}},
    ]
    objects = []
    for k in range(n):
        linear = random_turn(rng) @ np.diag(rng.uniform(0.4, 1.0, 3)) * (1 if k % 2 else -1)
        place = [2.2 * (k % 3 - 1), 1.1, 2.2 * (k // 3 - 1)]
        rows = [list(row) for row in rows_of(linear, place)]
        objects.append(
            {
                "type": "mesh_asset",
                "asset": "ball",
                "normals": "file" if k != 5 else "flat",
                "transform": [{"type": "matrix", "rows": rows}],
                **looks[k % 4],
            }
        )
    floor = {
        "type": "mesh",
        "positions": [[-6, 0, -6], [6, 0, -6], [6, 0, 6], [-6, 0, 6]],
        "faces": [[0, 2, 1], [0, 3, 2]],
    }
    (folder / "tiles.png").write_bytes(TILES.read_bytes())
    return document(
        *objects,
        floor,
        {"type": "sphere", "center": [0, 3.2, 0], "radius": 0.7, "material": "mirror"},
        camera={"type": "perspective", "fov_deg": 38, "look_at": {"eye": [5, 6, 9], "target": [0, 0.7, 0]}},
        image={"width": size, "height": size},
        sampling={"samples": 4, "seed": 1},
        integrator={"type": "blinn_phong", "max_depth": 5, "shadows": True},
        lights=[
            {"type": "point", "position": [4, 9, 5], "diffuse": [0.8, 0.8, 0.8], "specular": [0.5, 0.5, 0.5]},
            {"type": "directional", "direction": [1, -2, 0.3], "diffuse": [0.3, 0.3, 0.4]},
            {"type": "ambient", "intensity": [0.2, 0.2, 0.2]},
        ],
        materials={
            "red": {"ka": [0.8, 0.2, 0.2], "kd": [0.8, 0.2, 0.2], "ks": [0.5, 0.5, 0.5], "exponent": 40},
            "mirror": {"kd": [0.1, 0.1, 0.1], "kr": [0.8, 0.8, 0.8]},
            "glass": {"kd": [0.05, 0.05, 0.05], "kr": [0.1, 0.1, 0.1], "kt": [0.8, 0.9, 0.85], "eta": 1.5},
            "tiles": {"kd": [1, 1, 1], "ka": [1, 1, 1], "diffuse_texture": {"asset": "tiles"}},
        },
        assets={"ball": ball_file(folder), "tiles": {"file": "tiles.png", "sha256": sha256(TILES.read_bytes())}},
    )


@pytest.fixture
def both(tmp_path, monkeypatch):
    """Compile a document shared, and baked."""

    def run(scene):
        baked = compile_scene(scene, lambda ref: tmp_path / ref.file)
        with monkeypatch.context() as patch:
            patch.setattr(parts, "_SHARED_TRIANGLES", 100)
            patch.setattr(parts, "_SAVED_TRIANGLES", 100)
            shared = compile_scene(scene, lambda ref: tmp_path / ref.file)
        return shared, baked

    return run


def test_shared_and_baked_are_one_picture(tmp_path, both):
    """Every sample goes the same way, so float64 sums differ by rounding alone, and float32 pixels hardly ever."""
    scene = crowd(tmp_path, np.random.default_rng(4))
    (shared, stats), (baked, baked_stats) = both(scene)
    assert (stats.n_trees, stats.n_placements) == (2, 9)
    assert baked_stats.n_trees == 1
    assert stats.n_triangles == baked_stats.n_triangles == 9 * 320 + 2
    assert stats.n_bytes_saved > 0.6 * (baked_stats.n_bytes - stats.n_bytes)
    assert len(baked.solids) > len(shared.solids)  # none is looked for in what is placed: here the same ones
    one, other = render_compiled(shared._replace(solids=baked.solids)), render_compiled(baked)
    assert one.counters == other.counters
    assert one.counters["reflection_rays"] > 1000
    assert one.counters["transmission_rays"] > 1000
    assert np.abs(one.pixels - other.pixels).max() < 1e-6  # float32
    differs = np.abs(one.pixels - other.pixels).max(-1) > 2.0**-23 * np.abs(other.pixels).max(-1)
    assert differs.mean() < 0.01


def test_a_cloud_of_instances_over_nothing_skips_no_pixel_of_them(tmp_path, both):
    """Blocks that are filled with the background are those that no placement is in."""
    objects = [
        {
            "type": "mesh_asset",
            "asset": "ball",
            "transform": [{"type": "scale", "by": 0.3}, {"type": "translate", "by": [k - 2.0, (k % 3) - 1.0, 0]}],
        }
        for k in range(5)
    ]
    scene = document(
        *objects,
        camera={"type": "perspective", "fov_deg": 30, "look_at": {"eye": [0, 0, 20], "target": [0, 0, 0]}},
        image={"width": 64, "height": 64},
        background=[0.1, 0.2, 0.3],
        lights=[{"type": "ambient", "intensity": [1, 1, 1]}],
        assets={"ball": ball_file(tmp_path)},
    )
    (shared, stats), (baked, _) = both(scene)
    assert stats.n_placements == 5
    one, other = render_compiled(shared), render_compiled(baked)
    np.testing.assert_array_equal(one.pixels, other.pixels)
    assert one.counters["pixels_skipped_background"] > 0.9 * other.counters["pixels_skipped_background"] > 500


def test_placements_come_back_from_the_cache(tmp_path, both, monkeypatch):
    """Mapped from a file, the scene gives the same picture; another scene of the same model finds its tree."""
    scene = crowd(tmp_path, np.random.default_rng(5), size=32)
    (shared, _), _ = both(scene)
    monkeypatch.setattr(parts, "_SHARED_TRIANGLES", 100)
    monkeypatch.setattr(parts, "_SAVED_TRIANGLES", 100)
    monkeypatch.setattr("tracer.render.cache._MIN_CACHED_BVH_TRIANGLES", 100)
    resolve = lambda ref: tmp_path / ref.file  # noqa: E731
    compile_cached(scene, resolve, tmp_path / "cache", get_backend())
    mapped, stats = compile_cached(scene, resolve, tmp_path / "cache", get_backend())
    assert stats.from_cache
    assert stats.n_placements == 9
    np.testing.assert_array_equal(render_compiled(mapped).pixels, render_compiled(shared).pixels)
    trees = list((tmp_path / "cache" / "bvh").iterdir())
    monkeypatch.setattr("tracer.render.cache.build_tree", lambda *_: pytest.fail("a tree was built again"))
    moved = scene.model_copy(update={"objects": scene.objects[2:5]})
    _, stats = compile_cached(moved, resolve, tmp_path / "cache", get_backend())
    assert stats.n_placements == 3
    assert list((tmp_path / "cache" / "bvh").iterdir()) == trees
