"""The kinds of pictures of a dataset: one file each, with the kind's name, and one line here.

Beside them, `choice` has what they share, and `comparison` is the picture of two datasets, which is no kind.

The file of a kind has `describe(dataset, log)`: the description of the picture of chosen values. It raises UserError for values
of which there is no such picture.
"""

KINDS = {
    "cuts": "The plane of incidence for each sigma, with bands of two standard uncertainties.",
    "hemisphere": "All directions for each sigma. The radius is the polar angle; star: the light, +: the specular direction.",
    "polar": "The plane of incidence as a polar diagram.",
    "spectrum": "Some directions over the wavelength.",
}
"""What each kind shows, for the caption of a picture and the help of the command."""
