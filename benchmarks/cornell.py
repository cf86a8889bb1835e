"""A Cornell box for benchmarks: walls, two blocks, a mirror sphere and one of glass; no files needed.

Invariant: the same arguments give the same document.
"""

from typing import Any

WHITE, RED, GREEN = [0.73, 0.73, 0.73], [0.65, 0.05, 0.05], [0.12, 0.45, 0.15]


def cornell_box(width: int, height: int, samples: int, *, seed: int = 0) -> dict[str, Any]:
    """Return a scene document.

    Parameters
    ----------
    width, height : int
        Image size in pixels.
    samples : int
        Samples per pixel.
    seed : int
        Of the random numbers; another seed makes another job of the same work.
    """
    return {
        "version": 1,
        "name": "Cornell box",
        "camera": {
            "type": "perspective",
            "fov_deg": 40,
            "look_at": {"eye": [0, 1, 3.9], "target": [0, 1, 0], "up": [0, 1, 0]},
        },
        "image": {"width": width, "height": height},
        "integrator": {"type": "blinn_phong", "max_depth": 3, "shadows": True},
        "sampling": {"samples": samples, "seed": seed},
        "materials": {
            **{
                name: {"type": "blinn_phong", "ka": color, "kd": color}
                for name, color in (("white", WHITE), ("red", RED), ("green", GREEN))
            },
            "mirror": {"type": "blinn_phong", "ka": 0, "kd": 0.05, "ks": 0.5, "exponent": 200, "kr": 0.85},
            "glass": {
                "type": "blinn_phong",
                "ka": 0,
                "kd": 0,
                "ks": 0.5,
                "exponent": 200,
                "kr": 0.1,
                "kt": 0.85,
                "eta": 1.5,
            },
        },
        "lights": [
            {"type": "ambient", "intensity": 0.15},
            {"type": "point", "position": [0, 1.9, 0.2], "diffuse": 0.9},
        ],
        "objects": [
            _wall([-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1], "white"),
            _wall([-1, 2, -1], [1, 2, -1], [1, 2, 1], [-1, 2, 1], "white"),
            _wall([-1, 0, -1], [1, 0, -1], [1, 2, -1], [-1, 2, -1], "white"),
            _wall([-1, 0, 1], [-1, 0, -1], [-1, 2, -1], [-1, 2, 1], "red"),
            _wall([1, 0, -1], [1, 0, 1], [1, 2, 1], [1, 2, -1], "green"),
            {
                "type": "box",
                "min": [-0.3, 0, -0.3],
                "max": [0.3, 1.2, 0.3],
                "material": "white",
                "transform": [
                    {"type": "rotate", "axis": [0, 1, 0], "angle_deg": 18},
                    {"type": "translate", "by": [-0.4, 0, -0.4]},
                ],
            },
            {"type": "sphere", "center": [0.45, 0.35, 0.3], "radius": 0.35, "material": "mirror"},
            {"type": "sphere", "center": [-0.25, 0.25, 0.6], "radius": 0.25, "material": "glass"},
        ],
    }


def _wall(a: list[float], b: list[float], c: list[float], d: list[float], material: str) -> dict[str, Any]:
    """Return a rectangle as two triangles."""
    return {"type": "mesh", "positions": [a, b, c, d], "faces": [[0, 1, 2], [0, 2, 3]], "material": material}
