"""A figure as a PNG, whole or not at all."""

import io
from pathlib import Path

from matplotlib.figure import Figure

from goniotwin.app.errors import UserError
from goniotwin.app.formats import FormatError
from goniotwin.app.formats.whole_file import write_whole


def save(figure: Figure, path: Path, dots_an_inch: int | None = None) -> None:
    """With the figure's own resolution unless told. Raises UserError where no file can be written."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi="figure" if dots_an_inch is None else dots_an_inch)
    try:
        write_whole(path, content.getvalue())
    except FormatError as error:
        raise UserError(str(error)) from None
