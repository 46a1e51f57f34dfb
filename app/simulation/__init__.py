"""Simulation of BSDF measurements without devices: the paper's scheme of figure 7, and the paper's tables and figures.

`simulate` computes luminance factors of a sample from throughputs of etalon and sample; `paper` compares the virtual prototype
with the theory of a Gaussian sample, without deviations and with the worst of them.
"""
