"""N21: a whole scene times 2^k gives the same bits; moved by 1e6 of its size, the same picture but for pixels on edges.

A case is a pixel. Rotations stay as they are; points, lengths and translations are scaled.
"""

import numpy as np
from row import Row

from benchmarks.cornell import cornell_box
from benchmarks.local import compile_document, render_sums

POWERS = (-90, -40, -7, 3, 39, 43, 47, 60, 66, 70, 90)
LENGTHS = {"positions", "center", "radius", "min", "max", "position", "eye", "target", "by"}


def scaled(value, factor, key=""):
    """The document with every length multiplied."""
    if isinstance(value, dict):
        return {name: scaled(item, factor, name) for name, item in value.items()}
    if isinstance(value, list):
        return [scaled(item, factor, key) for item in value]
    return value * factor if key in LENGTHS and isinstance(value, int | float) else value


def moved(scene, by):
    """The document with everything moved along a diagonal."""
    move = lambda point: [x + by for x in point]  # noqa: E731
    objects = []
    for item in scene["objects"]:
        if item["type"] == "mesh":
            objects.append({**item, "positions": [move(p) for p in item["positions"]]})
        else:
            objects.append({**item, "transform": [*item.get("transform", []), {"type": "translate", "by": [by] * 3}]})
    pose = scene["camera"]["look_at"]
    pose = {**pose, "eye": move(pose["eye"]), "target": move(pose["target"])}
    lights = [
        {**light, "position": move(light["position"])} if "position" in light else light for light in scene["lights"]
    ]
    return {**scene, "objects": objects, "lights": lights, "camera": {**scene["camera"], "look_at": pose}}


def picture(scene):
    """The mean of the samples in float64: float32 pixels hide more than they show."""
    image = scene["image"]
    return render_sums(compile_document(scene), image["width"], image["height"], scene["sampling"]["samples"])[0]


def run(cases, seed=21):
    edge = max(16, int((cases / (1 + len(POWERS))) ** 0.5))
    scene = cornell_box(edge, edge, 4, seed=seed)
    plain = picture(scene)
    wrong = sum(int((picture(scaled(scene, 2.0**k)) != plain).any(-1).sum()) for k in POWERS)
    # where an edge, a shadow's edge or a mirror image of one falls between two samples, a sample may change sides
    apart = np.abs(picture(moved(scene, 2.0**20)) - plain).max(-1)
    note = f"moved by 2^20: {np.median(apart):.1e} at the median, {(apart > 1e-6).mean():.2%} of the pixels by more than 1e-6"
    return Row(
        "N21", "scene times 2^k, bit-equal", (1 + len(POWERS)) * edge * edge, wrong, float(np.median(apart)), 1e-9, note
    )
