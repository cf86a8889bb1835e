"""``make mini-check``: the MINI's picture against the oracle, pixel by pixel.

Job: render ``scenes/mini-cornell.json`` (3840 x 2160, 16 samples); compare crops over wheels, windows and grille, and a
pixel of each cell of a grid over the whole picture, with the oracle (``tests/naive.py``: equations and brute force):
at the same sample positions, where nothing but rounding may differ, and at independent ones, where nothing but sampling
noise may (``tests/agreement.py``). Write ``benchmarks/results/mini_check.md``, ``.json`` and ``.png``, and each crop
eight times enlarged into ``out/mini-check/``; fail where the two disagree.
Invariant: the oracle shares no code with the renderer, whose sampler tells where its samples were, and no more.
"""

import json
import sys
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.contact_sheet import Picture, draw_sheet, save_sheet
from benchmarks.data import DATA, REPOSITORY, MissingDataError, seed_file
from benchmarks.machine import describe_machine, machine_line
from client.assets import sha256_file
from tests import agreement

SCENE = REPOSITORY / "scenes" / "mini-cornell.json"
RESULTS = REPOSITORY / "benchmarks" / "results"
OUT = REPOSITORY / "out" / "mini-check"

WIDTH, HEIGHT = 48, 32  # of a crop, in pixels
CROPS = {  # left and top, in pixels of the whole picture
    "front wheel": (2296, 1630),
    "rear wheel": (962, 1318),
    "side window": (1646, 806),
    "wiper on the windscreen": (2124, 1138),
    "mirror behind the windscreen": (2075, 830),
    "grille, upper left": (2910, 1490),
    "grille, lower edge": (2980, 1515),
}
WHOLE = "the whole picture"
CELL_PX = 80  # one pixel of each cell of the whole picture
SAMPLES = 16  # of a pixel, as the scene has it
ORACLE_SAMPLES = 64
SEED = 20191
ENLARGED = 8
LISTED = 10  # pixels at most, the worst of each fault

BOUND = 2.0**-22
"""Of a pixel's difference at the same positions, times the greater of 1 and the value.

Texels are float32, as is the film (2^-24 each), and all else is float64. One of 16 samples that leaks or shadows itself
is off by much more: by a 16th of what it shows.
"""
SIGNIFICANCE = 0.01
LEAST_SHARE = 0.9975

Numbers = NDArray[np.float64]


class Place(NamedTuple):
    """Some pixels, by the renderer and by the oracle."""

    name: str
    pixels: NDArray[np.int64]  # (n, 2) columns and rows, from the left and the top
    ours: NDArray[np.float32]  # (n, 3)
    same: Numbers  # (n, 16, 3) the oracle's samples at our positions
    independent: Numbers  # (n, 64, 3) at positions uniform in the pixel
    oracle_s: float  # CPU seconds


class Verdict(NamedTuple):
    """How far a place agrees."""

    difference: Numbers  # (n,) largest of the channels, at the same positions
    beyond: NDArray[np.bool_]  # (n,) of these above the bound
    z: Numbers  # (n, 3)
    off: NDArray[np.bool_]  # (n,) of these above the limit
    bias: Numbers  # (3,)
    n_constant: int  # pixels whose means differ by no more than rounding: z is 0 in all channels


def pixels_of_crop(left: int, top: int) -> NDArray[np.int64]:
    """Return a crop's pixels by rows."""
    return np.array([(x, y) for y in range(top, top + HEIGHT) for x in range(left, left + WIDTH)])


def pixels_of_whole(width: int, height: int) -> NDArray[np.int64]:
    """Return a random pixel of each cell of the picture."""
    corners = np.array([(x, y) for y in range(0, height, CELL_PX) for x in range(0, width, CELL_PX)])
    return corners + np.random.default_rng(SEED).integers(0, CELL_PX, corners.shape)


def ask_oracle(document: dict[str, Any], film: NDArray[np.float32]) -> list[Place]:
    """Return all places, the oracle's samples with them."""
    from tests import naive
    from tests.kernel_pictures import positions_at
    from tests.naive_scenes import read_assets, read_document

    scene = read_document(document, *read_assets(document, DATA))

    def trace(positions: Numbers) -> Numbers:
        colors: Numbers = naive.trace(scene, positions[0], scene.height - positions[1])
        return colors.reshape(*positions.shape[1:], 3)

    generator = np.random.default_rng(SEED)
    places = []
    chosen = {name: pixels_of_crop(*corner) for name, corner in CROPS.items()}
    for name, pixels in {**chosen, WHOLE: pixels_of_whole(scene.width, scene.height)}.items():
        start = time.process_time()
        same = trace(positions_at(document["sampling"], pixels))
        offsets = generator.random((2, len(pixels), ORACLE_SAMPLES))
        independent = trace(pixels.T[:, :, None] + offsets)
        seconds = time.process_time() - start
        places.append(Place(name, pixels, film[pixels[:, 1], pixels[:, 0]], same, independent, seconds))
        print(f"{name}: {len(pixels)} pixels, oracle {seconds:.1f} CPU s", flush=True)
    return places


def judge(place: Place, limit: float) -> Verdict:
    """Compare the renderer with the oracle."""
    ours = place.ours.astype(np.float64)
    oracle = place.same.mean(axis=1)
    z, error = agreement.z_scores(ours, place.same, place.independent, BOUND)
    return Verdict(
        difference=np.abs(ours - oracle).max(axis=1),
        beyond=agreement.beyond(ours, oracle, BOUND),
        z=z,
        off=(np.abs(z) > limit).any(axis=1),
        bias=agreement.bias(ours, place.independent, error),
        n_constant=int((z == 0.0).all(axis=1).sum()),
    )


def worst_first(wrong: NDArray[np.bool_], by: Numbers) -> NDArray[np.int64]:
    """Return the numbers of wrong pixels."""
    order = np.argsort(-by, kind="stable")
    return order[wrong[order]]


def list_wrong(places: list[Place], verdicts: list[Verdict]) -> str:
    """Return a line for each pixel that is beyond or off: place, column, row, difference, largest z."""
    lines = []
    for place, verdict in zip(places, verdicts, strict=True):
        for k in np.flatnonzero(verdict.beyond | verdict.off):
            (x, y), z = place.pixels[k], np.abs(verdict.z[k]).max()
            lines.append(f'"{place.name}",{x},{y},{verdict.difference[k]:.3e},{z:.2f}\n')
    return "place,x,y,difference,z\n" + "".join(lines)


def faults_of(places: list[Place], verdicts: list[Verdict], bias_limit: float) -> list[str]:
    """Return a line for each thing that must not be."""
    faults = []
    for place, verdict in zip(places, verdicts, strict=True):
        oracle = place.same.mean(axis=1)
        wrong = worst_first(verdict.beyond, verdict.difference)
        if len(wrong):
            faults.append(f"{place.name}: {len(wrong)} pixels differ by more than rounding (leak or acne)")
        for k in wrong[:LISTED]:
            (x, y), ours, right = place.pixels[k], place.ours[k].tolist(), oracle[k].tolist()
            told = [" ".join(f"{value:.6f}" for value in color) for color in (ours, right)]
            faults.append(f"  pixel ({x}, {y}): {told[0]}, oracle {told[1]}")
        if (np.abs(verdict.bias) > bias_limit).any():
            means = ", ".join(f"{value:.2f}" for value in verdict.bias)
            faults.append(f"{place.name}: the mean is off, z {means}, limit {bias_limit:.2f}")
    off = np.concatenate([verdict.off for verdict in verdicts])
    if off.mean() > 1.0 - LEAST_SHARE:
        faults.append(f"{off.sum()} of {off.size} pixels are off by more than sampling noise")
        for place, verdict in zip(places, verdicts, strict=True):
            for k in worst_first(verdict.off, np.abs(verdict.z).max(axis=1))[:LISTED]:
                (x, y), z = place.pixels[k], ", ".join(f"{value:.1f}" for value in verdict.z[k])
                faults.append(f"  pixel ({x}, {y}), {place.name}: z {z}")
    return faults


def enlarge(rows: NDArray[np.uint8]) -> Picture:
    """Return a crop's pixels as a picture, each of them a square."""
    picture: Picture = rows.reshape(HEIGHT, WIDTH, 3).repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1)
    return picture


def panels(place: Place, verdict: Verdict, limit: float) -> list[Picture]:
    """Return what is to be looked at of a crop."""
    from tracer.film.develop import encode_8bit

    def shown(colors: NDArray[Any]) -> Picture:
        return enlarge(encode_8bit(np.ascontiguousarray(colors, dtype=np.float32), "srgb"))

    oracle = place.same.mean(axis=1)
    share = np.abs(place.ours - oracle) / (BOUND * np.maximum(1.0, np.abs(oracle)))
    worst = np.take_along_axis(verdict.z, np.abs(verdict.z).argmax(axis=1)[:, None], axis=1)[:, 0]
    side = np.clip(worst / limit, -1.0, 1.0)
    leaning = 1.0 - np.stack([np.maximum(-side, 0.0), np.abs(side), np.maximum(side, 0.0)], axis=1)
    return [
        shown(place.ours),
        shown(oracle),
        enlarge((255.0 * np.minimum(share, 1.0)).astype(np.uint8)),
        shown(place.independent.mean(axis=1)),
        enlarge((255.0 * leaning).astype(np.uint8)),
    ]


TITLES = [
    f"Smalti, {SAMPLES} samples",
    "oracle, same positions",
    "difference, white: bound",
    f"oracle, {ORACLE_SAMPLES} other samples",
    "z, blue: below, red: above",
]


def draw(places: list[Place], verdicts: list[Verdict], limit: float) -> None:
    """Write each crop to ``out/``, and all of them to the results."""
    rows = []
    for place, verdict in zip(places, verdicts, strict=True):
        if place.name in CROPS:
            x, y = CROPS[place.name]
            label = f"{place.name}: {WIDTH} x {HEIGHT} pixels at ({x}, {y}), x {ENLARGED}"
            rows.append((label, panels(place, verdict, limit)))
            name = place.name.replace(",", "").replace(" ", "-")
            save_sheet(draw_sheet(TITLES, rows[-1:]), OUT / f"{name}.png")
    save_sheet(draw_sheet(TITLES, rows), RESULTS / "mini_check.png")


def figures(place: Place, verdict: Verdict) -> dict[str, Any]:
    """Return a place's figures."""
    z = np.abs(verdict.z)
    return {
        "place": place.name,
        "pixels": len(place.pixels),
        "first_pixel": place.pixels[0].tolist(),
        "difference_quantiles": {str(q): float(np.quantile(verdict.difference, q)) for q in (0.5, 0.99, 1.0)},
        "beyond": int(verdict.beyond.sum()),
        "z_largest": float(z.max()),
        "z_rms": float(np.sqrt((z**2).mean())),
        "off": int(verdict.off.sum()),
        "bias_z": verdict.bias.tolist(),
        "constant": verdict.n_constant,
        "oracle_s": round(place.oracle_s, 1),
    }


HEAD = """# Is the MINI's picture right?

`make mini-check` renders `scenes/mini-cornell.json` (3840 x 2160, {ours} samples) and compares {pixels} of its
pixels with the oracle (`tests/naive.py`: equations and brute force, but that 16 triangles share a box): crops over
wheels, windows and grille, and a random pixel of each cell of {cell} x {cell} of the whole picture.

**{verdict}**

*Difference*: the oracle takes its samples where the renderer did. Bound: 2^-22 (2.4e-7) of the greater of 1 and the
value, for texels and film are float32. A sample that leaks or shadows itself is off by a {ours}th of what it shows. No
pixel may be *beyond*.

*z*: against the mean of {samples} samples of the oracle, uniform in the pixel, by numpy's generator. Standard error:
s sqrt(1/{ours} + 1/{samples}), with s from all {both} values that the oracle has for the pixel. Our samples are
stratified, so this is too wide for them: the oracle's share alone makes the RMS of z {alone:.2f}, and independent
samples of ours would make it 1. Limit: {limit:.2f}, Sidak-corrected to a significance of {significance} over all
pixels and channels; {share:.2%} of the pixels must keep to it, the others are *off*. Differences within the bound above
are none: so z is 0 in pixels whose means differ by no more than rounding (*constant*), and infinite where the oracle's
samples are all the same and ours are not that. *Bias*: z of a place's mean, in its worst channel; limit
{bias_limit:.2f}.

| place | pixels | difference: median | 99 % | largest | beyond | z: RMS | largest | off | bias | constant | CPU s |
|---|---|---|---|---|---|---|---|---|---|---|---|
"""


def page(result: dict[str, Any]) -> str:
    """Return the page."""
    head = HEAD.format(
        pixels=result["pixels"],
        cell=CELL_PX,
        verdict=result["verdict"],
        ours=SAMPLES,
        samples=ORACLE_SAMPLES,
        both=SAMPLES + ORACLE_SAMPLES,
        alone=(SAMPLES / (SAMPLES + ORACLE_SAMPLES)) ** 0.5,
        limit=result["z_limit"],
        significance=SIGNIFICANCE,
        share=LEAST_SHARE,
        bias_limit=result["bias_limit"],
    )
    lines = []
    for row in result["places"]:
        at = row["difference_quantiles"]
        cells = [
            row["place"] if row["place"] == WHOLE else f"{row['place']} {tuple(row['first_pixel'])}",
            row["pixels"],
            *(f"{at[q]:.1e}" for q in ("0.5", "0.99", "1.0")),
            row["beyond"],
            f"{row['z_rms']:.2f}",
            f"{row['z_largest']:.2f}",
            row["off"],
            f"{max(row['bias_z'], key=abs):.2f}",
            row["constant"],
            row["oracle_s"],
        ]
        lines.append(f"| {' | '.join(str(cell) for cell in cells)} |")
    lines += [
        "",
        f"Crops are {WIDTH} x {HEIGHT} pixels; left and top are given. Scene: SHA-256 `{result['scene_file_sha256']}`.",
        f"CPU seconds: {result['render_s']:.1f} for the whole picture, {result['oracle_s']:.0f} for the oracle.",
        f"Machine: {machine_line(result['machine'])}.",
        "",
        "![crops, eight times enlarged: Smalti, the oracle, their difference, z](mini_check.png)",
    ]
    return head + "\n".join(lines) + "\n"


def main() -> int:
    """Render, compare, write; return 0, 1 where something is wrong, 2 where data is missing."""
    try:
        for name in ("mini_geometry.json", "mini_body_diffuse.png"):
            seed_file(name)
    except MissingDataError as error:
        print(error, file=sys.stderr)
        return 2
    from benchmarks.local import render_film

    document = json.loads(SCENE.read_text())
    film = render_film(document, SCENE.parent)
    print(f"{film.pixels.shape[1]} x {film.pixels.shape[0]} pixels: {film.kernel_s:.1f} CPU s", flush=True)
    places = ask_oracle(document, film.pixels)
    n_pixels = sum(len(place.pixels) for place in places)
    limit = agreement.sidak_limit(SIGNIFICANCE, 3 * n_pixels)
    bias_limit = agreement.sidak_limit(SIGNIFICANCE, 3 * len(places))
    verdicts = [judge(place, limit) for place in places]
    faults = faults_of(places, verdicts, bias_limit)
    n_beyond = sum(int(verdict.beyond.sum()) for verdict in verdicts)
    n_off = sum(int(verdict.off.sum()) for verdict in verdicts)
    n_biased = sum(bool((np.abs(verdict.bias) > bias_limit).any()) for verdict in verdicts)
    result = {
        "scene_file_sha256": sha256_file(SCENE),
        "pixels": n_pixels,
        "bound": BOUND,
        "z_limit": limit,
        "bias_limit": bias_limit,
        "seed": SEED,
        "oracle_samples": ORACLE_SAMPLES,
        "verdict": f"{'Wrong' if faults else 'Right'}: {n_beyond} of {n_pixels} pixels differ by more than rounding, "
        f"{n_off} by more than sampling noise; {n_biased} of {len(places)} means are off.",
        "faults": faults,
        "render_s": round(film.kernel_s, 1),
        "oracle_s": round(sum(place.oracle_s for place in places), 1),
        "places": [figures(place, verdict) for place, verdict in zip(places, verdicts, strict=True)],
        "machine": describe_machine(),
    }
    draw(places, verdicts, limit)
    (OUT / "wrong.csv").write_text(list_wrong(places, verdicts))
    text = page(result)
    (RESULTS / "mini_check.md").write_text(text)
    (RESULTS / "mini_check.json").write_text(json.dumps(result, indent=1, sort_keys=True) + "\n")
    print("\n".join(line for line in text.splitlines() if line.startswith("|")))
    print(result["verdict"])
    print("benchmarks/results/mini_check.md, .json, .png; out/mini-check/, wrong.csv there lists what is wrong")
    for fault in faults:
        print(f"FAILED {fault}" if fault[0] != " " else fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
