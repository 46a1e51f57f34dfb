"""Files of the field, read and written: BSDF tables (Lumicept .ddr, Zemax .bsdf), scattered points (CSV), raysets (HDF5).

Whatever is wrong with a file is a `FormatError` of one line. Files appear whole or not at all. The rest of the program
gets arrays: BSDF in 1/sr, angles in degrees, in specular coordinates (radial = theta, azimuth = phi).
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
