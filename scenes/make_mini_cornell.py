"""Write ``scenes/mini-cornell.json``: the MINI in the Cornell box of the report.

Job: the car's material table in, one scene document out; camera, box and light are chosen here. Invariant: the document
names its files by SHA-256, so that its own hash fixes the picture's every input.
Source: ``seed/`` in the data folder (model and texture of WhoFama24/cse6413-raytracer, commit 167f0b0, MIT licence).
Its README says that the car has z up and the nose towards -y, that `Windows` and `Interior` share most of their
triangles, and that only one of the textures that the materials name exists.

Run ``python -m scenes.make_mini_cornell`` after a change here; the result is committed.
"""

import hashlib
import json
import os
import sys
from pathlib import Path
from typing import Any

OUTPUT = Path(__file__).parent / "mini-cornell.json"
DATA = Path(os.environ.get("SMALTI_DATA", Path(__file__).parent.parent.parent / "shared"))

GEOMETRY = "seed/mini_geometry.json"
TEXTURE = "seed/mini_body_diffuse.png"

SCALE = 0.01
"""World units per unit of the model: the car is 3.60 long, 1.93 wide and 1.64 high."""

LOWEST = -1.551
"""Lowest z of the model, where the tyres stand on the floor."""

TURN_DEG = 50.0
"""How far the nose is turned from the camera to the right, in degrees."""

PLACE = [0.0, 0.0, -2.2]
"""Where the middle of the car stands; the opening of the box is at z = 0."""

WIDTH, HEIGHT, DEPTH = 4.5, 2.5, 4.3
"""Inner size of the box, open at z = 0."""


def linear(color: list[float]) -> list[float]:
    """Return linear RGB of a colour as the material table has it, encoded for the screen like the texture."""
    return [round(c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4, 5) for c in color]


# What the table does not say: how each group shines. (ks, exponent, kr); others are matt with a faint gloss.
GLOSS: dict[str, tuple[float, float, float]] = {
    "Body": (0.5, 120.0, 0.07),
    "Roof": (0.4, 120.0, 0.08),
    "Body Chrome": (0.8, 200.0, 0.45),
    "Headlights": (0.8, 250.0, 0.15),
    "Brakelights": (0.6, 150.0, 0.08),
    "Mirrors": (0.9, 400.0, 0.80),
    "Rear View Mirror": (0.9, 400.0, 0.80),
    "Exhaust": (0.8, 200.0, 0.45),
    "Antenna": (0.4, 80.0, 0.20),
    "Brakes": (0.4, 60.0, 0.20),
    "License": (0.2, 40.0, 0.0),
}
RIM_GLOSS = (0.8, 150.0, 0.40)
MATT_GLOSS = (0.08, 20.0, 0.0)

MIRRORS = {"Mirrors", "Rear View Mirror"}
CHROME = {"Body Chrome", "Exhaust"}


def material(group: str, entry: dict[str, Any]) -> dict[str, Any]:
    """Return the material of one group: the texture where it exists, else the flat colour."""
    if group == "Windows":
        # The panes are single sheets, so they do not bend rays.
        return {"kd": 0.01, "ks": 0.6, "exponent": 400, "kr": 0.10, "kt": [0.72, 0.76, 0.76], "eta": 1.0}
    ks, exponent, kr = RIM_GLOSS if group.endswith("Rim") else GLOSS.get(group, MATT_GLOSS)
    described: dict[str, Any] = {"ks": ks, "exponent": exponent, "kr": kr}
    if group == "Interior":
        # Its shell lies on the panes: opaque, it would hide the seats.
        return {"kd": linear(entry["color"]), "ks": 0.05, "exponent": 20, "kt": [0.7, 0.7, 0.7], "eta": 1.0}
    # A mirror shows the scene in place of its own colour.
    share = 0.25 if group in MIRRORS else 1.0 - kr if group in CHROME or group.endswith("Rim") else 1.0
    if entry["diffuse"] == Path(TEXTURE).name:
        described["kd"] = share
        described["diffuse_texture"] = {"asset": "body"}
    else:
        described["kd"] = [round(share * c, 5) for c in linear(entry["color"])]
    return described


def walls() -> list[dict[str, Any]]:
    """Return the five walls as one quad each, with unit normals inwards."""
    x, y, z = WIDTH / 2.0, HEIGHT, -DEPTH
    corners = {
        "Floor": ([[-x, 0, 0], [x, 0, 0], [x, 0, z], [-x, 0, z]], [0, 1, 0], "wall"),
        "Ceiling": ([[-x, y, z], [x, y, z], [x, y, 0], [-x, y, 0]], [0, -1, 0], "wall"),
        "Back": ([[-x, 0, z], [x, 0, z], [x, y, z], [-x, y, z]], [0, 0, 1], "wall"),
        "Left": ([[-x, 0, 0], [-x, 0, z], [-x, y, z], [-x, y, 0]], [1, 0, 0], "red"),
        "Right": ([[x, 0, z], [x, 0, 0], [x, y, 0], [x, y, z]], [-1, 0, 0], "green"),
    }
    return [
        {
            "type": "mesh",
            "name": name,
            "material": painted,
            "positions": positions,
            "normals": [normal] * 4,
            "faces": [[0, 1, 2], [0, 2, 3]],
        }
        for name, (positions, normal, painted) in corners.items()
    ]


def digest(name: str) -> str:
    """Return the SHA-256 of a data file."""
    return hashlib.sha256((DATA / name).read_bytes()).hexdigest()


def document() -> dict[str, Any]:
    """Return the scene document."""
    table = json.loads((DATA / "seed" / "mini_material.json").read_text())
    materials = {
        "wall": {"kd": [0.73, 0.72, 0.69]},
        "red": {"kd": [0.62, 0.06, 0.05]},
        "green": {"kd": [0.11, 0.43, 0.09]},
    }
    materials |= {group: material(group, entry) for group, entry in table.items()}
    car = {
        "type": "mesh_asset",
        "name": "MINI",
        "asset": "mini",
        "materials": {group: group for group in table},
        "normals": "file",
        "transform": [
            {"type": "translate", "by": [0, 0, -LOWEST]},
            {"type": "rotate", "axis": [1, 0, 0], "angle_deg": -90},  # z up to y up; the nose now points to +z
            {"type": "scale", "by": SCALE},
            {"type": "rotate", "axis": [0, 1, 0], "angle_deg": TURN_DEG},
            {"type": "translate", "by": PLACE},
        ],
    }
    return {
        "version": 1,
        "name": "The MINI in the Cornell box",
        "camera": {
            "type": "perspective",
            "fov_deg": 35,
            "look_at": {"eye": [0, 1.6, 2.75], "target": [0, 0.9, -2.0], "up": [0, 1, 0]},
        },
        "image": {"width": 3840, "height": 2160},
        "integrator": {"type": "blinn_phong", "max_depth": 3, "shadows": True},
        "sampling": {"samples": 16, "sampler": "sobol", "seed": 2019},
        "materials": materials,
        "lights": [
            {"type": "ambient", "intensity": 0.13},
            # Comes in through the open side: flat, so that the ceiling's shadow stays above the car.
            {"type": "directional", "direction": [0.3, -0.28, -0.95], "diffuse": 0.45, "specular": 0.6},
            # The lamp under the ceiling, which the box has had since Cornell.
            {"type": "point", "position": [-0.2, HEIGHT - 0.08, -1.2], "diffuse": 0.58, "specular": 0.6},
        ],
        "objects": [*walls(), car],
        "background": 0,
        "assets": {
            "mini": {"file": GEOMETRY, "sha256": digest(GEOMETRY)},
            "body": {"file": TEXTURE, "sha256": digest(TEXTURE)},
        },
    }


def main() -> None:
    """Write the scene."""
    if not (DATA / GEOMETRY).is_file():
        sys.exit(f"{GEOMETRY} is missing: set SMALTI_DATA to a folder that has it (see README.md)")
    OUTPUT.write_text(json.dumps(document(), indent=1) + "\n")
    print(f"wrote {OUTPUT.name}")


if __name__ == "__main__":
    main()
