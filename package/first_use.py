"""Public names of a package that are loaded at their first use (PEP 562): a command loads the modules that it needs alone.

A package writes each name once, as an import for checkers and readers, which is also where it is loaded from:

    if TYPE_CHECKING:
        from goniotwin.twin.rig import VirtualRig as VirtualRig
    else:
        __getattr__, __dir__ = first_use(__name__)

One that has another name in the package is imported without `as`, and assigned: `open = open_dataset`.
"""

import ast
import builtins
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any


def first_use(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The `__getattr__` and `__dir__` of a package. Its source is read at the first name that is not loaded yet."""
    module = sys.modules[package]
    homes: dict[str, tuple[str, str]] = {}

    def names() -> list[str]:
        if not homes:
            homes.update(_homes(module.__spec__.loader.get_data(module.__file__)))  # type: ignore[union-attr]  # a package has both
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


def _homes(source: bytes) -> dict[str, tuple[str, str]]:
    """By public name the module that has it and its name there, from the imports for types of a package's source."""
    block = next(
        each for each in ast.parse(source).body if isinstance(each, ast.If) and ast.unparse(each.test) == "TYPE_CHECKING"
    )
    imported: dict[str, tuple[str, str]] = {}
    public: dict[str, tuple[str, str]] = {}
    for each in block.body:
        match each:
            case ast.ImportFrom(module=str(home), names=names):
                imported.update({alias.asname or alias.name: (home, alias.name) for alias in names})
                public.update({alias.name: (home, alias.name) for alias in names if alias.asname == alias.name})
            case ast.Assign(targets=[ast.Name(id=name)], value=ast.Name(id=own)):
                public[name] = imported[own]
    return public
