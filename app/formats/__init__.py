"""File formats of the field: BSDF tables (Lumicept .ddr, Zemax .bsdf), scattered points (CSV), raysets (HDF5).

A fault in a file raises `FormatError`, whose message is one line. A file is written completely or not at all. Readers return
arrays: BSDF in 1/sr, angles in degrees, in specular coordinates (radial = theta, azimuth = phi). `registry` has what each
format holds. A codec is loaded at its first use, and so are the names of this package: the help of commands needs neither.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.app.formats.ddr import DdrTable as DdrTable
    from goniotwin.app.formats.ddr import bsdf as bsdf
    from goniotwin.app.formats.ddr import read_ddr as read_ddr
    from goniotwin.app.formats.ddr import write_ddr as write_ddr
    from goniotwin.app.formats.file import FormatError as FormatError
    from goniotwin.app.formats.points import Points as Points
    from goniotwin.app.formats.points import PointStream as PointStream
    from goniotwin.app.formats.points import read_points_csv as read_points_csv
    from goniotwin.app.formats.points import write_points_csv as write_points_csv
    from goniotwin.app.formats.rayset import read_rayset as read_rayset
    from goniotwin.app.formats.rayset import write_rayset as write_rayset
    from goniotwin.app.formats.table import BsdfTable as BsdfTable
    from goniotwin.app.formats.zemax import ZemaxBsdf as ZemaxBsdf
    from goniotwin.app.formats.zemax import read_zemax as read_zemax
    from goniotwin.app.formats.zemax import write_zemax as write_zemax
else:
    __getattr__, __dir__ = first_use(__name__)
