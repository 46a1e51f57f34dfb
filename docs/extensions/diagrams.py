"""Pictures of graphs: a `mermaid` block of arrows becomes SVG at build time, by Graphviz, in the colours of the page."""

import re
from typing import Any

import pygraphviz
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

ARROW = re.compile(r"\s*([\w.]+) --> ([\w. &]+)")
PAGE_COLOURS = {"black": "currentColor", "white": "none"}


def svg(text: str) -> str:
    """A mermaid graph of arrows, `a --> b & c` a line, as the text of an SVG. Raises ValueError at any other line."""
    graph = pygraphviz.AGraph(directed=True, bgcolor="transparent", nodesep="0.3", ranksep="0.35", title="")
    graph.node_attr.update(shape="box", style="rounded", fontname="sans-serif", fontsize="13", height="0.35")
    graph.edge_attr.update(arrowsize="0.7")
    for line in text.splitlines():
        if line.strip() and line.strip() != "graph TD":
            arrow = ARROW.fullmatch(line)
            if arrow is None:
                raise ValueError(f"{line!r} is not an arrow of a graph")
            for other in arrow[2].split("&"):
                graph.add_edge(arrow[1], other.strip())
    drawn = graph.draw(format="svg", prog="dot").decode()
    drawn = re.sub(r"<title>.*?</title>\n?|<!--.*?-->\n?", "", drawn[drawn.index("<svg") :], flags=re.DOTALL)
    for graphviz, page in PAGE_COLOURS.items():
        drawn = drawn.replace(f'fill="{graphviz}"', f'fill="{page}"').replace(f'stroke="{graphviz}"', f'stroke="{page}"')
    return drawn.replace("<text ", '<text fill="currentColor" ').replace("<svg ", '<svg style="max-width: 100%; height: auto" ')


class Mermaid(SphinxDirective):
    """A graph of arrows in mermaid's notation, which forges draw too."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        return [nodes.raw("", svg("\n".join(self.content)), format="html")]


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("mermaid", Mermaid)
    return {"parallel_read_safe": True}
