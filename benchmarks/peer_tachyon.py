"""Tachyon's side of `benchmarks/jobs.py`: the mirror box as a scene file, rendered by ``tachyon`` on one thread.

What is the same as ours: triangles (`TRI`, flat, lit on the side that is seen), eye and field of view, a point light
that does not fade, ambient share, planar mirrors, depth, linear colours. Samples of a pixel are its centre and as many
random places as are missing. Triangles without area are left out by Tachyon: the poles of the bumpy sphere.

Its coordinates are left-handed: the picture is mirrored when it is read. It samples pixel x, counted from 1, about x
and not x - 0.5: `FRUSTUM`, the picture's bounds at distance 1, takes that half pixel off. `ZOOM` is then of no account,
but expected.

Invariant: a picture's seconds are CPU seconds of the process less those of the same run with one pixel of one sample,
because Tachyon prints wall time alone; so they contain the 16-bit file that is written.
"""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks import mirrorbox
from benchmarks.peers import Turn, find_program, read_ppm, run_program, version_of

PROGRAM = "SMALTI_TACHYON"
# a light is a sphere to Tachyon, and seen
_LIGHT_RADIUS = 1e-9


def part_text(part: mirrorbox.Part) -> str:
    """Return a part's material and triangles; nine digits tell float32 values apart."""
    red, green, blue = part.diffuse
    material = (
        f"TEXDEF {part.name} AMBIENT {mirrorbox.AMBIENT} DIFFUSE 1 SPECULAR {part.mirror} OPACITY 1 "
        f"COLOR {red} {green} {blue} TEXFUNC 0\n"
    )
    row = f"TRI V0 %.9g %.9g %.9g V1 %.9g %.9g %.9g V2 %.9g %.9g %.9g {part.name}\n"
    return material + "".join(row % tuple(triangle) for triangle in part.vertices[part.faces].reshape(-1, 9).tolist())


def scene_text(scene: list[mirrorbox.Part], size: int, samples: int) -> str:
    """Return the scene file."""
    half = math.tan(math.radians(mirrorbox.FOV_DEG / 2))
    low, high = -half - half / size, half - half / size
    eye, light = (" ".join(map(str, place)) for place in (mirrorbox.EYE, mirrorbox.LIGHT))
    color = " ".join([str(mirrorbox.INTENSITY)] * 3)
    return "".join(
        [
            f"BEGIN_SCENE\nRESOLUTION {size} {size}\nCAMERA\nPROJECTION PERSPECTIVE\nZOOM {0.5 / half:.17g}\n",
            f"ASPECTRATIO 1\nANTIALIASING {samples - 1}\nRAYDEPTH {mirrorbox.DEPTH + 1}\n",
            f"CENTER {eye}\nVIEWDIR 0 0 -1\nUPDIR 0 1 0\n",
            f"FRUSTUM {low:.17g} {high:.17g} {low:.17g} {high:.17g}\nEND_CAMERA\n",
            f"LIGHT CENTER {light} RAD {_LIGHT_RADIUS} COLOR {color}\n",
            *(part_text(part) for part in scene),
            "END_SCENE\n",
        ]
    )


class Tachyon:
    """Tachyon, started anew for each picture.

    Raises
    ------
    benchmarks.peers.AbsentError
        It is not installed.
    """

    name = "Tachyon"

    def __init__(self, scene: list[mirrorbox.Part], folder: Path, size: int, samples: int) -> None:
        self.program = find_program(PROGRAM, "tachyon", "tachyon")
        self.version = ""
        self.folder = folder
        (folder / "tachyon.dat").write_text(scene_text(scene, size, samples))

    def run(self, picture: str, *options: str) -> tuple[float, str]:
        """Run with options; returns (CPU seconds, what it said)."""
        command = [self.program, "tachyon.dat", "-fullshade", "-numthreads", "1", "-format", "PPM48", "-o", picture]
        return run_program([*command, *options], self.folder)

    def render(self) -> Turn:
        """Render once, and one pixel once more."""
        reading_s, _ = self.run("pixel.ppm", "-res", "1", "1", "-aasamples", "0")
        process_s, said = self.run("tachyon.ppm")
        self.version = version_of(said)
        return Turn(process_s - reading_s, reading_s, process_s)

    def picture(self) -> NDArray[np.float64]:
        """Return the last picture."""
        return read_ppm(self.folder / "tachyon.ppm")[:, ::-1]

    def close(self) -> None:
        """Nothing runs between pictures."""
