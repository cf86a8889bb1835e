"""Write ``scenes/textures.json`` and ``scenes/assets/tiles.png``: a small scene whose pixels need texture filtering.

Job: a tiled floor that runs to the horizon, a wall with the tile once, a crate with vertex colours and a tile on each
side, one sun and one lamp. Invariant: no mirror and no glass, so that what is seen is texture, edges and shadows.
Source: ours.

Run ``python -m scenes.make_textures`` after a change here; the results are committed.
"""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenes.make_seed import text

FOLDER = Path(__file__).parent
IMAGE = FOLDER / "assets" / "tiles.png"


def tile(size: int = 128) -> NDArray[np.uint8]:
    """Return a tile as sRGB levels (size, size, 3): four fields (plain, stripes, rings, checks) and a dark joint."""
    y, x = np.mgrid[0:size, 0:size] / size
    stripes = np.floor(x * 32) % 2
    rings = np.floor(np.hypot(x - 0.25, y - 0.75) * 28) % 2
    checks = (np.floor(x * 16) + np.floor(y * 16)) % 2
    field = np.where(y < 0.5, np.where(x < 0.5, 0.0, stripes), np.where(x < 0.5, rings, checks))
    light = np.where((y < 0.5) == (x < 0.5), 1.0, 0.0)[..., None]
    warm, cool = np.array([226, 184, 120]), np.array([120, 160, 196])
    color = (light * warm + (1 - light) * cool) * (1 - 0.55 * field[..., None])
    edge = np.minimum(np.minimum(x, 1 - 1 / size - x), np.minimum(y, 1 - 1 / size - y))
    return np.where(edge[..., None] < 0.02, 40, color).astype(np.uint8)


def quad(corners: list[list[float]], repeat: float, name: str, material: str) -> dict[str, Any]:
    """Return a quad, counter-clockwise from its lower left corner, with the tile repeated along both sides."""
    uvs = [[0, 0], [repeat, 0], [repeat, repeat], [0, repeat]]
    return {
        "type": "mesh",
        "name": name,
        "material": material,
        "positions": corners,
        "uvs": uvs,
        "faces": [[0, 1, 2], [0, 2, 3]],
    }


def crate(center: tuple[float, float, float], size: float) -> dict[str, Any]:
    """Return a cube of six quads, each with its own tile and a colour that changes from corner to corner."""
    positions, uvs, colors, faces = [], [], [], []
    for axis in range(3):
        for sign in (-1, 1):
            first = len(positions)
            for u, v in [(-1, -1), (1, -1), (1, 1), (-1, 1)]:
                corner = [0.0, 0.0, 0.0]
                corner[axis], corner[(axis + 1) % 3], corner[(axis + 2) % 3] = sign, u * sign, v
                positions.append([round(c + k * size / 2, 6) for c, k in zip(center, corner, strict=True)])
                uvs.append([(u + 1) // 2, (v + 1) // 2])
                colors.append([1.0, 0.75 + 0.25 * u, 0.75 + 0.25 * v])
            faces += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    return {
        "type": "mesh",
        "name": "crate",
        "material": "tiled",
        "positions": positions,
        "uvs": uvs,
        "colors": colors,
        "faces": faces,
        "transform": [
            {"type": "translate", "by": [-center[0], 0, -center[2]]},
            {"type": "rotate", "axis": [0, 1, 0], "angle_deg": 25},
            {"type": "translate", "by": [center[0], 0, center[2]]},
        ],
    }


def document(sha256: str) -> dict[str, Any]:
    """Return the scene document."""
    return {
        "version": 1,
        "name": "textures",
        "camera": {
            "type": "perspective",
            "fov_deg": 45,
            "look_at": {"eye": [0, 1.5, 6], "target": [0, 1, 0], "up": [0, 1, 0]},
        },
        "image": {"width": 420, "height": 240},
        "integrator": {"type": "blinn_phong", "max_depth": 0, "shadows": True},
        "sampling": {"samples": 16},
        "background": [0.35, 0.5, 0.7],
        "lights": [
            {"type": "ambient", "intensity": 0.15},
            {"type": "directional", "direction": [-1, -2, -1.5], "diffuse": 0.6, "specular": 0.6},
            {"type": "point", "position": [2, 3, 2], "diffuse": [0.6, 0.5, 0.4], "specular": 0.3},
        ],
        "materials": {
            "tiled": {"type": "blinn_phong", "kd": 0.9, "diffuse_texture": {"asset": "tiles", "wrap": "repeat"}},
            "glossy": {
                "type": "blinn_phong",
                "kd": 0.9,
                "ks": 0.3,
                "exponent": 60,
                "diffuse_texture": {"asset": "tiles", "wrap": "repeat"},
            },
        },
        "objects": [
            quad([[-40, 0, 10], [40, 0, 10], [40, 0, -70], [-40, 0, -70]], 80, "floor", "glossy"),
            quad([[1, 0, -3], [3.5, 0, -2], [3.5, 2.5, -2], [1, 2.5, -3]], 1, "wall", "tiled"),
            crate((-1, 0.75, 0), 1.5),
        ],
        "assets": {"tiles": {"file": f"assets/{IMAGE.name}", "sha256": sha256}},
    }


def main() -> None:
    """Write the image and the document."""
    IMAGE.parent.mkdir(exist_ok=True)
    Image.fromarray(tile()).save(IMAGE, optimize=True)
    sha256 = hashlib.sha256(IMAGE.read_bytes()).hexdigest()
    (FOLDER / "textures.json").write_text(text(document(sha256)) + "\n")
    print("scenes/textures.json, scenes/assets/tiles.png")


if __name__ == "__main__":
    main()
