"""Compile the entries through numba and write the image: the one module here that imports the compiler.

``python -m tracer.native.build IMAGE`` does it, in a process of its own and one more: numba's way from Python to
LLVM's language (:mod:`tracer.native.frontend`) is most of the work, and numba cannot take two kernels along it at once.

Each entry gets a door of its own, ``int32 door(int64 *words)``: numbers, and an array's address and lengths, are read
from ``words``, numba's native function is called, its results are written back to ``words``, and what is returned is
not 0 where it raised, which only memory that is not to be had makes a kernel do. All doors and what they call are one
LLVM module a process: numba's, optimised as numba does, without its wrappers for Python.

Numba's arrays are counted and freed by its runtime, which an image does without: the two functions that kernels call of
it are written here, over ``malloc`` and ``free``.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np
from llvmlite import binding, ir

from tracer.native.entries import ENTRIES, numba_kernel
from tracer.native.frontend import for_linking
from tracer.native.image import door_name, save_image
from tracer.native.link import link

import_module("tracer.jit")  # before numba: it says where numba keeps its own cache
numba: Final[Any] = import_module("numba")
_types: Final[Any] = import_module("numba.core.types")
_arrays: Final[Any] = import_module("numba.np.arrayobj")
_word: Final = ir.IntType(64)
_words: Final = ir.PointerType(_word)
_status: Final = ir.IntType(32)
_LARGEST: Final = "tracer.render.blocks.render_blocks"
"""What takes three quarters of the time: compiled in one process, all others in a second one meanwhile."""
_BY_DOOR: Final = {"tracer.rays.packet.trace_packet": 2, "tracer.rays.bundle.trace_alone": 1}
"""Kernels that it calls but does not compile, the second process does; and how many integers they return."""

# The layout of numba's MemInfo (numba/core/runtime/nrt.cpp): reference count, destructor, its argument, data, size,
# allocator. 64 bytes, so that data of any alignment up to that follows.
_RUNTIME: Final = """
declare ptr @malloc(i64)
declare void @free(ptr)

define ptr @NRT_MemInfo_alloc_aligned(i64 %size, i32 %align) {
  %a = zext i32 %align to i64
  %room = add i64 %a, 64
  %all = add i64 %room, %size
  %info = call ptr @malloc(i64 %all)
  %none = icmp eq ptr %info, null
  br i1 %none, label %out, label %fill
fill:
  %start = ptrtoint ptr %info to i64
  %first = add i64 %start, 63
  %beyond = add i64 %first, %a
  %over = urem i64 %beyond, %a
  %data = sub i64 %beyond, %over
  store i64 1, ptr %info
  %1 = getelementptr i64, ptr %info, i64 1
  store i64 0, ptr %1
  %2 = getelementptr i64, ptr %info, i64 2
  store i64 0, ptr %2
  %3 = getelementptr i64, ptr %info, i64 3
  store i64 %data, ptr %3
  %4 = getelementptr i64, ptr %info, i64 4
  store i64 %size, ptr %4
  %5 = getelementptr i64, ptr %info, i64 5
  store i64 0, ptr %5
  br label %out
out:
  ret ptr %info
}

define void @NRT_MemInfo_call_dtor(ptr %info) {
  call void @free(ptr %info)
  ret void
}
"""


def _numba_type(kind: Any) -> Any:
    """Return the type that numba gives an argument."""
    if kind == "i":
        return _types.int64
    if kind == "d":
        return _types.float64
    if kind == "scene":
        scene = import_module("tracer.types").CompiledScene
        return _types.NamedTuple([_numba_type(field) for field in expand(kind)], scene)
    dtype, _, n_dimensions = kind.partition(":")
    return _types.Array(numba.from_dtype(np.dtype(dtype)), int(n_dimensions), "C")


def expand(kind: str) -> str | list[str]:
    """Return a kind of argument with tuples written out."""
    if kind != "scene":
        return kind
    fields = import_module("tracer.types").FIELDS
    return [f"{np.dtype(dtype).str[1:]}:{len(shape)}" for dtype, shape in fields.values()]


def _read(context: Any, builder: Any, words: Any, place: int, kind: Any) -> tuple[Any, int]:
    """Emit the reading of an argument from ``words``; returns its value and the place behind it."""

    def word(index: int) -> Any:
        return builder.load(builder.gep(words, [_word(index)]))

    if isinstance(kind, list):
        fields = []
        for field in kind:
            value, place = _read(context, builder, words, place, field)
            fields.append(value)
        return fields, place
    if kind == "i":
        return word(place), place + 1
    if kind == "d":
        return builder.bitcast(word(place), ir.DoubleType()), place + 1
    array_type = _numba_type(kind)
    array = context.make_array(array_type)(context, builder)
    lengths = [word(place + 1 + axis) for axis in range(array_type.ndim)]
    item_size = _word(context.get_abi_sizeof(context.get_data_type(array_type.dtype)))
    strides = [item_size]
    for length in reversed(lengths[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    data = builder.inttoptr(word(place), array.data.type)
    _arrays.populate_array(array, data, lengths, strides, item_size, meminfo=None)
    return array._getvalue(), place + 1 + len(lengths)  # noqa: SLF001 - numba's own way


def _add_door(context: Any, module: Any, name: str, compiled: Any) -> tuple[list[Any], int]:
    """Emit the door to a compiled kernel; returns the kinds of its arguments and the number of its results."""
    description = compiled.fndesc
    native = context.declare_function(module, description)
    door = ir.Function(module, ir.FunctionType(_status, [_words]), door_name(name))
    builder = ir.IRBuilder(door.append_basic_block())
    kinds = [expand(kind) for kind in ENTRIES[name]]
    arguments, place = [], 0
    for kind, numba_type in zip(kinds, description.argtypes, strict=True):
        value, place = _read(context, builder, door.args[0], place, kind)
        if isinstance(kind, list):
            value = context.make_tuple(builder, numba_type, value)
        arguments.append(value)
    result_type = description.restype
    status, result = context.call_conv.call_function(builder, native, result_type, description.argtypes, arguments)
    result_types = [] if result_type == _types.none else list(getattr(result_type, "types", [result_type]))
    for index, one in enumerate(result_types):
        if not isinstance(one, _types.Integer | _types.Boolean):
            raise TypeError(f"{name} returns {result_type}: an entry returns integers")
        value = result if len(result_types) == 1 and one is result_type else builder.extract_value(result, index)
        value = context.cast(builder, value, one, _types.int64)
        builder.store(value, builder.gep(door.args[0], [_word(index)]))
    builder.ret(builder.zext(status.is_error, _status))
    return kinds, len(result_types)


def compile_kernel(name: str, kinds: tuple[str, ...]) -> Any:
    """Compile a kernel for arguments of some kinds, or load it from numba's cache."""
    dispatcher: Any = numba_kernel(name)
    arguments = tuple(_numba_type(kind) for kind in kinds)
    dispatcher.compile(arguments)
    return dispatcher.overloads[arguments]


def _link(module: Any, compiled: list[Any], doors: set[str]) -> Any:
    """Link doors, kernels and runtime, and drop what no door leads to."""
    linked = binding.parse_assembly(str(module))
    linked.link_in(binding.parse_assembly(_RUNTIME))
    for one in compiled:
        linked.link_in(one.library._get_module_for_linking(), preserve=True)  # noqa: SLF001 - as numba links
    for function in linked.functions:
        if not function.is_declaration and function.name not in doors:
            function.linkage = "internal"
    for variable in linked.global_variables:
        if not variable.is_declaration:
            variable.linkage = "internal"
    passes = binding.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    codegen = compiled[0].target_context.codegen()
    machine = _target_machine(codegen)
    passes.run(linked, binding.create_pass_builder(machine, binding.create_pipeline_tuning_options()))
    for options in ({"loop_vectorize": codegen._loopvect, "opt": codegen._opt_level, "cost": "cheap"}, {}):  # noqa: SLF001 - as numba optimises
        manager, builder = codegen._module_pass_manager(**options)  # noqa: SLF001
        manager.run(linked, builder)
    linked.verify()
    return linked


def _target_machine(codegen: Any) -> Any:
    """Return numba's target, but for code that runs wherever it is mapped."""
    triple, cpu, features = codegen.magic_tuple()
    return binding.Target.from_triple(triple).create_target_machine(
        cpu=cpu, features=features, opt=3, reloc="pic", codemodel="small"
    )


def _call_by_door(name: str, n_results: int) -> None:
    """Replace a kernel of integers by one that calls its door, for all that is compiled from now on."""
    simd, jit = import_module("tracer.simd"), import_module("tracer.jit")
    stack_memory, store, load, int64 = simd.stack_memory, simd.store, simd.load, _types.int64
    door = _types.ExternalFunction(door_name(name), _types.int32(_types.int64))
    n_words = len(ENTRIES[name])
    n_bytes = 8 * n_words

    @jit.inline
    def knock(arguments: Any) -> Any:
        words = stack_memory(n_bytes)
        for k in range(n_words):
            store(words + 8 * k, arguments[k])
        door(words)
        return words

    def call(*arguments: int) -> Any:
        return load(int64, knock(arguments))

    def call_for_two(*arguments: int) -> Any:
        words = knock(arguments)
        return load(int64, words), load(int64, words + 8)

    kernel = numba_kernel(name)
    instead = jit.kernel(call if n_results == 1 else call_for_two)
    for module in [module for path, module in sys.modules.items() if path.startswith("tracer.")]:
        for attribute in [key for key, value in vars(module).items() if value is kernel]:
            setattr(module, attribute, instead)


def compile_entries() -> list[Any]:
    """Compile all entries, or load them from numba's cache."""
    return [compile_kernel(name, kinds) for name, kinds in ENTRIES.items()]


def _compile_part(names: list[str]) -> tuple[bytes, dict[str, Any]]:
    """Compile entries into one optimised LLVM module; returns its bitcode and the entries' index."""
    if _LARGEST in names:
        numba_kernel(_LARGEST)  # brings the modules that call them
        for name, n_results in _BY_DOOR.items():
            _call_by_door(name, n_results)
    with for_linking():
        compiled = [compile_kernel(name, ENTRIES[name]) for name in names]
    context = compiled[0].target_context
    module = ir.Module("smalti")
    module.triple = binding.get_process_triple()
    module.data_layout = context.codegen()._data_layout  # noqa: SLF001
    index = {}
    for name, one in zip(names, compiled, strict=True):
        kinds, n_results = _add_door(context, module, name, one)
        index[name] = {"arguments": kinds, "results": n_results}
    return _link(module, compiled, {door_name(name) for name in names}).as_bitcode(), index


def write_image(path: Path) -> int:
    """Compile the entries and write the image.

    Parameters
    ----------
    path
        Its name, in the folder of the kernels' key.

    Returns
    -------
    int
        Bytes of the image.

    Raises
    ------
    LinkError
        There are no images on this system.
    OSError
        The folder cannot be written.
    """
    with ProcessPoolExecutor(1, mp_context=get_context("fork")) as other:
        others = other.submit(_compile_part, [name for name in ENTRIES if name != _LARGEST])
        code, index = _compile_part([_LARGEST])
        others_code, others_index = others.result()
    linked = binding.parse_bitcode(code)
    linked.link_in(binding.parse_bitcode(others_code))
    codegen = import_module("numba.core.registry").cpu_target.target_context.codegen()
    return save_image(path, path.parent.name, link(_target_machine(codegen).emit_object(linked)), index | others_index)


if __name__ == "__main__":
    write_image(Path(sys.argv[1]))
