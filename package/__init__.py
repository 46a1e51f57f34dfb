"""goniotwin: BSDF measurement campaigns on a goniophotometer, and their rehearsal on its digital twin.

The public API for scripts and notebooks. Everything is loaded at its first use, so that the import itself costs nothing:

    import goniotwin as g

    d = g.load("my.journal")                               # or any file that can be read; several samples: d["paper"]
    d.bsdf, d.u, d.flags, d.sigma_deg, d.theta_deg         # flat arrays of one length
    s = g.simulate("gaussian:width_deg=5", sigma_deg=[30])   # gives the same type

`g.open` is the same function as `g.load`; `from goniotwin import *` leaves it out, for it would hide Python's own `open`.
A mistake in a file or an argument raises `GoniotwinError`: one line with what, where and the remedy.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.app.data.comparison import DatasetComparison as DatasetComparison
    from goniotwin.app.data.comparison import compare as compare
    from goniotwin.app.data.comparison import theory as theory
    from goniotwin.app.data.dataset import Dataset as Dataset
    from goniotwin.app.data.opening import open_dataset
    from goniotwin.app.data.plotting import plot as plot
    from goniotwin.app.data.simulation import simulate as simulate
    from goniotwin.app.data.values import ValueWithU as ValueWithU
    from goniotwin.app.errors import GoniotwinError as GoniotwinError
    from goniotwin.version import __version__ as __version__

    load = open_dataset
    open = open_dataset
else:
    __getattr__, __dir__ = first_use(__name__)
