"""Write ``scenes/demo.json``: the picture of ``make demo``, a still life on a mosaic floor.

Job: one scene document that needs no file and shows most of what the format can: every shape, a mesh with normals and
vertex colours, groups, transforms, a mirror, glass, and every kind of light. Invariant: the numbers depend on nothing
but this script; coordinates are rounded, so the document stays small.

Run ``python -m scenes.make_demo`` after a change here; the result is committed.
"""

import colorsys
import json
import math
from pathlib import Path
from typing import Any

OUTPUT = Path(__file__).parent / "demo.json"

Vector = tuple[float, float, float]

TILE = 0.38
"""Pitch of the mosaic's tiles; a tenth of it is grout."""

N_TILES = 28
"""Tiles along each side of the mosaic."""

KNOT_STEPS, KNOT_SIDES = 144, 12
"""Corners of the knot's tube along and around."""


LOOKING_GLASS = [1.25, 2.75, -4.64]
TILT = [-0.1, -0.22, 0.97]
"""Centre and normal of the mirror on the wall: it shows the knot from behind."""


def rounded(vector: Vector, digits: int = 3) -> list[float]:
    """Return a vector with short decimals."""
    return [round(coordinate, digits) + 0.0 for coordinate in vector]


def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def unit(a: Vector) -> Vector:
    """Return a vector of length 1."""
    length = math.hypot(*a)
    return (a[0] / length, a[1] / length, a[2] / length)


def knot_point(angle: float) -> Vector:
    """Return a point of the trefoil knot."""
    radius = 2.0 + math.cos(3.0 * angle)
    return (radius * math.cos(2.0 * angle), radius * math.sin(2.0 * angle), 1.25 * math.sin(3.0 * angle))


def knot() -> dict[str, Any]:
    """Return a trefoil knot as a tube with smooth normals, its colour running from gold to crimson and back."""
    positions, normals, colors, faces = [], [], [], []
    for step in range(KNOT_STEPS):
        angle = 2.0 * math.pi * step / KNOT_STEPS
        here, ahead = knot_point(angle), knot_point(angle + 1e-4)
        along = unit((ahead[0] - here[0], ahead[1] - here[1], ahead[2] - here[2]))
        aside = unit(cross(along, (-here[0], -here[1], 0.4)))
        across = cross(aside, along)
        blend = 0.5 - 0.5 * math.cos(angle)
        color = colorsys.hsv_to_rgb((0.125 - 0.17 * blend) % 1.0, 0.92, 0.95 - 0.25 * blend)
        for side in range(KNOT_SIDES):
            turn = 2.0 * math.pi * side / KNOT_SIDES
            c, s = math.cos(turn), math.sin(turn)
            normal = (c * aside[0] + s * across[0], c * aside[1] + s * across[1], c * aside[2] + s * across[2])
            positions.append(
                rounded((here[0] + 0.52 * normal[0], here[1] + 0.52 * normal[1], here[2] + 0.52 * normal[2]))
            )
            normals.append(rounded(normal, 2))
            colors.append(rounded(color, 2))
            i, j = step * KNOT_SIDES + side, step * KNOT_SIDES + (side + 1) % KNOT_SIDES
            k, m = (((step + 1) % KNOT_STEPS) * KNOT_SIDES + x % KNOT_SIDES for x in (side, side + 1))
            faces += [[i, k, m], [i, m, j]]
    return {
        "type": "mesh",
        "name": "knot",
        "material": "glaze",
        "positions": positions,
        "normals": normals,
        "colors": colors,
        "faces": faces,
        "transform": [
            {"type": "scale", "by": 0.42},
            {"type": "rotate", "axis": [0, 1, 0], "angle_deg": -18},
            {"type": "translate", "by": [0, 1.53, -0.5]},
        ],
    }


def tile_color(x: float, z: float) -> Vector:
    """Return the colour of the tile at a place: rings of blue and turquoise around gold, no two tiles alike."""
    ring = math.hypot(x, z + 0.5)
    grain = math.modf(abs(math.sin(12.9898 * x + 78.233 * z) * 43758.5453))[0]
    band = math.sin(2.1 * ring)
    if band > 0.82:
        hue, saturation, value = 0.11, 0.85, 0.75
    elif band > 0.0:
        hue, saturation, value = 0.52, 0.75, 0.42
    else:
        hue, saturation, value = 0.61, 0.80, 0.30
    return colorsys.hsv_to_rgb(hue + 0.035 * (grain - 0.5), saturation, value * (0.6 + 0.6 * grain))


def mosaic() -> dict[str, Any]:
    """Return the floor's glass tiles (smalti) as one mesh; each leans a little, so that each shines in its own way."""
    positions: list[list[float]] = []
    normals: list[list[float]] = []
    colors: list[list[float]] = []
    faces: list[list[int]] = []
    for row in range(N_TILES):
        for column in range(N_TILES):
            x = (column - (N_TILES - 1) / 2.0) * TILE
            z = (row - (N_TILES - 1) / 2.0) * TILE - 1.0
            lean = (0.05 * math.sin(91.7 * x + 37.1 * z), 1.0, 0.05 * math.sin(53.3 * x - 71.9 * z))
            first, half = len(positions), 0.45 * TILE
            for dx, dz in ((-half, half), (half, half), (half, -half), (-half, -half)):
                positions.append(rounded((x + dx, 0.01, z + dz), 3))
                normals.append(rounded(unit(lean), 2))
                colors.append(rounded(tile_color(x, z), 2))
            faces += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    return {
        "type": "mesh",
        "name": "mosaic",
        "material": "tile",
        "positions": positions,
        "normals": normals,
        "colors": colors,
        "faces": faces,
    }


def crystal() -> dict[str, Any]:
    """Return a faceted crystal with two groups of faces, each of its own material."""
    corners = [(math.cos(k * math.pi / 3), 0.0, math.sin(k * math.pi / 3)) for k in range(6)]
    positions = [rounded(corner, 3) for corner in corners] + [[0, 1.5, 0], [0, -0.7, 0]]
    upper = [[(k + 1) % 6, k, 6] for k in range(6)]
    lower = [[k, (k + 1) % 6, 7] for k in range(6)]
    return {
        "type": "mesh",
        "name": "crystal",
        "positions": positions,
        "faces": upper + lower,
        "groups": {"crown": [0, 6], "foot": [6, 12]},
        "materials": {"crown": "ruby", "foot": "copper"},
        "transform": [
            {"type": "scale", "by": 0.42},
            {"type": "rotate", "axis": [0, 1, 0], "angle_deg": 17},
            {"type": "translate", "by": [2.35, 1.3, -1.9]},
        ],
    }


MATERIALS: dict[str, dict[str, Any]] = {
    "grout": {"kd": [0.10, 0.09, 0.085]},
    "wall": {"kd": [0.24, 0.25, 0.33], "ks": 0.05, "exponent": 10},
    "tile": {"kd": 0.9, "ks": 0.35, "exponent": 60, "kr": 0.07},
    "glaze": {"kd": 0.85, "ks": 0.7, "exponent": 90, "kr": 0.10},
    "chrome": {"kd": 0.03, "ks": 0.9, "exponent": 400, "kr": [0.83, 0.84, 0.86]},
    "glass": {"kd": 0.0, "ks": 0.9, "exponent": 500, "kr": 0.09, "kt": [0.90, 0.95, 0.93], "eta": 1.5},
    "marble": {"kd": [0.72, 0.69, 0.65], "ks": 0.25, "exponent": 40},
    "copper": {"kd": [0.45, 0.17, 0.08], "ks": [0.9, 0.5, 0.3], "exponent": 60, "kr": [0.35, 0.18, 0.10]},
    "ruby": {"kd": [0.35, 0.01, 0.03], "ks": 0.8, "exponent": 200, "kr": 0.12, "kt": [0.45, 0.04, 0.08], "eta": 1.0},
    "lamp": {"kd": 0.0, "ke": [1.0, 0.82, 0.55]},
}

LIGHTS: list[dict[str, Any]] = [
    {"type": "ambient", "intensity": [0.17, 0.18, 0.22]},
    {"type": "directional", "direction": [-0.7, -1.0, -0.55], "diffuse": [0.50, 0.48, 0.44], "specular": 0.5},
    {"type": "point", "position": [-3.3, 2.6, -1.9], "diffuse": [0.42, 0.30, 0.15], "specular": [0.5, 0.4, 0.2]},
    {
        "type": "spot",
        "position": [2.6, 5.5, 4.2],
        "direction": [-2.3, -4.2, -4.4],
        "inner_angle_deg": 13,
        "outer_angle_deg": 20,
        "diffuse": [0.75, 0.72, 0.66],
        "specular": 0.8,
    },
]


def objects() -> list[dict[str, Any]]:
    """Return all that stands on the floor, and the floor."""
    return [
        {"type": "plane", "name": "ground", "point": [0, 0, 0], "normal": [0, 1, 0], "material": "grout"},
        {"type": "plane", "name": "wall", "point": [0, 0, -5], "normal": [0, 0, 1], "material": "wall"},
        mosaic(),
        knot(),
        {"type": "sphere", "name": "mirror ball", "center": [-2.05, 0.86, 0.55], "radius": 0.85, "material": "chrome"},
        {"type": "sphere", "name": "glass ball", "center": [1.75, 0.66, 1.15], "radius": 0.65, "material": "glass"},
        {
            "type": "box",
            "name": "plinth",
            "min": [-0.5, 0, -0.5],
            "max": [0.5, 1.0, 0.5],
            "material": "marble",
            "transform": [
                {"type": "rotate", "axis": [0, 1, 0], "angle_deg": 28},
                {"type": "translate", "by": [2.35, 0.01, -1.9]},
            ],
        },
        crystal(),
        {
            "type": "cylinder",
            "name": "column",
            "start": [-3.3, 0, -2.2],
            "end": [-3.3, 2.1, -2.2],
            "radius": 0.3,
            "material": "marble",
        },
        {"type": "sphere", "name": "lamp", "center": [-3.3, 2.27, -2.2], "radius": 0.18, "material": "lamp"},
        {
            "type": "disk",
            "name": "looking glass",
            "center": LOOKING_GLASS,
            "normal": TILT,
            "radius": 1.3,
            "material": "chrome",
        },
        {
            "type": "cylinder",
            "name": "its frame",
            "start": [round(c - 0.1 * t, 4) for c, t in zip(LOOKING_GLASS, TILT, strict=True)],
            "end": [round(c + 0.1 * t, 4) for c, t in zip(LOOKING_GLASS, TILT, strict=True)],
            "radius": 1.36,
            "capped": False,
            "material": "copper",
        },
        {
            "type": "cylinder",
            "name": "ring",
            "start": [-0.65, 0.3, 2.0],
            "end": [-0.2, 0.3, 2.12],
            "radius": 0.29,
            "capped": False,
            "material": "copper",
        },
    ]


def document() -> dict[str, Any]:
    """Return the scene document."""
    return {
        "version": 1,
        "name": "Smalti: a still life",
        "camera": {
            "type": "perspective",
            "fov_deg": 36,
            "look_at": {"eye": [0.4, 2.7, 7.6], "target": [0, 1.25, -0.6], "up": [0, 1, 0]},
        },
        "image": {"width": 640, "height": 360},
        "integrator": {"type": "blinn_phong", "max_depth": 5, "shadows": True},
        "sampling": {"samples": 16, "sampler": "sobol", "seed": 0},
        "materials": MATERIALS,
        "lights": LIGHTS,
        "objects": objects(),
        "background": [0.30, 0.40, 0.58],
    }


def main() -> None:
    """Write the scene, one line for each table and object."""
    members = []
    for key, value in document().items():
        if isinstance(value, list) and isinstance(value[0], dict):
            members.append(f'"{key}": [\n  ' + ",\n  ".join(json.dumps(item) for item in value) + "\n ]")
        elif key == "materials":
            lines = (f'"{name}": {json.dumps(item)}' for name, item in value.items())
            members.append(f'"{key}": {{\n  ' + ",\n  ".join(lines) + "\n }")
        else:
            members.append(f'"{key}": {json.dumps(value)}')
    OUTPUT.write_text("{\n " + ",\n ".join(members) + "\n}\n")
    print(f"wrote {OUTPUT.name}")


if __name__ == "__main__":
    main()
