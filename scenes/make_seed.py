"""Write the nine scenes of the original program's reference pictures as scene documents, into ``scenes/seed/``.

Job: ``reference_scenes.json`` in, nine scene documents v1 out. Invariant: positions, normals (raw, neither unit nor
perpendicular), colours and reflection factors are the given numbers, unrounded; only equal vertices are merged.
Source: ``seed/README.md`` in the data folder (facts of WhoFama24/cse6413-raytracer, commit 167f0b0).

Run ``python -m scenes.make_seed`` after a change here; the results are committed.

Two habits of the original have no place in a scene document, and Smalti does not share them: the interpolated normal
enters the reflection formula as it is (eq. 17), and shadow rays start at a fixed t_min. The encoding of the PNG (linear
levels) belongs to the job, not to the scene.
"""

import json
import os
import sys
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent / "seed"
DATA = Path(os.environ.get("SMALTI_DATA", Path(__file__).parent.parent.parent / "shared"))


def mesh(thing: dict[str, Any]) -> dict[str, Any]:
    """Return one object of the facts as an inline mesh whose equal vertices (position and normal) are merged."""
    vertices: dict[tuple[tuple[float, ...], tuple[float, ...]], int] = {}
    faces = []
    for triangle in thing["triangles"]:
        corners = zip(triangle["positions"], triangle["normals"], strict=True)
        faces.append([vertices.setdefault((tuple(p), tuple(n)), len(vertices)) for p, n in corners])
    return {
        "type": "mesh",
        "name": thing["name"],
        "material": thing["name"],
        "positions": [list(position) for position, _ in vertices],
        "normals": [list(normal) for _, normal in vertices],
        "faces": faces,
    }


def material(thing: dict[str, Any], facts: dict[str, Any], terms: dict[str, bool]) -> dict[str, Any]:
    """Return an object's material: the terms that a picture lacks are zero."""
    return {
        "type": "blinn_phong",
        "ka": thing["color"] if terms["ambient"] else 0.0,
        "kd": thing["color"] if terms["diffuse"] else 0.0,
        "ks": facts["specular_color"] if terms["specular"] else 0.0,
        "exponent": facts["shininess"],
        "kr": thing["reflection"] if terms["reflections"] else 0.0,
        "two_sided": False,
    }


def document(facts: dict[str, Any], entry: dict[str, Any]) -> dict[str, Any]:
    """Return the scene document of one reference picture."""
    plane, terms = facts["camera"]["view_plane"], entry["terms"]
    lights: list[dict[str, Any]] = [{"type": "ambient", "intensity": facts["ambient_level"]}]
    if terms["diffuse"] or terms["specular"]:
        lights += [{"type": "directional", "direction": d} for d in entry["light_travel_directions"]]
    width, height = facts["camera"]["image_size"]
    bounds = {side: plane[side] for side in ("left", "right", "bottom", "top")}
    return {
        "version": 1,
        "name": Path(entry["image"]).stem,
        "camera": {"type": "view_plane", **bounds, "distance": -plane["z"]},
        "image": {"width": width, "height": height},
        "integrator": {
            "type": "blinn_phong",
            "max_depth": facts["max_reflection_bounces"],
            "shadows": terms["shadows"],
        },
        "sampling": {"samples": entry["samples_per_pixel"]},
        "background": facts["background"],
        "lights": lights,
        "materials": {thing["name"]: material(thing, facts, terms) for thing in entry["objects"]},
        "objects": [mesh(thing) for thing in entry["objects"]],
    }


def text(value: Any, indent: str = "") -> str:
    """Return JSON with one line for each list of numbers and for each member that fits into a line."""
    line = json.dumps(value)
    if len(line) + len(indent) <= 100 or not isinstance(value, dict | list):
        return line
    inner = indent + "  "
    if isinstance(value, dict):
        rows = [f"{inner}{json.dumps(key)}: {text(item, inner)}" for key, item in value.items()]
        return "{\n" + ",\n".join(rows) + f"\n{indent}}}"
    return "[\n" + ",\n".join(inner + text(item, inner) for item in value) + f"\n{indent}]"


def main() -> int:
    """Write the nine documents."""
    source = DATA / "seed" / "reference_scenes.json"
    if not source.is_file():
        print(f"{source} is missing: set SMALTI_DATA to the folder that holds seed/", file=sys.stderr)
        return 2
    facts = json.loads(source.read_text())
    FOLDER.mkdir(exist_ok=True)
    for entry in facts["scenes"]:
        path = (FOLDER / entry["image"]).with_suffix(".json")
        path.write_text(text(document(facts, entry)) + "\n")
        print(f"scenes/seed/{path.name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
