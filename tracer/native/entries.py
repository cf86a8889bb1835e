"""The kernels that Python calls, by name, and what calls them: an image's code where there is one, else numba's.

Invariant: this module does not import numba. A call whose arguments are not of the types below goes to numba's kernel,
which compiles for any.
"""

import os
import warnings
from collections.abc import Callable
from functools import lru_cache
from importlib import import_module
from typing import Any, Final

from tracer.native.image import ArgumentTypeError, Image, ImageError, load_image
from tracer.native.key import image_path, mark_use

# Arguments of each kernel: "i" int64, "d" float64, "f8:2" a C-contiguous array of float64 with two dimensions, "scene"
# a `tracer.types.CompiledScene`. Results are integers, as many as numba infers.
ENTRIES: Final[dict[str, tuple[str, ...]]] = {
    "tracer.accel.records.survey_vertices": ("f8:2", "f8:2"),
    "tracer.accel.records.survey_faces": ("f8:2", "i4:2", "f8:2"),
    "tracer.accel.records.make_records": ("f8:2", "i4:2", "i", "f8:1", "f4:2"),
    "tracer.accel.cells.count_cells": ("f8:2", "i4:2", "i", "i", "i", "f8:1", "f4:2", "i", "f4:2", "i4:1"),
    "tracer.accel.cells.split_cells": ("f4:2", "i4:2", "i", "i", "f4:2", "f4:2", "i4:1"),
    "tracer.accel.clusters.join_groups": ("f4:2", "f4:2", "i8:2", "f4:2", "i8:1"),
    "tracer.accel.cells.sort_records": (
        *("f8:2", "i4:2", "i", "i", "i", "f8:1", "f4:2", "i"),
        *("i4:1", "i8:1", "f4:2"),
    ),
    "tracer.accel.binary.bound_records": ("f4:2", "i", "i", "f4:2"),
    "tracer.accel.binary.build_binary": ("f4:2", "f4:2", "i", "i", "f4:1", "i", "i", "i8:2"),
    "tracer.accel.collapse.plan_nodes": ("f4:2", "i", "f4:2", "i4:2"),
    "tracer.accel.subtrees.build_subtree": ("f4:2", "i", "i", "i", "f4:2", "f4:2", "i4:2", "i"),
    "tracer.accel.emit.emit_single_leaf": ("f4:2", "f4:2", "i", "f8:2", "i4:2", "i8:1", "i", "i"),
    "tracer.accel.emit.emit_node": ("f4:2", "i4:2", "f4:2", "f8:2", "i4:2", "i", "i8:1", "i", "i", "i8:2"),
    "tracer.accel.emit.emit_subtree": ("f4:2", "i4:2", "f4:2", "f8:2", "i4:2", "i8:1", "i", "i"),
    "tracer.accel.binned.build_tree": ("f8:2", "i", "f8:2", "i4:2", "i4:1"),
    "tracer.render.inside.hash_places": ("f8:2", "u8:2", "u8:1"),
    "tracer.render.inside.is_closed": ("i4:2", "u8:1"),
    "tracer.render.inside.measure_ball": ("f8:2", "i4:2", "f8:1", "f8:1", "f8:1"),
    "tracer.render.contrast.measure_contrast": ("f8:5", "i4:2", "i", "i", "i", "f8:1"),
    "tracer.render.contrast.scale_sums": ("f8:5", "i8:1", "d"),
    # for another entry alone: see `build`
    "tracer.rays.packet.trace_packet": ("i", "i", "i", "i", "i", "i", "i", "i"),
    "tracer.rays.bundle.trace_alone": ("i", "i", "i", "i", "i", "i", "i"),
    "tracer.render.blocks.render_blocks": ("scene", "i4:2", "i", "i", "i8:1", "f8:5", "i8:1"),
}


def compiles_nothing() -> bool:
    """Whether NUMBA_DISABLE_JIT asks for plain Python."""
    return os.environ.get("NUMBA_DISABLE_JIT", "0") not in {"", "0"}


@lru_cache(maxsize=1)
def current_image() -> Image | None:
    """Map the image of this process's kernels; None where there is none, with a warning where it cannot be used."""
    if compiles_nothing():
        return None
    path = image_path()
    try:
        image = load_image(path, path.parent.name)
    except FileNotFoundError:
        return None
    except (OSError, ImageError) as error:
        warnings.warn(f"{error}: kernels are compiled anew; `smalti warm` mends it", RuntimeWarning, stacklevel=2)
        return None
    mark_use(path.parent)
    return image


def numba_kernel(name: str) -> Callable[..., Any]:
    """Return the kernel that numba compiles."""
    module, _, function = name.rpartition(".")
    kernel: Callable[..., Any] = getattr(import_module(module), function)
    return kernel


class Entry:
    """A kernel that Python calls.

    Parameters
    ----------
    name
        Of `ENTRIES`.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, *arguments: Any) -> Any:
        """Call the kernel; the GIL is not held meanwhile."""
        image = current_image()
        if image is not None:
            try:
                return image.doors[self.name](*arguments)
            except ArgumentTypeError:
                pass
        return numba_kernel(self.name)(*arguments)


def entry(name: str) -> Entry:
    """Return the kernel of a name.

    Raises
    ------
    KeyError
        It is not one of `ENTRIES`: an image would lack it.
    """
    if name not in ENTRIES:
        raise KeyError(name)
    return Entry(name)
