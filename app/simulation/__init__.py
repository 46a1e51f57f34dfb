"""The instrument's BSDF without devices: the paper's scheme of figure 7, and its Table 3 beside ours.

`simulate` goes from a sample and grids over throughputs of etalon and sample to files; `table3` holds the virtual
prototype against the theory of a Gaussian, without deviations and with the worst of them.
"""
