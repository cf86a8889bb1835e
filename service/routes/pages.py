"""Pages for people: the landing page with the recent jobs, and the API reference.

Job: static files, and one page made from the OpenAPI document.
Invariant: nothing is loaded from elsewhere, no script or style stands inline (the Content-Security-Policy forbids it),
and every text that is put into markup is escaped.
"""

from pathlib import Path
from typing import Final

from fastapi import APIRouter, Request
from fastapi.responses import Response

from service import problems
from service.problems import Problem
from service.reference import render_reference
from service.results import answer_bytes

router = APIRouter(include_in_schema=False)

_FOLDER: Final = Path(__file__).resolve().parents[1] / "static"
_TYPES: Final = {
    "page.css": "text/css; charset=utf-8",
    "page.js": "text/javascript; charset=utf-8",
    "icon.svg": "image/svg+xml",
}
_HTML: Final = "text/html; charset=utf-8"


@router.get("/")
def get_landing(request: Request) -> Response:
    """Return the landing page."""
    return answer_bytes(request, (_FOLDER / "index.html").read_bytes(), _HTML)


@router.get("/static/{name}")
def get_static(request: Request, name: str) -> Response:
    """Return one of the page's files; no other name is ever looked up."""
    if name not in _TYPES:
        raise Problem(problems.ROUTE_NOT_FOUND, "There is no such file.")
    return answer_bytes(request, (_FOLDER / name).read_bytes(), _TYPES[name])


@router.get("/docs")
def get_docs(request: Request) -> Response:
    """Return the API reference."""
    return answer_bytes(request, render_reference(request.app.openapi()).encode(), _HTML)
