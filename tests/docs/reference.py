"""The extension of the site that makes the pages of the reference, as a module."""

import importlib.util
from functools import cache
from types import ModuleType

from tests.docs.snippets import DOCS


@cache
def reference() -> ModuleType:
    """`docs/extensions/reference.py`, which is in no package."""
    spec = importlib.util.spec_from_file_location("reference", DOCS / "extensions" / "reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
