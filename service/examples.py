"""Examples for the OpenAPI document: one for each request and answer.

Job: plain values; tests send the requests and validate the answers, so that the examples cannot rot.
"""

from typing import Any, Final

from service import problems
from service.problems import FieldFault, Problem

JOB_ID: Final = "01jd9zk3v0w8m6x4q2r7t5y1ba"
SHA256: Final = "2cf24dba5fb0a30e26e83b2ac5b9e29e1b161e5c1fa7425e73043362938b9824"
_OTHER_SHA256: Final = "486ea46224d1bb4fb680f34f7c9ad96a8f24ec88be73ea8e5a6c65260e9cb8a7"
_URL: Final = f"/v1/jobs/{JOB_ID}"

SCENE: Final[dict[str, Any]] = {
    "version": 1,
    "camera": {"type": "perspective", "fov_deg": 40, "look_at": {"eye": [0, 1, 5], "target": [0, 0.6, 0]}},
    "image": {"width": 160, "height": 120},
    "integrator": {"type": "blinn_phong", "max_depth": 2},
    "sampling": {"samples": 4},
    "materials": {"red": {"type": "blinn_phong", "kd": [0.8, 0.15, 0.1], "kr": 0.2}},
    "lights": [{"type": "directional", "direction": [-1, -2, -1.5]}, {"type": "ambient", "intensity": 0.2}],
    "objects": [
        {"type": "sphere", "center": [0, 0.7, 0], "radius": 0.7, "material": "red"},
        {"type": "plane", "point": [0, 0, 0], "normal": [0, 1, 0]},
    ],
}

JOB_CREATE: Final[dict[str, Any]] = {
    "scene": SCENE,
    "output": {"png_color_space": "srgb", "tile_size": 64},
    "priority": 50,
    "name": "A red sphere",
}

JOB_RUNNING: Final[dict[str, Any]] = {
    "id": JOB_ID,
    "name": "A red sphere",
    "state": "rendering",
    "created_at": "2025-01-15T09:30:00.000000Z",
    "updated_at": "2025-01-15T09:30:00.120000Z",
    "progress": {
        "tiles_done": 2,
        "tiles_total": 6,
        "fraction": 0.333,
        "rays": 84000,
        "rays_per_s": 2100000.0,
        "eta_s": 0.1,
    },
    "image": {"width": 160, "height": 120},
    "samples": 4,
    "problem": None,
    "links": {
        "self": _URL,
        "events": f"{_URL}/events",
        "scene": f"{_URL}/scene",
        "cancel": f"{_URL}/cancel",
        "result_png": None,
        "result_exr": None,
        "preview_png": None,
        "report": None,
    },
}

JOB_DONE: Final[dict[str, Any]] = {
    **JOB_RUNNING,
    "state": "succeeded",
    "updated_at": "2025-01-15T09:30:00.410000Z",
    "progress": {
        "tiles_done": 6,
        "tiles_total": 6,
        "fraction": 1.0,
        "rays": 251000,
        "rays_per_s": 2200000.0,
        "eta_s": 0.0,
    },
    "links": {
        **JOB_RUNNING["links"],
        "cancel": None,
        "result_png": f"{_URL}/result.png",
        "result_exr": f"{_URL}/result.exr",
        "preview_png": f"{_URL}/preview.png",
        "report": f"{_URL}/report",
    },
}

JOB_PAGE: Final[dict[str, Any]] = {"jobs": [JOB_DONE], "next_cursor": None}

ESTIMATE: Final[dict[str, Any]] = {
    "scene_sha256": SHA256,
    "image": {"width": 160, "height": 120},
    "samples_per_pixel": 4,
    "samples_total": 76800,
    "rays_at_most": 460800,
    "cpu_seconds": 0.027,
    "tiles": 6,
    "memory_bytes": 105054208,
    "result_bytes": 288000,
    "store_bytes": 518400,
    "features": ["camera:perspective", "light:ambient", "light:directional", "object:plane", "object:sphere"],
    "skipped": ["crop", "emission", "textures", "transmission"],
    "assets_missing": [],
    "assets_never_loaded": [],
}

EVENTS: Final = (
    'event: created\ndata: {"seq":1,"state":"queued"}\nid: 1\n\n'
    'event: state\ndata: {"seq":2,"state":"preparing"}\nid: 2\n\n'
    'event: progress\ndata: {"state":"rendering","progress":{"tiles_done":2,"tiles_total":6}}\n\n'
)

ASSETS_QUERY: Final[dict[str, Any]] = {"sha256": [SHA256, _OTHER_SHA256]}
ASSETS_MISSING: Final[dict[str, Any]] = {"missing": [_OTHER_SHA256]}
ASSET_CREATED: Final[dict[str, Any]] = {"sha256": SHA256, "size_bytes": 5, "created": True}
ASSET_PRESENT: Final[dict[str, Any]] = {"sha256": SHA256, "size_bytes": 5, "created": False}

REPORT: Final[dict[str, Any]] = {"job_id": JOB_ID, "film_sha256": SHA256, "tiles": 6}

WORKERS: Final[dict[str, Any]] = {
    "workers": [
        {
            "name": "host-1",
            "host": "host",
            "pid": 4711,
            "state": "busy",
            "job_id": JOB_ID,
            "tile": 3,
            "seen_s": 0.4,
        }
    ]
}

READY: Final[dict[str, Any]] = {
    "status": "ready",
    "checks": {"store": "ok", "queue": "ok", "workers": "2 alive"},
}
HEALTH: Final[dict[str, Any]] = {"status": "ok", "version": "0.1.0"}

SCENE_SCHEMA: Final[dict[str, Any]] = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "$id": "urn:smalti:scene:1",
    "title": "Scene",
    "type": "object",
    "additionalProperties": False,
    "required": ["version", "camera", "image"],
}
"""Its head: the definitions of materials, lights and objects are left out."""
METRICS: Final = """\
# HELP smalti_jobs_accepted_total Jobs made durable and answered.
# TYPE smalti_jobs_accepted_total counter
smalti_jobs_accepted_total 12.0
# HELP smalti_workers_alive Live workers in the registry.
# TYPE smalti_workers_alive gauge
smalti_workers_alive 2.0
"""

_EXTRA: Final[dict[str, dict[str, Any]]] = {
    "illegal-transition": {"current_state": "succeeded", "allowed": []},
    "job-running": {"current_state": "rendering"},
    "result-not-ready": {"current_state": "rendering"},
    "result-never": {"current_state": "failed"},
    "assets-missing": {"missing": [_OTHER_SHA256]},
    "too-large": {"limit_bytes": 67108864},
    "service-not-ready": {"checks": {"store": "ok", "queue": "ok", "workers": "none alive"}},
}
_ERRORS: Final[dict[str, tuple[FieldFault, ...]]] = {
    "scene-invalid": (FieldFault("/scene/camera/fov_deg", "is 190", "a number >= 1e-06 and <= 179.999"),),
    "request-invalid": (FieldFault("/output/tile_size", "is 50", "a multiple of 16"),),
    "assets-missing": (FieldFault("/scene/assets/car", "is not in the store", "PUT /v1/assets/{sha256} first"),),
    "parameters-invalid": (FieldFault("/query/limit", 'is the text "0"', "a whole number >= 1 and <= 200"),),
}


def problem_example(kind: problems.ProblemType) -> dict[str, Any]:
    """Return a problem document of this kind."""
    problem = Problem(kind, kind.meaning, errors=_ERRORS.get(kind.slug, ()), extra=_EXTRA.get(kind.slug, {}))
    return problem.document("/v1/jobs", "6f1c0b5e9a7d4c32")


def answer(example: object, media_type: str = "application/json") -> dict[str, Any]:
    """Return the part of an OpenAPI response that shows an example."""
    return {"content": {media_type: {"example": example}}}
