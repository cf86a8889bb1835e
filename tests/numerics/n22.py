"""N22: the same bytes, whoever renders which part when, on random scenes. What needs the service is in tests/acceptance.

A case is a picture made in one of these ways, held against the picture rendered at once:

- tiles: of 16 to 256 px, in random order, by 1 to 8 threads, as film tiles; some are rendered twice, some after a try that
  was cancelled on the way;
- blocks: any of them in any order in calls of any number;
- crop: a rectangle of the picture, and nothing else;
- ranges: samples in parts, in blocks of any order. Each part is rounded, so what they add up to may differ from the
  whole in the last places: the row's worst, in ulp;
- again: the document compiled anew, or mapped from the cache.
"""

import hashlib
import itertools
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
from PIL import Image
from row import Row

from tests.random_scenes import random_document
from tracer.film.develop import develop_blocks
from tracer.film.tile import Rect, TileHeader, blocks_of_rect, decode_tile, encode_tile
from tracer.film.writer import film_sha256
from tracer.render import Canceled, compile_cached, compile_scene, get_backend, list_blocks, render_compiled
from tracer.render.sources import SceneFiles
from tracer.scene import parse_scene
from tracer.types import COUNTERS
from worker.grid import TileGrid

BY_CALL = COUNTERS.index("pixels_skipped_background")  # each range skips them
# Of samples that are traced a sum is rounded once. Those of plain squares (tracer.integrators.plain) are one colour times
# a sum of numbers for each lamp: rounded in lanes, across them, as a product, and in the end; in the whole and in the parts.
BOUND_ULP = 8.0
ROOM = np.array([[x, y, z] for x in (-6.0, 6.0) for y in (-6.0, 6.0) for z in (-6.0, 6.0)])
WALLS = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]]


def scene_of(rng):
    """A random document: any of the samplers, fixed or adaptive, textures, glass, mirrors, a room, things far away."""
    document = random_document(
        int(rng.integers(2**31)),
        clear=bool(rng.random() < 0.5),
        textured=bool(rng.random() < 0.2),
        shapes=bool(rng.random() < 0.6),
    )
    width, height = rng.integers(1, 120, 2)
    if rng.random() < 0.2:
        width, height = 5 * width, height // 2 + 1
    samples = int(rng.choice([1, 2, 3, 5, 9, 16]))
    document["image"] = {"width": int(width), "height": int(height)}
    document["sampling"]["samples"] = samples
    if samples > 2 and rng.random() < 0.4:
        least = int(rng.choice(np.arange(2, samples, 2)))
        document["sampling"]["adaptive"] = {"threshold": float(10.0 ** rng.uniform(-4, 0)), "min_samples": least}
    if rng.random() < 0.5:  # flat faces that fill blocks, so that squares of pixels are told at once
        room = {"type": "mesh", "positions": ROOM.tolist(), "faces": WALLS, "material": "second"}
        document["objects"].append(room)
    if rng.random() < 0.2:  # a tree of its own, below a tree of trees
        far = {**document["objects"][0], "transform": [{"type": "translate", "by": [1e9, 0.0, -1e9]}]}
        document["objects"].append(far)
    return document


class Case:
    """A document, what it compiles to, and its picture rendered at once."""

    def __init__(self, rng, folder, assets):
        self.rng = rng
        self.folder = folder
        self.document = scene_of(rng) | {"assets": assets}
        self.compiled = self.compile(self.document)
        self.blocks = list_blocks(self.compiled)
        self.samples = self.document["sampling"]["samples"]
        self.film = render_compiled(self.compiled, threads=int(rng.choice([1, 1, 1, 2, 4, 8])))
        self.sha256 = film_sha256(self.film.pixels)
        self.whole = self.render(self.blocks)

    def compile(self, document):
        files = SceneFiles(cache=self.folder)  # the texture is loaded once: each time costs a process
        return compile_scene(parse_scene(document), self.find, files)[0]

    def find(self, ref):
        return self.folder / ref.file

    def render(self, blocks, span=None):
        return get_backend().render(self.compiled, blocks, span or (0, self.samples), np.zeros(1, np.int64))


def cancelled(case, blocks):
    """Render blocks while someone cancels; whatever comes of it is thrown away."""
    flag = np.zeros(1, np.int64)
    timer = threading.Timer(float(case.rng.uniform(0, 2e-3)), flag.__setitem__, (0, 1))
    timer.start()
    with suppress(Canceled):
        get_backend().render(case.compiled, blocks, (0, case.samples), flag)
    timer.join()


def by_tiles(case):
    rng, film = case.rng, case.film
    grid = TileGrid(*film.window, int(16 * rng.integers(1, 17)))
    twice = rng.integers(0, grid.n_tiles, rng.integers(0, 4))
    tiles = rng.permutation(np.append(np.arange(grid.n_tiles), twice)).tolist()
    for tile in tiles[: rng.integers(0, 3)]:
        cancelled(case, blocks_of_rect(Rect(*grid.tile_rect(tile))))

    def work(tile):
        rect = Rect(*grid.tile_rect(tile))
        part = case.render(blocks_of_rect(rect))
        counters = dict(zip(COUNTERS, part.counters.tolist(), strict=True))
        header = TileHeader(rect, (0, case.samples), counters, worker=threading.current_thread().name)
        return tile, encode_tile(header, develop_blocks(rect, part.sums, case.samples))

    with ThreadPoolExecutor(int(rng.choice([1, 2, 4, 8]))) as pool:
        written = list(pool.map(work, tiles))
    pixels, store = np.full_like(film.pixels, np.nan), {}
    for tile, data in written:
        header, values = decode_tile(data)
        before = store.setdefault(tile, (header.counters, values))
        if before[0] != header.counters or not np.array_equal(before[1], values):
            return True
        x, y = header.rect.x - grid.x, header.rect.y - grid.y
        pixels[y : y + header.rect.height, x : x + header.rect.width] = values
    counters = {name: sum(counters[name] for counters, _ in store.values()) for name in COUNTERS}
    return film_sha256(pixels) != case.sha256 or counters != film.counters


def by_blocks(case):
    rng, n = case.rng, len(case.blocks)
    order = rng.permutation(n)
    cuts = np.unique(rng.integers(0, n + 1, rng.integers(0, 6)))
    parts = [case.render(case.blocks[part]) for part in np.split(order, cuts)]
    sums = np.concatenate([part.sums for part in parts])
    counters = np.sum([part.counters for part in parts], axis=0)
    return not np.array_equal(sums, case.whole.sums[order]) or not np.array_equal(counters, case.whole.counters)


def by_crop(case):
    rng, document = case.rng, case.document
    (left, right), (top, bottom) = (
        np.sort(rng.choice(document["image"][side] + 1, 2, replace=False)).tolist() for side in ("width", "height")
    )
    crop = {"x": left, "y": top, "width": right - left, "height": bottom - top}
    film = render_compiled(case.compile({**document, "image": {**document["image"], "crop": crop}}))
    return film_sha256(film.pixels) != film_sha256(case.film.pixels[top:bottom, left:right])


def again(case):
    if case.rng.random() < 0.5:
        compiled = case.compile(case.document)
    else:
        for _ in range(2):  # written, then mapped
            compiled = compile_cached(parse_scene(case.document), case.find, case.folder / "cache", get_backend())[0]
    film = render_compiled(compiled)
    return film_sha256(film.pixels) != case.sha256 or film.counters != case.film.counters


def by_ranges(case):
    """(wrong, largest difference of sums, ulp)"""
    rng, n = case.rng, len(case.blocks)
    if "adaptive" in case.document["sampling"] or case.samples < 2:
        return False, 0.0
    cuts = np.unique([0, *rng.integers(1, case.samples, rng.integers(1, 4)), case.samples]).tolist()
    order = rng.permutation(n)
    parts = [case.render(case.blocks[order], span) for span in itertools.pairwise(cuts)]
    first = case.render(case.blocks, (cuts[0], cuts[1]))
    wrong = not np.array_equal(first.sums[order], parts[0].sums)
    counters = np.sum([part.counters for part in parts], axis=0)
    whole_counters = case.whole.counters.copy()
    whole_counters[BY_CALL] = counters[BY_CALL]
    wrong |= not np.array_equal(counters, whole_counters)
    whole = case.whole.sums[order]
    exact = np.sum([part.sums.astype(np.longdouble) for part in parts], axis=0)
    return wrong, float((np.abs(whole - exact) / np.spacing(np.maximum(whole, 1e-300))).max())


WAYS = {"tiles": by_tiles, "blocks": by_blocks, "crop": by_crop, "again": again}


def run(cases, seed=22):
    rng = np.random.default_rng(seed)
    total, worst, pixels, adaptive = 0, 0.0, 0, 0
    wrong = dict.fromkeys((*WAYS, "ranges"), 0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        texture = folder / "picture.png"
        Image.fromarray(rng.integers(0, 256, (5, 7, 3), dtype=np.uint8)).save(texture)
        assets = {"picture": {"file": texture.name, "sha256": hashlib.sha256(texture.read_bytes()).hexdigest()}}
        while total < cases:
            case = Case(rng, folder, assets)
            for way, differs in WAYS.items():
                wrong[way] += differs(case)
            differs, ulp = by_ranges(case)
            wrong["ranges"] += differs
            worst = max(worst, ulp)
            total += len(wrong)
            pixels += len(wrong) * case.film.pixels[..., 0].size
            adaptive += "adaptive" in case.document["sampling"]
    note = ", ".join(f"{way} {count}" for way, count in wrong.items())
    note += f"; {total // len(wrong):,} scenes, {adaptive:,} adaptive; {pixels:,} pixels; sums of ranges in ulp; resume waits for that feature"
    return Row("N22", "the same bytes in any parts", total, sum(wrong.values()), worst, BOUND_ULP, note)
