"""Config keys of the last release, read as the keys that replace them; gone with the next."""

from __future__ import annotations

from collections.abc import MutableMapping

__all__ = ["take_old_keys"]

_MOVED = (  # from `contract` to `skeleton`, names kept
    *("weights", "initial_contraction", "initial_attraction", "attraction_rule", "amplification"),
    *("max_contraction", "max_attraction", "min_weight", "termination_ratio", "max_iterations"),
    *("n_neighbors", "mollify_factor"),
)


def take_old_keys(config: MutableMapping) -> list[str]:
    """Rename old keys in place, and say in a line each what replaces them.

    `skeleton.method` follows from three: `graph.method: tree` and `contract.preset: default` are
    limbs, `mst`, `paper` and `contract.method: lbc` alone are the contraction. A new key that is
    there wins.
    """
    contract, graph = config.get("contract"), config.get("graph")
    contract = contract if isinstance(contract, MutableMapping) else {}
    graph = graph if isinstance(graph, MutableMapping) else {}
    old = {
        f"{section}.{name}": place.pop(name)
        for section, place, names in (
            ("contract", contract, ("preset", "method")),
            ("graph", graph, ("method",)),
        )
        for name in names
        if name in place
    }
    moved = {name: contract.pop(name) for name in _MOVED if name in contract}
    if not (old or moved):
        return []
    skeleton = config["skeleton"] = dict(config.get("skeleton") or {})
    lines = []
    if old:
        said = ", ".join(f"{key}: {value}" for key, value in old.items())
        if "method" in skeleton:
            lines.append(f"{said} does nothing beside skeleton.method, which replaces it")
        else:
            skeleton["method"] = _method(old)
            lines.append(f"{said} is now skeleton.method: {skeleton['method']}")
    for name, value in moved.items():
        if value is not None:  # null was the method's own constant
            lines.append(f"contract.{name} is now skeleton.{name}")
            skeleton.setdefault(name, value)
    return [f"{line}; the old key goes with the next release" for line in lines]


def _method(old: dict) -> str:
    contraction = old.get("contract.method", "slbc")
    if "graph.method" in old:
        return contraction if old["graph.method"] == "mst" else "limbs"
    if "contract.preset" in old:
        return contraction if old["contract.preset"] == "paper" else "limbs"
    return contraction
