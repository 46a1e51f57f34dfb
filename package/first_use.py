"""Public names of a package that are loaded at their first use (PEP 562): a command loads the modules that it needs alone.

The package imports these names for types, so that checkers and readers see where they come from:

    if TYPE_CHECKING:
        from goniotwin.twin.rig import VirtualRig as VirtualRig
    else:
        __getattr__ = first_use(__name__, {"rig": ("VirtualRig",)})
"""

import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any


def first_use(package: str, homes: Mapping[str, Iterable[str]]) -> Callable[[str], Any]:
    """The `__getattr__` of a package: `homes` has the names by the module of the package that has them."""
    modules = {name: module for module, names in homes.items() for name in names}

    def load(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{modules[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return load
