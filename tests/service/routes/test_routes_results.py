"""Downloads: validators, ranges, digests, and the states in which there is nothing to download."""

import base64
import hashlib
import json
import os

import pytest
from service_farm import FLOW, PNG, Farm, assert_problem, scene

from worker.states import JobState

NAMES = {
    "result.png": "image/png",
    "result.exr": "image/x-exr",
    "preview.png": "image/png",
    "report": "application/json",
}


@pytest.fixture(scope="module")
def job_id(farm: Farm) -> str:
    return farm.finished()


@pytest.mark.parametrize("name", NAMES)
def test_whole_file(farm: Farm, job_id: str, name: str) -> None:
    answer = farm.client.get(f"/v1/jobs/{job_id}/{name}")
    assert answer.status_code == 200
    assert answer.headers["Content-Type"] == NAMES[name]
    assert answer.headers["Content-Length"] == str(len(answer.content))
    assert answer.headers["Accept-Ranges"] == "bytes"
    digest = hashlib.sha256(answer.content).digest()
    assert answer.headers["Repr-Digest"] == f"sha-256=:{base64.b64encode(digest).decode()}:"
    assert answer.headers["ETag"] == f'"{digest.hex()}"'
    assert answer.headers["Content-Disposition"].startswith("inline")


def test_the_links_of_the_job_lead_here(farm: Farm, job_id: str) -> None:
    links = farm.client.get(f"/v1/jobs/{job_id}").json()["links"]
    assert links.pop("cancel") is None
    for name, link in links.items():
        if name != "events":
            assert farm.client.get(link).status_code == 200, name


def test_unchanged(farm: Farm, job_id: str) -> None:
    etag = farm.client.get(f"/v1/jobs/{job_id}/result.png").headers["ETag"]
    answer = farm.client.get(f"/v1/jobs/{job_id}/result.png", headers={"If-None-Match": f'"x", {etag}'})
    assert answer.status_code == 304
    assert answer.content == b""
    assert answer.headers["ETag"] == etag


def test_head(farm: Farm, job_id: str) -> None:
    answer = farm.client.head(f"/v1/jobs/{job_id}/result.png")
    assert answer.status_code == 200
    assert answer.content == b""
    assert answer.headers["Content-Length"] == str(len(PNG))


@pytest.mark.parametrize(
    ("header", "part"), [("bytes=0-9", slice(0, 10)), ("bytes=100-", slice(100, None)), ("bytes=-7", slice(-7, None))]
)
def test_ranges(farm: Farm, job_id: str, header: str, part: slice) -> None:
    answer = farm.client.get(f"/v1/jobs/{job_id}/result.png", headers={"Range": header})
    assert answer.status_code == 206
    assert answer.content == PNG[part]
    first, last, _ = part.indices(len(PNG))
    assert answer.headers["Content-Range"] == f"bytes {first}-{last - 1}/{len(PNG)}"
    # The digest is that of the whole file, so that a client can check what it put together.
    assert hashlib.sha256(PNG).hexdigest() in answer.headers["ETag"]


def test_if_range(farm: Farm, job_id: str) -> None:
    url = f"/v1/jobs/{job_id}/result.png"
    etag = farm.client.get(url).headers["ETag"]
    assert farm.client.get(url, headers={"Range": "bytes=0-0", "If-Range": etag}).status_code == 206
    assert farm.client.get(url, headers={"Range": "bytes=0-0", "If-Range": '"other"'}).status_code == 200


def test_a_range_outside_the_file(farm: Farm, job_id: str) -> None:
    answer = farm.client.get(f"/v1/jobs/{job_id}/result.png", headers={"Range": f"bytes={len(PNG)}-"})
    assert_problem(answer, 416, "range-not-satisfiable")
    assert answer.headers["Content-Range"] == f"bytes */{len(PNG)}"


def test_a_file_larger_than_one_piece(farm: Farm) -> None:
    job_id = farm.submit()
    data = os.urandom((3 << 20) + 17)
    farm.finish(job_id, png=data)
    assert farm.client.get(f"/v1/jobs/{job_id}/result.png").content == data
    answer = farm.client.get(f"/v1/jobs/{job_id}/result.png", headers={"Range": "bytes=1000000-2500000"})
    assert answer.content == data[1000000:2500001]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("state", ["queued", "rendering"])
def test_not_ready(farm: Farm, name: str, state: str) -> None:
    job_id = farm.submit()
    if state == "rendering":
        farm.move(job_id, *FLOW[:2])
    answer = farm.client.get(f"/v1/jobs/{job_id}/{name}")
    assert assert_problem(answer, 409, "result-not-ready")["current_state"] == state
    assert answer.headers["Retry-After"]


@pytest.mark.parametrize("end", [JobState.FAILED, JobState.CANCELED])
def test_never(farm: Farm, end: JobState) -> None:
    job_id = farm.submit()
    farm.move(job_id, *([JobState.CANCELING] if end is JobState.CANCELED else []), end)
    answer = farm.client.get(f"/v1/jobs/{job_id}/result.png")
    assert assert_problem(answer, 409, "result-never")["current_state"] == end
    assert "Retry-After" not in answer.headers


def test_scene_is_the_canonical_document(farm: Farm) -> None:
    job_id = farm.submit(document=scene(name="sc\u00e9ne"))
    answer = farm.client.get(f"/v1/jobs/{job_id}/scene")
    assert answer.headers["Content-Type"] == "application/json"
    assert hashlib.sha256(answer.content).hexdigest() == farm.store.read_job(job_id).scene_sha256
    assert answer.headers["ETag"] == f'"{farm.store.read_job(job_id).scene_sha256}"'
    assert answer.headers["Repr-Digest"].startswith("sha-256=:")
    document = json.loads(answer.content)
    assert document["name"] == "sc\u00e9ne"
    assert document["sampling"]["samples"] == 16  # defaults are written out
    again = farm.client.get(f"/v1/jobs/{job_id}/scene", headers={"If-None-Match": answer.headers["ETag"]})
    assert again.status_code == 304
    assert farm.post(document).status_code == 202


def test_the_preview_comes_early(farm: Farm) -> None:
    job_id = farm.submit()
    farm.move(job_id, *FLOW[:2])
    assert farm.client.get(f"/v1/jobs/{job_id}").json()["links"]["preview_png"] is None
    farm.store.result_path(job_id, "preview.png").write_bytes(PNG)
    link = farm.client.get(f"/v1/jobs/{job_id}").json()["links"]["preview_png"]
    first = farm.client.get(link)
    assert first.content == PNG
    farm.store.result_path(job_id, "preview.png").write_bytes(PNG + b"more")
    second = farm.client.get(link, headers={"If-None-Match": first.headers["ETag"]})
    assert second.status_code == 200
    assert second.content == PNG + b"more"
    assert_problem(farm.client.get(f"/v1/jobs/{job_id}/result.png"), 409, "result-not-ready")
