"""A whole picture in this process: threads, cancel, crop, cache, progress."""

import threading

import numpy as np
import pytest

from tests.tracer.render.hand_made import mixed, settings
from tracer.render import Canceled, render_compiled, render_scene
from tracer.render.frame import list_blocks, window_of
from tracer.scene import parse_scene


def test_crop_equals_the_full_picture():
    full = render_compiled(mixed()).pixels
    for crop in [(0, 0, 40, 24), (5, 3, 20, 17), (17, 16, 1, 1), (39, 23, 1, 1)]:
        x, y, w, h = crop
        part = render_compiled(mixed(settings=settings(crop=crop)))
        np.testing.assert_array_equal(part.pixels, full[y : y + h, x : x + w])
        assert part.counters["samples"] == 4 * w * h


def test_threads_change_nothing():
    scene = mixed(settings=settings(width=200, height=100))
    seen = []
    one, three = render_compiled(scene), render_compiled(scene, threads=3, progress=seen.append)
    np.testing.assert_array_equal(one.pixels, three.pixels)
    assert one.counters == three.counters
    assert [p.blocks_done for p in seen] == sorted(p.blocks_done for p in seen)
    assert (seen[-1].blocks_done, seen[-1].blocks_total) == (91, 91)
    assert seen[-1].rays == sum(v for name, v in one.counters.items() if name.endswith("_rays"))


def test_cancel_of_a_whole_picture():
    scene = mixed(settings=settings(width=1600, height=1600, samples=256))
    cancel = np.zeros(1, np.int64)
    threading.Timer(0.2, lambda: cancel.__setitem__(0, 1)).start()
    with pytest.raises(Canceled):
        render_compiled(scene, cancel=cancel, threads=2)


SCENE = {
    "version": 1,
    "camera": {"type": "perspective", "fov_deg": 40},
    "image": {"width": 40, "height": 24, "crop": {"x": 15, "y": 0, "width": 2, "height": 17}},
    "sampling": {"samples": 2},
    "lights": [{"type": "ambient", "intensity": 1}],
    "objects": [{"type": "sphere", "center": [0, 0, -3], "radius": 1}],
}


def no_files(ref):
    raise AssertionError(ref)


def test_blocks_are_those_that_the_crop_touches():
    scene = mixed(settings=settings(crop=(15, 0, 2, 17)))
    assert window_of(scene) == (15, 0, 2, 17)
    assert list_blocks(scene).tolist() == [[0, 0], [1, 0], [0, 1], [1, 1]]


def test_a_document_becomes_a_film_with_and_without_a_cache(tmp_path):
    scene = parse_scene(SCENE)
    plain = render_scene(scene, no_files)
    assert plain.pixels.shape == (17, 2, 3)
    assert plain.pixels.any()
    assert (plain.window, plain.n_samples) == ((15, 0, 2, 17), 2)
    assert plain.counters["samples"] == 2 * 2 * 17
    for from_cache in (False, True):
        kept = render_scene(scene, no_files, cache_dir=tmp_path)
        np.testing.assert_array_equal(kept.pixels, plain.pixels)
        assert kept.stats.from_cache is from_cache


def test_what_was_canceled_before_is_not_even_compiled():
    scene = parse_scene(
        {**SCENE, "objects": [{"type": "mesh_asset", "asset": "a"}], "assets": {"a": {"file": "a.obj"}}}
    )
    with pytest.raises(Canceled):
        render_scene(scene, no_files, cancel=np.ones(1, np.int64))
