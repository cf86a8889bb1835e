"""Where rays come from and what becomes of them.

Camera rays, the spawning of secondary rays; and against triangles: the exact predicate, the traversals of the wide
tree, and `RayCaster`, their public door.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tracer.rays.caster import Hits, RayCaster

__all__ = ["Hits", "RayCaster"]


def __getattr__(name: str) -> Any:
    """Load the caster when it is asked for: numba comes in with it."""
    if name in __all__:
        from tracer.rays import caster

        return getattr(caster, name)
    raise AttributeError(name)
