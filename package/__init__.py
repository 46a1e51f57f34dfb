"""goniotwin: BSDF measurement campaigns on a goniophotometer, and their rehearsal on its digital twin.

The public API for scripts and notebooks. Everything is loaded at its first use, so that the import itself costs nothing:

    import goniotwin

    reduced = goniotwin.reduce_journal("my.journal")       # reduced.samples["paper"].bsdf, .u_bsdf, .flags
    simulation = goniotwin.simulate("gaussian:width_deg=5", sigma_deg=[30])

Whatever a file or an argument can do wrong is raised as `UserError`: one line with what, where and the remedy.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from goniotwin.app.errors import UserError
    from goniotwin.app.scripting import open_journal, reduce_journal, simulate

    __version__: str

__all__ = ["UserError", "__version__", "open_journal", "reduce_journal", "simulate"]

_HOMES = {
    "UserError": "goniotwin.app.errors",
    "open_journal": "goniotwin.app.scripting",
    "reduce_journal": "goniotwin.app.scripting",
    "simulate": "goniotwin.app.scripting",
}


def __getattr__(name: str) -> Any:
    """Load a public name at its first use (PEP 562)."""
    if name == "__version__":
        value: Any = version("goniotwin")
    elif name in _HOMES:
        value = getattr(import_module(_HOMES[name]), name)
    else:
        raise AttributeError(f"module 'goniotwin' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
