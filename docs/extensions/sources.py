"""Links to files of the repository that are no pages: to the address in `source_address`, or a plain path while it is empty."""

from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform


class SourceLinks(SphinxTransform):
    """Replaces links to files outside the folder of the pages, before Sphinx would copy these into the site."""

    default_priority = 300

    def apply(self, **_: Any) -> None:
        pages = Path(self.app.srcdir)
        folder = (pages / self.env.docname).parent
        for link in list(self.document.findall(addnodes.download_reference)):
            target = link["reftarget"]
            path = (pages / target.lstrip("/") if target.startswith("/") else folder / target).resolve()
            if path.is_relative_to(pages) or not path.is_relative_to(pages.parent):
                continue
            name = path.relative_to(pages.parent).as_posix()
            if address := self.config.source_address:
                new = nodes.reference("", "", *link.children, refuri=f"{address.rstrip('/')}/{name}", internal=False)
                link.replace_self(new)
            elif link.astext() == name:
                link.replace_self(nodes.literal("", name))
            else:
                link.replace_self([*link.children, nodes.Text(" in "), nodes.literal("", name)])


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_config_value("source_address", "", "env", str)
    app.add_transform(SourceLinks)
    return {"parallel_read_safe": True}
