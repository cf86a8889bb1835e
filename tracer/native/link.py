"""Link one object file into a flat piece of code that runs wherever it is mapped: the part of a linker that is needed.

Handled is what LLVM emits for position-independent kernels on Linux and x86-64: relocations relative to the place, and
addresses in constants. Everything else is refused, by name. What the object lacks (``malloc``, ``asin``) is reached by
a jump through a table that the loader fills.

Sources: System V ABI, "Object Files"; its AMD64 supplement, "Relocation".
"""

import struct
from typing import Final, NamedTuple

PAGE: Final = 4096
_X86_64: Final = 62
_SYMBOLS, _RELOCATIONS, _NO_BITS = 2, 4, 8  # kinds of sections
_WRITABLE, _ALLOCATED = 1, 2  # flags of sections
_ABSOLUTE_64, _RELATIVE, _RELATIVE_CALL = 1, 2, 4  # kinds of relocations
_SECTION: Final = struct.Struct("<IIQQQQIIQQ")
_SYMBOL: Final = struct.Struct("<IBBHQQ")
_RELOCATION: Final = struct.Struct("<QQq")
_JUMP: Final = struct.Struct("<2sixx")  # jmp *offset(%rip)


class LinkError(Exception):
    """The object holds something that this linker does not know."""


class Linked(NamedTuple):
    """Code and data, ready to be mapped."""

    content: bytes
    n_constant: int  # bytes from the start that are never written: code and constants, whole pages
    exports: dict[str, int]  # name -> offset
    imports: dict[str, int]  # name -> offset of the word that receives its address
    addresses: list[tuple[int, int]]  # (offset of a word, offset whose address it receives)


class _Section(NamedTuple):
    name: int
    kind: int
    flags: int
    address: int
    offset: int
    size: int
    link: int
    info: int
    alignment: int
    entry_size: int


def _aligned(offset: int, alignment: int) -> int:
    return -(-offset // alignment) * alignment


def link(data: bytes) -> Linked:
    """Lay out an object's sections and resolve its references.

    Parameters
    ----------
    data
        A relocatable ELF file.

    Returns
    -------
    Linked

    Raises
    ------
    LinkError
        It is for another machine or system, or holds an unknown relocation.
    """
    if data[:6] != b"\x7fELF\x02\x01" or struct.unpack_from("<H", data, 18)[0] != _X86_64:
        raise LinkError("images are made for Linux on x86-64 alone")
    (table,) = struct.unpack_from("<Q", data, 40)
    (n_sections,) = struct.unpack_from("<H", data, 60)
    sections = [_Section(*_SECTION.unpack_from(data, table + 64 * i)) for i in range(n_sections)]
    (symbol_table,) = (section for section in sections if section.kind == _SYMBOLS)
    names_at = sections[symbol_table.link].offset
    symbols: list[tuple[str, int, int]] = []  # name, section, value
    for place in range(symbol_table.offset, symbol_table.offset + symbol_table.size, _SYMBOL.size):
        name_at, _, _, section, value, _ = _SYMBOL.unpack_from(data, place)
        start = names_at + name_at
        symbols.append((data[start : data.index(b"\0", start)].decode(), section, value))
    missing = [name for name, section, _ in symbols if section == 0 and name]

    # Jumps to what is missing, code, constants; from the next page on what is written to; last the table of addresses.
    content = bytearray(_JUMP.size * len(missing))
    starts: dict[int, int] = {}
    n_constant = 0
    for writable in (0, _WRITABLE):
        for i, section in enumerate(sections):
            if section.flags & _ALLOCATED and section.flags & _WRITABLE == writable:
                content += bytes(_aligned(len(content), max(section.alignment, 1)) - len(content))
                starts[i] = len(content)
                end = section.offset + section.size
                content += bytes(section.size) if section.kind == _NO_BITS else data[section.offset : end]
        if not writable:
            content += bytes(_aligned(len(content), PAGE) - len(content))
            n_constant = len(content)
    content += bytes(_aligned(len(content), 8) - len(content))
    imports = {name: len(content) + 8 * k for k, name in enumerate(missing)}
    content += bytes(_aligned(len(content) + 8 * len(missing), PAGE) - len(content))
    jumps = {name: _JUMP.size * k for k, name in enumerate(missing)}
    for name, place in jumps.items():
        _JUMP.pack_into(content, place, b"\xff\x25", imports[name] - (place + 6))

    addresses: list[tuple[int, int]] = []
    for section in sections:
        if section.kind != _RELOCATIONS or section.info not in starts:
            continue
        for place in range(section.offset, section.offset + section.size, _RELOCATION.size):
            offset, which, addend = _RELOCATION.unpack_from(data, place)
            name, home, value = symbols[which >> 32]
            kind = which & 0xFFFFFFFF
            if (home and home not in starts) or (not home and kind != _RELATIVE_CALL):
                raise LinkError(f"{name or 'a symbol'} is neither here nor a function to call")
            target = (starts[home] + value if home else jumps[name]) + addend
            at = starts[section.info] + offset
            if kind in {_RELATIVE, _RELATIVE_CALL}:
                struct.pack_into("<i", content, at, target - at)
            elif kind == _ABSOLUTE_64 and at >= n_constant:
                addresses.append((at, target))
            else:
                raise LinkError(f"relocation {kind} of {name or 'a section'} is unknown")
    exports = {name: starts[home] + value for name, home, value in symbols if name and home in starts}
    return Linked(bytes(content), n_constant, exports, imports, addresses)
