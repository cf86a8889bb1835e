"""Where data outside the repository is found, and what to say where it is not.

Invariant: nothing is downloaded; the one variable is ``SMALTI_DATA`` (default: ``shared`` beside the repository).
"""

import os
from pathlib import Path

REPOSITORY = Path(__file__).parent.parent
DATA = Path(os.environ.get("SMALTI_DATA") or REPOSITORY.parent / "shared")


class MissingDataError(Exception):
    """Data outside the repository is not there; the message says what to get, and from where."""


def seed_file(name: str) -> Path:
    """Return the path of a file of the seed data, or raise MissingDataError."""
    path = DATA / "seed" / name
    if not path.is_file():
        raise MissingDataError(
            f"{path} is missing.\n"
            "Get the reference pictures (box-*.png) and the model (mini_*.json, mini_body_diffuse.png) of the public\n"
            "repository github.com/WhoFama24/cse6413-raytracer, commit 167f0b0 (MIT licence), and\n"
            "reference_scenes.json, which holds its scenes as numbers; put them into a folder seed/, and set\n"
            "SMALTI_DATA to the folder that holds seed/."
        )
    return path
