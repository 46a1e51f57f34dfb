"""The schedule: the file in which the operator states the measurements, its grids, and the certificate of the etalon."""
