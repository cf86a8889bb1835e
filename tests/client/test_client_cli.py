"""The command line: output, exit codes, pipes."""

import hashlib
import json
import os
import shlex
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import pytest
from typer.testing import CliRunner, Result

from client import api, cli
from client.errors import EXIT_CODE_MEANINGS

SCENE = {"version": 1, "camera": {"type": "perspective", "fov_deg": 40}, "image": {"width": 4, "height": 3}}


@pytest.fixture
def smalti(fake: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run the command line against the fake service."""
    make = api.Client.__init__

    def connect(self: Any, url: str | None = None, **more: Any) -> None:
        make(self, url, http=httpx.MockTransport(fake), sleep=fake.sleeps.append, **more)

    monkeypatch.setattr(api.Client, "__init__", connect)
    runner = CliRunner()

    def run(*arguments: Any, text: str | None = None) -> Result:
        return runner.invoke(cli.app, [str(one) for one in arguments], input=text, prog_name="smalti")

    return run


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(SCENE))
    return path


def finish_after_submit(fake: Any, state: str = "succeeded", **more: Any) -> None:
    fake.events = lambda _: iter(())
    original = fake.post_job

    def post(request: httpx.Request) -> httpx.Response:
        answer = original(request)
        for job in fake.jobs.values():
            job.update(state=state, **more)
        return answer

    fake.post_job = post


def test_submit_prints_the_id_alone_on_standard_output(smalti: Any, scene: Path) -> None:
    result = smalti("submit", scene)
    assert (result.exit_code, result.stdout) == (0, "job1\n")
    assert "smalti watch job1" in result.stderr


def test_submit_reads_standard_input_and_sends_options(smalti: Any, fake: Any) -> None:
    options = ("--samples", 4, "--size", "8x6", "--tile-size", 32, "--png", "linear", "--priority", 9, "--name", "a")
    assert smalti("submit", "-", *options, text=json.dumps(SCENE)).exit_code == 0
    body = json.loads(fake.requests[-1].content)
    assert body["scene"] == {**SCENE, "sampling": {"samples": 4}, "image": {"width": 8, "height": 6}}
    assert body["output"] == {"png_color_space": "linear", "tile_size": 32}
    assert (body["priority"], body["name"]) == (9, "a")


def test_submit_with_an_output_waits_and_downloads(smalti: Any, fake: Any, scene: Path, tmp_path: Path) -> None:
    finish_after_submit(fake)
    fake.results = {"result.png": b"png", "result.exr": b"exr"}
    result = smalti("submit", scene, "-o", tmp_path / "a.png", "-o", tmp_path / "a.exr")
    assert (result.exit_code, result.stdout) == (0, "job1\n")
    assert (tmp_path / "a.png").read_bytes() == b"png"
    assert (tmp_path / "a.exr").read_bytes() == b"exr"


@pytest.mark.parametrize(("state", "code"), [("failed", 4), ("canceled", 5)])
def test_a_job_that_ends_badly_has_its_exit_code(smalti: Any, fake: Any, scene: Path, state: str, code: int) -> None:
    finish_after_submit(
        fake, state, problem={"title": "Bad mesh", "detail": "a.obj: no faces"} if state == "failed" else None
    )
    result = smalti("submit", scene, "--wait")
    assert result.exit_code == code
    assert ("a.obj: no faces" in result.stderr) == (state == "failed")


@pytest.mark.parametrize(
    ("options", "asked"),
    [((), None), (("--wait",), "wait=1"), (("--watch",), "wait=1"), (("--wait", "--timeout", "5"), None)],
)
def test_who_waits_asks_the_service_to_answer_with_the_end(
    smalti: Any, fake: Any, scene: Path, options: tuple[str, ...], asked: str | None
) -> None:
    """A small job has ended when the answer to the POST comes: one request, no stream, no second look."""
    finish_after_submit(fake)
    if asked:
        fake.post_job = lambda request: httpx.Response(200, json=fake.add_job("job1", "succeeded"))
    result = smalti("submit", scene, *options)
    assert (result.exit_code, result.stdout.split()[0]) == (0, "job1")
    posted = next(one for one in fake.requests if one.method == "POST" and one.url.path == "/v1/jobs")
    assert posted.headers.get("Prefer") == asked
    if asked:
        assert [one for one in fake.requests if "/v1/jobs/job1" in one.url.path] == []


def test_waiting_too_long_has_its_exit_code(smalti: Any, fake: Any, scene: Path) -> None:
    finish_after_submit(fake, "rendering")
    assert smalti("submit", scene, "--wait", "--timeout", "0.1").exit_code == 9


def test_wrong_usage(smalti: Any, scene: Path, tmp_path: Path) -> None:
    for arguments in (
        ("submit",),
        ("submit", tmp_path / "none.json"),
        ("submit", scene, "--size", "big"),
        ("submit", scene, "--size", "0x5"),
        ("submit", scene, "--tile-size", 40),
        ("submit", scene, "-o", "out.jpg"),
        ("submit", scene, "-o", tmp_path / "none" / "out.png"),
        ("get", "job1", "-o", tmp_path / "none" / "out.png"),
        ("status", "job1", "--url", "no-url"),
        ("render", scene),
        ("nonsense",),
        ("--nonsense",),
        ("worker",),
    ):
        result = smalti(*arguments)
        assert result.exit_code == 2, arguments
        assert "Traceback" not in result.output


def test_size_does_not_go_with_a_crop(smalti: Any, tmp_path: Path) -> None:
    crop = {"x": 0, "y": 0, "width": 1, "height": 1}
    (tmp_path / "s.json").write_text(json.dumps({**SCENE, "image": {"width": 4, "height": 3, "crop": crop}}))
    assert smalti("submit", tmp_path / "s.json", "--size", "8x6").exit_code == 2


def test_an_invalid_scene_is_told_by_pointer(smalti: Any, fake: Any, scene: Path) -> None:
    fault = {"pointer": "/scene/camera/fov_deg", "detail": "400 is too large", "expected": "below 180"}
    body = {"type": "urn:smalti:problem:scene-invalid", "title": "The scene is not valid", "errors": [fault]}
    headers = {"Content-Type": "application/problem+json"}
    fake.next("POST", "/v1/jobs", *[httpx.Response(422, json=body, headers=headers) for _ in range(2)])
    result = smalti("submit", scene)
    assert result.exit_code == 3
    assert "/scene/camera/fov_deg: 400 is too large (expected: below 180)" in result.stderr
    error = json.loads(smalti("submit", scene, "--json").stderr)
    assert error["exit_code"] == 3
    assert error["faults"] == [
        {"pointer": "/scene/camera/fov_deg", "message": "400 is too large", "expected": "below 180"}
    ]
    assert error["problem"]["type"] == "urn:smalti:problem:scene-invalid"


def test_a_missing_file_is_told_with_the_mend(smalti: Any, tmp_path: Path) -> None:
    (tmp_path / "s.json").write_text(json.dumps({**SCENE, "assets": {"mini": {"file": "seed/mini_geometry.json"}}}))
    result = smalti("submit", tmp_path / "s.json")
    assert result.exit_code == 3
    assert "/assets/mini/file" in result.stderr
    assert "WhoFama24/cse6413-raytracer" in result.stderr


@pytest.mark.parametrize("options", [("--local",), ()])
def test_a_scene_whose_file_is_nowhere_is_not_valid(
    smalti: Any, fake: Any, tmp_path: Path, options: tuple[str, ...]
) -> None:
    assets = {"m": {"file": "gone.ply", "sha256": hashlib.sha256(b"mesh").hexdigest()}}
    (tmp_path / "s.json").write_text(json.dumps({**SCENE, "assets": assets}))
    result = smalti("validate", tmp_path / "s.json", *options)
    assert result.exit_code == 3
    assert "/assets/m/file" in result.stderr
    assert "valid" not in result.stdout
    fake.assets[assets["m"]["sha256"]] = b"mesh"
    assert smalti("validate", tmp_path / "s.json", *options).exit_code == (3 if options else 0)


def test_status_for_people_and_for_scripts(smalti: Any, fake: Any) -> None:
    fake.add_job("job1", "rendering")
    fake.add_job("job2", "failed", problem={"detail": "a.obj: no faces"})
    result = smalti("status", "job1", "job2")
    assert result.exit_code == 0
    assert "25 % (1/4 tiles)" in result.stdout
    assert "a.obj: no faces" in result.stdout
    assert json.loads(smalti("status", "job1", "--json").stdout) == fake.jobs["job1"]
    assert [one["id"] for one in json.loads(smalti("status", "job1", "job2", "--json").stdout)] == ["job1", "job2"]


def test_what_is_not_there(smalti: Any, tmp_path: Path) -> None:
    for arguments in (
        ("status", "x"),
        ("watch", "x"),
        ("cancel", "x"),
        ("delete", "x"),
        ("get", "x", "-o", tmp_path / "a.png"),
    ):
        assert smalti(*arguments).exit_code == 7


def test_what_is_not_allowed_now(smalti: Any, fake: Any, tmp_path: Path) -> None:
    fake.add_job("job1", "rendering")
    assert smalti("delete", "job1").exit_code == 8
    assert smalti("get", "job1", "-o", tmp_path / "a.png").exit_code == 8


def test_no_service(smalti: Any, fake: Any) -> None:
    fake.next("GET", "/v1/jobs", *[httpx.ConnectError("refused")] * 9)
    result = smalti("list")
    assert result.exit_code == 6
    assert "smalti serve" in result.stderr


def test_watch_prints_plain_lines_without_a_terminal(smalti: Any, fake: Any) -> None:
    fake.add_job("job1", "succeeded")
    result = smalti("watch", "job1")
    assert result.exit_code == 0
    assert "succeeded, 1/4 tiles" in result.stderr
    assert "\x1b" not in result.output


def test_get_writes_what_was_asked_for(smalti: Any, fake: Any, tmp_path: Path) -> None:
    fake.add_job()
    fake.results = {"result.exr": b"exr", "preview.png": b"small"}
    assert smalti("get", "job1", "-o", tmp_path / "a.exr", "-o", tmp_path / "r.json").exit_code == 0
    assert (tmp_path / "a.exr").read_bytes() == b"exr"
    assert json.loads((tmp_path / "r.json").read_text()) == {"tiles": 4}
    assert smalti("get", "job1", "--kind", "preview").exit_code == 0
    assert Path("job1.png").read_bytes() == b"small"
    answer = json.loads(smalti("get", "job1", "-o", tmp_path / "a.exr", "--json").stdout)
    assert answer == [{"file": str(tmp_path / "a.exr"), "kind": "exr", "bytes": 3}]


def test_cancel_and_delete_take_several(smalti: Any, fake: Any) -> None:
    fake.add_job("job1", "rendering")
    fake.add_job("job2", "rendering")
    assert smalti("cancel", "job1", "job2").stdout == "job1 canceling\njob2 canceling\n"
    for job in fake.jobs.values():
        job["state"] = "canceled"
    assert smalti("delete", "job1", "job2").stdout == "job1 deleted\njob2 deleted\n"
    assert fake.jobs == {}


def test_list_pages(smalti: Any, fake: Any) -> None:
    assert smalti("list").stdout == ""
    for number in range(5):
        fake.add_job(f"job{number}", name="a\x1b[31mred")
    result = smalti("list", "--limit", 2)
    assert [line.split()[0] for line in result.stdout.splitlines()] == ["job", "job4", "job3"]
    assert "--all" in result.stderr
    assert "\x1b" not in result.output, "a job's name must not colour the terminal"
    assert len(json.loads(smalti("list", "--limit", 2, "--all", "--json").stdout)) == 5


def test_validate_asks_the_service_or_checks_here(smalti: Any, fake: Any, scene: Path) -> None:
    result = smalti("validate", scene)
    assert result.exit_code == 0
    assert "123 M" in result.stdout
    assert "CPU seconds, roughly  0.27\n" in result.stdout
    assert json.loads(smalti("validate", scene, "--json").stdout)["tiles"] == 1
    fake.next("POST", "/v1/jobs", *[httpx.ConnectError("refused")] * 99)
    assert "checked here" in smalti("validate", scene).stderr
    assert smalti("validate", scene, "--url", "http://127.0.0.1:9").exit_code == 6
    assert json.loads(smalti("validate", scene, "--local", "--json").stdout)["image"] == {"width": 4, "height": 3}


def test_validate_here_finds_faults(smalti: Any, tmp_path: Path) -> None:
    (tmp_path / "s.json").write_text(json.dumps({**SCENE, "camera": {"type": "perspective", "fov_deg": 400}}))
    result = smalti("validate", tmp_path / "s.json", "--local")
    assert result.exit_code == 3
    assert "/camera/fov_deg" in result.stderr


def test_schema_of_this_installation_and_of_a_service(smalti: Any) -> None:
    assert json.loads(smalti("schema").stdout)["$schema"].startswith("https://json-schema.org")
    assert json.loads(smalti("schema", "--url", "http://127.0.0.1:9").stdout) == {"title": "scene"}


def test_unexpected_errors_are_no_tracebacks(smalti: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def explode(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError("kaboom")

    monkeypatch.setattr(api.Client, "list", explode)
    result = smalti("list")
    assert result.exit_code == 1
    assert "unexpected ZeroDivisionError: kaboom" in result.stderr
    assert "Traceback" not in result.output
    monkeypatch.setenv("SMALTI_TRACEBACK", "1")
    assert isinstance(smalti("list").exception, ZeroDivisionError)


def test_ctrl_c_has_its_exit_code(smalti: Any, fake: Any, scene: Path) -> None:
    def interrupt(_: httpx.Request) -> None:
        raise KeyboardInterrupt

    fake.next("POST", "/v1/jobs", interrupt)
    result = smalti("submit", scene)
    assert result.exit_code == 130
    assert "interrupted" in result.stderr


def test_unwritable_output_is_an_error_with_its_name(smalti: Any, fake: Any, tmp_path: Path) -> None:
    fake.add_job()
    fake.results = {"result.png": b"png"}
    (tmp_path / "file").write_text("")
    result = smalti("get", "job1", "-o", tmp_path / "file/a.png")
    assert result.exit_code == 2
    assert str(tmp_path / "file") in result.stderr


def test_help_documents_every_exit_code_and_command(smalti: Any) -> None:
    text = " ".join(smalti("--help").stdout.split())
    for code, meaning in EXIT_CODE_MEANINGS.items():
        assert f"{int(code)} {meaning}" in text
    for command in ("render", "submit", "status", "watch", "get", "cancel", "delete", "list", "validate", "schema"):
        assert command in text
        assert smalti(command, "--help").exit_code == 0
    for command in ("serve", "worker", "warm", "doctor", "demo"):
        assert smalti(command, "--help").exit_code == 0


def test_version(smalti: Any) -> None:
    assert smalti("--version").stdout.startswith("smalti 0.")


# In processes of their own


def run_process(*arguments: str, **more: Any) -> "subprocess.CompletedProcess[str]":
    environment = {**os.environ, "PYTHONPATH": str(Path(cli.__file__).parents[1]), "SMALTI_URL": "http://127.0.0.1:9"}
    return subprocess.run(
        [sys.executable, "-m", "client", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        env=environment,
        check=False,
        **more,
    )


def test_help_imports_nothing_heavy_and_is_quick() -> None:
    code = "import sys; from client.cli import app\ntry: app(['--help'])\nexcept SystemExit: pass\nprint(sorted({n.split('.')[0] for n in sys.modules}), file=sys.stderr)"
    environment = {**os.environ, "PYTHONPATH": str(Path(cli.__file__).parents[1])}
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True
    ).stderr
    for name in ("httpx", "numba", "numpy", "pydantic", "rich", "tracer", "worker", "service"):
        assert f"'{name}'" not in loaded
    before = os.times()
    run_process("--help")
    after = os.times()
    # CPU time, because other tests run beside this one: 0.29 s when written.
    assert (after.children_user - before.children_user) + (after.children_system - before.children_system) < 0.5 * 2


def test_a_submission_does_without_pydantic() -> None:
    """As Typer does until 0.28; its import was a tenth of a submission's time."""
    code = "import sys; from client.cli import app\ntry: app(['submit', 'absent.json', '--wait'])\nexcept SystemExit: pass\nprint('pydantic' in sys.modules)"
    environment = {**os.environ, "PYTHONPATH": str(Path(cli.__file__).parents[1])}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    assert "absent.json" in done.stderr
    assert done.stdout.strip() == "False"


def test_errors_in_a_pipe_are_plain() -> None:
    result = run_process("list")
    assert result.returncode == 6
    assert result.stdout == ""
    assert "error: no answer from a Smalti service at http://127.0.0.1:9" in result.stderr
    assert "\x1b" not in result.stderr


def test_a_reader_that_goes_away_is_no_error() -> None:
    command = f"{shlex.quote(sys.executable)} -m client schema | head -n 1; exit ${{PIPESTATUS[0]}}"
    environment = {**os.environ, "PYTHONPATH": str(Path(cli.__file__).parents[1])}
    started = time.monotonic()
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, env=environment, check=False)
    assert time.monotonic() - started < 60
    assert (result.returncode, result.stdout, result.stderr) == (0, "{\n", "")
