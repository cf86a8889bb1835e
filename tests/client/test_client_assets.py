"""Scene files and the files they name."""

import hashlib
import io
import json
import sys
from pathlib import Path

import pytest

from client.assets import data_folder, parse_document, pointer_to, prepare_scene, read_scene
from client.errors import AssetError, SceneInvalidError, UsageError


def sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def scene(**assets: dict[str, object]) -> dict[str, object]:
    return {"version": 1, "assets": assets}


def test_file_beside_the_scene_is_hashed_and_named_plainly(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/a.ply").write_bytes(b"abc")
    document = scene(mesh={"file": "sub/a.ply"})
    prepared = prepare_scene(document, tmp_path)
    assert prepared.document["assets"] == {"mesh": {"file": "a.ply", "sha256": sha(b"abc")}}
    assert prepared.uploads == {sha(b"abc"): tmp_path / "sub/a.ply"}
    assert prepared.files == {"mesh": tmp_path / "sub/a.ply"}
    assert document == scene(mesh={"file": "sub/a.ply"}), "the caller's document must stay as it is"


def test_data_folder_comes_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data, home = tmp_path / "data", tmp_path / "home"
    for folder in (data, home):
        folder.mkdir()
    monkeypatch.setenv("SMALTI_DATA", str(data))
    (data / "a.ply").write_bytes(b"data")
    assert prepare_scene(scene(m={"file": "a.ply"}), home).document["assets"]["m"]["sha256"] == sha(b"data")
    (home / "a.ply").write_bytes(b"home")
    assert prepare_scene(scene(m={"file": "a.ply"}), home).document["assets"]["m"]["sha256"] == sha(b"home")


def test_default_data_folder_is_shared_beside_the_current_one() -> None:
    assert data_folder() == Path("../shared")


def test_given_hash_is_checked(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(b"abc")
    good = {"file": "a.ply", "sha256": sha(b"abc")}
    assert prepare_scene(scene(m=good), tmp_path).document["assets"]["m"] == good
    with pytest.raises(AssetError) as caught:
        prepare_scene(scene(m={"file": "a.ply", "sha256": "0" * 64}), tmp_path)
    assert caught.value.faults[0].pointer == "/assets/m/sha256"
    assert sha(b"abc") in caught.value.faults[0].message
    assert caught.value.exit_code == 3


def test_missing_files_are_told_all_at_once_with_folders_and_mend(tmp_path: Path) -> None:
    with pytest.raises(AssetError) as caught:
        prepare_scene(scene(a={"file": "seed/mini_geometry.json"}, **{"b/c": {"file": "x.ply"}}), tmp_path)
    first, second = caught.value.faults
    assert first.pointer == "/assets/a/file"
    assert second.pointer == "/assets/b~1c/file"
    assert str(tmp_path) in first.message
    assert str(Path("../shared").resolve()) in first.message
    assert "WhoFama24/cse6413-raytracer" in caught.value.hint
    assert "SMALTI_DATA" in caught.value.hint


def test_mend_is_told_for_seed_data_only(tmp_path: Path) -> None:
    with pytest.raises(AssetError) as caught:
        prepare_scene(scene(a={"file": "x.ply"}), tmp_path)
    assert caught.value.hint == ""


@pytest.mark.parametrize("name", ["passwd", "id.pem", "x.obj.txt"])
def test_a_file_that_no_loader_reads_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("secret")
    for file in (f"../{name}", str(tmp_path / name)):
        with pytest.raises(AssetError, match="cannot be used") as caught:
            prepare_scene(scene(m={"file": file}), _sub(tmp_path))
        assert caught.value.faults[0].pointer == "/assets/m/file"
        assert ".obj" in caught.value.faults[0].expected


def _sub(folder: Path) -> Path:
    (folder / "sub").mkdir(exist_ok=True)
    return folder / "sub"


def test_a_name_that_leaves_the_folders_is_warned_of(tmp_path: Path) -> None:
    (tmp_path / "a.PLY").write_bytes(b"abc")
    for file in ("../a.PLY", str(tmp_path / "a.PLY")):
        assert "outside" in prepare_scene(scene(m={"file": file}), _sub(tmp_path)).warnings[0]
    assert prepare_scene(scene(m={"file": "sub/../a.PLY"}), tmp_path).warnings == []


def test_absent_file_with_a_hash_is_left_to_the_service(tmp_path: Path) -> None:
    prepared = prepare_scene(scene(a={"file": "d/x.ply", "sha256": "a" * 64}), tmp_path)
    assert list(prepared.absent) == ["a" * 64]
    assert prepared.document["assets"]["a"] == {"file": "x.ply", "sha256": "a" * 64}


@pytest.mark.parametrize("file", ["http://host/a.ply", "file:///a.ply", "//host/a.ply", "s3://b/a.ply"])
def test_urls_are_refused(tmp_path: Path, file: str) -> None:
    with pytest.raises(AssetError) as caught:
        prepare_scene(scene(a={"file": file}), tmp_path)
    assert "URL" in caught.value.faults[0].message


def test_companions_are_found_hashed_and_uploaded(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n")
    (tmp_path / "a.mtl").write_text("map_Kd t.png\nmap_Ks gone.png\n")
    (tmp_path / "t.png").write_bytes(b"png")
    prepared = prepare_scene(scene(m={"file": "a.obj"}), tmp_path)
    mtl = sha((tmp_path / "a.mtl").read_bytes())
    assert prepared.document["assets"]["m"]["companions"] == {"a.mtl": mtl, "t.png": sha(b"png")}
    assert prepared.uploads[mtl] == tmp_path / "a.mtl"
    assert prepared.uploads[sha(b"png")] == tmp_path / "t.png"
    assert "gone.png" in prepared.warnings[0]


def test_given_companions_are_checked_and_not_discovered(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n")
    (tmp_path / "a.mtl").write_text("x")
    (tmp_path.parent / "out.mtl").write_text("x")
    for companions, pointer in (
        ({"a.mtl": "0" * 64}, "/assets/m/companions/a.mtl"),
        ({"../out.mtl": sha(b"x")}, "/assets/m/companions/..~1out.mtl"),
    ):
        with pytest.raises(AssetError) as caught:
            prepare_scene(scene(m={"file": "a.obj", "companions": companions}), tmp_path)
        assert caught.value.faults[0].pointer == pointer
    none = {"file": "a.obj", "companions": {"a.mtl": None}}
    prepared = prepare_scene(scene(m=none), tmp_path)
    assert prepared.document["assets"]["m"]["companions"] == {}, "known to be missing: never read, never sent"


def test_remote_uri_in_a_model_is_a_fault_of_the_asset(tmp_path: Path) -> None:
    (tmp_path / "a.gltf").write_text(json.dumps({"buffers": [{"uri": "http://127.0.0.1:9/x.bin"}]}))
    with pytest.raises(AssetError) as caught:
        prepare_scene(scene(m={"file": "a.gltf"}), tmp_path)
    assert caught.value.faults[0].pointer == "/assets/m/file"
    assert "http://127.0.0.1:9/x.bin" in caught.value.faults[0].message


@pytest.mark.parametrize(
    "document", [{}, {"assets": 5}, {"assets": {"a": 5}}, {"assets": {"a": {"file": 5}}}, {"assets": {"a": {}}}]
)
def test_malformed_tables_are_left_to_the_service(document: dict[str, object]) -> None:
    assert prepare_scene(document).document == document


@pytest.mark.parametrize("file", ["", "\0", "x" * 5000, ".", "a\ud800"])
def test_odd_names_are_faults_not_crashes(tmp_path: Path, file: str) -> None:
    with pytest.raises(AssetError):
        prepare_scene(scene(a={"file": file}), tmp_path)


@pytest.mark.parametrize(
    ("text", "pointer", "told", "expected"),
    [
        (b"{", "", "line 1, column 2", "one JSON object"),
        (b"\xff\xfe{}", "", "is not UTF-8", "JSON text in UTF-8"),
        (b"[]", "", "an array of 0 items", "a JSON object"),
        (b'{"a": {"b": 1, "b": 2}}', "/a/b", "stands twice", "each key once"),
        (b'{"image": {"width": NaN}}', "/image/width", "is NaN", "a finite number"),
        (b'{"lights": [{"intensity": -Infinity}]}', "/lights/0/intensity", "infinite", "a finite number"),
        (b'{"camera": {"fov_deg": 1e999}}', "/camera/fov_deg", "beyond", "a finite number"),
        (b"[" * 200_000, "", "nests deeper", "levels"),
    ],
)
def test_what_is_no_scene_document_is_told(text: bytes, pointer: str, told: str, expected: str) -> None:
    with pytest.raises(SceneInvalidError, match=r"^my\.json has") as caught:
        parse_document(text, "my.json")
    fault = caught.value.faults[0]
    assert fault.pointer == pointer
    assert told in fault.message
    assert expected in fault.expected
    assert caught.value.exit_code == 3


def test_numbers_keep_their_values() -> None:
    assert parse_document('{"a": [0.1, 1e-300, 3, 12345678901234567890]}') == {
        "a": [0.1, 1e-300, 3, 12345678901234567890]
    }


def test_unreadable_scene_file_is_wrong_usage(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="No such file"):
        read_scene(tmp_path / "none.json")


def test_scene_comes_from_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b'{"version": 1}')))
    assert read_scene("-") == ({"version": 1}, Path())


def test_pointer_escapes() -> None:
    assert pointer_to("a/b", "c~d") == "/a~1b/c~0d"
