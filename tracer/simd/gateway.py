"""Numba's inner modules as untyped names.

Numba annotates parts of its extending API for other readers than a strict type checker (an `intrinsic` is described
by its typing function, not by its call). Here every such module is imported once, as ``Any``, and after
:mod:`tracer.jit`, which decides where compiled code is kept.
"""

from importlib import import_module
from typing import Any, Final

import tracer.jit  # noqa: F401 - first

cgutils: Final[Any] = import_module("numba.core.cgutils")
types: Final[Any] = import_module("numba.core.types")
models: Final[Any] = import_module("numba.core.datamodel.models")
_extending: Final[Any] = import_module("numba.extending")
_templates: Final[Any] = import_module("numba.core.typing.templates")

intrinsic: Final[Any] = _extending.intrinsic
lower_builtin: Final[Any] = _extending.lower_builtin
register_model: Final[Any] = _extending.register_model
lower_getattr_generic: Final[Any] = import_module("numba.core.imputils").lower_getattr_generic
AttributeTemplate: Final[Any] = _templates.AttributeTemplate
infer_getattr: Final[Any] = _templates.infer_getattr
AbstractTemplate: Final[Any] = _templates.AbstractTemplate
infer_global: Final[Any] = _templates.infer_global
signature: Final[Any] = _templates.signature
