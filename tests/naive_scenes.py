"""Scenes for the oracle: the nine of ``reference_scenes.json``, and small scene documents v1.

Job: plain dicts in, ``tests.naive.Scene`` out. Invariant: nothing of ``tracer`` is imported; defaults of the document are
written down here a second time. Source: ``seed/README.md`` in the data folder and the scene document's description.
"""

import json
import math
from pathlib import Path

import numpy as np
from PIL import Image

from tests.naive import Camera, Light, Material, Scene, Texture, Triangle, cross, unit, vec
from tests.naive_mesh import Mesh
from tests.naive_shapes import Box, Cylinder, Disk, Plane, Sphere

NONE = [0.0] * 3


def seed_scene(facts, entry, *, original):
    """Return one scene of ``reference_scenes.json``: ``facts`` is the whole file, ``entry`` one of its scenes."""
    terms, plane = entry["terms"], facts["camera"]["view_plane"]
    width, height = facts["camera"]["image_size"]
    primitives = []
    for thing in entry["objects"]:
        material = Material(
            ka=thing["color"] if terms["ambient"] else NONE,
            kd=thing["color"] if terms["diffuse"] else NONE,
            ks=facts["specular_color"] if terms["specular"] else NONE,
            exponent=facts["shininess"],
            kr=[thing["reflection"] if terms["reflections"] else 0.0] * 3,
            two_sided=False,
        )
        primitives += [Triangle(*tri["positions"], material, normals=tri["normals"]) for tri in thing["triangles"]]
    bounds = {side: plane[side] for side in ("left", "right", "bottom", "top")}
    return Scene(
        camera=Camera(facts["camera"]["eye"], [1, 0, 0], [0, 1, 0], [0, 0, 1], **bounds, distance=-plane["z"]),
        width=width,
        height=height,
        primitives=primitives,
        lights=[Light("directional", direction=d) for d in entry["light_travel_directions"]],
        ambient=[facts["ambient_level"]] * 3,
        background=facts["background"],
        shadows=terms["shadows"],
        max_depth=facts["max_reflection_bounces"],
        samples=entry["samples_per_pixel"],
        t_min=entry["t_min"],
        original=original,
    )


def rgb(value):
    """Return the three numbers of a scene document's colour: one number stands for grey."""
    return [float(value)] * 3 if isinstance(value, int | float) else [float(c) for c in value]


def read_document(doc, textures=None, models=None):
    """Return the oracle's scene for a scene document v1 (a dict).

    ``textures`` maps asset names to arrays (height, width, 3) of 8-bit levels, ``models`` to objects of vertexdata,
    indexdata and groups (the MINI's form; other files are not read here). The oracle never cuts a path short:
    integrator.min_throughput is ignored, as are sampler and seed (positions are given to ``render``) and the crop.
    """
    width, height = doc["image"]["width"], doc["image"]["height"]
    integrator = doc.get("integrator", {})
    materials = {name: read_material(m, textures or {}) for name, m in doc.get("materials", {}).items()}
    lights = doc.get("lights", [])
    ambient = np.zeros(3)
    for light in lights:
        if light["type"] == "ambient":
            ambient += rgb(light["intensity"])
    return Scene(
        camera=read_camera(doc["camera"], width / height),
        width=width,
        height=height,
        primitives=[p for thing in doc.get("objects", []) for p in read_object(thing, materials, models or {})],
        lights=[read_light(light) for light in lights if light["type"] != "ambient"],
        ambient=list(ambient),
        background=rgb(doc.get("background", 0.0)),
        shadows=integrator.get("shadows", True),
        max_depth=integrator.get("max_depth", 3),
        samples=doc.get("sampling", {}).get("samples", 16),
    )


def read_assets(doc, folder):
    """Return the textures and the models of a document's assets for read_document, from files below a folder."""
    textures, models = {}, {}
    for name, asset in doc.get("assets", {}).items():
        path = Path(folder) / asset["file"]
        if path.suffix == ".json":
            models[name] = json.loads(path.read_text())
        else:
            with Image.open(path) as image:
                textures[name] = np.asarray(image.convert("RGB"))
    return textures, models


def read_camera(camera, aspect):
    eye, u, v, w = NONE, [1, 0, 0], [0, 1, 0], [0, 0, 1]
    if camera.get("look_at") is not None:
        look = camera["look_at"]
        eye = look["eye"]
        w = unit(vec(np.subtract(look["eye"], look["target"])))
        u = unit(cross(vec(look.get("up", [0, 1, 0])), w))
        v = cross(w, u)
    elif camera.get("matrix") is not None:
        columns = np.array(camera["matrix"], dtype=float)[:3].T
        u, v, w, eye = columns
    if camera["type"] == "view_plane":
        bounds = [camera["left"], camera["right"], camera["bottom"], camera["top"]]
        return Camera(eye, u, v, w, *bounds, distance=camera["distance"])
    if camera["type"] == "orthographic":
        top, distance = camera["height"] / 2.0, None
        right = top * aspect
    else:
        reach, distance = math.tan(math.radians(camera["fov_deg"]) / 2.0), 1.0
        vertical = camera.get("fov_axis", "vertical") == "vertical"
        top, right = (reach, reach * aspect) if vertical else (reach / aspect, reach)
    return Camera(eye, u, v, w, -right, right, -top, top, distance)


def read_material(material, textures):
    attenuation = material.get("attenuation") or {}
    texture = material.get("diffuse_texture")
    given = {name: rgb(material[name]) for name in ("ka", "kd", "ks", "ke", "kr", "kt") if name in material}
    given.setdefault("ka", given.get("kd", [0.8] * 3))
    given |= {name: material[name] for name in ("exponent", "eta", "two_sided") if name in material}
    if texture is not None:
        given["texture"] = Texture(
            textures[texture["asset"]],
            repeat=texture.get("wrap", "repeat") == "repeat",
            srgb=texture.get("color_space", "srgb") == "srgb",
            bilinear=texture.get("filter", "bilinear") == "bilinear",
        )
    abc = (attenuation.get("a", 1.0), attenuation.get("b", 0.0), attenuation.get("c", 0.0))
    return Material(attenuation=abc, **given)


def read_light(light):
    given = {name: rgb(light[name]) for name in ("ambient", "diffuse", "specular") if name in light}
    places = ("position", "direction", "inner_angle_deg", "outer_angle_deg")
    return Light(light["type"], **{name: light[name] for name in places if name in light}, **given)


def read_transform(steps):
    """Return the 4x4 product of a list of transforms, applied first to last."""
    product = np.eye(4)
    for step in steps or []:
        matrix = np.eye(4)
        if step["type"] == "translate":
            matrix[:3, 3] = step["by"]
        elif step["type"] == "scale":
            matrix[:3, :3] = np.diag(rgb(step["by"]))
        elif step["type"] == "rotate":  # Rodrigues: R = I + sin K + (1 - cos) K^2, K the cross product with the axis
            x, y, z = np.divide(step["axis"], np.linalg.norm(step["axis"]))
            k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            angle = math.radians(step["angle_deg"])
            matrix[:3, :3] += math.sin(angle) * k + (1.0 - math.cos(angle)) * k @ k
        else:
            matrix = np.array(step["rows"], dtype=float)
        product = matrix @ product
    return product


def read_object(thing, materials, models):
    """Return the primitives of one object."""
    matrix = read_transform(thing.get("transform"))
    material = materials[thing["material"]] if thing.get("material") else Material()
    kind = thing["type"]
    if kind == "mesh":
        return read_mesh(thing, matrix, material, materials)
    if kind == "mesh_asset":
        return read_model(thing, matrix, material, materials, models[thing["asset"]])
    if material.texture is not None:
        raise NotImplementedError("the oracle has no texture coordinates on shapes")
    shapes = {
        "sphere": lambda: Sphere(material, matrix, thing["center"], thing["radius"]),
        "plane": lambda: Plane(material, matrix, thing["point"], thing["normal"]),
        "disk": lambda: Disk(material, matrix, thing["center"], thing["normal"], thing["radius"]),
        "box": lambda: Box(material, matrix, thing["min"], thing["max"]),
        "cylinder": lambda: Cylinder(
            material, matrix, thing["start"], thing["end"], thing["radius"], thing.get("capped", True)
        ),
    }
    return [shapes[kind]()]


def read_mesh(thing, matrix, material, materials):
    positions = np.array(thing["positions"], dtype=float) @ matrix[:3, :3].T + matrix[:3, 3]
    normals = thing.get("normals")
    if normals is not None:  # by the inverse transpose, and as long as that makes them
        normals = np.array(normals, dtype=float) @ np.linalg.inv(matrix[:3, :3])
    mirrored = np.linalg.det(matrix[:3, :3]) < 0.0
    triangles = []
    for face, (i, j, k) in enumerate(thing["faces"]):
        corners = [i, k, j] if mirrored else [i, j, k]  # keep the winding outward
        of_face = material
        for group, (first, end) in (thing.get("groups") or {}).items():
            if first <= face < end and group in (thing.get("materials") or {}):
                of_face = materials[thing["materials"][group]]

        def pick(values, corners=corners):
            return None if values is None else [[float(c) for c in values[at]] for at in corners]

        a, b, c = pick(positions)
        triangles.append(Triangle(a, b, c, of_face, pick(normals), pick(thing.get("uvs")), pick(thing.get("colors"))))
    return triangles


def read_model(thing, matrix, material, materials, model):
    """Return a mesh for each group of triangles of a model: eight numbers a vertex, x y z nx ny nz u v, v upwards.

    Which side of a triangle is the outer one is told by these normals, whatever the order of its corners.
    """
    if thing.get("normals", "file") != "file":
        raise NotImplementedError("the oracle takes a model's normals as the file has them")
    vertices = np.array(model["vertexdata"], dtype=float).reshape(-1, 8)
    faces = np.array(model["indexdata"]).reshape(-1, 3)
    positions = vertices[:, :3] @ matrix[:3, :3].T + matrix[:3, 3]
    normals = vertices[:, 3:6] @ np.linalg.inv(matrix[:3, :3])
    groups = sorted(model["groups"].items(), key=lambda item: item[1])  # by their first triangles
    if [first for _, (first, _) in groups] + [len(faces)] != [0] + [end for _, (_, end) in groups]:
        raise NotImplementedError("the oracle wants each triangle in a group")
    meshes = []
    for name, (first, end) in groups:
        of_group = (thing.get("materials") or {}).get(name)
        corners = faces[first:end]
        meshes.append(
            Mesh(
                positions[corners],
                material if of_group is None else materials[of_group],
                normals=normals[corners],
                uvs=vertices[corners, 6:8],
            )
        )
    return meshes
