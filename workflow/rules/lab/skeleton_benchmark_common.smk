# What the rules of the benchmarks share.

SKELETON_BENCHMARK = SETTINGS["benchmark"]["skeleton"]
SKELETON_ROOT = "results/benchmark/skeleton"
# Kind of run of another program to the key of its Python
SKELETON_PEERS = {"peer": "peer_python", "pytlidar": "pytlidar_python"}


def seeds_of(section, first="first_seed", n="n_trees"):
    """Return the seeds that two keys of a benchmark's section ask for."""
    return range(section[first], section[first] + section[n])


def first_trees(key):
    """Return the numbers of the set's trees that one key of the section asks for."""
    return range(min(SKELETON_BENCHMARK[key], SKELETON_BENCHMARK["n_trees"]))


def kinds_of_peers():
    """Return the kinds of runs of other programs whose Python is given."""
    return [kind for kind, key in SKELETON_PEERS.items() if SKELETON_BENCHMARK[key]]


def scores_of_peers():
    """Return the score files of other programs and of ours on the same trees."""
    return [
        f"{SKELETON_ROOT}/{number:02d}/scores_{kind}.json"
        for number in first_trees("n_peer")
        for kind in ("default", *kinds_of_peers())
    ]


def scores_of_skeletons():
    """Return the score files of all runs; the peer's only where its Python is given."""
    kinds = {"default": "n_trees", "paper": "n_paper"}
    kinds |= dict.fromkeys(kinds_of_peers(), "n_peer")
    return [
        f"{SKELETON_ROOT}/{number:02d}/scores_{kind}.json"
        for kind, key in kinds.items()
        for number in first_trees(key)
    ]


def scores_of_trunks():
    """Return the score files of the set with trunks of given radii."""
    return [
        f"{SKELETON_ROOT}/trunks/{round(1000 * radius)}/{number:02d}/scores.json"
        for radius in SKELETON_BENCHMARK["trunk_radii_m"]
        for number in range(SKELETON_BENCHMARK["n_trunk_trees"])
    ]


def methods_of_kind(wildcards):
    """Return the methods of one kind of run; none stands for another program."""
    ours = {
        "paper": ["lbc_paper", "slbc_paper"],
        "default": ["bare_default", "slbc_default"],
    }
    return ours.get(wildcards.kind, [])


def python_of(kind):
    """Return another program's Python for its runs."""
    key = SKELETON_PEERS[kind]
    return lambda wildcards: SKELETON_BENCHMARK[key] if wildcards.kind == kind else ""
