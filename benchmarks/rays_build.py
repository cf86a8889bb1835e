"""One build in a process of its own: `benchmarks.rays` starts it, for us and for Embree in turn.

    python -m benchmarks.rays_build ours|embree MESH

Prints JSON: the CPU seconds of building, in the program and in the system, and by how many bytes the process has grown.
In a fresh process both pay for fresh memory, as a program that builds once does; inside one process Embree would pay
for it each time and we only the first, or the other way round, as the C library decides.

Invariant: two small meshes are built first, so that libraries are loaded, kernels compiled and threads started.
Embree's seconds are those of its commit, which the wheel does with the first ray; the wheel's own copying of the mesh,
more than half of the whole call, is not counted.
"""

import argparse
import json
import os
import resource
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rays_meshes import MESHES, Mesh, in_a_box, soup

EMBREE = "SMALTI_EMBREE"
PAGE = os.sysconf("SC_PAGE_SIZE")


def find_embree() -> None:
    """Look for the wheel also in the folder that SMALTI_EMBREE names, after all others."""
    folder = os.environ.get(EMBREE)
    if folder:
        sys.path.append(folder)


def resident_bytes() -> int:
    """Return the memory of this process; 0 where the system does not tell it this way."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE
    except OSError:
        return 0


def build_ours(mesh: Mesh) -> Callable[[], Any]:
    """Return what builds our tree."""
    from tracer.rays import RayCaster

    return lambda: RayCaster(*mesh)


def build_embree(mesh: Mesh) -> Callable[[], Any]:
    """Return what builds Embree's tree of a mesh that it holds already."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, *mesh)
    one = np.ones((1, 3), np.float32)

    def build() -> Any:
        scene.run(one, one)
        return scene

    return build


def main() -> int:
    """Build once and print what it cost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("who", choices=("ours", "embree"))
    parser.add_argument("mesh", choices=MESHES)
    options = parser.parse_args()
    find_embree()
    maker = build_ours if options.who == "ours" else build_embree
    for n_triangles in (30, 30_000):  # other kernels build small ones
        maker(in_a_box(soup(n_triangles)))()
    build = maker(MESHES[options.mesh]())
    before, memory = resource.getrusage(resource.RUSAGE_SELF), resident_bytes()
    built = build()
    after = resource.getrusage(resource.RUSAGE_SELF)
    grown = resident_bytes() - memory
    user, system = after.ru_utime - before.ru_utime, after.ru_stime - before.ru_stime
    print(json.dumps({"user_s": user, "system_s": system, "resident_bytes": grown}))
    del built
    return 0


if __name__ == "__main__":
    sys.exit(main())
