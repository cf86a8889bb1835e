"""The backend seam: what blocks return does not depend on how they are asked for."""

import threading
import time

import numpy as np
import pytest

from tests.tracer.render.hand_made import build, mixed, settings
from tracer.render import Canceled, get_backend, list_blocks, render_compiled
from tracer.types import COUNTERS, SAMPLER_INDEPENDENT, SAMPLER_SOBOL, SAMPLER_STRATIFIED


def render(scene, blocks=None, samples=None, cancel=None):
    blocks = list_blocks(scene) if blocks is None else np.asarray(blocks, np.int32)
    samples = samples or (0, int(scene.settings[6]))
    return get_backend().render(scene, blocks, samples, np.zeros(1, np.int64) if cancel is None else cancel)


def counters_of(film):
    return dict(zip(COUNTERS, film.counters.tolist(), strict=True))


def test_identity():
    backend = get_backend()
    assert (backend.name, backend.arithmetic) == ("cpu", "f64-v2")
    with pytest.raises(KeyError):
        get_backend("abacus")


@pytest.mark.parametrize("sampler", [SAMPLER_INDEPENDENT, SAMPLER_STRATIFIED, SAMPLER_SOBOL])
def test_blocks_do_not_depend_on_order_or_company(sampler):
    scene = mixed(settings=settings(sampler=sampler))
    blocks = list_blocks(scene)
    together = render(scene)
    backwards = render(scene, blocks[::-1])
    np.testing.assert_array_equal(backwards.sums[::-1], together.sums)
    np.testing.assert_array_equal(backwards.counters, together.counters)
    alone = [render(scene, blocks[k : k + 1]) for k in range(len(blocks))]
    np.testing.assert_array_equal(np.concatenate([film.sums for film in alone]), together.sums)
    np.testing.assert_array_equal(np.sum([film.counters for film in alone], axis=0), together.counters)


def test_sample_ranges_add_up():
    """Passes of a picture are its parts: halves are even and odd indices of the whole, whatever a range begins with."""
    scene = mixed(settings=settings(samples=7))
    whole = render(scene)
    parts = [render(scene, samples=span) for span in [(0, 3), (3, 4), (4, 7)]]
    np.testing.assert_allclose(sum(part.sums for part in parts), whole.sums, rtol=1e-15)
    assert [part.n_samples.tolist() for part in parts] == [[2, 1], [0, 1], [2, 1]]
    assert whole.n_samples.tolist() == [4, 3]
    np.testing.assert_array_equal(parts[1].sums[:, 0], 0.0)


def test_halves_are_independent_estimates():
    film = render(mixed(settings=settings(samples=16)))
    means = film.sums / 8
    assert 0 < np.abs(means[:, 0] - means[:, 1]).max() < 1.0
    assert np.abs(means[:, 0] - means[:, 1]).mean() < 0.05


def test_outside_the_crop_is_zero():
    scene = mixed(settings=settings(crop=(3, 5, 8, 4)))
    film = render(scene, [[0, 0]])
    inside = np.zeros((16, 16), bool)
    inside[5:9, 3:11] = True
    assert (film.sums[0][:, ~inside] == 0).all()
    assert (film.sums[0][:, inside] > 0).any(axis=-1).all()


def test_position_does_not_depend_on_the_pictures_size():
    """The same part of the view plane at the same absolute pixels: a wider picture shows the same and more."""
    small = mixed()
    wide = mixed(settings=settings(width=80), camera=[0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, -1, 3, -0.6, 0.6, 1])
    a, b = render_compiled(small).pixels, render_compiled(wide).pixels
    np.testing.assert_allclose(b[:, :40], a, rtol=1e-5, atol=1e-6)


def test_skipping_changes_nothing():
    """A small sphere in the corner of a large background: same film, fewer rays."""
    sphere = mixed().shape_kind[:1]
    assert len(sphere) == 1
    films = {}
    for skip in (0, 1):
        lone = build(
            spheres=[((-2.0, 1.0, -4.0), 0.4, mixed().materials[3])],
            background=[0.1, 1 / 3, 0.7],
            settings=settings(skip=skip, samples=5),
        )
        films[skip] = render(lone)
    np.testing.assert_array_equal(films[0].sums, films[1].sums)
    full, less = counters_of(films[0]), counters_of(films[1])
    assert full["pixels_skipped_background"] == 0
    assert less["pixels_skipped_background"] > 700
    assert full["samples"] == less["samples"] == full["primary_rays"]
    assert less["primary_rays"] == 5 * (40 * 24 - less["pixels_skipped_background"])


def test_an_infinite_plane_forbids_skipping():
    scene = build(
        materials=[mixed().materials[0]],
        material_flags=[[-1, 0, 0, 1]],
        plane_point=[[0, -1, 0]],
        plane_normal=[[0, 1, 0]],
        plane_uv=np.zeros((1, 2, 3)),
        plane_material=[0],
        ambient=[1, 1, 1],
    )
    film = render_compiled(scene)
    assert film.counters["pixels_skipped_background"] == 0
    assert film.pixels[-1].min() > 0.4
    assert film.pixels[0].max() == 0.0


def test_empty_scene_is_background():
    film = render_compiled(build(background=[0.25, 0.5, 1.0]))
    np.testing.assert_array_equal(film.pixels, np.broadcast_to(np.float32([0.25, 0.5, 1.0]), (24, 40, 3)))
    assert film.counters["pixels_skipped_background"] == 24 * 40


def test_sums_are_compensated():
    """65,536 samples of 0.1: the sum of each half is the rounded exact one; plain addition is off by far more."""
    scene = build(background=[0.1, 1e-3, 1e10 / 3], settings=settings(width=1, height=1, samples=65536, skip=0))
    film = render(scene)
    for channel, value in enumerate([0.1, 1e-3, 1e10 / 3]):
        assert film.sums[0, 0, 0, 0, channel] == pytest.approx(32768 * value, rel=2.0**-52)
    assert abs(np.cumsum(np.full(32768, 0.1))[-1] / (32768 * 0.1) - 1) > 1e-13


def test_cancel_before():
    with pytest.raises(Canceled):
        render(mixed(), cancel=np.ones(1, np.int64))


@pytest.mark.parametrize(("width", "height", "samples"), [(1600, 1600, 64), (16, 1, 65536)])
def test_cancel_is_seen_soon(width, height, samples):
    """In a large picture, and within one row of pixels of many samples: the flag is polled within milliseconds."""
    scene = mixed(settings=settings(width=width, height=height, samples=samples))
    cancel = np.zeros(1, np.int64)
    ended = []

    def work():
        with pytest.raises(Canceled):
            render(scene, cancel=cancel)
        ended.append(time.perf_counter())

    thread = threading.Thread(target=work)
    render(mixed())  # compiled by now
    thread.start()
    time.sleep(0.1)
    assert thread.is_alive()
    asked = time.perf_counter()
    cancel[0] = 1
    thread.join(10)
    assert ended[0] - asked < 0.25  # 20 ms on an idle machine; the bound leaves room for a busy one


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"blocks": [[-1, 0]]}, "blocks"),
        ({"blocks": [0, 1]}, "blocks"),
        ({"samples": (0, 5)}, "sample range"),
        ({"samples": (2, 2)}, "sample range"),
        ({"cancel": np.zeros(1)}, "cancel"),
    ],
)
def test_wrong_arguments_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        render(mixed(), **change)


def test_wrong_arrays_are_refused():
    scene = mixed()
    for change in [
        {"materials": scene.materials.astype(np.float32)},
        {"vertex_positions": np.asfortranarray(scene.vertex_positions)},
        {"bvh_children": scene.bvh_children[:, :3].copy()},
    ]:
        with pytest.raises(ValueError, match=next(iter(change))):
            render(scene._replace(**change))
