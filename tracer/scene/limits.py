"""Every bound of the scene document, in one place, each with its reason.

Invariant: a document inside these bounds can be compiled and rendered without an overflow of float64 in a product of
a few lengths, and be refused or accepted in bounded time and memory.
"""

from typing import Final

# --- the text -----------------------------------------------------------------------------------------------------

MAX_TEXT_BYTES: Final = 64 * 1024 * 1024
"""Length of the JSON text. About 600,000 inline triangles; larger meshes belong into an asset, which is streamed."""

MAX_DEPTH: Final = 64
"""Nesting of arrays and objects. The deepest legal value has 6 levels; a recursive reader needs a bound."""

MAX_CONTAINERS: Final = 4_000_000
"""Opening brackets in the text, counted before parsing: an empty list costs 64 bytes in memory and 3 in the text."""

MAX_ITEMS: Final = 16_000_000
"""Commas in the text, counted before parsing, for the same reason: 64 MB of `"ab",` would be 800 MB of strings."""

MAX_NODES: Final = 250_000
"""Values outside arrays of numbers (and of rows of numbers). Each can earn a fault, and a fault costs about 1 KB."""

MAX_FAULTS: Final = 200
"""Faults told at once. Nobody reads more, and an answer stays below 100 KB; the last one tells how many were left."""

MAX_ROW_FAULTS: Final = 10
"""Faults told of one array of numbers, such as a mesh's positions: they mostly have one cause."""

# --- numbers ------------------------------------------------------------------------------------------------------

MAX_COORDINATE: Final = 1e30
"""Size of a coordinate: fits float32 boxes (3.4e38), and a product of ten lengths fits float64 (1.8e308)."""

MIN_LENGTH: Final = 1e-30
"""Shortest radius, distance or direction: its square (1e-60) and the inverse of that are far inside float64."""

MAX_TEXTURE_COORDINATE: Final = 1e9
"""Size of u and v: times a texture side of 65,536 it stays below 2^46, so the texel's index is exact."""

MAX_COLOR: Final = 1e6
"""Size of a colour or coefficient: 33 factors along the deepest path times light and sum stay below 1e220."""

MAX_EXPONENT: Final = 1e6
"""Specular exponent; at 1e6 the highlight is 0.1 degrees wide, a quarter of the sun's disk."""

MAX_ATTENUATION: Final = 1e30
"""Size of a, b and c of the attenuation: as coordinates, c is multiplied by a squared distance."""

MIN_ATTENUATION: Final = 1e-30
"""Least a, b and c of the attenuation beside 0: 1 / a of a denormal a is infinite, and that times black is NaN."""

MIN_ETA: Final = 0.01
MAX_ETA: Final = 100.0
"""Index of refraction relative to the outside; matter has 1 to 4, and its inverse must be expressible, too."""

MIN_FOV_DEG: Final = 1e-6
MAX_FOV_DEG: Final = 179.999
"""Field of view: at both ends a pixel's direction still differs from its neighbour's by more than float64's spacing."""

MIN_UP_SINE: Final = 1e-9
"""Sine between `up` and the viewing direction: rounding (1e-16) over 1e-9 turns the picture by at most 1e-7, which is
less than 0.01 pixel across 65,536 of them; below, the sideways axis is made of rounding errors."""

# --- counts -------------------------------------------------------------------------------------------------------

MAX_IMAGE_SIDE: Final = 65_536
"""Pixels along one side: block coordinates (16 px) fit 12 bits and pixel numbers 32 bits."""

MAX_SAMPLES_PER_PIXEL: Final = 65_536
"""Samples per pixel: beyond 2^16 points a Sobol' sequence in 32 bits has no strata left for two dimensions."""

MAX_TOTAL_SAMPLES: Final = 2**38
"""Pixels times samples: 2.7e11, about three days of one core at a million samples a second."""

MAX_DEPTH_OF_RAYS: Final = 32
"""Bounces after the primary ray: two mirrors of 0.8 leave 0.0008 of the light after 32."""

MAX_SEED: Final = 2**32 - 1
"""The seed is one 32-bit word of the random number's key."""

MAX_OBJECTS: Final = 10_000
MAX_LIGHTS: Final = 1_000
MAX_MATERIALS: Final = 10_000
MAX_ASSETS: Final = 1_000
MAX_COMPANIONS: Final = 1_000
MAX_GROUPS: Final = 10_000
"""Entries of the tables: hand-written and exported scenes stay far below; a mesh carries the rest."""

MAX_TRANSFORMS: Final = 64
"""Steps of one transform list; the product of so many matrices still rounds below 1e-13."""

MAX_NAME_LENGTH: Final = 256
"""Characters of a name: names are repeated in faults, logs and reports."""

MAX_FILE_NAME_LENGTH: Final = 1024
"""Characters of a file name with its folders; file systems allow 4,096 bytes, 4 a character."""
