"""GraphML of uniform undirected graphs: written and read as columns, without a graph's objects.

The bytes are those that networkx writes with ``prettyprint`` and ``named_key_ids``; networkx itself
takes ten times longer.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import escape

__all__ = ["GraphColumns", "parse_long", "read_graphml", "write_graphml"]

_HEAD = """<?xml version='1.0' encoding='utf-8'?>
<graphml xmlns="http://graphml.graphdrawing.org/xmlns" \
xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:schemaLocation="http://graphml.graphdrawing.org/xmlns \
http://graphml.graphdrawing.org/xmlns/1.0/graphml.xsd">
"""
_TYPES = {bool: "boolean", int: "long", float: "double", str: "string"}


def parse_long(text: str) -> int:
    """Return a whole number of 64 bits, as GraphML's ``long`` has.

    Raises
    ------
    ValueError
        For one beyond, or none.
    """
    value = int(text)
    if not -(2**63) <= value < 2**63:
        raise ValueError(f"{text!r} is no whole number of 64 bits")
    return value


_PARSE: dict[str, Callable] = {
    **dict.fromkeys(("int", "long"), parse_long),
    **dict.fromkeys(("float", "double"), float),
    "string": str,
    "boolean": lambda text: text.lower() in ("true", "1"),
}


@dataclass
class GraphColumns:
    """A graph whose nodes all have the same attributes, as all edges have.

    Attributes
    ----------
    attributes : dict of str to str, int, float or bool
        Of the graph.
    ids : list of str
        Of the nodes.
    nodes : dict of str to list
        Attribute to its value at each node.
    edges : list of tuple of str
        Ids of the two nodes of each edge.
    edge_data : dict of str to list
        Attribute to its value at each edge.
    """

    attributes: dict
    ids: list
    nodes: dict
    edges: list
    edge_data: dict


def write_graphml(path: str | os.PathLike, graph: GraphColumns) -> None:
    """Write a graph; edges come by their first node, as networkx lists them.

    Parameters
    ----------
    path : path-like
    graph : GraphColumns
    """
    place = {name: row for row, name in enumerate(graph.ids)}
    edges = [(a, b) if place[a] <= place[b] else (b, a) for a, b in graph.edges]
    order = sorted(range(len(edges)), key=lambda row: place[edges[row][0]])
    keys = [("graph", name, value) for name, value in graph.attributes.items()]
    for kind, columns in (("node", graph.nodes), ("edge", graph.edge_data)):
        keys += [(kind, name, values[0]) for name, values in columns.items() if values]
    lines = [
        f'  <key id="{name}" for="{kind}" attr.name="{name}" attr.type="{_TYPES[type(value)]}" />\n'
        for kind, name, value in reversed(keys)
    ]
    node = ['    <node id="%s">\n', *map(_template, graph.nodes), "    </node>\n"]
    edge_parts = ['    <edge source="%s" target="%s">\n', *map(_template, graph.edge_data)]
    edge = "".join([*edge_parts, "    </edge>\n"])
    node_columns = [graph.ids, *(map(_text, values) for values in graph.nodes.values())]
    edge_columns = [[ends[0] for ends in edges], [ends[1] for ends in edges]]
    edge_columns += [list(map(_text, values)) for values in graph.edge_data.values()]
    edge_columns = [[column[row] for row in order] for column in edge_columns]
    own = "".join(
        f'    <data key="{name}">{_text(value)}</data>\n'
        for name, value in graph.attributes.items()
    )
    Path(path).write_text(
        _HEAD
        + "".join(lines)
        + '  <graph edgedefault="undirected">\n'
        + "".join(map("".join(node).__mod__, zip(*node_columns, strict=True)))
        + "".join(map(edge.__mod__, zip(*edge_columns, strict=True)))
        + own
        + "  </graph>\n</graphml>\n",
        encoding="utf-8",
    )


def _template(name: str) -> str:
    return f'      <data key="{name}">%s</data>\n'


def _text(value: object) -> str:
    return escape(value) if isinstance(value, str) else str(value)


def read_graphml(path: str | os.PathLike) -> GraphColumns:
    """Read a graph; attributes that only some nodes or edges have are left out.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    GraphColumns

    Raises
    ------
    SyntaxError, ValueError
        If the file is no GraphML.
    """
    try:
        root = ElementTree.parse(path).getroot()
    except LookupError as error:  # an encoding that Python does not know
        raise ValueError(str(error)) from error
    graph = root.find("{*}graph")
    if graph is None:
        raise ValueError("there is no graphml with a graph in it")
    keys = {}
    for key in root.iterfind("{*}key"):
        kind = key.get("attr.type", "string")
        if kind not in _PARSE:
            raise ValueError(f"{kind!r} is no type of an attribute")
        keys[key.get("id")] = key.get("attr.name"), _PARSE[kind]

    def data(element: ElementTree.Element) -> dict:
        values = {}
        for item in element.iterfind("{*}data"):
            if item.get("key") not in keys:
                raise ValueError(f"no key {item.get('key')!r} is declared")
            name, parse = keys[item.get("key")]
            values[name] = parse(item.text or "")
        return values

    nodes, edges = graph.findall("{*}node"), graph.findall("{*}edge")
    return GraphColumns(
        data(graph),
        [node.get("id") for node in nodes],
        _shared(list(map(data, nodes))),
        [(edge.get("source"), edge.get("target")) for edge in edges],
        _shared(list(map(data, edges))),
    )


def _shared(rows: list) -> dict:
    """Columns of what all rows have."""
    names = [name for name in (rows[0] if rows else ()) if all(name in row for row in rows)]
    return {name: [row[name] for row in rows] for name in names}
