"""Public names of a package that are loaded at their first use (PEP 562): a command loads the modules that it needs alone.

A package writes each name once, as an import for checkers and readers, which is also where it is loaded from:

    if TYPE_CHECKING:
        from goniotwin.twin.rig import VirtualRig as VirtualRig
    else:
        __getattr__, __dir__ = first_use(__name__)

One that has another name in the package is imported without `as`, and assigned: `open = open_dataset`.
"""

import builtins
import re
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

IMPORT = re.compile(r"^    from (\S+) import (\w+)( as \2)?$", re.MULTILINE)
ASSIGNMENT = re.compile(r"^    (\w+) = (\w+)$", re.MULTILINE)


def first_use(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The `__getattr__` and `__dir__` of a package. Its source is read at the first name that is not loaded yet."""
    module = sys.modules[package]
    homes: dict[str, tuple[str, str]] = {}

    def names() -> list[str]:
        if not homes:
            source = module.__spec__.loader.get_data(module.__file__).decode()  # type: ignore[union-attr]
            imports = {own: (home, public) for home, own, public in IMPORT.findall(source)}
            assigned = {name: (imports[own][0], own) for name, own in ASSIGNMENT.findall(source)}
            homes.update({own: (home, own) for own, (home, public) in imports.items() if public} | assigned)
        return sorted(homes)

    def load(name: str) -> Any:
        if name == "__all__":
            return [each for each in names() if not hasattr(builtins, each)]  # which an import of all would hide
        if name not in names():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home, own = homes[name]
        value = getattr(import_module(home), own)
        setattr(module, name, value)
        return value

    return load, names
