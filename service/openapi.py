"""The OpenAPI document: bodies that routes read themselves, problems by status, the scene's schema.

Job: complete what FastAPI derives from the routes.
Invariant: made from the same models and catalogue that the routes use; nothing is described twice.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema
from starlette.routing import BaseRoute

from service import examples
from service.problems import MEDIA_TYPE, PARAMETERS_INVALID, ProblemType
from service.schemas import AssetQuery, FaultView, JobCreate, ProblemView

_REF: Final = "#/components/schemas/{model}"

DESCRIPTION: Final = """\
Send a scene, get the picture.

* `POST /v1/jobs` answers 202 once the job is on disk. Every later fault costs time, never the job.
* `GET /v1/jobs/{id}/events` streams what happens; `Prefer: wait=30` waits in the POST itself.
* Assets (meshes, textures) are uploaded once under their SHA-256 and named by it in the scene.
* A query parameter that a call does not know is refused with 422: a mistyped `validate_only` starts nothing.
* Every error is a problem document (RFC 9457) with a stable `type`; 422 lists every fault with a JSON pointer.
"""

TAGS: Final = [
    {"name": "jobs", "description": "Submit scenes, follow them, cancel and delete them."},
    {"name": "results", "description": "The pictures and the report of a job."},
    {"name": "assets", "description": "Meshes and textures, by their SHA-256."},
    {"name": "service", "description": "The service itself."},
]


def json_body(model: type[BaseModel], values: Mapping[str, object]) -> dict[str, Any]:
    """Return ``openapi_extra`` for a route that reads a JSON body of this model by itself."""
    named = {name: {"value": value} for name, value in values.items()}
    schema = {"$ref": _REF.format(model=model.__name__)}
    return {"requestBody": {"required": True, "content": {"application/json": {"schema": schema, "examples": named}}}}


def problem_answers(*listed: ProblemType) -> dict[int | str, dict[str, Any]]:
    """Return ``responses`` with these kinds of problems, by status, with an example for each."""
    answers: dict[int | str, dict[str, Any]] = {}
    for status in sorted({kind.status for kind in listed}):
        kinds = [kind for kind in listed if kind.status == status]
        answers[status] = {
            "description": "; ".join(kind.title for kind in kinds),
            "content": {
                MEDIA_TYPE: {
                    "schema": {"$ref": _REF.format(model=ProblemView.__name__)},
                    "examples": {
                        kind.slug: {"summary": kind.title, "value": examples.problem_example(kind)} for kind in kinds
                    },
                }
            },
        }
    return answers


def build_openapi(app: FastAPI, routes: Sequence[BaseRoute]) -> dict[str, Any]:
    """Return the OpenAPI document of the app, whose own routes are `routes`."""
    document = get_openapi(
        title=app.title,
        version=app.version,
        summary=app.summary,
        description=app.description,
        routes=app.routes,
        tags=TAGS,
        license_info={"name": "MIT", "identifier": "MIT"},
    )
    received = [(model, "validation") for model in (JobCreate, AssetQuery, ProblemView, FaultView)]
    _, schemas = models_json_schema(received, ref_template=_REF)  # type: ignore[arg-type]
    components = document.setdefault("components", {}).setdefault("schemas", {})
    for name, schema in schemas["$defs"].items():
        components.setdefault(name, schema)
    declared_answers = {
        route.unique_id: {str(status): answer for status, answer in route.responses.items()}
        for route in routes
        if isinstance(route, APIRoute)
    }
    # FastAPI's own 422 speaks of a model that is never sent here.
    for path in document["paths"].values():
        for operation in path.values():
            answers = operation["responses"]
            declared = declared_answers.get(operation["operationId"], {})
            for status, answer in answers.items():
                for media_type, content in declared.get(status, {}).get("content", {}).items():
                    # FastAPI drops every null, also those inside examples.
                    restored = {key: value for key, value in content.items() if key.startswith("example")}
                    answer["content"][media_type].update(restored)
            if "application/json" in answers.get("422", {}).get("content", {}):
                del answers["422"]["content"]["application/json"]
                answers.update({str(key): value for key, value in problem_answers(PARAMETERS_INVALID).items()})
            # Any call may be sent with a query parameter that it does not know.
            answers.setdefault("422", problem_answers(PARAMETERS_INVALID)[422])
            answers.setdefault("default", _any_problem())
    components.pop("HTTPValidationError", None)
    components.pop("ValidationError", None)
    return document


def _any_problem() -> dict[str, Any]:
    """Return the answer for all other errors: unknown route or host, wrong method, a fault of the service."""
    schema = {"$ref": _REF.format(model=ProblemView.__name__)}
    return {"description": "Any other problem", "content": {MEDIA_TYPE: {"schema": schema}}}
