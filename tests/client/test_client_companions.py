"""Files that models name: found in the model's folder and nowhere else."""

import json
import struct
from pathlib import Path

import pytest

from client.companions import RemoteUriError, discover_companions


def names(model: Path) -> dict[str, bool]:
    return {name: path is not None for name, path in discover_companions(model).files.items()}


def put(path: Path, text: str | bytes = "x") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def glb(document: object) -> bytes:
    text = json.dumps(document).encode()
    return b"glTF" + struct.pack("<II", 2, 20 + len(text)) + struct.pack("<I4s", len(text), b"JSON") + text


def test_obj_library_and_textures_with_options_and_spaces(tmp_path: Path) -> None:
    put(
        tmp_path / "my lib.mtl",
        "newmtl a\r\nmap_Kd -s 1 1 1 -o 0.5 -bm 2 two words.png\r\n  map_bump\t-clamp on b.png\n",
    )
    put(tmp_path / "two words.png")
    put(tmp_path / "b.png")
    model = put(tmp_path / "car.obj", "# mtllib not.mtl\nmtllib my lib.mtl\nv 0 0 0\n")
    assert names(model) == {"my lib.mtl": True, "two words.png": True, "b.png": True}


def test_obj_with_two_libraries_on_a_line_and_a_missing_one(tmp_path: Path) -> None:
    put(tmp_path / "a.mtl")
    put(tmp_path / "b.mtl")
    model = put(tmp_path / "car.obj", "mtllib a.mtl b.mtl\nmtllib gone.mtl\n")
    assert names(model) == {"a.mtl": True, "b.mtl": True, "gone.mtl": False}
    assert "gone.mtl" in discover_companions(model).warnings[0]


def test_texture_beside_a_library_in_a_sub_folder(tmp_path: Path) -> None:
    put(tmp_path / "mat/a.mtl", "map_Kd near.png\nmap_Ks far.png\nmap_Ke none.png\n")
    put(tmp_path / "mat/near.png")
    put(tmp_path / "far.png")
    model = put(tmp_path / "car.obj", "mtllib mat\\a.mtl\n")
    assert names(model) == {"mat/a.mtl": True, "mat/near.png": True, "far.png": True, "mat/none.png": False}


@pytest.mark.parametrize(
    "name", ["../secret.png", "/etc/hostname", "a/../../secret.png", "C:\\secret.png", "..\\secret.png"]
)
def test_names_that_lead_out_are_left_out_and_never_read(tmp_path: Path, name: str) -> None:
    put(tmp_path / "secret.png")
    put(tmp_path / "model/a.mtl", f"map_Kd {name}\n")
    found = discover_companions(put(tmp_path / "model/car.obj", "mtllib a.mtl\n"))
    assert list(found.files) == ["a.mtl"]
    assert "outside its folder" in found.warnings[0]


def test_links_out_of_the_folder_count_as_missing(tmp_path: Path) -> None:
    put(tmp_path / "secret.png")
    put(tmp_path / "model/a.mtl", "map_Kd link.png\n")
    (tmp_path / "model/link.png").symlink_to(tmp_path / "secret.png")
    assert names(put(tmp_path / "model/car.obj", "mtllib a.mtl\n")) == {"a.mtl": True, "link.png": False}


def test_gltf_buffers_and_images_without_data_uris(tmp_path: Path) -> None:
    put(tmp_path / "a b.bin")
    put(tmp_path / "t.png")
    document = {
        "buffers": [{"uri": "a%20b.bin"}, {"uri": "data:application/octet-stream;base64,AAAA"}, {"byteLength": 1}, 7],
        "images": [{"uri": "t.png"}, {"uri": "gone.png"}, {"bufferView": 0}],
    }
    expected = {"a b.bin": True, "t.png": True, "gone.png": False}
    assert names(put(tmp_path / "m.gltf", json.dumps(document))) == expected
    assert names(put(tmp_path / "m.glb", glb(document))) == expected


@pytest.mark.parametrize("uri", ["http://127.0.0.1:9/a.bin", "HTTPS://x/a.bin", "file:///etc/hostname", "//host/a.bin"])
def test_remote_uris_are_refused(tmp_path: Path, uri: str) -> None:
    with pytest.raises(RemoteUriError, match="on the network"):
        discover_companions(put(tmp_path / "m.gltf", json.dumps({"buffers": [{"uri": uri}]})))
    put(tmp_path / "a.mtl", f"map_Kd {uri}\n")
    if not uri.startswith("file"):
        with pytest.raises(RemoteUriError):
            discover_companions(put(tmp_path / "m.obj", "mtllib a.mtl\n"))


def test_ply_texture_is_read_from_the_header_only(tmp_path: Path) -> None:
    put(tmp_path / "skin.png")
    header = b"ply\nformat ascii 1.0\ncomment TextureFile skin.png\nend_header\ncomment TextureFile no.png\n"
    assert names(put(tmp_path / "m.ply", header)) == {"skin.png": True}


@pytest.mark.parametrize(
    "content",
    [b"", b"\xff\xfe\x00", b"[[[[", b"null", b'{"buffers": 5, "images": [{"uri": 3}]}', b"glTF" + b"\xff" * 30],
)
@pytest.mark.parametrize("suffix", [".obj", ".gltf", ".glb", ".ply", ".stl", ".mtl", ".json", ".OBJ"])
def test_damaged_files_have_no_companions(tmp_path: Path, content: bytes, suffix: str) -> None:
    assert names(put(tmp_path / f"m{suffix}", content)) == {}


def test_deeply_nested_gltf_is_no_crash(tmp_path: Path) -> None:
    assert names(put(tmp_path / "m.gltf", "[" * 100_000)) == {}
