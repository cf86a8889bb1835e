"""``make stress``: the stress suite at full size, one row a test.

python -m tests.numerics [--only N1,N2] [--scale 1.0] [--processes 2]
"""

import argparse
import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # as pytest does for these modules

from suite import ELSEWHERE, TESTS, WAITING, run_all


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(TESTS))
    parser.add_argument("--scale", type=float, default=1.0, help="1 is full size, 0 as small as pytest")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    options = parser.parse_args()
    names = options.only.split(",")
    if unknown := [name for name in names if name not in TESTS]:
        parser.error(f"{', '.join(unknown)}: expected some of {', '.join(TESTS)}")
    start = time.perf_counter()
    rows = run_all(names, options.scale, options.processes, lambda row: print(row.line(), flush=True))
    for name, where in sorted({**ELSEWHERE, **WAITING}.items(), key=lambda item: int(item[0][1:])):
        print(f"{name:4s} {where}")
    failed = [row.test for row in rows if not row.good]
    print(
        f"{sum(row.cases for row in rows):,} cases in {time.perf_counter() - start:.0f} s; "
        + (f"FAILED: {', '.join(failed)}" if failed else "all good")
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
