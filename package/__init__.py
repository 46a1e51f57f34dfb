"""goniotwin: BSDF measurement campaigns on a goniophotometer, and their rehearsal on its digital twin.

The public API for scripts and notebooks. Everything is loaded at its first use, so that the import itself costs nothing:

    import goniotwin as g

    d = g.open("my.journal")                               # or any file that can be read; several samples: d["paper"]
    d.bsdf, d.u, d.flags, d.sigma_deg, d.theta_deg         # flat arrays of one length
    s = g.simulate("gaussian:width_deg=5", sigma_deg=[30])   # gives the same type

Whatever a file or an argument can do wrong is raised as `GoniotwinError`: one line with what, where and the remedy.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from goniotwin.app.data.comparison import DatasetComparison, compare, theory
    from goniotwin.app.data.dataset import Dataset
    from goniotwin.app.data.opening import open_dataset as open
    from goniotwin.app.data.plotting import plot
    from goniotwin.app.data.simulation import simulate
    from goniotwin.app.data.values import ValueWithU
    from goniotwin.app.errors import GoniotwinError

    __version__: str

__all__ = [
    "Dataset",
    "DatasetComparison",
    "GoniotwinError",
    "ValueWithU",
    "__version__",
    "compare",
    "open",
    "plot",
    "simulate",
    "theory",
]

_HOMES = {
    "Dataset": ("goniotwin.app.data.dataset", "Dataset"),
    "DatasetComparison": ("goniotwin.app.data.comparison", "DatasetComparison"),
    "GoniotwinError": ("goniotwin.app.errors", "GoniotwinError"),
    "ValueWithU": ("goniotwin.app.data.values", "ValueWithU"),
    "compare": ("goniotwin.app.data.comparison", "compare"),
    "open": ("goniotwin.app.data.opening", "open_dataset"),
    "plot": ("goniotwin.app.data.plotting", "plot"),
    "simulate": ("goniotwin.app.data.simulation", "simulate"),
    "theory": ("goniotwin.app.data.comparison", "theory"),
}


def __getattr__(name: str) -> Any:
    """Load a public name at its first use (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("goniotwin")
    elif name in _HOMES:
        module, attribute = _HOMES[name]
        value = getattr(import_module(module), attribute)
    else:
        raise AttributeError(f"module 'goniotwin' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
