"""GraphML of uniform undirected graphs: written and read as columns, without a graph's objects.

The bytes are those that networkx writes with ``prettyprint`` and ``named_key_ids``. A file of
another layout, as other tools write it, is read by networkx.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

__all__ = ["GraphColumns", "read_graphml", "write_graphml"]

_HEAD = """<?xml version='1.0' encoding='utf-8'?>
<graphml xmlns="http://graphml.graphdrawing.org/xmlns" \
xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:schemaLocation="http://graphml.graphdrawing.org/xmlns \
http://graphml.graphdrawing.org/xmlns/1.0/graphml.xsd">
"""
_TYPES = {bool: "boolean", int: "long", float: "double", str: "string"}
_KEY = re.compile(
    r' *<key id="([^"&]+)" for="(graph|node|edge)" attr\.name="([^"&]+)" '
    r'attr\.type="(boolean|long|double|string)" />\n'
)
_DATA = re.compile(r' *<data key="([^"&]+)">([^<&]*)</data>\n')
_PARSE = {
    "long": int,
    "double": float,
    "string": str,
    "boolean": {"True": True, "False": False}.get,
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
    node_columns = [graph.ids, *map(_texts, graph.nodes.values())]
    edge_columns = [[ends[0] for ends in edges], [ends[1] for ends in edges]]
    edge_columns += map(_texts, graph.edge_data.values())
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


def _texts(values: list) -> list[str]:
    return (
        list(map(_text, values))
        if values and isinstance(values[0], str)
        else list(map(str, values))
    )


def read_graphml(path: str | os.PathLike) -> GraphColumns:
    """Read a graph.

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
        text = Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError:
        text = ""
    found = _read_own_layout(text)
    return _read_any(path) if found is None else found


def _read_own_layout(text: str) -> GraphColumns | None:
    """Columns of a file as `write_graphml` writes it, None of any other."""
    start, end = '  <graph edgedefault="undirected">\n', "  </graph>\n</graphml>"
    head, opened, body = text.partition(start)
    body, closed, rest = body.partition(end)
    if not (opened and closed and head.startswith(_HEAD)) or rest.strip():
        return None
    declared, at = {}, len(_HEAD)
    while match := _KEY.match(head, at):
        declared[match[2], match[1]] = match[3], _PARSE[match[4]]
        at = match.end()
    first_edge = body.find("    <edge ")
    after = max(body.rfind("    </edge>\n"), body.rfind("    </node>\n")) + len("    </node>\n")
    split = after if first_edge < 0 else first_edge
    parts = (
        _read_part(body[:split], "node", '<node id="([^"&]*)">', declared),
        _read_part(
            body[split:after], "edge", '<edge source="([^"&]*)" target="([^"&]*)">', declared
        ),
        _read_part(f"    <graph>\n{body[after:]}    </graph>\n", "graph", "<graph>()", declared),
    )
    node_part, edge_part, graph_part = parts
    if at != len(head) or node_part is None or edge_part is None or graph_part is None:
        return None
    (ids,), nodes = node_part
    (sources, targets), edge_data = edge_part
    attributes = {name: values[0] for name, values in graph_part[1].items()}
    return GraphColumns(attributes, ids, nodes, list(zip(sources, targets, strict=True)), edge_data)


def _read_part(text: str, kind: str, opening: str, declared: dict) -> tuple | None:
    """Ids and columns of elements that follow one another and have one layout, None of others."""
    n_ids = opening.count("(")
    if not text:
        return [[] for _ in range(n_ids)], {}
    first = text[: text.find(f"    </{kind}>\n")]
    names = [match[1] for match in _DATA.finditer(first)]
    if len(set(names)) < len(names) or any((kind, name) not in declared for name in names):
        return None
    layout = "".join(
        [f" *{opening}\n", *(rf' *<data key="{re.escape(n)}">([^<&]*)</data>\n' for n in names)]
    )
    layout += f" *</{kind}>\n"
    if re.fullmatch(f"(?:{layout.replace('(', '(?:')})+", text) is None:
        return None
    rows = re.findall(layout, text)
    columns = list(zip(*rows, strict=True)) if n_ids + len(names) > 1 else [tuple(rows)]
    values = {}
    for name, column in zip(names, columns[n_ids:], strict=True):
        attribute, parse = declared[kind, name]
        values[attribute] = list(map(parse, column))
    return [list(column) for column in columns[:n_ids]], values


def _read_any(path: str | os.PathLike) -> GraphColumns:
    """Columns by networkx; attributes that only some nodes or edges have are left out."""
    import networkx as nx  # takes longer to import than our own files to read

    try:
        graph = nx.read_graphml(path)
    except nx.NetworkXError as error:
        raise ValueError(str(error)) from error
    edges, edge_data = list(graph.edges), [data for _, _, data in graph.edges(data=True)]
    attributes = {k: v for k, v in graph.graph.items() if k not in ("node_default", "edge_default")}
    nodes = _shared([data for _, data in graph.nodes(data=True)])
    return GraphColumns(attributes, list(graph.nodes), nodes, edges, _shared(edge_data))


def _shared(rows: list) -> dict:
    """Columns of what all rows have."""
    names = [name for name in (rows[0] if rows else ()) if all(name in row for row in rows)]
    return {name: [row[name] for row in rows] for name in names}
