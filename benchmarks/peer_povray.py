"""POV-Ray's side of `benchmarks/jobs.py`: the mirror box as a scene file, rendered by ``povray`` on one thread.

What is the same as ours: triangles (`mesh2`, flat), eye and field of view, a point light that does not fade, ambient
share, planar mirrors, depth, linear colours. Surfaces are lit on the side that is seen, which is POV-Ray's default.

Samples: its antialiasing without adaptation (``+AM1 +A0.0 +R4``) takes the pixel's centre beside the 4 x 4 samples, and
rays outside its tiles: 17.06 rays a pixel here. So the picture is rendered with pixels of a sample each, 4 x 4 for one
of ours, and averaged when it is read: 16 rays exactly, and the CPU time a little less.

Invariant: a picture's seconds are the CPU seconds that POV-Ray prints for tracing; files are neither read nor written
in them.
"""

import math
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks import mirrorbox
from benchmarks.peers import Turn, find_program, read_ppm, run_program, version_of

PROGRAM = "SMALTI_POVRAY"
_CPU_S = r"{} Time.*?with\s+([\d.]+)\s+CPU-seconds"


def vector(values: tuple[float, float, float]) -> str:
    """Return numbers as POV-Ray writes vectors."""
    return f"<{','.join(map(str, values))}>"


def mesh_text(part: mirrorbox.Part) -> str:
    """Return a part as a `mesh2` with its material; nine digits tell float32 values apart."""
    vertices = ",\n".join(f"<{x:.9g},{y:.9g},{z:.9g}>" for x, y, z in part.vertices.tolist())
    faces = ",\n".join(f"<{a},{b},{c}>" for a, b, c in part.faces.tolist())
    finish = f"ambient {mirrorbox.AMBIENT} diffuse 1 brilliance 1 phong 0 specular 0 reflection {part.mirror}"
    return (
        f"mesh2 {{\nvertex_vectors {{ {len(part.vertices)},\n{vertices} }}\n"
        f"face_indices {{ {len(part.faces)},\n{faces} }}\n"
        f"pigment {{ rgb {vector(part.diffuse)} }} finish {{ {finish} }}\n}}\n"
    )


def scene_text(scene: list[mirrorbox.Part]) -> str:
    """Return the scene file. `right` is +x for a view along -z: that makes the coordinates right-handed."""
    distance = 0.5 / math.tan(math.radians(mirrorbox.FOV_DEG / 2))
    return "".join(
        [
            "#version 3.7;\n",
            f"global_settings {{ assumed_gamma 1.0 max_trace_level {mirrorbox.DEPTH + 1} }}\n",
            f"camera {{ perspective location {vector(mirrorbox.EYE)}",
            f" up y right x direction <0,0,{-distance:.17g}> }}\n",
            f"light_source {{ {vector(mirrorbox.LIGHT)} rgb {mirrorbox.INTENSITY} }}\n",
            *(mesh_text(part) for part in scene),
        ]
    )


class PovRay:
    """POV-Ray, started anew for each picture.

    Raises
    ------
    benchmarks.peers.AbsentError
        It is not installed.
    ValueError
        ``samples`` is not a square.
    """

    name = "POV-Ray"

    def __init__(self, scene: list[mirrorbox.Part], folder: Path, size: int, samples: int) -> None:
        self.program = find_program(PROGRAM, "povray", "povray")
        self.version = ""
        self.folder = folder
        self.size, self.edge = size, math.isqrt(samples)
        if self.edge**2 != samples:
            raise ValueError(f"samples: {samples}: expected a square, such as 16")
        (folder / "povray.pov").write_text(scene_text(scene))

    def render(self) -> Turn:
        """Render once."""
        pixels = self.size * self.edge
        resolution = [f"+W{pixels}", f"+H{pixels}", "-A"]
        files = ["+Ipovray.pov", "+Opovray.ppm", "+FP16", "File_Gamma=1.0", "-D", "-V"]
        process_s, said = run_program([self.program, *files, *resolution, "+WT1"], self.folder)
        self.version = version_of(said)
        found = [re.search(_CPU_S.format(step), said, re.DOTALL) for step in ("Parse", "Bounding", "Trace")]
        parsing, bounding, tracing = (float(match[1]) if match else math.nan for match in found)
        if math.isnan(parsing + bounding + tracing):
            raise RuntimeError("POV-Ray told no CPU seconds")
        return Turn(tracing, parsing + bounding, process_s)

    def picture(self) -> NDArray[np.float64]:
        """Return the last picture."""
        samples = read_ppm(self.folder / "povray.ppm").reshape(self.size, self.edge, self.size, self.edge, 3)
        pixels: NDArray[np.float64] = samples.mean(axis=(1, 3))
        return pixels

    def close(self) -> None:
        """Nothing runs between pictures."""
