"""Mitsuba's side of `benchmarks/jobs.py`: runs under an interpreter that has ``mitsuba``, and needs nothing of ours.

    python peer_mitsuba.py SCENE.npz PICTURE.npy     a line on standard input: a picture; its CPU seconds as JSON
    python peer_mitsuba.py --start                   a 64 x 64 picture by `scalar_rgb`, for the time from process start

The integrator does what the mirror box needs and no more: closest hit, one shadow ray, diffuse and ambient light, the
mirror's ray; colours come from one table, not from BSDF plugins. One thread.
"""

import json
import sys
import time
from typing import Any

import numpy as np


def load_scene(mi: Any, path: str) -> tuple[Any, Any]:
    """Return (scene, the file's arrays)."""
    arrays = np.load(path)
    fov, _, _, size, samples, _ = arrays["numbers"]
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": float(fov),
            "fov_axis": "y",
            "to_world": mi.ScalarTransform4f().look_at(
                origin=arrays["eye"].tolist(), target=arrays["target"].tolist(), up=[0, 1, 0]
            ),
            "film": {
                "type": "hdrfilm",
                "width": int(size),
                "height": int(size),
                "rfilter": {"type": "box"},
                "component_format": "float32",
            },
            "sampler": {"type": "independent", "sample_count": int(samples)},
        },
    }
    for i in range(len(arrays["mirror"])):
        vertices, faces = arrays[f"vertices{i}"], arrays[f"faces{i}"]
        properties = mi.Properties()
        properties["face_normals"] = True
        mesh = mi.Mesh(f"part{i}", len(vertices), len(faces), properties)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = vertices.ravel()
        parameters["faces"] = faces.astype(np.uint32).ravel()
        parameters.update()
        scene[f"part{i}"] = mesh
    return mi.load_dict(scene), arrays


def make_integrator(mi: Any, dr: Any, scene: Any, arrays: Any) -> Any:
    """Return the integrator, with the scene's colours in it."""
    _, intensity, ambient, _, _, depth = (float(x) for x in arrays["numbers"])
    # shapes are known in kernels by their number in a registry: the table is laid out by it
    numbers = dr.reinterpret_array(mi.UInt32, mi.ShapePtr(scene.shapes())).numpy()
    table = np.zeros((int(max(numbers)) + 1, 4), np.float32)
    for shape, number in zip(scene.shapes(), numbers, strict=True):
        part = int(shape.id().removeprefix("part"))
        table[number, :3], table[number, 3] = arrays["diffuse"][part], arrays["mirror"][part]
    colors, mirrors = mi.Float(table[:, :3].ravel()), mi.Float(table[:, 3].copy())
    light = mi.Point3f(*arrays["light"].tolist())

    class Whitted(mi.SamplingIntegrator):  # type: ignore[name-defined, misc]
        def __init__(self, properties: Any) -> None:
            super().__init__(properties)

        def sample(  # type: ignore[no-untyped-def]
            self,
            scene,  # noqa: ANN001
            sampler,  # noqa: ANN001, ARG002
            ray,  # noqa: ANN001
            medium=None,  # noqa: ANN001, ARG002
            active=True,  # noqa: ANN001
        ) -> Any:
            def bounce(ray: Any, radiance: Any, weight: Any, seen: Any, level: Any, active: Any) -> Any:
                si = scene.ray_intersect(ray, mi.RayFlags.Minimal, False, active)
                active &= si.is_valid()
                seen |= active
                n = dr.select(dr.dot(si.n, ray.d) > 0, -si.n, si.n)
                number = dr.reinterpret_array(mi.UInt32, si.shape)
                color = dr.gather(mi.Color3f, colors, number, active)
                mirror = dr.gather(mi.Float, mirrors, number, active)
                to_light = light - si.p
                cosine = dr.dot(n, to_light) * dr.rsqrt(dr.squared_norm(to_light))
                lit = active & (cosine > 0)
                lit &= ~scene.ray_test(si.spawn_ray_to(light), lit)
                strength = ambient + dr.select(lit, cosine * intensity, 0.0)
                radiance += dr.select(active, weight * color * strength, 0.0)
                weight *= mirror
                active &= (mirror > 0) & (level < int(depth))
                ray = si.spawn_ray(ray.d - 2 * dr.dot(ray.d, n) * n)
                return ray, radiance, weight, seen, level + 1, active

            state = (mi.Ray3f(ray), mi.Color3f(0.0), mi.Float(1.0), mi.Bool(False), mi.UInt32(0), mi.Bool(active))
            _, radiance, _, seen, _, _ = dr.while_loop(state, lambda *state: state[-1], bounce)
            return radiance, seen, []

    return Whitted(mi.Properties())


def serve(scene_path: str, picture_path: str) -> None:
    """Render a picture for each line of standard input."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(1)
    scene, arrays = load_scene(mi, scene_path)
    integrator = make_integrator(mi, dr, scene, arrays)
    samples = int(arrays["numbers"][4])
    for seed, _line in enumerate(sys.stdin):
        start = time.process_time()
        image = mi.render(scene, integrator=integrator, spp=samples, seed=seed)
        dr.eval(image)
        dr.sync_thread()
        seconds = time.process_time() - start
        np.save(picture_path, np.array(image, np.float32)[..., :3])
        print(json.dumps({"cpu_s": seconds, "version": mi.__version__}), flush=True)


def start() -> None:
    """Render one small picture as fast as a fresh process can."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    description = mi.cornell_box()
    description["sensor"]["film"]["width"] = description["sensor"]["film"]["height"] = 64
    description["integrator"] = {"type": "direct"}
    np.array(mi.render(mi.load_dict(description), spp=4))


if __name__ == "__main__":
    if sys.argv[1:] == ["--start"]:
        start()
    else:
        serve(*sys.argv[1:])
