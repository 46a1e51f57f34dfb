"""Tolerances of the instrument (paper, section 3.3): limits of each deviation alone, of all combinations, and common ones.

`study` reads a study file, `stages` and `drawing` are the paper's stages and what goes beyond them, over any response of the
instrument. `lobe` and `light` are these responses. `tolerances` does a whole study, `report` presents it.
"""
