"""The kinds of pictures of a dataset: one file each, and one line here.

A file has `describe(dataset, log)`: the description of the picture of chosen values. It raises UserError for values of which
there is no such picture.
"""

KINDS = {
    "cuts": "The plane of incidence for each sigma, with bands of two standard uncertainties.",
    "hemisphere": "All directions for each sigma. The radius is the polar angle; star: the light, +: the specular direction.",
    "polar": "The plane of incidence as a polar diagram.",
    "spectrum": "Some directions over the wavelength.",
}
"""What each kind shows, for the caption of a picture and the help of the command."""
