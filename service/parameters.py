"""Query parameters that a route does not know are refused, not ignored.

Job: one dependency, which the app puts before every route; a mistyped `validate_only` must not start a render.
Invariant: what a route knows is read off its own declaration, so that no list can lag behind.
"""

import difflib
from collections.abc import Iterator

from fastapi import Request
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute

from service import problems
from service.validation import invalid
from tracer.scene.faults import Fault, pointer_of


async def refuse_unknown(request: Request) -> None:
    """Raise the 422 problem that names every query parameter which the request's route does not declare."""
    if not request.query_params:
        return
    route = request.scope.get("route")
    known = sorted(set(_declared(route.dependant))) if isinstance(route, APIRoute) else []
    unknown = [name for name in request.query_params if name not in known]
    if unknown:
        faults = [
            Fault(pointer_of("query", name), "is not a parameter of this call", _right(name, known)) for name in unknown
        ]
        raise invalid(problems.PARAMETERS_INVALID, faults)


def _declared(dependant: Dependant) -> Iterator[str]:
    """Yield the names of the query parameters of a route and of what it depends on."""
    yield from (field.alias for field in dependant.query_params)
    for inner in dependant.dependencies:
        yield from _declared(inner)


def _right(name: str, known: list[str]) -> str:
    """Say what would be right in place of a name: the nearest known one first."""
    if not known:
        return "no query parameters"
    folded = name.lower().replace("-", "_")
    near = difflib.get_close_matches(folded, known, n=1, cutoff=0.6)
    others = [one for one in known if one not in near]
    if not near:
        return " or ".join(known)
    return f"{near[0]}; also known: {', '.join(others)}" if others else near[0]
