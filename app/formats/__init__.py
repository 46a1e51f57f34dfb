"""File formats of the field: BSDF tables (Lumicept .ddr, Zemax .bsdf), scattered points (CSV), raysets (HDF5).

A fault in a file raises `FormatError`, whose message is one line. A file is written completely or not at all. Readers return
arrays: BSDF in 1/sr, angles in degrees, in specular coordinates (radial = theta, azimuth = phi).
"""

from goniotwin.app.formats.ddr import DdrTable, bsdf, read_ddr, write_ddr
from goniotwin.app.formats.file import FormatError
from goniotwin.app.formats.points import Points, read_points_csv, write_points_csv
from goniotwin.app.formats.rayset import read_rayset, write_rayset
from goniotwin.app.formats.zemax import ZemaxBsdf, read_zemax, write_zemax

__all__ = [
    "DdrTable",
    "FormatError",
    "Points",
    "ZemaxBsdf",
    "bsdf",
    "read_ddr",
    "read_points_csv",
    "read_rayset",
    "read_zemax",
    "write_ddr",
    "write_points_csv",
    "write_rayset",
    "write_zemax",
]
