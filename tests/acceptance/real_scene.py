"""A small scene with mirrors, shadows and a shape of each sort, for tests that need real kernels."""

from typing import Any


def _wall(corners: list[list[float]], material: str) -> dict[str, Any]:
    return {"type": "mesh", "positions": corners, "faces": [[0, 1, 2], [0, 2, 3]], "material": material}


BOX: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "perspective", "fov_deg": 40, "look_at": {"eye": [0, 0, 3.8], "target": [0, 0, 0]}},
    "image": {"width": 160, "height": 112},
    "sampling": {"samples": 64, "seed": 3},
    "materials": {
        "red": {"type": "blinn_phong", "kd": [0.8, 0.1, 0.1]},
        "green": {"type": "blinn_phong", "kd": [0.1, 0.8, 0.1]},
        "white": {"type": "blinn_phong", "kd": 0.8},
        "mirror": {"type": "blinn_phong", "kd": 0.1, "ks": 0.5, "kr": 0.8},
    },
    "lights": [{"type": "point", "position": [0, 0.9, 0.2], "diffuse": 0.8}, {"type": "ambient", "intensity": 0.1}],
    "objects": [
        _wall([[-1, -1, 1], [-1, -1, -1], [-1, 1, -1], [-1, 1, 1]], "red"),
        _wall([[1, -1, -1], [1, -1, 1], [1, 1, 1], [1, 1, -1]], "green"),
        _wall([[-1, -1, 1], [1, -1, 1], [1, -1, -1], [-1, -1, -1]], "white"),
        _wall([[-1, 1, -1], [1, 1, -1], [1, 1, 1], [-1, 1, 1]], "white"),
        _wall([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1]], "white"),
        {"type": "sphere", "center": [-0.3, -0.6, 0], "radius": 0.4, "material": "mirror"},
        {"type": "box", "min": [0.1, -1, -0.5], "max": [0.6, 0.2, 0], "material": "white"},
    ],
}
