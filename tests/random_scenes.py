"""Small random scene documents for comparing the kernels with the oracle.

Invariant: nothing coincides (no coplanar overlaps, no contact), because there the nearest surface is a matter of rounding.
"""

import numpy as np


def numbers(generator, low, high, count):
    return [round(float(x), 3) for x in generator.uniform(low, high, count)]


def number(generator, low, high):
    return numbers(generator, low, high, 1)[0]


def chance(generator, probability):
    return bool(generator.random() < probability)


def direction(generator):
    while True:
        v = generator.normal(size=3)
        if np.linalg.norm(v) > 0.3:
            return [round(float(x), 3) for x in v]


def color(generator, high=1.0):
    return numbers(generator, 0, high, 3) if chance(generator, 0.5) else number(generator, 0, high)


def random_material(generator, *, clear):
    material = {
        "type": "blinn_phong",
        "ka": color(generator),
        "kd": color(generator),
        "ks": color(generator),
        "exponent": number(generator, 0, 200),
        "ke": color(generator, 0.2),
        "two_sided": chance(generator, 0.7),
        "attenuation": {"a": number(generator, 0.2, 2), "b": number(generator, 0, 1), "c": number(generator, 0, 0.5)},
    }
    if chance(generator, 0.5):
        material["kr"] = color(generator)
    if clear:
        material |= {"kt": color(generator), "eta": number(generator, 0.5, 2.0)}
    return material


def random_transform(generator, spread=1.5):
    steps = []
    if chance(generator, 0.5):
        factor = numbers(generator, 0.6, 1.5, 3)
        if chance(generator, 0.3):
            factor[0] = -factor[0]
        steps.append({"type": "scale", "by": factor})
    if chance(generator, 0.7):
        steps.append({"type": "rotate", "axis": direction(generator), "angle_deg": number(generator, -180, 180)})
    if chance(generator, 0.2):
        rows = np.eye(4)
        rows[0, 1], rows[2, 0] = numbers(generator, -0.5, 0.5, 2)
        steps.append({"type": "matrix", "rows": rows.tolist()})
    return [*steps, {"type": "translate", "by": numbers(generator, -spread, spread, 3)}]


def random_mesh(generator, *, normals, textured=False):
    """Return a bumpy grid of triangles with normals that are neither unit nor perpendicular."""
    n = int(generator.integers(2, 4))
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij"), axis=-1).reshape(-1, 2)
    heights = generator.uniform(-0.4, 0.4, len(grid))
    positions = [
        [round(float(x), 3), round(float(y), 3), round(float(z), 3)] for (x, y), z in zip(grid, heights, strict=True)
    ]
    faces = []
    for i in range(n - 1):
        for j in range(n - 1):
            a = i * n + j
            faces += [[a, a + n, a + n + 1], [a, a + n + 1, a + 1]]
    mesh = {"type": "mesh", "positions": positions, "faces": faces}
    if normals:
        mesh["normals"] = [[*numbers(generator, -0.5, 0.5, 2), number(generator, 0.4, 2)] for _ in positions]
    if chance(generator, 0.5):
        mesh["colors"] = [numbers(generator, 0, 1, 3) for _ in positions]
    if textured:
        mesh["uvs"] = [numbers(generator, -1.5, 2.5, 2) for _ in positions]
    return mesh


def random_shape(generator):
    kind = generator.choice(["sphere", "box", "disk", "cylinder", "plane"])
    center = np.array(numbers(generator, -0.5, 0.5, 3))
    shape = {
        "sphere": {"center": center.tolist(), "radius": number(generator, 0.3, 0.9)},
        "box": {
            "min": (center - numbers(generator, 0.2, 0.8, 3)).tolist(),
            "max": (center + numbers(generator, 0.2, 0.8, 3)).tolist(),
        },
        "disk": {"center": center.tolist(), "normal": direction(generator), "radius": number(generator, 0.4, 1.2)},
        "cylinder": {
            "start": center.tolist(),
            "end": (center + direction(generator)).tolist(),
            "radius": number(generator, 0.2, 0.6),
            "capped": chance(generator, 0.7),
        },
        "plane": {"point": numbers(generator, -4, -2, 3), "normal": direction(generator)},
    }[str(kind)]
    return {"type": str(kind)} | shape


def random_light(generator):
    kind = str(generator.choice(["directional", "point", "spot"]))
    light = {"type": kind, "diffuse": color(generator), "specular": color(generator)}
    if chance(generator, 0.4):
        light["ambient"] = color(generator, 0.3)
    if kind != "point":
        light["direction"] = direction(generator)
    if kind != "directional":
        light["position"] = numbers(generator, -4, 4, 3)
    if kind == "spot":
        inner = number(generator, 0, 60)
        light |= {"inner_angle_deg": inner, "outer_angle_deg": inner + number(generator, 0, 25) + 1}
        if chance(generator, 0.8):  # at the middle of the scene, more or less
            light["direction"] = [
                round(-p + o, 3) for p, o in zip(light["position"], numbers(generator, -0.5, 0.5, 3), strict=True)
            ]
    return light


def random_camera(generator):
    eye = np.array(direction(generator))
    eye = eye / np.linalg.norm(eye) * generator.uniform(4, 6)
    pose = {
        "look_at": {
            "eye": [round(float(x), 3) for x in eye],
            "target": numbers(generator, -0.5, 0.5, 3),
            "up": [0.1, 1.0, 0.2],
        }
    }
    kind = int(generator.integers(4))
    if kind == 0:
        axis = str(generator.choice(["vertical", "horizontal"]))
        return {"type": "perspective", "fov_deg": number(generator, 25, 80), "fov_axis": axis} | pose
    if kind == 1:
        return {"type": "orthographic", "height": number(generator, 2, 5)} | pose
    plane = {
        "type": "view_plane",
        "left": -0.5,
        "right": number(generator, 0.3, 0.7),
        "bottom": -0.4,
        "top": 0.6,
        "distance": 0.9,
    }
    if kind == 2:
        return plane | pose
    # skewed and stretched on purpose: the document allows any invertible affine matrix
    return plane | {"matrix": [[1.0, 0.1, 0.05, 0.2], [0.0, 0.9, 0.0, 0.1], [0.0, 0.0, 1.1, 5.0], [0, 0, 0, 1]]}


def random_document(seed, *, clear=False, textured=False, shapes=True, size=32):
    """Return a scene document v1, one sample a pixel, nothing cut by throughput.

    ``clear`` gives most materials transmission, ``textured`` a texture of the asset "picture" to the first.
    """
    generator = np.random.default_rng(seed)
    names = ["first", "second", "third"]
    materials = {name: random_material(generator, clear=clear and chance(generator, 0.8)) for name in names}
    if textured:
        materials["first"]["diffuse_texture"] = {
            "asset": "picture",
            "wrap": str(generator.choice(["repeat", "clamp"])),
            "color_space": str(generator.choice(["srgb", "linear"])),
            "filter": str(generator.choice(["bilinear", "nearest"])),
        }
    objects = [random_mesh(generator, normals=chance(generator, 0.6), textured=textured) for _ in range(2)]
    if shapes:
        objects += [random_shape(generator) for _ in range(3)]
    for k, thing in enumerate(objects):
        thing["transform"] = random_transform(generator)
        # only meshes have texture coordinates that the oracle knows
        allowed = names if thing["type"] == "mesh" or not textured else names[1:]
        thing["material"] = names[0] if k == 0 else str(generator.choice(allowed))
    if len(objects[0]["faces"]) > 2 and not textured:
        objects[0] |= {"groups": {"Half": [0, 2]}, "materials": {"Half": "second"}}
    return {
        "version": 1,
        "camera": random_camera(generator),
        "image": {"width": size, "height": size - 8},
        "integrator": {
            "type": "blinn_phong",
            "max_depth": int(generator.integers(0, 4)),
            "shadows": chance(generator, 0.8),
            "min_throughput": 0.0,
        },
        "sampling": {
            "samples": 1,
            "sampler": str(generator.choice(["sobol", "independent", "stratified"])),
            "seed": int(generator.integers(2**32)),
        },
        "background": color(generator, 0.5),
        "lights": [{"type": "ambient", "intensity": color(generator, 0.2)}]
        + [random_light(generator) for _ in range(int(generator.integers(1, 4)))],
        "materials": materials,
        "objects": objects,
    }
