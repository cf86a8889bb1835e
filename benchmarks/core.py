"""Speed of the kernel on a scene: every n-th block of the picture, in one thread, best of several runs.

``python -m benchmarks.core [scenes/mini-cornell.json] [--every 23] [--runs 3]``
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from benchmarks.local import compile_document
from tracer.native.warm import warm
from tracer.render import get_backend, list_blocks
from tracer.types import COUNTERS, SETTING_SAMPLES


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", nargs="?", type=Path, default=Path("scenes/mini-cornell.json"))
    parser.add_argument("--every", type=int, default=23, help="render every n-th block")
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    print(f"kernels ready after {warm():.1f} s")
    start = time.perf_counter()
    compiled = compile_document(json.loads(options.scene.read_bytes()), options.scene.parent)
    print(f"scene compiled in {time.perf_counter() - start:.2f} s, {len(compiled.face_vertices)} triangles")
    blocks = list_blocks(compiled)
    chosen = blocks[:: options.every].copy()
    samples = (0, int(compiled.settings[SETTING_SAMPLES]))
    seconds = []
    for _ in range(options.runs):
        start = time.thread_time()
        film = get_backend().render(compiled, chosen, samples, np.zeros(1, np.int64))
        seconds.append(time.thread_time() - start)
    best = min(seconds)
    counters = dict(zip(COUNTERS, film.counters.tolist(), strict=True))
    rays = sum(value for name, value in counters.items() if name.endswith("_rays"))
    for name, value in counters.items():
        print(f"  {name:28} {value / counters['samples']:8.4f} a sample")
    print(f"{1e6 * best / counters['samples']:.3f} us a sample, {rays / best / 1e6:.2f} Mrays/s (one thread)")
    print(f"the whole picture: {best * len(blocks) / len(chosen):.1f} CPU seconds")


if __name__ == "__main__":
    main()
