"""GraphML of uniform undirected graphs, read as columns: from any writer, and hostile files too."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from xml.etree import ElementTree

__all__ = ["GraphColumns", "parse_long", "read_graphml"]


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
