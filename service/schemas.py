"""The bodies of the API: what a client may send and what it gets back.

Job: pydantic models at the edge; they make the OpenAPI document, too.
Invariant: what comes in forbids unknown members; what goes out has every member, null where nothing is known, so that
a client never has to ask whether a member exists. The scene itself is `tracer.scene.SceneDoc`, unchanged.
"""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints

from tracer.scene import SceneDoc
from worker.contract import BLOCK_PX, MAX_TILE_PX, MIN_TILE_PX
from worker.states import JobState

Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$", strict=True)]
Time = Annotated[str, Field(description="RFC 3339 in UTC.", json_schema_extra={"format": "date-time"})]


def _check_text(value: str) -> str:
    """Refuse what UTF-8 cannot encode; JSON can smuggle it in as a backslash-u escape of half a pair."""
    value.encode()  # UnicodeEncodeError is a ValueError: pydantic makes a fault of it
    return value


class Received(BaseModel):
    """Base of what clients send: unknown members are faults, texts are no numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Sent(BaseModel):
    """Base of what clients get."""

    model_config = ConfigDict(frozen=True)


class OutputOptions(Received):
    """How the picture is written."""

    png_color_space: Literal["srgb", "linear"] = Field(
        default="srgb", description="Encoding of result.png; the EXR is linear in any case."
    )
    tile_size: int | None = Field(
        default=None,
        ge=MIN_TILE_PX,
        le=MAX_TILE_PX,
        multiple_of=BLOCK_PX,
        description="Edge of a tile, px; chosen by the amount of work where it lacks. The bytes do not depend on it.",
    )


class JobOptions(Received):
    """All of a job request but the scene."""

    output: OutputOptions = OutputOptions()
    priority: int = Field(default=50, ge=0, le=100, description="Higher is served earlier.")
    name: Annotated[str, AfterValidator(_check_text)] | None = Field(
        default=None, min_length=1, max_length=200, description="A title for lists; the scene's own name by default."
    )


class JobCreate(JobOptions):
    """A job request."""

    scene: SceneDoc = Field(description="Scene document, version 1; assets by SHA-256.")


class AssetQuery(Received):
    """A question: which of these assets are missing."""

    sha256: list[Sha256] = Field(max_length=10_000, description="Hashes, 64 lowercase hexadecimal digits each.")


class AssetAnswer(Sent):
    """The assets that are not in the store, in the order asked, each once."""

    missing: list[Sha256]


class AssetView(Sent):
    """One asset in the store."""

    sha256: Sha256
    size_bytes: int
    created: bool = Field(description="Whether this request stored it.")


class ImageView(Sent):
    """Size of the picture, px."""

    width: int
    height: int


class Progress(Sent):
    """How far a job is. Counted from the store when the queue is away; rates are null then."""

    tiles_done: int
    tiles_total: int
    fraction: float = Field(ge=0, le=1)
    rays: int | None = Field(description="Rays traced so far, of all kinds.")
    rays_per_s: float | None
    eta_s: float | None = Field(description="Seconds until the end, estimated from the tiles so far.")


class JobLinks(Sent):
    """Where to go from here; those of the results are null until they exist."""

    self: str
    events: str
    scene: str
    cancel: str | None = Field(description="POST here to cancel; null when the job has ended.")
    result_png: str | None
    result_exr: str | None
    preview_png: str | None
    report: str | None


class JobProblem(BaseModel):
    """Why a job failed: an RFC 9457 problem, with further members such as the file."""

    model_config = ConfigDict(extra="allow", frozen=True)

    type: str
    title: str
    detail: str | None = None


class JobView(Sent):
    """A job as it stands."""

    id: str
    name: str | None
    state: JobState
    created_at: Time
    updated_at: Time
    progress: Progress
    image: ImageView
    samples: int
    problem: JobProblem | None
    links: JobLinks


class JobPage(Sent):
    """A page of jobs, newest first."""

    jobs: list[JobView]
    next_cursor: str | None = Field(description="The next page's cursor; null at the end.")


class EventView(Sent):
    """One event of a job's history, as in the event stream."""

    seq: int
    at: Time
    type: str
    state: JobState
    previous: JobState | None
    by: str
    detail: dict[str, Any] | None


class Estimate(Sent):
    """What a job would take, without making it."""

    scene_sha256: Sha256
    image: ImageView
    samples_per_pixel: int
    samples_total: int
    rays_at_most: int = Field(description="Upper bound: every path to full depth, every light asked at each point.")
    cpu_seconds: float = Field(
        description="Rough: by samples, lights and bounces, at 30 million rays a second and core, summed over all "
        "cores. Scenes of shapes and glass take several times longer; preparing a scene comes on top."
    )
    tiles: int
    memory_bytes: int = Field(description="One worker's memory for the inline scene and one tile; assets come on top.")
    result_bytes: int = Field(description="Size of the pictures without compression.")
    store_bytes: int = Field(description="Most that the job takes of the store while it runs: tiles and pictures.")
    features: list[str] = Field(description="What the scene uses.")
    skipped: list[str] = Field(description="What the scene does not use.")
    assets_missing: list[str] = Field(description="Names of assets that have to be uploaded first.")
    assets_never_loaded: list[str] = Field(description="Names in the assets table that nothing uses.")


class WorkerView(Sent):
    """A live worker."""

    name: str
    host: str | None
    pid: int | None
    state: str | None
    job_id: str | None
    tile: int | None
    seen_s: float | None = Field(description="Seconds since its last sign of life.")


class WorkerList(Sent):
    """The live workers."""

    workers: list[WorkerView]


class Health(Sent):
    """The process answers."""

    status: Literal["ok"] = "ok"
    version: str


class Readiness(Sent):
    """Whether jobs are accepted, queued and rendered; each check on its own."""

    status: Literal["ready"] = "ready"
    checks: dict[str, str]


class FaultView(Sent):
    """One fault in what was sent."""

    pointer: str = Field(description="JSON pointer from the body's root (RFC 6901).")
    detail: str
    expected: str


class ProblemView(BaseModel):
    """An error (RFC 9457)."""

    model_config = ConfigDict(extra="allow", frozen=True)

    type: str = Field(description="Stable: branch on this.")
    title: str
    status: int
    detail: str
    instance: str
    errors: list[FaultView] | None = None
    request_id: str | None = None
