"""The linker and the image's file, on small objects made for each test."""

import struct

import numpy as np
import pytest
from llvmlite import binding

from tracer.native.image import ArgumentTypeError, ImageError, door_name, load_image, save_image
from tracer.native.link import PAGE, LinkError, link

KEY = "0123456789abcdef"
KERNEL = "a.b.kernel"
DOOR = door_name(KERNEL)
ADD = f"""
define i32 @{DOOR}(ptr %words) {{
  %a = load i64, ptr %words
  %at = getelementptr i64, ptr %words, i64 1
  %b = load i64, ptr %at
  %sum = add i64 %a, %b
  store i64 %sum, ptr %words
  ret i32 0
}}
"""


def compile_object(text, reloc="pic", codemodel="small"):
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    machine = binding.Target.from_default_triple().create_target_machine(reloc=reloc, codemodel=codemodel)
    module = binding.parse_assembly(text)
    module.triple = machine.triple
    return machine.emit_object(module)


def make_image(path, text, arguments=("i", "i"), results=1):
    save_image(path, KEY, link(compile_object(text)), {KERNEL: {"arguments": list(arguments), "results": results}})
    return path


def load_kernel(path):
    return load_image(path, KEY).doors[KERNEL]


def test_numbers_go_in_and_come_out(tmp_path):
    kernel = load_kernel(make_image(tmp_path / "image", ADD))
    assert kernel(2**62, -5) == 2**62 - 5
    assert kernel(np.int32(3), True) == 4


def test_floats_tuples_and_arrays(tmp_path):
    """Words of (d, (i, array of 2 dimensions), i): the float's bits, the number, address and two lengths, the number."""
    text = f"""
define i32 @{DOOR}(ptr %words) {{
  %at = getelementptr i64, ptr %words, i64 2
  %array = load ptr, ptr %at
  %x = load i64, ptr %words
  store i64 %x, ptr %array
  ret i32 0
}}
"""
    kernel = load_kernel(make_image(tmp_path / "image", text, ["d", ["i", "f8:2"], "i"], 6))
    array = np.zeros((3, 4))
    words = kernel(0.1, (7, array), 8)
    assert array[0, 0] == 0.1
    assert words[1:] == (7, array.ctypes.data, 3, 4, 8)


@pytest.mark.parametrize("argument", [np.zeros((2, 2), np.float32), np.zeros(4), np.zeros((4, 4)).T[1:]])
def test_other_arrays_are_refused(tmp_path, argument):
    kernel = load_kernel(make_image(tmp_path / "image", ADD, ["f8:2"]))
    with pytest.raises(ArgumentTypeError):
        kernel(argument)
    with pytest.raises(ArgumentTypeError, match="arguments"):
        kernel(np.zeros((2, 2)), 1)


def test_a_status_is_a_lack_of_memory(tmp_path):
    kernel = load_kernel(make_image(tmp_path / "image", f"define i32 @{DOOR}(ptr %words) {{ ret i32 1 }}", []))
    with pytest.raises(MemoryError):
        kernel()


def test_calls_of_the_systems_functions_and_addresses_in_constants(tmp_path):
    """A table of addresses of constants, one of them used by a function of the system, and a variable of zeros."""
    text = f"""
@one = internal constant [4 x i8] c"one\\00"
@three = internal constant [6 x i8] c"three\\00"
@table = internal constant [2 x ptr] [ptr @one, ptr @three]
@count = internal global i64 0
declare i64 @strlen(ptr)
define i32 @{DOOR}(ptr %words) {{
  %index = load i64, ptr %words
  %at = getelementptr [2 x ptr], ptr @table, i64 0, i64 %index
  %string = load ptr, ptr %at
  %length = call i64 @strlen(ptr %string)
  store i64 %length, ptr %words
  %old = load i64, ptr @count
  %new = add i64 %old, 1
  store i64 %new, ptr @count
  %second = getelementptr i64, ptr %words, i64 1
  store i64 %new, ptr %second
  ret i32 0
}}
"""
    path = make_image(tmp_path / "image", text, ["i"], 2)
    kernel = load_kernel(path)
    assert [kernel(0), kernel(1)] == [(3, 1), (5, 2)]
    assert load_kernel(path)(1) == (5, 1)  # each mapping has variables of its own


def test_a_missing_function_is_told_before_anything_runs(tmp_path):
    text = f"declare i32 @no_such_function(ptr)\ndefine i32 @{DOOR}(ptr %w) {{\n  %s = call i32 @no_such_function(ptr %w)\n  ret i32 %s\n}}"
    with pytest.raises(ImageError, match="no_such_function"):
        load_image(make_image(tmp_path / "image", text), KEY)


def test_what_the_linker_does_not_know_is_refused():
    data = bytearray(compile_object(ADD))
    struct.pack_into("<H", data, 18, 183)  # AArch64
    with pytest.raises(LinkError, match="x86-64"):
        link(bytes(data))
    with pytest.raises(LinkError, match="x86-64"):
        link(b"\xcf\xfa\xed\xfe" + bytes(100))  # Mach-O
    variable = f"@v = external global i64\ndefine i32 @{DOOR}(ptr %w) {{\n  %x = load i64, ptr @v\n  store i64 %x, ptr %w\n  ret i32 0\n}}"
    with pytest.raises(LinkError, match="v"):
        link(compile_object(variable))
    fixed = f"@v = internal global i64 1\ndefine i32 @{DOOR}(ptr %w) {{\n  %x = load volatile i64, ptr @v\n  store i64 %x, ptr %w\n  ret i32 0\n}}"
    with pytest.raises(LinkError, match="relocation"):
        link(compile_object(fixed, reloc="static", codemodel="large"))


def test_damaged_and_foreign_files_are_refused(tmp_path):
    path = make_image(tmp_path / "image", ADD)
    whole = path.read_bytes()
    assert len(whole) % PAGE == 0
    with pytest.raises(ImageError, match="fedcba"):
        load_image(path, "fedcba")
    for place in (60, len(whole) - 1, len(whole) // 2):
        damaged = bytearray(whole)
        damaged[place] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(ImageError, match="damaged"):
            load_image(path, KEY)
    path.write_bytes(whole[:-PAGE])
    with pytest.raises(ImageError, match="damaged"):
        load_image(path, KEY)
    path.write_bytes(whole[:20])
    with pytest.raises(ImageError, match="cut short"):
        load_image(path, KEY)
    path.write_bytes(b"something else" + whole)
    with pytest.raises(ImageError, match="not an image"):
        load_image(path, KEY)
    with pytest.raises(FileNotFoundError):
        load_image(tmp_path / "none", KEY)


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = make_image(tmp_path / "image", ADD)
    before = path.read_bytes()
    monkeypatch.setattr("tracer.native.image.os.fsync", lambda _: (_ for _ in ()).throw(OSError("no space left")))
    with pytest.raises(OSError, match="no space"):
        make_image(path, ADD)
    assert [one.name for one in tmp_path.iterdir()] == ["image"]
    assert path.read_bytes() == before
